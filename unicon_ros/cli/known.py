"""`unicon robots`, `policies`, `platforms`, `faces`, `blocks`, `workflows`: all that is known.

Their names complete a command line in a shell, by argcomplete, where that is installed:
eval "$(register-python-argcomplete unicon)"    # in ~/.bashrc; zsh likewise
"""

from __future__ import annotations

import argparse
import inspect
import os
import re
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unicon_base import AnyDict, PlatformError, PolicyError, UniconError, WorkflowError
from unicon_ros.cli.console import print_json, print_table, print_text
from unicon_ros.cli.options import Adder, argument, command, flag

if TYPE_CHECKING:
    from collections.abc import Callable

    from unicon_core.robots import Robot

    Run = Callable[[argparse.Namespace], int]


def _listed(function: Run, what: str) -> Run:
    """Return a command that refuses `--json` beside a name."""

    def run(arguments: argparse.Namespace) -> int:
        if arguments.json and arguments.name:
            raise UniconError(f"{what}: --json prints the list; leave out {arguments.name}")
        return function(arguments)

    return run


def _rows(rows: list[AnyDict], arguments: argparse.Namespace) -> int:
    """Print a list as JSON, or its names alone."""
    if arguments.json:
        print_json(rows)
    else:
        print("\n".join(str(row["name"]) for row in rows))
    return 0


def _robots(arguments: argparse.Namespace) -> int:
    from unicon_core.robots import load_robot, robot_table, robots_rows, robots_table

    if not arguments.name and (arguments.json or arguments.quiet):
        return _rows(robots_rows(), arguments)
    print_text(robot_table(load_robot(arguments.name)) if arguments.name else robots_table())
    return 0


def _new(arguments: argparse.Namespace) -> int:
    from unicon_ros.cli.new_robot import new_robot

    print(new_robot(arguments.model, arguments.out, arguments.kind))
    return 0


def _policies(arguments: argparse.Namespace) -> int:
    from unicon_core.policies import load_policy, policies_rows, policies_table, policy_table
    from unicon_core.policies.file import IncompletePolicyError
    from unicon_core.policies.policy_yaml import known_text

    if not arguments.name and (arguments.json or arguments.quiet):
        return _rows(policies_rows(), arguments)
    robot = _robot(arguments)
    if not arguments.name:
        print_text(policies_table())
        return 0
    try:
        contract = load_policy(arguments.name, robot=robot)
    except IncompletePolicyError as error:
        print(known_text(error.facts))
        raise
    print_text(policy_table(contract, robot))
    return 0


def _import(arguments: argparse.Namespace) -> int:
    from unicon_core.policies import import_policy

    print(import_policy(arguments.source, arguments.out, **_told(arguments)))
    return 0


def _fetch(arguments: argparse.Namespace) -> int:
    from unicon_core.policies.fetch import fetch_policy

    told = {"sha256": arguments.sha256, **_told(arguments)}
    print(fetch_policy(arguments.source, arguments.out, **told))
    return 0


def _told(arguments: argparse.Namespace) -> AnyDict:
    given = {"joints": _joints(arguments.joints)} if arguments.joints else None
    return {"force": arguments.force, "robot": _robot(arguments), "given": given}


def _joints(text: str) -> Any:
    """Return what `--joints` says: names with commas, a file of a list, or a mapping."""
    from unicon_base.bounded_yaml import YamlError
    from unicon_base.located_yaml import parse_value, read_yaml

    path = Path(text).expanduser()
    if os.path.isfile(path):
        value = read_yaml(path, PolicyError).value
    else:
        try:
            value = parse_value(text)
        except YamlError as error:
            raise PolicyError(f"--joints {text}: {error}; give NAME,NAME… or a file") from error
    return re.split(r"[\s,]+", value.strip(" ,")) if isinstance(value, str) else value


def _robot(arguments: argparse.Namespace) -> Robot | None:
    from unicon_core.robots import load_robot

    return load_robot(arguments.robot) if arguments.robot else None


def _blocks(arguments: argparse.Namespace) -> int:
    status = _factories("blocks", WorkflowError, arguments)
    if arguments.name is None and not (arguments.json or arguments.quiet):
        from unicon_core.workflow.flow_yaml import FLOW_WORDS

        print_text(
            f"\na flow also has policy: NAME, call: module:function and {', '.join(FLOW_WORDS)}"
        )
    return status


def _factories(kind: str, error: type[UniconError], arguments: argparse.Namespace) -> int:
    from unicon_core.evidence import LEVELS, load_evidence
    from unicon_core.workflow.registry import find_factory, known

    name, ledger = arguments.name, load_evidence() if kind == "platforms" else {}
    seen = {n: e for (of, n), e in ledger.items() if of == "simulator"}
    listed = sorted(known(kind).items())
    if not name and (arguments.json or arguments.quiet):
        levels = {each: {"evidence": evidence.level} for each, evidence in seen.items()}
        rows = [{"name": n, "factory": at, **levels.get(n, {})} for n, at in listed]
        return _rows(rows, arguments)
    if name is None:
        words = {n: LEVELS["never"] if e.level == "never" else e.against for n, e in seen.items()}
        print_table([(each, at, words.get(each, "")) for each, at in listed])
        return 0
    factory = find_factory(kind, name, error)
    target = known(kind).get(name, name)
    print_text(name if target == name else f"{name}  ({target})")
    print_table([(f"  {option}", what) for option, what in _parameters(factory)])
    print_text(f"\n{inspect.getdoc(factory) or 'no description'}")
    return 0


def _parameters(factory: Any) -> list[tuple[str, str]]:
    """Return what a factory is given: the states it names, and the options of the workflow."""
    from unicon_core.workflow.autowire import option_names, state_names

    states, options = state_names(factory), option_names(factory)
    rows = [(name, f"state, {mode}") for name, mode in states.items()]
    for name, parameter in inspect.signature(factory).parameters.items():
        if name not in options:
            continue
        given = "to be given" if parameter.default is parameter.empty else f"{parameter.default!r}"
        rows.append((name, f"option, {given}"))
    return rows


def _workflows(arguments: argparse.Namespace) -> int:
    from unicon_core.workflow import load_document, workflow_names
    from unicon_core.workflow.document import description_of

    if arguments.name:
        print(load_document(arguments.name).path.read_text("utf-8"), end="")
        return 0
    rows = []
    for name in workflow_names():
        try:
            rows.append((name, description_of(name)))
        except WorkflowError as error:  # one broken file hides no other
            rows.append((name, f"file is wrong: {error}"))
    if arguments.json or arguments.quiet:
        return _rows([{"name": name, "description": text} for name, text in rows], arguments)
    print_table(rows)
    return 0


LISTS: dict[str, tuple[Run, str]] = {
    "robots": (_robots, "robots and their joints, gains, limits and sources"),
    "policies": (_policies, "policies and their contracts"),
    "platforms": (partial(_factories, "platforms", PlatformError), "platforms and their options"),
    "faces": (
        partial(_factories, "faces", PlatformError),
        "faces of emulated robots, by protocol, and their options",
    ),
    "blocks": (_blocks, "blocks and their options"),
    "workflows": (_workflows, "workflows"),
}
"""Commands that list names: what runs each, and what it lists."""

_ROBOT = argument("--robot", "ROBOT", "robot that orders the joints")
_OUT = (
    argument("--out", "DIR", "where to write", required=True),
    flag("--force", "replace a policy in DIR"),
    _ROBOT,
    argument(
        "--joints",
        "NAMES",
        "in the training side's order, where the source does not say it: NAME,NAME…, a "
        "file with a list, or '{from: model}' of ROBOT, or of some of its joints: "
        "'{from: model, only: [PATTERN, …]}'",
    ),
)
VERBS: dict[str, tuple[Run, str, tuple[Adder, ...]]] = {
    "robots new": (
        _new,
        "write a robot file of what a model knows",
        (
            argument("model", "MODEL", "MJCF or URDF"),
            argument("--out", "FILE", "where to write (default: NAME.yaml)"),
            argument("--kind", "KIND", "what the robot is, where its model does not say"),
        ),
    ),
    "policies import": (
        _import,
        "convert a policy to policy.yaml and its network",
        (argument("source", "FILE_OR_FOLDER", "what to read"), *_OUT),
    ),
    "policies fetch": (
        _fetch,
        "fetch a policy from where it is published, and convert it",
        (
            argument(
                "source",
                "URL",
                "hf://OWNER/REPO[@REV][/PATH], wandb://ENTITY/PROJECT/RUN or file:///PATH",
            ),
            argument("--sha256", "HEX", "of the network; another one is refused"),
            *_OUT,
        ),
    ),
}
"""Commands of two words, each with its own help: what runs it, what it does, what it takes."""


def add(commands: Any) -> None:
    """Add the commands to the parser."""
    for name, (run, what) in LISTS.items():
        verbs = [f"unicon {verb} --help" for verb in VERBS if verb.startswith(name)]
        command(
            name,
            _listed(run, name),
            f"list the {what}",
            None,
            argument("name", "NAME", "show this one in full", nargs="?"),
            flag("--json", "print the list as JSON"),
            *[_ROBOT] * (name == "policies"),
            epilog=f"See also: {', '.join(verbs)}." if verbs else "",
        )(commands)
    for verb, (run, what, taken) in VERBS.items():
        command(verb, run, what, what, *taken)(commands)


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
    for word, action in _actions(parser):
        what = str(action.metavar) if action.metavar != "NAME" else word

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
