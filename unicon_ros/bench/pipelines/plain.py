"""Process of plain rclpy nodes: `--variant` robot, controller, events, triggered or both."""

from __future__ import annotations

import time
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor

from unicon_ros.bench.pipelines.log import Log, Stop, arguments
from unicon_ros.bench.pipelines.plain_nodes import PlainController, PlainRobot


def main() -> None:
    """Run until the robot has measured for `--seconds`, or until SIGTERM."""
    options = arguments()
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    stop = Stop()
    received = Log("stamp", "received")
    sent = Log("stamp", "seen", "begin", "end")
    robot: PlainRobot | None = None
    nodes: list[Any] = []
    if options.variant in ("robot", "both"):
        robot = PlainRobot(options.joints, options.state_rate, options.best_effort, received)
        nodes.append(robot)
    if options.variant != "robot":
        triggered = options.variant == "triggered"
        every = round(options.state_rate / options.rate) if triggered else 0
        nodes.append(
            PlainController(options.joints, options.rate, every, options.best_effort, sent)
        )
    executor: Any = SingleThreadedExecutor()
    if options.variant == "events":
        from rclpy.experimental import EventsExecutor

        executor = EventsExecutor()
    for node in nodes:
        executor.add_node(node)
    deadline = 0
    while not stop:
        executor.spin_once(timeout_sec=0.1)
        # The measurement starts half a second after the first command: discovery is over then.
        log = received if robot is not None else sent
        if log.count and not deadline:
            deadline = time.time_ns() + 500_000_000 + round(options.seconds * 1e9)
            received.start_cpu()
            sent.start_cpu()
        if robot is not None and deadline and time.time_ns() > deadline:
            break
    if robot is not None:
        received.save(options.out)
    if options.variant != "robot":
        name = f"{options.out.stem}_controller" if robot is not None else options.out.stem
        sent.save(options.out.with_name(f"{name}.npz"))
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
