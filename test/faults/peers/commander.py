"""Says `cmd_vel`: first well, then as the fault tells. Arguments: LOG RUNS_LOG FAULT AT.

FAULT is one of `silence`, `killed` (by SIGKILL), `good` (goes on well), `nan` and `garbage` at
1 kHz, `bits` (random ones in a whole message, at 1 kHz), a number such as 50, or `50 flood` at
1 kHz. It comes once the run has obeyed for AT ticks.
"""

from __future__ import annotations

import math
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import Twist
from rclpy.serialization import serialize_message

from faults.command_log import FAULT, CommandLog
from faults.peers.noise import garbage, random_bits

PATIENCE = 60.0  # s until somebody obeys; a run may take 40 s to start
SAID = 0.3  # m/s; the workflow's own command is another one
LASTS = 2.4  # s
STEADILY, FLOOD = 0.02, 0.001  # s between two messages


def twist(x: float, y: float = 0.0, yaw: float = 0.0) -> Twist:
    """Return a velocity command in [m/s], [rad/s]."""
    message = Twist()
    message.linear.x, message.linear.y, message.angular.z = x, y, yaw
    return message


def main() -> None:
    """Run until all is said."""
    log, runs = CommandLog(Path(sys.argv[1])), CommandLog(Path(sys.argv[2]))
    fault, at = sys.argv[3], int(sys.argv[4])
    rclpy.init()
    node = rclpy.create_node("commander")
    publisher = node.create_publisher(Twist, "cmd_vel", 10)

    well, most = twist(SAID), 0 if fault == "good" else at
    end = time.monotonic() + PATIENCE
    while runs.driven(SAID) <= most and time.monotonic() < end:
        publisher.publish(well)
        time.sleep(STEADILY)
    if runs.driven(SAID) <= most:
        sys.exit("nobody obeyed")  # the fault is not reached
    if fault != "good":
        log.add(FAULT)
    if fault == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if fault == "silence":
        time.sleep(LASTS)
    else:
        make, interval = said(fault, well)
        end = time.monotonic() + LASTS
        while time.monotonic() < end:
            publisher.publish(make())
            time.sleep(interval)
    node.destroy_node()
    rclpy.shutdown()


def said(fault: str, well: Twist) -> tuple[Callable[[], Any], float]:
    """Return what makes the messages of a fault, and the time between two of them in [s]."""
    rng, raw = np.random.default_rng(0), serialize_message(well)
    if fault == "good":
        return lambda: well, STEADILY
    if fault == "garbage":
        return lambda: garbage(rng, raw), FLOOD
    if fault == "bits":
        return lambda: random_bits(rng, raw, 6), FLOOD
    number, _, flood = fault.partition(" ")
    value = float(number)
    wrong = twist(value, -value, value)
    return lambda: wrong, FLOOD if flood or math.isnan(value) else STEADILY


main()
