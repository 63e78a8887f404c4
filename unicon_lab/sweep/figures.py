"""Figures of a rollout: what a row of a sweep's table says of it, and how it is computed."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from unicon_base import AnyDict, UniconError
from unicon_base.arrays import Array, Float64
from unicon_base.located_yaml import read_yaml
from unicon_core.metrics import fall_time, mse, unfolded_mse
from unicon_core.metrics.distances import LEANS
from unicon_core.page import write_file
from unicon_core.robots import Robot, joint_index
from unicon_core.runtime.rollouts import Rollout
from unicon_core.states import States
from unicon_core.workflow import Program
from unicon_lab.analysis.paired_runs import bring_together
from unicon_lab.analysis.run import FEWEST, Run

MOVED = (
    *("distance_m", "commanded_m", "speed_error", "turn_error", "speed_bias", "turn_bias"),
    "fall_s",
)
STILL = 1e-6
"""Command in [m/s] and [rad/s] up to which nothing is asked for."""


def finite_rows(states: Mapping[str, Array]) -> int:
    """Return how many samples there are before the first in which something is not a number."""
    good = np.ones(len(states["joint_pos"]), np.bool_)
    for values in states.values():
        good &= np.isfinite(values).all(axis=1)
    return len(good) if good.all() else int(np.argmin(good))


def moved(
    states: Mapping[str, Float64], period: float, whole: bool = False
) -> dict[str, float | None]:
    """Return what the base did until it fell.

    Distance counts in the commanded direction and up to a fall, so that a robot which is pushed
    aside or topples has not walked; a base that only turns has distance 0.

    Args:
        states: `base_pos_w` [m], `base_quat` (wxyz, base to world), `base_ang_vel` [rad/s],
            `projected_gravity` and `velocity_command` (vx, vy [m/s], wz [rad/s], in the base's
            heading frame) over time, shape (n, d), all finite.
        period: between two samples in [s].
        whole: a lean until the end is no fall, see `fall_time`.

    Returns:
        `distance_m`: way in the commanded direction; `commanded_m`: integral of the commanded
        speed, also after a fall; `speed_error` [m/s] and `turn_error` [rad/s]: RMS of measured
        minus commanded, (vx, vy) by the way in each tick and wz by the gyro, from the first to the
        last tick with a command; `speed_bias`, `turn_bias`: size of the mean of the same, in which
        the sway of the gait cancels out; `fall_s`: when it fell. None where there is none.
    """
    figures: dict[str, float | None] = dict.fromkeys(MOVED)
    command = states["velocity_command"]
    if len(command) < 2:
        return figures
    figures["commanded_m"] = float(np.sum(np.linalg.norm(command[:-1, :2], axis=1)) * period)
    fall = round(float(fall_time(states["projected_gravity"], period, whole=whole)), 9)
    if not math.isnan(fall):
        figures["fall_s"] = fall
        upright = round(fall / period)
        states = {name: values[:upright] for name, values in states.items()}
        command = states["velocity_command"]
    w, x, y, z = states["base_quat"][:-1].T
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    step = np.diff(states["base_pos_w"], axis=0)
    ahead = np.cos(yaw) * step[:, 0] + np.sin(yaw) * step[:, 1]
    aside = np.cos(yaw) * step[:, 1] - np.sin(yaw) * step[:, 0]
    way, asked = np.stack([ahead, aside], axis=1), command[:-1, :2]
    speed = np.linalg.norm(asked, axis=1)
    along = np.sum(way * asked, axis=1) / np.maximum(speed, STILL)
    figures["distance_m"] = float(np.sum(along[speed > STILL]))
    active = np.flatnonzero((np.abs(command[:-1]) > STILL).any(axis=1))
    if len(active):
        part = slice(active[0], active[-1] + 1)
        wrong = way[part] / period - asked[part]
        turn = states["base_ang_vel"][:-1][part, 2] - command[:-1][part, 2]
        figures |= {
            "speed_error": float(np.sqrt(np.mean(np.sum(wrong**2, axis=1)))),
            "turn_error": float(np.sqrt(np.mean(turn**2))),
            "speed_bias": float(np.linalg.norm(wrong.mean(axis=0))),
            "turn_bias": float(abs(turn.mean())),
        }
    return figures


def apart(first: Run, other: Run) -> AnyDict:
    """Return how far the joint positions of a run are from those of another.

    Both are cut at a fall, and joints matched by name, as `unicon analyze` does.

    Returns:
        `mse`: mean of squares, sample by sample, in [rad²]; `unfolded_mse`: as the UniCon authors
        compute it, in [rad²]; `shift_s` that aligns both best; `compared_s`; `notes`.

    Raises:
        UniconError: there is too little in common.
    """
    both = bring_together(first, other)
    one, two = both.unshifted
    return {
        "mse": float(mse(one, two)),
        "unfolded_mse": float(unfolded_mse(one, two)),
        "shift_s": int(both.aligned.shift) * both.period,
        "compared_s": len(one) * both.period,
        "notes": both.notes,
    }


def columns_of(states: States, names: Iterable[str]) -> dict[str, slice]:
    """Return where states lie in `Rollout.states`: name to columns.

    Raises:
        UniconError: there is no such state, or it is not of float32.
    """
    found = {}
    for name in names:
        view = states[name]
        if view.dtype != np.float32:
            raise UniconError(f"state {name!r} is {view.dtype}; float32 ones are kept alone")
        start = states.offset(name)
        found[name] = slice(start, start + view.size)
    return found


def keep_states(path: Path, names: Iterable[str], program: Program, rollout: Rollout) -> None:
    """Write the states of a rollout, whole or not at all: float32, shape (ticks, elements).

    Args:
        path: of the `.npz`; its folder is made as needed.
        names: of the states.
        program: whose rollout it is.
        rollout: that has ended.

    Raises:
        UniconError: it cannot be written.
    """
    places = columns_of(program.states, names)
    arrays: AnyDict = {key: rollout.states[:, place] for key, place in places.items()}
    arrays |= {"dt": program.period, "joint_names": np.array(program.robot.joint_names)}
    arrays |= {"robot": program.robot.name, "workflow": program.name}
    content = io.BytesIO()
    np.savez(content, platform=program.platform.facts.name, **arrays)
    write_file(path, content.getvalue(), folders=True)


HELD_S = 0.1
"""How long a base leans until it counts as fallen in [s], as of `gap.fall_time`."""
NEAR = 0.01
"""Of a limit of position in [rad] or [m]: so near counts as hit."""
FULL = 0.99
"""Share of the limit of effort that counts as hit."""

# Ends of a rollout that a lean has no part in.
_BY_ITSELF = ("done", "duration")

_LOOKED_AT = (
    *("joint_pos", "joint_vel", "joint_effort", "base_pos_w", "base_quat", "projected_gravity"),
    *("base_ang_vel", "velocity_command"),
)


@dataclass(frozen=True)
class Column:
    """One figure: its type, its unit, what it says."""

    kind: type
    unit: str
    words: str

    def named(self, name: str) -> str:
        """Return a name with the unit."""
        return f"{name} [{self.unit}]" if self.unit else name


_KINDS = {kind.__name__: kind for kind in (bool, int, float, str)}
COLUMNS = {
    name: Column(_KINDS[kind], unit, words)
    for name, (kind, unit, words) in read_yaml(Path(__file__).with_suffix(".yaml")).value.items()
}
"""Name of each figure to what it is; `figures.yaml` has the table."""


NUMBERS = [name for name, column in COLUMNS.items() if column.kind in (int, float)]
"""Figures of which there are means."""


def empty_row() -> AnyDict:
    """Return a row of which nothing is known."""
    return dict.fromkeys(COLUMNS)


class FallLook:
    """Ends a rollout where the robot has fallen, by the measure of `gap.fall_time`.

    Args:
        states: of the program.
        period: of a tick in [s].
    """

    def __init__(self, states: States, period: float) -> None:
        gravity: Array = states["projected_gravity"]
        self._down = gravity.item
        self._limit = -math.cos(LEANS)
        self._held = max(1, round(HELD_S / period))
        self._leaning = 0

    def __call__(self) -> bool:
        self._leaning = self._leaning + 1 if not self._down(2) <= self._limit else 0
        return self._leaning >= self._held


def reference_for(run: Run, robot: Robot, period: float) -> Run:
    """Return a run to compare joint positions with, its joints in a robot's order.

    Args:
        run: as it was read.
        robot: of the rollouts.
        period: of their ticks in [s].

    Raises:
        UniconError: it is of another robot or another rate.
    """
    own = float(np.median(np.diff(run.time)))
    if abs(own - period) > 1e-3 * period:
        raise UniconError(
            f"{run.path} has {1 / own:.4g} samples a second and the workflow {1 / period:.4g} "
            "ticks; record the reference at the workflow's rate"
        )
    positions = run.states["joint_pos"]
    if run.joints:
        positions = positions[:, joint_index(robot.joint_names, run.joints)]
    if positions.shape[1] != robot.num_joints:
        raise UniconError(
            f"{run.path} has {positions.shape[1]} joints and {robot.name} {robot.num_joints}; "
            "give a reference of this robot"
        )
    states = {k: v for k, v in run.states.items() if k == "projected_gravity"}
    return replace(run, joints=robot.joint_names, states=states | {"joint_pos": positions})


class Figures:
    """Computes the figures of one program's rollouts.

    Args:
        states: of the program.
        robot: of it.
        period: of a tick in [s].
        reference: run to compare joint positions with, or None.
    """

    def __init__(
        self, states: States, robot: Robot, period: float, reference: Run | None = None
    ) -> None:
        self._period, self._reference, self._joints = period, reference, robot.joint_names
        self._floats = robot.floats
        self._columns = columns_of(states, _LOOKED_AT)
        self._lower = robot.lower + NEAR
        self._upper = robot.upper - NEAR
        self._effort = np.nan_to_num(robot.effort_limit, nan=np.inf) * FULL

    def __call__(self, rollout: Rollout) -> AnyDict:
        """Return the row of a rollout, but for the program's hash."""
        every = {name: rollout.states[:, place] for name, place in self._columns.items()}
        count = finite_rows(every)
        states = {name: values[:count] for name, values in every.items()}
        row = empty_row() | {
            "outcome": {"looked": "fell"}.get(rollout.ended, rollout.ended),
            "fault": bool(rollout.fault),
            "fault_block": rollout.block or None,
            "text": rollout.fault[:300] or None,
            "ticks": rollout.ticks,
            "duration_s": round(rollout.ticks * self._period, 9),
            "sha256_commands": rollout.sha256_commands,
        }
        if len(states["joint_pos"]):
            row |= self._of_joints(states)
            row |= self._of_base(states, rollout) if self._floats else {}
        endless = [k for k, v in row.items() if isinstance(v, float) and not math.isfinite(v)]
        return row | dict.fromkeys(endless)

    def _of_base(self, states: Mapping[str, Array], rollout: Rollout) -> AnyDict:
        wide = {name: values.astype(np.float64) for name, values in states.items()}
        row = moved(wide, self._period, rollout.ended in _BY_ITSELF)
        upright = -states["projected_gravity"][:, 2].astype(np.float64)
        leans = upright < math.cos(LEANS)
        fell = row["fall_s"] is not None or bool(rollout.fault and leans[-1])
        if fell and row["fall_s"] is None:  # a fault came before it had leaned long enough
            first = len(leans) - int(np.argmin(leans[::-1])) if not leans.all() else 0
            row["fall_s"] = round(first * self._period, 9)
        lowest = float(np.clip(upright.min(), -1.0, 1.0))
        return row | {"fell": fell, "tilt_deg": math.degrees(math.acos(lowest))}

    def _of_joints(self, states: Mapping[str, Array]) -> AnyDict:
        pos, effort = states["joint_pos"], states["joint_effort"]
        power = np.abs(effort.astype(np.float64) * states["joint_vel"])
        row = {
            "energy_j": float(power.sum() * self._period),
            "position_limit_hits": int(np.sum((pos <= self._lower) | (pos >= self._upper))),
            "effort_limit_hits": int(np.sum(np.abs(effort) >= self._effort)),
        }
        if self._reference is not None and len(pos) >= FEWEST:
            names = ("joint_pos", "projected_gravity")
            wide = {name: states[name].astype(np.float64) for name in names}
            time = np.arange(len(pos), dtype=np.float64) * self._period
            own = Run(Path("rollout"), {}, "ticks", 0.0, time, self._joints, wide)
            row["unfolded_mse"] = apart(self._reference, own)["unfolded_mse"]
        return row
