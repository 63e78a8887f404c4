"""Keywords of `Program`: the keys of a workflow file, for type checkers and editors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypedDict

from unicon_core.flow import Node

Named = str | Mapping[str, Any]
Flow = Node | Callable[..., object] | str | Mapping[str, Any]
Blocks = Sequence[Flow]


class Described(TypedDict, total=False):
    """A workflow in Python; `Workflow` says what each key means and which values it takes."""

    robot: Named
    platform: Named
    flow: Flow
    name: str
    description: str
    store: Named
    parts: Mapping[str, Any]
    scene: Mapping[str, Any]
    platforms: Mapping[str, Any]
    rate: float
    duration: float
    num_robots: int
    map: str
    ros: bool
    states: Mapping[str, Any]
    policies: Mapping[str, Any]
    skills: Mapping[str, Any]
    estimate: Blocks
    commands: Blocks
    start: Named
    wind_down: Flow
    safety: str | Blocks | Mapping[str, Any]
    deferred: Blocks
    twin: Named
    pacing: Mapping[str, Any]
    check: Mapping[str, Any]
