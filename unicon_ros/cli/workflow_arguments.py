"""Arguments that several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from unicon_ros.view import LOCAL, PORT


def add_workflow(parser: argparse.ArgumentParser) -> None:
    """Add WORKFLOW and `--set`."""
    parser.add_argument("workflow", metavar="WORKFLOW", help="name in config/workflows/, or a path")
    add_overrides(parser)


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """Add `--set`."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        dest="overrides",
        help="override a value, such as platform=fake, safety.0=finite or "
        "policies.walk.given.action.scale=0.5 (repeatable)",
    )


def positive(text: str) -> float:
    """Return an argument that is a number > 0, such as a duration in [s] or a rate in [Hz]."""
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a number > 0")
    return value


def count_to(most: int) -> Callable[[str], int]:
    """Return what reads an argument that is a whole number from 1 to `most`."""

    def count(text: str) -> int:
        number = int(text)
        if not 1 <= number <= most:
            raise argparse.ArgumentTypeError(f"{text} is not a number from 1 to {most}")
        return number

    return count


def quality(text: str) -> int:
    """Return an argument that is the quality of a JPEG."""
    number = int(text)
    if not 1 <= number <= 100:
        raise argparse.ArgumentTypeError(f"{text} is not a quality of a JPEG; give 1 to 100")
    return number


def port(text: str) -> int:
    """Return an argument that is a number of a port, 0 for any that is free."""
    number = int(text)
    if not 0 <= number <= 65535:
        raise argparse.ArgumentTypeError(f"{text} is not a port; give 1 to 65535, or 0 for any")
    return number


def add_view_options(parser: argparse.ArgumentParser) -> None:
    """Add where and how a viewer is served."""
    parser.add_argument(
        "--view-host", metavar="HOST", default=LOCAL, help="where the viewer is served"
    )
    parser.add_argument(
        "--view-port",
        metavar="PORT",
        type=port,
        default=PORT,
        help=f"its port (default {PORT}, or the next free one)",
    )
    parser.add_argument(
        "--view-token",
        metavar="TOKEN",
        default="",
        help="what others have to know, for --view-host",
    )
    parser.add_argument(
        "--view-fps", metavar="N", type=positive, default=30.0, help="pictures per second at most"
    )


def view_options(arguments: argparse.Namespace, sink: str = "") -> dict[str, Any]:
    """Return the options of a viewer, for `View`."""
    return {
        "sink": sink or arguments.view,
        "host": arguments.view_host,
        "port": arguments.view_port,
        "token": arguments.view_token,
        "fps": arguments.view_fps,
    }
