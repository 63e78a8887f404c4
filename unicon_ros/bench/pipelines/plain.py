"""Process of plain rclpy nodes, which spin.

`--variant` robot, controller, events, triggered, both, mirror, observer or threads: a controller
with a thread that spins, as UniCon bridges ROS, `spin_once`, then sleep. This is our own baseline
of that style: one message is taken for each pass of the spinning thread, so a queue of depth 10
stays full of old states. The loop runs at its rate beside it and sends.
"""

from __future__ import annotations

import argparse
import threading
import time
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from unicon_ros.bench.pipelines.log import Log, Stop, arguments, beside
from unicon_ros.bench.pipelines.plain_nodes import (
    Controller,
    PlainController,
    PlainMirror,
    PlainObserver,
    PlainRobot,
)

SPIN_PERIOD = 0.002  # s between two passes of the spinning thread


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    stop = Stop()
    nodes, logs = _nodes(options)
    executor: Any = SingleThreadedExecutor()
    if options.variant == "events":
        from rclpy.experimental import EventsExecutor

        executor = EventsExecutor()
    for node in nodes:
        executor.add_node(node)
    if isinstance(nodes[0], Controller) and options.variant == "threads":
        _send_beside(executor, nodes[0], 1.0 / options.rate, stop)
    while not stop:
        executor.spin_once(timeout_sec=0.1)
    for log in logs:
        log.save()
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


def _send_beside(executor: Any, node: Controller, period: float, stop: Stop) -> None:
    """Send at a rate, beside a thread that spins, until SIGTERM."""

    def spin() -> None:
        while not stop:
            executor.spin_once(timeout_sec=0.0)
            time.sleep(SPIN_PERIOD)

    thread = threading.Thread(target=spin)
    thread.start()
    due = time.monotonic() + period
    while not stop:
        time.sleep(max(0.0, due - time.monotonic()))
        due = max(due + period, time.monotonic())
        node.send()
    thread.join()


def _nodes(options: argparse.Namespace) -> tuple[list[Node], list[Log]]:
    """Return the nodes of a variant, and their logs."""
    joints, state_rate, best_effort = options.joints, options.state_rate, options.best_effort
    received, published = Log(options.out, "stamp", "received"), Log(options.out, "begin", "end")
    if options.variant == "mirror":
        return [PlainMirror(joints, state_rate, best_effort, published)], [published]
    if options.variant == "observer":
        return [PlainObserver(best_effort, received)], [received]
    nodes: list[Node] = []
    logs: list[Log] = []
    sent_file = options.out
    if options.variant in ("robot", "both"):
        nodes.append(PlainRobot(joints, state_rate, best_effort, received))
        logs.append(received)
        sent_file = beside(options.out, "controller")
    if options.variant != "robot":
        sent = Log(sent_file, "stamp", "seen", "begin", "end")
        if options.variant == "threads":
            return [Controller(joints, best_effort, sent, depth=10)], [sent]
        heard = Log(beside(sent_file, "heard"), "stamp", "received")
        every = round(state_rate / options.rate) if options.variant == "triggered" else 0
        nodes.append(PlainController(joints, options.rate, every, best_effort, sent, heard))
        logs += [sent, heard]
    return nodes, logs


if __name__ == "__main__":
    main()
