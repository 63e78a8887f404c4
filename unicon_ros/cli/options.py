"""How commands declare their arguments, and the arguments that several of them share.

A module of a command has `add`, which adds it to the parser.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from unicon_base import AnyDict

Adder: TypeAlias = Callable[[Any], object]
"""Adds a command to the commands, or an argument to a parser or a group of its arguments."""

EXAMPLES: AnyDict = {"formatter_class": argparse.RawDescriptionHelpFormatter}
"""Settings of a command whose description has lines that stay as they are."""
REPEATED: AnyDict = {"action": "append", "default": []}
"""Settings of an option that may be given several times."""


def command(
    name: str,
    run: Callable[[argparse.Namespace], int],
    what: str,
    description: str | None = None,
    *arguments: Adder,
    **settings: Any,
) -> Adder:
    """Return what adds a command.

    Args:
        name: of the command.
        run: runs it; takes what was parsed and returns the exit status.
        what: its line in the list of commands.
        description: begins its own help.
        arguments: that it takes.
        settings: of `argparse.ArgumentParser`.
    """

    def add(commands: Any) -> None:
        parser = commands.add_parser(name, help=what, description=description, **settings)
        parser.set_defaults(function=run)
        _add_all(parser, arguments)

    return add


def several(
    name: str, what: str, description: str | None, metavar: str, *commands: Adder, **settings: Any
) -> Adder:
    """Return what adds a command that has commands of its own; arguments as of `command`."""

    def add(parsers: Any) -> None:
        parser = parsers.add_parser(name, help=what, description=description, **settings)
        _add_all(parser.add_subparsers(dest=name, metavar=metavar, required=True), commands)

    return add


def together(*commands: Adder) -> Adder:
    """Return what adds all of some commands."""
    return lambda parsers: _add_all(parsers, commands)


def option(name: str, **settings: Any) -> Adder:
    """Return what adds an argument; settings as of `add_argument`."""
    return lambda parser: parser.add_argument(name, **settings)


def argument(name: str, metavar: str, what: str, **settings: Any) -> Adder:
    """Return what adds an argument with a value.

    Args:
        name: `--NAME` of an option, else a positional argument.
        metavar: stands for the value in the help.
        what: the help.
        settings: of `add_argument`, such as `type` and `default`.
    """
    return option(name, metavar=metavar, help=what, **settings)


def flag(name: str, what: str) -> Adder:
    """Return what adds an option without a value, false unless given."""
    return option(name, action="store_true", help=what)


def group(title: str, about: str | None, *arguments: Adder) -> Adder:
    """Return what adds arguments under a title of their own in the help."""
    return lambda parser: _add_all(parser.add_argument_group(title, about), arguments)


def exclusive(*arguments: Adder) -> Adder:
    """Return what adds arguments of which one may be given."""
    return lambda parser: _add_all(parser.add_mutually_exclusive_group(), arguments)


def _add_all(to: Any, adders: Sequence[Adder]) -> None:
    for add in adders:
        add(to)


OVERRIDES = argument(
    "--set",
    "PATH=VALUE",
    "override a value, such as platform=fake, safety.0=finite or "
    "policies.walk.given.action.scale=0.5 (repeatable)",
    dest="overrides",
    **REPEATED,
)
WORKFLOW = (argument("workflow", "WORKFLOW", "name in config/workflows/, or a path"), OVERRIDES)
MAP = argument("--map", "MAP", "of that: name in config/maps/, or a path")
FORCE = argument(
    "--force",
    "CODE",
    "go on with an error of `unicon check` of this code; may be repeated",
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


def listed(text: str) -> list[str]:
    """Return the words of an argument that stand between commas."""
    return [word for each in text.split(",") if (word := each.strip())]


port = whole("a port", 0, 65535, ", where 0 is any that is free")


RUN_OPTIONS = (
    argument("--duration", "S", "end after S seconds", type=positive),
    option(
        "--speed",
        choices=("real", "max"),
        default="real",
        help="pace to the wall clock (real) or tick as fast as possible (max, simulators)",
    ),
    option(
        "--ros",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="mirror states to ROS 2 topics (default: what the workflow says, else no)",
    ),
    argument("--map", "MAP", "message map: name in config/maps/, or a path"),
    argument("--namespace", "NS", "ROS namespace"),
    argument(
        "--frame-prefix",
        "PREFIX",
        "what stands before the names of all ROS frames, such as robot1/",
        default="",
    ),
    argument("--part", "NAME", "run one part of a workflow that has parts", default=""),
    flag(
        "--native",
        "compile blocks that have a C++ twin, with the same commands; without a compiler the "
        "Python tick runs",
    ),
    argument("--trace", "FILE.json", "write every block of every tick"),
    argument(
        "--report",
        "FILE.json|FILE.html",
        "write the report: its figures, or one page with pictures",
    ),
    FORCE,
    flag("--yes", "a robot moves once its gates hold, without being asked"),
    flag(
        "--dry",
        "run everything on the live robot and send nothing, at the end either; a simulated "
        "robot gets limp joints",
    ),
    argument(
        "--fetch",
        "DIR|URL",
        "fetch the models and policies that are missing first, of GitHub or of a mirror",
        nargs="?",
        const="",
    ),
    option(
        "--ros-args",
        nargs=argparse.REMAINDER,
        default=[],
        help="everything after this goes to ROS (remaps, parameters)",
    ),
)
"""How a workflow runs, for `unicon run` and `unicon replay`."""
