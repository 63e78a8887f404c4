"""Calls services of the node. Arguments: LOG RUNS_LOG WAIT SERVICE …

WAIT is the number of commands that must have left before the first call; the others follow each
other after 0.5 s. The first call of ~/estop is the fault.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import rclpy
from std_srvs.srv import Trigger

from unicon_ros.bench.faults.command_log import FAULT, RECV, CommandLog

PATIENCE = 30.0  # s until the service is there and an answer has come
SHORT = 6.0  # s for an answer: a node that hangs gives none


def main() -> None:
    """Run until all was called."""
    log, runs = CommandLog(Path(sys.argv[1])), CommandLog(Path(sys.argv[2]))
    wait, words = int(sys.argv[3]), sys.argv[4:]
    rclpy.init()
    node = rclpy.create_node("caller")
    clients = {word: node.create_client(Trigger, f"/unicon/{word}") for word in words}
    if not clients[words[0]].wait_for_service(timeout_sec=PATIENCE):
        sys.exit(f"no service ~/{words[0]}")
    end = time.monotonic() + PATIENCE
    while runs.of(RECV).size < wait and time.monotonic() < end:
        time.sleep(0.001)
    marked = False
    for word in words:
        if not clients[word].wait_for_service(timeout_sec=1.0):
            print(f"{word}: no such service", flush=True)
            continue
        if word == "estop" and not marked:
            log.add(FAULT)
            marked = True
        answer = clients[word].call_async(Trigger.Request())
        rclpy.spin_until_future_complete(node, answer, timeout_sec=SHORT)
        print(f"{word}: {answer.result()}", flush=True)
        time.sleep(0.5)
    time.sleep(0.5)


main()
