"""How the fuzz writes mutated YAML, and reads a workflow as `check`, `show` and `run` do."""

from __future__ import annotations

import contextlib
import random
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from mutate import mutate_bytes, mutate_text, mutate_tree, to_text

from unicon_base.errors import Fault
from unicon_core.check import check_workflow
from unicon_core.runtime import Runner, RunOptions
from unicon_core.show.text import show_text
from unicon_core.workflow import load_workflow

__all__ = ["Reader", "tree", "whole", "write"]

Reader = Callable[[], object]


class _Tagged(yaml.SafeLoader):
    """Reads the seeds; tags of Python become what stands below them."""


def _plain(loader: Any, suffix: str, node: yaml.Node) -> Any:
    if isinstance(node, yaml.MappingNode):
        return loader.construct_mapping(node, deep=True)
    if isinstance(node, yaml.SequenceNode):
        return loader.construct_sequence(node, deep=True)
    return loader.construct_scalar(node)


_Tagged.add_multi_constructor("tag:yaml.org,2002:python/", _plain)


@cache
def tree(text: str) -> Any:
    return yaml.load(text, _Tagged)


def write(path: Path, text: str, dice: random.Random) -> None:
    """Write a mutated YAML file: mostly its tree changed, else its text or its bytes."""
    way = dice.random()
    if way < 0.75:
        text = to_text(mutate_tree(tree(text), dice))
    elif way < 0.92:
        text = mutate_text(text, dice)
    raw = text.encode("utf-8", "surrogatepass")
    path.write_bytes(raw if way < 0.92 else mutate_bytes(raw, dice))


def whole(
    path: Path, overrides: tuple[str, ...] = (), platform: str = "fake", ticks: int = 0
) -> object:
    """Check a workflow, build it as `show` and `run` do, and run it for some ticks."""
    overrides = (*overrides, f"platform={platform}")
    check_workflow(path, overrides)
    workflow = load_workflow(path, overrides)
    try:
        show_text(
            workflow.root,
            workflow.states,
            workflow.critical,
            robot=workflow.robot,
            policies=workflow.policies,
        )
        speed = "real" if platform == "fake_robot" else "max"
        graph = Runner(workflow, RunOptions(speed=speed, capacity=16)).graph  # type: ignore[arg-type]
        graph.warm_up()
        with contextlib.suppress(Fault):  # which is what gates and stops are for
            for gate in workflow.gates:
                gate()
            for _ in range(ticks):
                graph.step()
    finally:
        workflow.close()
    return workflow
