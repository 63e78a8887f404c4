"""Process of plain rclpy nodes: `--variant` robot, controller, events, triggered or both."""

from __future__ import annotations

from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor

from unicon_ros.bench.pipelines.log import Log, Stop, arguments, beside
from unicon_ros.bench.pipelines.plain_nodes import PlainController, PlainRobot


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    stop = Stop()
    received = Log(options.out, "stamp", "received")
    both = options.variant == "both"
    sent = Log(
        beside(options.out, "controller") if both else options.out, "stamp", "seen", "begin", "end"
    )
    heard = Log(beside(sent.path, "heard"), "stamp", "received")
    nodes: list[Any] = []
    if options.variant in ("robot", "both"):
        nodes.append(PlainRobot(options.joints, options.state_rate, options.best_effort, received))
    if options.variant != "robot":
        triggered = options.variant == "triggered"
        every = round(options.state_rate / options.rate) if triggered else 0
        nodes.append(
            PlainController(options.joints, options.rate, every, options.best_effort, sent, heard)
        )
    executor: Any = SingleThreadedExecutor()
    if options.variant == "events":
        from rclpy.experimental import EventsExecutor

        executor = EventsExecutor()
    for node in nodes:
        executor.add_node(node)
    while not stop:
        executor.spin_once(timeout_sec=0.1)
    if options.variant in ("robot", "both"):
        received.save()
    if options.variant != "robot":
        sent.save()
        heard.save()
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
