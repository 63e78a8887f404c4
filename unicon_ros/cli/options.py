"""How commands declare their arguments, and the arguments that several of them share."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from unicon_ros.view import LOCAL, PORT, SINKS

REPEATED: dict[str, Any] = {"action": "append", "default": []}
"""Settings of an option that may be given several times."""


def command(
    commands: Any,
    name: str,
    run: Callable[[argparse.Namespace], int],
    what: str,
    description: str | None = None,
    **settings: Any,
) -> Any:
    """Add a command and return its parser.

    Args:
        commands: what `add_subparsers` returned.
        name: of the command.
        run: runs it; takes what was parsed and returns the exit status.
        what: its line in the list of commands.
        description: begins its own help.
        settings: of `argparse.ArgumentParser`.
    """
    parser = commands.add_parser(name, help=what, description=description, **settings)
    parser.set_defaults(function=run)
    return parser


def argument(parser: Any, name: str, metavar: str, what: str, **settings: Any) -> None:
    """Add an argument with a value.

    Args:
        parser: of a command, or a group of its arguments.
        name: `--NAME` of an option, else a positional argument.
        metavar: stands for the value in the help.
        what: the help.
        settings: of `add_argument`, such as `type` and `default`.
    """
    parser.add_argument(name, metavar=metavar, help=what, **settings)


def flag(parser: Any, name: str, what: str, **settings: Any) -> None:
    """Add an option without a value, false unless given; arguments as of `argument`."""
    parser.add_argument(name, action="store_true", help=what, **settings)


def add_workflow(parser: argparse.ArgumentParser) -> None:
    """Add WORKFLOW and `--set`."""
    argument(parser, "workflow", "WORKFLOW", "name in config/workflows/, or a path")
    add_overrides(parser)


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """Add `--set`."""
    argument(
        parser,
        "--set",
        "PATH=VALUE",
        "override a value, such as platform=fake, safety.0=finite or "
        "policies.walk.given.action.scale=0.5 (repeatable)",
        dest="overrides",
        **REPEATED,
    )


def positive(text: str) -> float:
    """Return an argument that is a number > 0, such as a duration in [s] or a rate in [Hz]."""
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a number > 0")
    return value


def seconds(text: str) -> float:
    """Return an argument that is a time >= 0 in [s]."""
    value = float(text)
    if not 0.0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a time >= 0 in [s]")
    return value


def whole(what: str, least: int, most: int, more: str = "") -> Callable[[str], int]:
    """Return what reads an argument that is a whole number within bounds.

    Args:
        what: it is, with its article.
        least: smallest number, 0 or more.
        most: largest number.
        more: ends the message where it is none.
    """

    def number(text: str) -> int:
        if not text.isdecimal() or not least <= int(text) <= most:
            raise argparse.ArgumentTypeError(f"{text} is not {what}; give {least} to {most}{more}")
        return int(text)

    return number


port = whole("a port", 0, 65535, ", where 0 is any that is free")


def add_view_options(parser: argparse.ArgumentParser) -> None:
    """Add where and how a viewer is served."""
    argument(parser, "--view-host", "HOST", "where the viewer is served", default=LOCAL)
    argument(
        parser,
        "--view-port",
        "PORT",
        f"its port (default {PORT}, or the next free one)",
        type=port,
        default=PORT,
    )
    argument(
        parser, "--view-token", "TOKEN", "what others have to know, for --view-host", default=""
    )
    argument(parser, "--view-fps", "N", "pictures per second at most", type=positive, default=30.0)


def view_options(arguments: argparse.Namespace, sink: str = "") -> dict[str, Any]:
    """Return the options of a viewer, for `View`."""
    return {
        "sink": sink or arguments.view,
        "host": arguments.view_host,
        "port": arguments.view_port,
        "token": arguments.view_token,
        "fps": arguments.view_fps,
    }


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """Add what says how a workflow runs, for `unicon run` and `unicon replay`."""
    argument(parser, "--duration", "S", "end after S seconds", type=positive)
    parser.add_argument(
        "--speed",
        choices=("real", "max"),
        default="real",
        help="pace to the wall clock (real) or tick as fast as possible (max, simulators)",
    )
    parser.add_argument(
        "--ros",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="mirror states to ROS 2 topics (default: what the workflow says, else no)",
    )
    argument(parser, "--map", "MAP", "message map: name in config/maps/, or a path")
    argument(parser, "--namespace", "NS", "ROS namespace")
    argument(
        parser,
        "--frame-prefix",
        "PREFIX",
        "what stands before the names of all ROS frames, such as robot1/",
        default="",
    )
    argument(parser, "--part", "NAME", "run one part of a workflow that has parts", default="")
    argument(
        parser,
        "--record",
        "FILE.mcap|FOLDER/",
        "record every state of every tick, and the messages of the map",
    )
    argument(
        parser,
        "--record-split",
        "1GB|60s",
        "record to a bag folder whose files are that large or long, or both: 1GB,10min",
        default="",
    )
    argument(
        parser,
        "--record-frames",
        "all|NAME,…",
        "record pictures and clouds too: of all cameras and scanners, or of these handles",
        default="",
    )
    argument(
        parser,
        "--record-jpeg",
        "QUALITY",
        "record raw pictures as JPEG of that quality, 1 to 100 (default: as they are)",
        type=whole("a quality of a JPEG", 1, 100),
        default=0,
    )
    argument(
        parser,
        "--faults",
        "DIR",
        "where the record of a fault goes, or off (default: $UNICON_FAULTS, else "
        "~/.local/state/unicon/faults)",
    )
    argument(parser, "--trace", "FILE.json", "write every block of every tick")
    argument(
        parser,
        "--report",
        "FILE.json|FILE.html",
        "write the report: its figures, or one page with pictures",
    )
    argument(parser, "--picture", "FILE.png", "draw path, velocities and joints")
    parser.add_argument(
        "--view",
        nargs="?",
        const="page",
        choices=(*SINKS, "window"),
        help="show the run: a page in the browser (default), Foxglove, meshcat, or the simulator's "
        "own window",
    )
    add_view_options(parser)
    argument(
        parser,
        "--metrics",
        "PORT",
        "tell figures to Prometheus at http://127.0.0.1:PORT/metrics",
        type=port,
    )
    argument(
        parser,
        "--force",
        "CODE",
        "go on with an error of `unicon check` of this code; may be repeated",
        **REPEATED,
    )
    flag(parser, "--yes", "a robot moves once its gates hold, without being asked")
    flag(
        parser,
        "--dry",
        "run everything on the live robot and send nothing, at the end either; a simulated "
        "robot gets limp joints",
    )
    argument(
        parser,
        "--fetch",
        "DIR|URL",
        "fetch the models and policies that are missing first, of GitHub or of a mirror",
        nargs="?",
        const="",
    )
    parser.add_argument(
        "--ros-args",
        nargs=argparse.REMAINDER,
        default=[],
        help="everything after this goes to ROS (remaps, parameters)",
    )
