"""Says `cmd_vel`: first well, then as the fault tells. Arguments: LOG RUNS_LOG FAULT.

FAULT is one of `nan`, `silence`, `50`, `1e30`, `good` (goes on well).
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path

import rclpy
from geometry_msgs.msg import Twist

from unicon_ros.bench.faults.command_log import FAULT, CommandLog

PATIENCE = 30.0  # s until somebody listens


def main() -> None:
    """Run until all is said."""
    log, fault = CommandLog(Path(sys.argv[1])), sys.argv[3]
    rclpy.init()
    node = rclpy.create_node("commander")
    publisher = node.create_publisher(Twist, "cmd_vel", 10)
    end = time.monotonic() + PATIENCE
    while not publisher.get_subscription_count() and time.monotonic() < end:
        time.sleep(0.02)
    said = Twist()
    said.linear.x = 0.3

    def repeat(seconds: float, interval: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            publisher.publish(said)
            time.sleep(interval)

    repeat(1.2, 0.02)
    if fault != "good":
        log.add(FAULT)
    if fault == "silence":
        time.sleep(1.6)
    elif fault == "nan":
        said.linear.x = math.nan
        repeat(1.6, 0.001)
    else:
        if fault != "good":
            said.linear.x, said.linear.y, said.angular.z = float(fault), -float(fault), float(fault)
        repeat(1.6, 0.02)
    node.destroy_node()
    rclpy.shutdown()


main()
