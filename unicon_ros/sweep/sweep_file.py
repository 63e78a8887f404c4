"""Sweep file: what is varied, how often, and what is looked at; read with every mistake located.

schema: unicon.sweep/1
workflow: go2_walk
duration: 10
vary:
  scene.seed: {range: [0, 99]}
  scene.push.velocity: {uniform: [0.1, 1.0]}
sample: random
rollouts: 2000
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from unicon_core.bounds import DURATION
from unicon_core.errors import UniconError, alternatives
from unicon_core.file_kinds import other_kind
from unicon_core.located_yaml import Located, read_yaml
from unicon_core.workflow.overrides import split_setting
from unicon_ros.sweep.draws import Parameter, parameter, setting_of
from unicon_ros.sweep.gate import Gate, read_gate

SCHEMA = "unicon.sweep/1"

KEYS = {
    "schema": SCHEMA,
    "workflow": "name of a workflow, or a path from this file's folder on",
    "set": "PATH to value, the same in every rollout, as of --set",
    "vary": "PATH to what it may be: a list, or {uniform: [A, B]} and the like",
    "sample": "grid (all combinations), random or sobol",
    "rollouts": "how many points are drawn, of random and sobol",
    "seed": "of the draws; 0 unless told",
    "repeat": "rollouts of each point, with scene.seed counted on; 1 unless told",
    "duration": "of a rollout in [s]; the workflow's unless told",
    "early_stop": "fall, or none",
    "reference": "a run (.npz) to compare joint positions with",
    "keep": "states that are kept of every tick, a file for each rollout; none unless told",
    "timeout": "wall time in [s] that a rollout may take; 60 unless told",
    "engine": "local (processes here), batch (rows side by side in each) or ray (a cluster); local "
    "unless told",
    "gate": "list of conditions such as fall<0.01",
    "description": "one line",
}
SAMPLES = ("grid", "random", "sobol")
ENGINES = ("local", "batch", "ray")
STOPS = ("fall", "none")
TIMEOUT = 60.0
MOST_ROLLOUTS = 1_000_000
MOST_PARAMETERS = 32
MOST_REPEAT = 10_000


@dataclass(frozen=True)
class SweepFile:
    """A sweep as it was asked for.

    Attributes:
        path: the file.
        workflow: name or path.
        settings: texts of `--set` of every rollout.
        parameters: what is varied, in order.
        sample: one of `SAMPLES`.
        rollouts: points that are drawn; None of a grid.
        seed: of the draws.
        repeat: rollouts of each point.
        duration: in [s], None for the workflow's.
        stops_at_fall: a rollout ends where the robot falls.
        reference: run to compare with, or None.
        keep: states of every tick that are kept, by name.
        timeout: in [s] of wall time.
        engine: one of `ENGINES`; no row depends on it.
        gates: conditions that have to hold.
        description: one line.
        located: for errors.
    """

    path: Path
    workflow: str
    settings: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    sample: str
    rollouts: int | None
    seed: int
    repeat: int
    duration: float | None
    stops_at_fall: bool
    reference: Path | None
    keep: tuple[str, ...]
    timeout: float
    engine: str
    gates: tuple[Gate, ...]
    description: str
    located: Located

    @property
    def points(self) -> int:
        """Points of the grid, or those that are drawn."""
        if self.rollouts is not None:
            return self.rollouts
        return math.prod(len(each.values or ()) for each in self.parameters)

    @property
    def rows(self) -> int:
        """Rollouts in all."""
        return self.points * self.repeat


def read_sweep(path: str | Path, overrides: Iterable[str] = ()) -> SweepFile:
    """Read a sweep file.

    Args:
        path: of the file.
        overrides: further texts as of `--set`, the same in every rollout.

    Raises:
        UniconError: it is not a sweep; with file and line.
    """
    located = read_yaml(Path(path), UniconError)
    other = other_kind(located.value, "sweep")
    if other:
        raise located.error(("schema",), other)
    return _Reader(located).read(tuple(overrides))


class _Reader:
    def __init__(self, located: Located) -> None:
        self._located = located
        if not isinstance(located.value, dict):
            raise located.error((), "a sweep is a mapping with workflow and vary")
        self._values: dict[Any, Any] = located.value
        for key in self._values:
            if key not in KEYS:
                raise located.error((key,), f"unknown key {key!r}; {alternatives(str(key), KEYS)}")

    def read(self, overrides: tuple[str, ...]) -> SweepFile:
        values = self._values
        if values.get("schema", SCHEMA) != SCHEMA:
            raise self._wrong("schema", f"this version reads {SCHEMA}")
        workflow = values.get("workflow")
        if not isinstance(workflow, str) or not workflow:
            raise self._wrong("workflow", f"give {KEYS['workflow']}")
        beside = self._located.path.parent / workflow
        if "/" in workflow or Path(workflow).suffix in (".yaml", ".yml"):
            workflow = str(beside) if beside.exists() else workflow
        sample = values.get("sample", "grid")
        if sample not in SAMPLES:
            raise self._wrong("sample", alternatives(str(sample), SAMPLES))
        parameters = self._parameters(sample)
        settings = (*self._settings(), *overrides)
        repeat = self._count("repeat", 1, 1, MOST_REPEAT)
        fixed = {split_setting(text)[0] for text in settings}
        for each in parameters:
            if each.path in fixed:
                raise self._wrong("vary", f"{each.path} is set and varied; take one out", each.path)
            if each.path == "scene.seed" and repeat > 1:
                raise self._wrong(
                    "repeat", "vary says scene.seed, which repeat counts on; take one out"
                )
        rollouts = None
        if sample == "grid":
            if values.get("rollouts") is not None:
                raise self._wrong(
                    "rollouts", "a grid has as many as it has points; take it out, or sample: sobol"
                )
        else:
            rollouts = self._count("rollouts", None, 1, MOST_ROLLOUTS)
        stop = values.get("early_stop", "none")
        if stop not in STOPS:
            raise self._wrong("early_stop", alternatives(str(stop), STOPS))
        engine = values.get("engine", ENGINES[0])
        if engine not in ENGINES:
            raise self._wrong("engine", alternatives(str(engine), ENGINES))
        sweep = SweepFile(
            path=self._located.path,
            workflow=workflow,
            settings=settings,
            parameters=parameters,
            sample=sample,
            rollouts=rollouts,
            seed=self._count("seed", 0, 0, 2**63 - 1),
            repeat=repeat,
            duration=self._time("duration", None, DURATION),
            stops_at_fall=stop == "fall",
            reference=self._reference(),
            keep=self._keep(),
            timeout=self._time("timeout", TIMEOUT, 86_400.0) or TIMEOUT,
            engine=engine,
            gates=self._gates(parameters),
            description=str(values.get("description") or ""),
            located=self._located,
        )
        if sweep.rows > MOST_ROLLOUTS:
            what = "rollouts" if rollouts is not None else "vary"
            raise self._wrong(
                what, f"that makes {sweep.rows} rollouts; at most {MOST_ROLLOUTS} are run"
            )
        return sweep

    def _wrong(self, key: str, text: str, *more: str) -> UniconError:
        said = self._values.get(key)
        shown = f"{key}: " if said is None or more else f"{key} is {said!r:.60}; "
        if said is None and not more:
            shown = f"the key {key!r} is missing; "
        return self._located.error((key, *more), f"{shown}{text}")

    def _parameters(self, sample: str) -> tuple[Parameter, ...]:
        vary = self._values.get("vary")
        if not isinstance(vary, dict) or not vary:
            raise self._wrong("vary", "write {scene.seed: {range: [0, 99]}}")
        if len(vary) > MOST_PARAMETERS:
            raise self._wrong("vary", f"{len(vary)} are varied; at most {MOST_PARAMETERS}")
        found = []
        for path, said in vary.items():
            try:
                split_setting(f"{path}=0")
                each = parameter(str(path), said)
            except UniconError as error:
                raise self._located.error(("vary", path), f"vary.{path} {error}") from error
            if sample == "grid" and each.values is None:
                raise self._located.error(
                    ("vary", path),
                    f"vary.{path}: a grid has no end of {each.kind}; write {{linspace: [A, B, "
                    "N]}, or sample: random or sobol",
                )
            found.append(each)
        return tuple(found)

    def _settings(self) -> list[str]:
        said = self._values.get("set")
        if said is None:
            return []
        if not isinstance(said, dict):
            raise self._wrong("set", "write {platform: mujoco}")
        return [setting_of(str(path), value) for path, value in said.items()]

    def _keep(self) -> tuple[str, ...]:
        said = self._values.get("keep")
        names = [] if said is None else said
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise self._wrong("keep", "write a list of states: [joint_pos, base_pos_w]")
        return tuple(dict.fromkeys(names))

    def _gates(self, parameters: tuple[Parameter, ...]) -> tuple[Gate, ...]:
        said = self._values.get("gate")
        texts = [] if said is None else said if isinstance(said, list) else [said]
        paths = [each.path for each in parameters]
        try:
            gates = tuple(read_gate(str(text)) for text in texts)
            for gate in gates:
                gate.check(paths)
        except UniconError as error:
            raise self._located.error(("gate",), str(error)) from error
        return gates

    def _reference(self) -> Path | None:
        said = self._values.get("reference")
        if said is None:
            return None
        path = self._located.path.parent / str(said)
        if path.suffix != ".npz" or not path.is_file():
            raise self._wrong("reference", "give a run that is there, as a .npz")
        return path

    def _count(self, key: str, default: int | None, least: int, most: int) -> int:
        value = self._values.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise self._wrong(key, f"give a whole number from {least} to {most}")
        return value

    def _time(self, key: str, default: float | None, most: float) -> float | None:
        value = self._values.get(key, default)
        if value is None:
            return None
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not 0.0 < value <= most:
            raise self._wrong(key, f"give a time above 0 up to {most:g} s")
        return float(value)
