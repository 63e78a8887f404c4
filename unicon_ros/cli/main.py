"""`unicon`: parses the command line and runs one command.

Exit status: 0 done, 1 bad input, 2 usage, 3 fault. Nothing heavy is imported before a command needs
it: `unicon --help` loads neither rclpy, MuJoCo nor onnxruntime.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

import unicon_core
from unicon_core.errors import UniconError
from unicon_ros.cli import bench, check, known, run, show

__all__ = ["main"]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="unicon",
        description="Run learned robot controllers on simulators and robots, mirrored to ROS 2.",
    )
    parser.add_argument("--version", action="version", version=unicon_core.__version__)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for command in (run, check, show, bench, known):
        command.add(commands)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status.

    Args:
        argv: arguments without the program's name; those of the process if None.
    """
    arguments = _parser().parse_args(argv)
    try:
        return int(arguments.function(arguments))
    except UniconError as error:
        print(f"unicon: error: {error}", file=sys.stderr)
        return 1
    except _map_errors() as error:
        print(f"unicon: error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader has gone (`unicon show … | head`): nobody is left to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _map_errors() -> tuple[type[Exception], ...]:
    """Return the errors of the message map where it was loaded: loading it here costs 50 ms."""
    errors = sys.modules.get("unicon_msgs_map.errors")
    return () if errors is None else (errors.MapError,)
