"""OwnNode: a node in a ROS context of its own, for a session or a platform without a host."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from unicon_core.errors import UniconError, one_line
from unicon_ros import compat
from unicon_ros.ending import exits_within
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
            with exits_within(3, 20.0):
                self.executor.shutdown()
                self.node.destroy_node()
                self._rclpy.try_shutdown(context=self.context)
