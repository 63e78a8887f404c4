"""`unicon_node`: the executable of the lifecycle node.

Exit status: 0 ended by SIGINT, SIGTERM or a shutdown, 1 bad input at start, 3 a fault with the
parameter `exit_on_fault`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from unicon_base import UniconError, one_line
from unicon_core.non_blocking_writer import open_standard_files, relayed_stderr
from unicon_core.signals import SIGNALS, Interrupted
from unicon_ros import compat
from unicon_ros.process_exit import exit_with_parent

USAGE = """\
usage: unicon_node [--end-with PID|parent|nobody] --ros-args -p workflow:=NAME [-p name:=value …]
         [-r from:=to …]

Runs a workflow as a ROS 2 lifecycle node. With --end-with it gets SIGTERM, which damps, when that
process ends, the one that started it or one further up; so it does without the option under
`ros2 launch`, unless that says nobody. Parameters, with descriptions and ranges:
  ros2 param describe /unicon PARAMETER, or unicon_ros/parameter_table.py.
"""


def main(args: Sequence[str] | None = None) -> int:
    """Run the node.

    Args:
        args: command line without the program's name; that of the process if None.
    """
    open_standard_files()
    with SIGNALS:  # before anything is imported or opened
        return _main(list(sys.argv[1:] if args is None else args))


def _main(arguments: list[str]) -> int:
    try:
        rclpy = compat.import_rclpy("unicon_node")
        own = _without_ros(rclpy, arguments)
        whom = None
        if len(own) == 2 and own[0] == "--end-with":
            whom = own[1]
        elif own:
            if own[0] in ("-h", "--help"):
                print(USAGE, end="")
                return 0
            print(f"unicon_node: unknown argument {own[0]!r}\n{USAGE}", end="", file=sys.stderr)
            return 2
        exit_with_parent(whom)
        return _spin(rclpy, arguments)
    except Interrupted:  # while building: nothing has moved, and all is closed
        return 0
    except UniconError as error:
        print(f"unicon_node: error: {error}", file=sys.stderr)
        return 1


def _without_ros(rclpy: Any, arguments: list[str]) -> list[str]:
    try:
        return list(rclpy.utilities.remove_ros_args(["unicon_node", *arguments]))[1:]
    except Exception as error:
        raise _refused(error) from error


def _refused(error: Exception) -> UniconError:
    text = one_line(error).split(", at /")[0]
    return UniconError(f"{text}; correct the arguments after --ros-args")


def _spin(rclpy: Any, arguments: list[str]) -> int:
    from unicon_ros.bridge.own_node import without_shared_memory
    from unicon_ros.node import UniconNode
    from unicon_ros.process_exit import exit_watchdog

    context = rclpy.context.Context()
    try:
        # Signals are the node's: SIGINT has to damp before ROS goes away.
        no_signals = rclpy.signals.SignalHandlerOptions.NO
        with without_shared_memory():
            rclpy.init(args=arguments, context=context, signal_handler_options=no_signals)
            node = UniconNode(context=context)
    except Exception as error:
        rclpy.try_shutdown(context=context)
        raise _refused(error) from error
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    status = 1
    try:
        with relayed_stderr():
            status = node.spin(executor)
        if status == 1:
            print(f"unicon_node: error: {node.error}", file=sys.stderr)
        return status
    except Interrupted:
        status = 0
        raise
    finally:
        with exit_watchdog(status):
            executor.shutdown()
            node.destroy_node()
            rclpy.try_shutdown(context=context)
