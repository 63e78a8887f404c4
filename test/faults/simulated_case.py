"""SimulatedCase: one fault in MuJoCo, what is declared of it, and in what it is put."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, Literal

import numpy as np

from faults.case import TICKS
from faults.mishaps import Mishap
from faults.simulated_platform import MODULE
from unicon_base.errors import UniconError
from unicon_base.resources import find_resource
from unicon_core.workflow.tick_tree import ROBOT_SAFETY

Outcome = Literal["refuse", "go on", "zero command", "soft", "damp"]

ROBOTS: dict[str, dict[str, Any]] = {
    "go2": {
        "robot": "go2",
        "rate": 50,
        "scene": {"initial_pose": "rest"},
        "policies": {"walk": "go2_velocity"},
        "flow": {"chain": [{"pose": {"to": "stand", "duration": 0.6}}, {"policy": "walk"}]},
    },
    "g1": {
        "robot": "g1_29dof",
        "rate": 50,
        "scene": {
            "model": "assets:models/g1_29dof/g1_29dof.xml",
            "initial_pose": "policy:walk",
        },
        "policies": {
            "walk": {"path": "assets:policies/g1_velocity_mjlab", "given": {"robot": "g1_29dof"}}
        },
        "flow": {"policy": "walk"},
    },
}
"""What `go2_walk` and `g1_walk` do, shorter."""

COMMAND = [{"velocity_command": {"constant": [0.5, 0.0, 0.3]}}]


@dataclass(frozen=True)
class SimulatedCase:
    """One fault, put into both robots at random ticks.

    Attributes:
        group: heading of the table.
        name: what goes wrong.
        outcome: what is to come of it.
        reason: a part of the reason that is told.
        within: in how many ticks it is to be found; its reaction may take two more. One figure, or
            one for each robot.
        fault: what the platform does, see `FaultySimulator`; a joint may be one for each robot.
        mishap: what a block does, or a person, in its place.
        during: the phase in which it begins.
        ticks: of that phase, first and last, between which it begins.
        workflow: further keys of the workflow.
        also: safety blocks beside the strict set, behind it.
        flow: instead of the robot's; `{walk}` in it stands for that.
        real: run as a robot: gates, approach, real time.
        overruns: ticks counted as missed, at least.
        quick: one of the few that every test run takes.
    """

    group: str
    name: str
    outcome: Outcome = "damp"
    reason: str = ""
    within: int | Mapping[str, int] = 0
    fault: Mapping[str, Any] = field(default_factory=dict)
    mishap: Mishap | None = None
    during: str = "run"
    ticks: tuple[int, int] = (5, 120)
    workflow: Mapping[str, Any] = field(default_factory=dict)
    also: tuple[Any, ...] = ()
    flow: Any = None
    real: bool = False
    overruns: int = 0
    quick: bool = False

    @property
    def row(self) -> str:
        """Return the row of the table: group and name."""
        return f"{self.group}: {self.name}"

    def name_in(self, robot: str) -> str:
        """Return the name of the case in the results."""
        return f"{self.row}, {robot}"

    def detection(self, robot: str) -> int:
        """Return in how many ticks it is to be found in a robot."""
        return self.within if isinstance(self.within, int) else self.within[robot]

    def at(self, robot: str, seed: int = 0) -> list[int]:
        """Return the ticks at which it begins, the same for the same seed."""
        rng = np.random.default_rng([zlib.crc32(f"{self.row}/{robot}".encode()), seed])
        first, last = self.ticks
        count = min(TICKS, last - first + 1)
        return sorted(int(t) for t in rng.choice(np.arange(first, last + 1), count, replace=False))

    def described(self, robot: str, at: int) -> dict[str, Any]:
        """Return the program of it, as keywords of `Program`."""
        values = {**ROBOTS[robot], "commands": COMMAND, **self.workflow}
        if self.flow is not None:
            values["flow"] = _filled(self.flow, values["flow"])
        platform = f"{MODULE}:{'robot' if self.real else 'simulator'}"
        fault = {
            key: value[robot] if isinstance(value, Mapping) and robot in value else value
            for key, value in self.fault.items()
        }
        options = {"fault": fault, "at": at, "during": self.during}
        start = {"operator": False, "approach": 2.0, "fade_in": 0.3}
        return {
            "start": start,
            **values,
            "platform": platform,
            "platforms": {platform: options},
            "safety": values.get("safety") or [*ROBOT_SAFETY, *self.also],
        }


def _filled(value: Any, walk: Any) -> Any:
    if value == "{walk}":
        return walk
    if isinstance(value, dict):
        return {key: _filled(each, walk) for key, each in value.items()}
    if isinstance(value, list):
        return [_filled(each, walk) for each in value]
    return value


def able(robot: str) -> str:
    """Return what is missing to run a robot, "" for nothing."""
    for package in ("mujoco", "onnxruntime"):
        if find_spec(package) is None:
            return package
    model = ROBOTS[robot]["scene"].get("model")
    try:
        if model is not None:
            find_resource(model, "model")
    except UniconError:
        return "the assets folder (UNICON_ASSETS)"
    return ""


def set_to(state: str, value: object, joint: Any = None, **more: Any) -> dict[str, Any]:
    """Return the fault that a state has another value."""
    return {"set": {state: value}, "joint": joint, **more}
