"""OwnNode: a node in a ROS context of its own, for a session or a platform without a host.

`calm_middleware_threads` keeps the middleware's threads out of the tick's way.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from unicon_base.errors import UniconError, one_line
from unicon_ros import compat
from unicon_ros.process_exit import exit_watchdog
from unicon_ros.transport import without_shared_memory


class OwnNode:
    """A plain rclpy node and its executor; signals stay with the runner, which damps first.

    Args:
        name: of the node, unless `ros_args` remap it.
        namespace: of the node.
        ros_args: ROS arguments (`-r a:=b`, `-p name:=value`), with or without `--ros-args`.

    Attributes:
        node: the rclpy node.
        executor: a single-threaded executor with the node in it.
        context: their rclpy context.

    Raises:
        MissingDependencyError: rclpy is not installed.
        UniconError: a name or an argument is wrong.
    """

    def __init__(self, name: str, namespace: str | None, ros_args: Sequence[str]) -> None:
        rclpy = self._rclpy = compat.import_rclpy()
        arguments = list(ros_args)
        if arguments and "--ros-args" not in arguments:
            arguments.insert(0, "--ros-args")
        self.context: Any = rclpy.context.Context()
        self._closed = False
        try:
            with without_shared_memory():
                rclpy.init(
                    args=arguments,
                    context=self.context,
                    signal_handler_options=rclpy.signals.SignalHandlerOptions.NO,
                )
                self.node: Any = rclpy.node.Node(name, namespace=namespace, context=self.context)
        except Exception as error:
            rclpy.try_shutdown(context=self.context)
            raise UniconError(
                f"ROS 2 node {name!r} in namespace {namespace or '/'!r} with arguments "
                f"{arguments}: {one_line(error)}; correct the name, the namespace or --ros-args"
            ) from error
        self.executor: Any = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def close(self) -> None:
        """Destroy the node and shut its context down, once."""
        if not self._closed:
            self._closed = True
            # A middleware that never ends is a fault; whoever knows better asks for it sooner.
            with exit_watchdog(3, 20.0):
                self.executor.shutdown()
                self.node.destroy_node()
                self._rclpy.try_shutdown(context=self.context)


def calm_middleware_threads() -> int:
    """Give this process's threads that are not Python's SCHED_BATCH; return how many there were.

    That keeps the threads of DDS from pushing the tick's thread off its core. A write wakes two or
    three of them, each of which preempts the writer: with a reader that hangs, `publish` took 84 µs
    at p50 and 1440 at p99 on a busy machine, with 1.7 forced switches a call. Threads of
    SCHED_BATCH do not preempt on waking (sched(7)): then 63 and 158 µs and none, while they still
    run at once on a free core. It needs no privilege and is not a priority.

    Does nothing where the system has no such thing, or where a thread has a policy of its own.
    """
    if not hasattr(os, "SCHED_BATCH"):
        return 0
    own = {thread.native_id for thread in threading.enumerate()} | {threading.get_native_id()}
    calmed = 0
    try:
        numbers = [int(name) for name in os.listdir("/proc/self/task")]
    except OSError:
        return 0
    for number in numbers:
        if number in own:
            continue
        with suppress(OSError):  # it has ended, or a sandbox forbids it
            if os.sched_getscheduler(number) == os.SCHED_OTHER:
                os.sched_setscheduler(number, os.SCHED_BATCH, os.sched_param(0))
                calmed += 1
    return calmed
