"""`unicon robots`, `policies`, `platforms`, `blocks`, `workflows`: what is known, with sources."""

from __future__ import annotations

import argparse
from typing import Any

from unicon_core.errors import PlatformError, WorkflowError

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the commands to the parser."""
    for name, function, what in (
        ("robots", _robots, "robots and their joints, gains, limits and sources"),
        ("policies", _policies, "policies and their contracts; `import X --out DIR` converts one"),
        ("platforms", _platforms, "platforms and their options"),
        ("blocks", _blocks, "blocks and their options"),
        ("workflows", _workflows, "workflows"),
    ):
        parser = commands.add_parser(name, help=f"list the {what}")
        parser.add_argument("name", nargs="?", metavar="NAME", help="show this one in full")
        if name == "policies":
            parser.add_argument(
                "source", nargs="?", metavar="X", help="with `import`: what to read"
            )
            parser.add_argument("--out", metavar="DIR", help="with `import`: where to write")
            parser.add_argument("--robot", metavar="ROBOT", help="robot that orders the joints")
        parser.set_defaults(function=function)


def _robots(arguments: argparse.Namespace) -> int:
    from unicon_core.robots import load_robot, robot_table, robots_table

    print(robot_table(load_robot(arguments.name)) if arguments.name else robots_table())
    return 0


def _policies(arguments: argparse.Namespace) -> int:
    from unicon_core.errors import PolicyError
    from unicon_core.policies import import_policy, load_policy, policies_table, policy_table
    from unicon_core.robots import load_robot

    robot = load_robot(arguments.robot) if arguments.robot else None
    if arguments.name == "import":
        if not arguments.source or not arguments.out:
            raise PolicyError("policies import needs a policy and --out DIR")
        print(import_policy(arguments.source, arguments.out, robot=robot))
    elif arguments.name:
        print(policy_table(load_policy(arguments.name, robot=robot)))
    else:
        print(policies_table())
    return 0


def _platforms(arguments: argparse.Namespace) -> int:
    return _factories("platforms", arguments.name, PlatformError)


def _blocks(arguments: argparse.Namespace) -> int:
    return _factories("blocks", arguments.name, WorkflowError)


def _factories(kind: str, name: str | None, error: Any) -> int:
    import inspect

    from unicon_core.workflow.registry import find_factory, known

    if name is None:
        width = max(map(len, known(kind)))
        for each, target in sorted(known(kind).items()):
            print(f"{each:<{width}}  {target}")
        return 0
    factory = find_factory(kind, name, error)
    print(f"{name}{inspect.signature(factory)}\n\n{inspect.getdoc(factory) or 'no description'}")
    return 0


def _workflows(arguments: argparse.Namespace) -> int:
    from unicon_core.workflow import load_document, workflow_names

    if arguments.name:
        print(load_document(arguments.name).path.read_text(encoding="utf-8"), end="")
        return 0
    names = workflow_names()
    width = max(map(len, names), default=0)
    for name in names:
        print(f"{name:<{width}}  {load_document(name).values.get('description', '')}")
    return 0
