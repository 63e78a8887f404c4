"""Motion: what a run's base did of what it was commanded, and how far joints are from another's.

For sweeps and transfers alike.

Distance counts in the commanded direction and up to a fall, so that a robot which is pushed aside
or topples has not walked; a base that only turns has distance 0.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from unicon_base.arrays import Array, Float64
from unicon_core.metrics import fall_time, mse, unfolded_mse
from unicon_lab.analysis.paired_runs import Options, bring_together
from unicon_lab.analysis.run import Run

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


def apart(first: Run, other: Run) -> dict[str, Any]:
    """Return how far the joint positions of a run are from those of another.

    Both are cut at a fall, and joints matched by name, as `unicon analyze` does.

    Returns:
        `mse`: mean of squares, sample by sample, in [rad²]; `unfolded_mse`: as the UniCon authors
        compute it, in [rad²]; `shift_s` that aligns both best; `compared_s`; `notes`.

    Raises:
        UniconError: there is too little in common.
    """
    both = bring_together(first, other, Options())
    one, two = both.unshifted
    return {
        "mse": float(mse(one, two)),
        "unfolded_mse": float(unfolded_mse(one, two)),
        "shift_s": int(both.aligned.shift) * both.period,
        "compared_s": len(one) * both.period,
        "notes": both.notes,
    }
