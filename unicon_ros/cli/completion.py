"""Completion of a command line in a shell, by argcomplete, where that is installed.

eval "$(register-python-argcomplete unicon)"    # in ~/.bashrc; zsh likewise
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable, Iterator

from unicon_ros.cli.known import LISTS, VERBS

ASSETS = ("fetch", "path", "verify")
"""Verbs of `unicon assets` that take names."""


def complete(parser: argparse.ArgumentParser) -> None:
    """Print what argcomplete asks for, and end the process."""
    try:
        import argcomplete
        from argcomplete.completers import FilesCompleter
    except ModuleNotFoundError:  # the shell has that of another Python
        raise SystemExit(1) from None
    line, point = os.environ["COMP_LINE"], int(os.environ["COMP_POINT"])
    for verb in VERBS:  # one word for the parser
        if f" {verb} " in line[:point]:
            line, point = line.replace(verb, verb.replace(" ", "\\ "), 1), point + 1
    os.environ |= {"COMP_LINE": line, "COMP_POINT": str(point)}
    files = FilesCompleter()
    for command, action in _actions(parser):
        what = str(action.metavar) if action.metavar != "NAME" else command

        def completer(prefix: str, what: str = what, **_: object) -> list[str]:
            return [*_names(what, prefix), *(files(prefix) if what == "WORKFLOW" else ())]

        if what in (*LISTS, *ASSETS, "PATH=VALUE", "WORKFLOW", "ROBOT"):
            action.completer = completer  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser, always_complete_options=False)


def _actions(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.Action]]:
    """Yield the arguments of a parser and of its commands, with the command's last word."""
    for action in parser._actions:
        yield parser.prog.split()[-1], action
        if isinstance(action, argparse._SubParsersAction):
            for each in action.choices.values():
                yield from _actions(each)


def _names(what: str, prefix: str) -> Iterable[str]:
    """Return what is known of a kind."""
    from unicon_core.assets.manifest import load_assets
    from unicon_core.policies import policies_rows
    from unicon_core.robots import robot_names
    from unicon_core.workflow import workflow_names
    from unicon_core.workflow.registry import known

    if what == "PATH=VALUE":
        key = prefix.partition("=")[0]
        kinds = {"robot": "ROBOT", "platform": "platforms"}
        return [f"{key}={name}" for name in _names(kinds[key], "")] if key in kinds else ()
    if what in ("WORKFLOW", "workflows"):
        return workflow_names()
    if what in ("ROBOT", "robots"):
        return robot_names()
    if what == "policies":
        return [row["name"] for row in policies_rows()]
    return load_assets() if what in ASSETS else known(what)
