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
import operator
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from unicon_base import AnyDict, AnyMapping, UniconError, alternatives
from unicon_base.located_yaml import other_kind, read_yaml
from unicon_base.schema.marks import NotEmpty, Text, Within, Write, positive
from unicon_base.schema.read import read
from unicon_base.schema.types import Here, Mistakes
from unicon_core.bounds import DURATION
from unicon_core.workflow.document import split_setting
from unicon_lab.sweep.draws import Parameter, parameter, setting_of
from unicon_lab.sweep.figures import NUMBERS

_EACH = " for each "
_FORM = re.compile(
    r"\s*(\w+)(?:\.(\w+))?\s*(<=|>=|<|>)\s*([-+]?(?:\d+\.?|\d*\.\d+)(?:[eE][-+]?\d+)?)\s*"
)
_SIGNS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
SHARES = {"fall": "fell", "fault": "fault"}
"""Word to the column whose share of rollouts it is."""
_OF_SHARES = ["rate", "lower", "upper"]
_OF_FIGURES = ["mean", "min", "max", "p05", "p50", "p95"]


@dataclass(frozen=True)
class Gate:
    """A condition.

    Attributes:
        text: as it was written.
        word: `fall`, `fault`, or a figure.
        statistic: of it over all rollouts.
        sign: how it is compared.
        bar: with what.
        each: parameter for whose values it has to hold one by one; "" for all rollouts together.
    """

    text: str
    word: str
    statistic: str
    sign: str
    bar: float
    each: str = ""

    def check(self, parameters: Sequence[str]) -> None:
        """Look whether what it is asked for each value of is varied.

        Raises:
            UniconError: it is not.
        """
        if self.each and self.each not in parameters:
            raise UniconError(
                f"gate {self.text!r}: {self.each!r} is not varied; "
                f"{alternatives(self.each, parameters)}"
            )

    def met(self, value: float) -> bool:
        """Return whether a value holds the condition; NaN never does."""
        return bool(_SIGNS[self.sign](value, self.bar))


def read_gate(text: str) -> Gate:
    """Return a condition.

    Args:
        text: such as `fall<0.01`, `fall.upper<0.02` (the upper end of its 95 % interval),
            `distance_m.p05>3`, `speed_bias<0.1 for each scene.payload.mass`.

    Raises:
        UniconError: it is none.
    """
    condition, _, each = text.partition(_EACH)
    found = _FORM.fullmatch(condition)
    if found is None:
        raise UniconError(
            f"gate {text!r:.60} is not a condition; write fall<0.01 or distance_m.p05>3"
        )
    word, statistic, sign, bar = found.groups()
    if word not in SHARES and word not in NUMBERS:
        raise UniconError(
            f"gate {text!r}: no figure {word!r}; {alternatives(word, [*SHARES, *NUMBERS])}"
        )
    known = _OF_SHARES if word in SHARES else _OF_FIGURES
    statistic = statistic or known[0]
    if statistic not in known:
        raise UniconError(
            f"gate {text!r}: {word} has no {statistic!r}; {alternatives(statistic, known)}"
        )
    return Gate(text.strip(), word, statistic, sign, float(bar), each.strip())


SCHEMA = "unicon.sweep/1"

TIMEOUT = 60.0
MOST_ROLLOUTS = 1_000_000
MOST_PARAMETERS = 32
MOST_REPEAT = 10_000


_Vary = Annotated[AnyMapping, NotEmpty, Write("{scene.seed: {range: [0, 99]}}")]


@dataclass(frozen=True)
class SweepDocument:
    """A sweep: one workflow, many times.

    Attributes:
        workflow: name of a workflow, or a path from this file's folder on.
        vary: PATH to what it may be: a list, or {uniform: [A, B]} and the like.
        schema: version of the format.
        set: PATH to value, the same in every rollout, as of --set.
        sample: grid (all combinations), random or sobol.
        rollouts: how many points are drawn, of random and sobol.
        seed: of the draws.
        repeat: rollouts of each point, with scene.seed counted on.
        duration: of a rollout; the workflow's unless given.
        early_stop: where a rollout ends.
        reference: a run (.npz) to compare joint positions with.
        keep: states that are kept of every tick, a file for each rollout.
        timeout: wall time that a rollout may take.
        engine: local (processes here), batch (rows side by side in each) or ray (a cluster).
        gate: conditions such as fall<0.01.
        description: one line.
    """

    workflow: Text
    vary: _Vary
    schema: Literal["unicon.sweep/1"] = "unicon.sweep/1"
    set: Annotated[AnyMapping | None, Write("{platform: mujoco}")] = None
    sample: Literal["grid", "random", "sobol"] = "grid"
    rollouts: Annotated[int | None, Within(1, MOST_ROLLOUTS)] = None
    seed: Annotated[int, Within(0, 2**63 - 1)] = 0
    repeat: Annotated[int, Within(1, MOST_REPEAT)] = 1
    duration: Annotated[float | None, positive(DURATION, "s")] = None
    early_stop: Literal["fall", "none"] = "none"
    reference: str | None = None
    keep: Annotated[list[str] | None, Write("[joint_pos, base_pos_w]")] = None
    timeout: Annotated[float, positive(86_400.0, "s")] = TIMEOUT
    engine: Literal["local", "batch", "ray"] = "local"
    gate: Annotated[str | list[str] | None, Write("a list of conditions such as fall<0.01")] = None
    description: str | None = None

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note what is varied in vain, and a number of points that a sample does not have."""
        vary, rollouts = found.get("vary", {}), found.get("rollouts")
        if len(vary) > MOST_PARAMETERS:
            here.note(f"{len(vary)} are varied; at most {MOST_PARAMETERS}", "vary")
        grid = found.get("sample", "grid") == "grid"
        if grid and rollouts is not None:
            text = "is of a drawn sample; take it out, or write sample: sobol"
            here.value(f"is {rollouts}, which {text}", "rollouts")
        if not grid and rollouts is None and "sample" in found and "rollouts" not in here.document:
            here.note(f"missing key 'rollouts'; add rollouts: 1 to {MOST_ROLLOUTS}")
        for path, said in vary.items():
            try:
                split_setting(f"{path}=0")
                each = parameter(path, said)
            except UniconError as error:
                here.value(error.message, "vary", path)
                continue
            if grid and each.values is None:
                remedy = "write {linspace: [A, B, N]}, or sample: random or sobol"
                here.value(f"is {each.kind}, of which a grid has no end; {remedy}", "vary", path)
        for path in vary:
            if path in (found.get("set") or {}):
                here.value("is set and varied; take one out", "vary", path)
        if "scene.seed" in vary and found.get("repeat", 1) > 1:
            here.value("counts scene.seed on, which vary says, too; take one out", "repeat")
        gates_of(found.get("gate"), vary, here)


def gates_of(said: Any, paths: Iterable[str], here: Here | None = None) -> tuple[Gate, ...]:
    """Return the conditions of a sweep; what is wrong with them goes to `here`."""
    gates = []
    try:
        for text in [] if said is None else said if isinstance(said, list) else [said]:
            gates.append(read_gate(text))
            gates[-1].check(list(paths))
    except UniconError as error:
        if here is not None:
            here.note(error.message, "gate")
    return tuple(gates)


@dataclass(frozen=True)
class SweepFile:
    """A sweep as it was asked for.

    Attributes:
        path: the file.
        workflow: name or path.
        settings: texts of `--set` of every rollout.
        parameters: what is varied, in order.
        said: what the document says besides: `sample`, `seed`, `repeat`, `duration` in [s] or None
            for the workflow's, `timeout` in [s] of wall time, `engine`, on which no row depends.
        reference: run to compare with, or None.
        keep: states of every tick that are kept, by name.
        gates: conditions that have to hold.
    """

    path: Path
    workflow: str
    settings: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    said: SweepDocument
    reference: Path | None
    keep: tuple[str, ...]
    gates: tuple[Gate, ...]

    @property
    def points(self) -> int:
        """Points of the grid, or those that are drawn."""
        if self.said.rollouts is not None:
            return self.said.rollouts
        return math.prod(len(each.values or ()) for each in self.parameters)

    @property
    def rows(self) -> int:
        """Rollouts in all."""
        return self.points * self.said.repeat


def read_sweep(path: str | Path, overrides: Iterable[str] = ()) -> SweepFile:
    """Read a sweep file.

    Args:
        path: of the file.
        overrides: further texts as of `--set`, the same in every rollout.

    Raises:
        UniconError: it is not a sweep; with file and line.
    """
    overrides = tuple(overrides)
    located = read_yaml(Path(path), UniconError)
    other = other_kind(located.value, "sweep")
    if other:
        raise located.error(("schema",), other)
    folder = located.path.parent

    def beside(mistakes: Mistakes) -> None:
        fixed = {split_setting(text)[0] for text in overrides}
        vary, reference = (located.value.get(key) for key in ("vary", "reference"))
        for path in fixed & set(vary if isinstance(vary, dict) else ()):
            mistakes.value(("vary", path), "is set and varied; take one out")
        if isinstance(reference, str):
            file = folder / reference
            if file.suffix != ".npz" or not file.is_file():
                text = f"is {reference!r:.60}; give a run that is there, as a .npz"
                mistakes.value(("reference",), text)

    said = read(SweepDocument, located, "sweep", beside)
    workflow = said.workflow
    if "/" in workflow or Path(workflow).suffix in (".yaml", ".yml"):
        workflow = str(folder / workflow) if (folder / workflow).exists() else workflow
    sweep = SweepFile(
        located.path,
        workflow,
        (*(setting_of(k, v) for k, v in (said.set or {}).items()), *overrides),
        tuple(parameter(path, each) for path, each in said.vary.items()),
        said,
        None if said.reference is None else folder / said.reference,
        tuple(dict.fromkeys(said.keep or ())),
        gates_of(said.gate, said.vary),
    )
    if sweep.rows > MOST_ROLLOUTS:
        what = "vary" if said.rollouts is None else "rollouts"
        raise located.error(
            (what,), f"{what}: that makes {sweep.rows} rollouts; at most {MOST_ROLLOUTS} are run"
        )
    return sweep
