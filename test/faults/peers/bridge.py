"""A bridge in a process of its own, which is lost. Arguments: LOG RUNS_LOG SIGNAL AT WORKFLOW.

The bridge is the workflow's part `desk`, run with `--ros`; this process says `cmd_vel` to it, and
sends it the signal once the run has obeyed and has begun tick AT.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import rclpy
from geometry_msgs.msg import Twist

from faults.command_log import FAULT, SEND, CommandLog
from unicon_core.states.backends.shm import remove_dead
from unicon_ros.process_exit import die_with_parent

PART = "desk"
SAID = 0.3  # m/s; the workflow's own command is another one
PATIENCE = 40.0  # s until the run obeys
LASTS = 2.4  # s


def main() -> None:
    """Run until the fault is over."""
    log, runs = CommandLog(Path(sys.argv[1])), CommandLog(Path(sys.argv[2]))
    number, at, workflow = signal.Signals[sys.argv[3]], int(sys.argv[4]), sys.argv[5]
    command = [sys.executable, "-m", "unicon_ros", "run", workflow, "--part", PART, "--ros"]
    while not runs.of(SEND).size:  # the part with the robot comes first
        time.sleep(0.01)
    desk = subprocess.Popen(command, preexec_fn=die_with_parent)
    rclpy.init()
    node = rclpy.create_node("commander")
    publisher = node.create_publisher(Twist, "cmd_vel", 10)
    said = Twist()
    said.linear.x = SAID
    end = time.monotonic() + PATIENCE
    heard = 0
    while time.monotonic() < end:
        publisher.publish(said)
        time.sleep(0.02)
        heard = runs.driven(SAID)
        if heard > at:
            break
    if heard <= at:
        desk.kill()
        sys.exit("nobody obeyed")  # the fault is not reached
    log.add(FAULT)
    desk.send_signal(number)
    print(f"{number.name} after {heard} commands", flush=True)
    time.sleep(LASTS)
    desk.kill()
    desk.wait()
    store = json.loads(Path(workflow).read_text(encoding="utf-8"))["store"]["shm"]
    remove_dead(f"{store}-{PART}")  # nobody else comes under this name
    rclpy.shutdown()


main()
