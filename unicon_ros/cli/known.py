"""`unicon robots`, `policies`, `platforms`, `faces`, `blocks`, `workflows`: all that is known."""

from __future__ import annotations

import argparse
import inspect
from typing import TYPE_CHECKING, Any

from unicon_core.aligned import aligned
from unicon_core.errors import PlatformError, PolicyError, RobotError, UniconError, WorkflowError

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the commands to the parser."""
    for name, function, what in (
        (
            "robots",
            _robots,
            "robots and their joints, gains, limits and sources; `new MODEL` writes a file",
        ),
        (
            "policies",
            _policies,
            "policies and their contracts; `import X --out DIR` converts one, `fetch URL --out "
            "DIR` gets it first",
        ),
        ("platforms", _platforms, "platforms and their options"),
        ("faces", _faces, "faces of emulated robots, by protocol, and their options"),
        ("blocks", _blocks, "blocks and their options"),
        ("workflows", _workflows, "workflows"),
    ):
        parser = commands.add_parser(name, help=f"list the {what}")
        parser.add_argument("name", nargs="?", metavar="NAME", help="show this one in full")
        if name == "robots":
            parser.add_argument(
                "model", nargs="?", metavar="MODEL", help="with `new`: MJCF or URDF"
            )
            parser.add_argument("--out", metavar="FILE", help="with `new`: where to write")
            parser.add_argument(
                "--kind",
                metavar="KIND",
                help="with `new`: what the robot is, where its model does not say",
            )
        if name == "policies":
            parser.add_argument(
                "source",
                nargs="?",
                metavar="X",
                help="with `import`: what to read; with `fetch`: hf://OWNER/REPO[@REV][/PATH], "
                "wandb://ENTITY/PROJECT/RUN or file:///PATH",
            )
            parser.add_argument("--out", metavar="DIR", help="of both: where to write")
            parser.add_argument("--sha256", metavar="HEX", help="with `fetch`: of the network")
            parser.add_argument(
                "--force", action="store_true", help="with `fetch`: replace a policy in DIR"
            )
            parser.add_argument("--robot", metavar="ROBOT", help="robot that orders the joints")
        parser.set_defaults(function=function)


def _robots(arguments: argparse.Namespace) -> int:
    from unicon_core.robots import load_robot, robot_table, robots_table

    model, out, kind = arguments.model, arguments.out, arguments.kind
    if arguments.name == "new":
        if not model:
            raise RobotError("robots new: give the model: unicon robots new MODEL [--out FILE]")
        from unicon_ros.cli.new_robot import new_robot

        print(new_robot(model, out, kind))
        return 0
    if model or out or kind:
        what = model or ("--out" if out else "--kind")
        raise RobotError(
            f"robots: {what} goes with new; write unicon robots NAME, or "
            "unicon robots new MODEL --out FILE"
        )
    print(robot_table(load_robot(arguments.name)) if arguments.name else robots_table())
    return 0


def _policies(arguments: argparse.Namespace) -> int:
    from unicon_core.policies import import_policy, load_policy, policies_table, policy_table
    from unicon_core.robots import load_robot

    name, source, out = arguments.name, arguments.source, arguments.out
    if name in ("import", "fetch"):
        if not source or not out:
            what = "FILE_OR_FOLDER" if name == "import" else "URL"
            raise PolicyError(
                f"policies {name}: give what to read and where to write: "
                f"unicon policies {name} {what} --out DIR"
            )
    elif source or out:
        raise PolicyError(
            f"policies: {source or '--out'} goes with import; write unicon policies NAME, or "
            "unicon policies import FILE_OR_FOLDER --out DIR"
        )
    if name != "fetch" and (arguments.sha256 or arguments.force):
        raise PolicyError(
            "policies: --sha256 and --force go with fetch: unicon policies fetch URL --out DIR"
        )
    robot = load_robot(arguments.robot) if arguments.robot else None
    if name == "fetch":
        from unicon_core.policies.fetch import fetch_policy

        told = {"sha256": arguments.sha256, "force": arguments.force, "robot": robot}
        print(fetch_policy(source, out, **told))
    elif name == "import":
        print(import_policy(source, out, robot=robot))
    elif name:
        print(policy_table(load_policy(name, robot=robot), robot))
    else:
        print(policies_table())
    return 0


def _platforms(arguments: argparse.Namespace) -> int:
    return _factories("platforms", arguments.name, PlatformError)


def _faces(arguments: argparse.Namespace) -> int:
    return _factories("faces", arguments.name, PlatformError)


def _blocks(arguments: argparse.Namespace) -> int:
    status = _factories("blocks", arguments.name, WorkflowError)
    if arguments.name is None:
        from unicon_core.workflow.flow_yaml import FLOW_WORDS

        print(f"\na flow also has policy: NAME, call: module:function and {', '.join(FLOW_WORDS)}")
    return status


def _factories(kind: str, name: str | None, error: type[UniconError]) -> int:
    from unicon_core.workflow.registry import find_factory, known

    if name is None:
        _print_table(sorted(known(kind).items()))
        return 0
    factory = find_factory(kind, name, error)
    target = known(kind).get(name, name)
    print(name if target == name else f"{name}  ({target})")
    _print_table(_parameters(factory), indent="  ")
    print(f"\n{inspect.getdoc(factory) or 'no description'}")
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

    if arguments.name:
        print(load_document(arguments.name).path.read_text(encoding="utf-8"), end="")
        return 0
    rows = []
    for name in workflow_names():
        try:
            rows.append((name, str(load_document(name).values.get("description", ""))))
        except WorkflowError as error:  # one broken file hides no other
            rows.append((name, f"file is wrong: {error}"))
    _print_table(rows)
    return 0


def _print_table(rows: Sequence[Sequence[str]], indent: str = "") -> None:
    for line in aligned(rows, underlined=False):
        print(f"{indent}{line}")
