"""Report: pages about runs. Here are the words with which each page answers how fast a robot was,
whether it fell, and what was commanded; `run_page` is the page of `unicon run --report`."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from unicon_base.arrays import Array
from unicon_core.metrics import fall_time

ANSWERING = ("base_lin_vel", "joint_vel", "projected_gravity", "velocity_command")
"""States that `words` looks at."""


def words(states: Mapping[str, Array], period: float) -> tuple[str, str, str]:
    """Return how fast a robot was, whether it fell, and what was commanded, each in words.

    Args:
        states: those of `ANSWERING` that are known, shape (n, d); of each, samples in which
            something is not a finite number are left out.
        period: between two samples in [s].
    """
    finite = {name: states[name] for name in ANSWERING if name in states}
    finite = {n: kept for n, v in finite.items() if len(kept := v[np.isfinite(v).all(axis=1)])}
    fast, fell, asked = list[str](), "not known: no attitude is recorded", "joint targets alone"
    if "base_lin_vel" in finite:
        speed = np.linalg.norm(finite["base_lin_vel"][:, :2], axis=1)
        fast.append(f"base {speed.mean():.2f} m/s on average, {speed.max():.2f} m/s at most")
    if "joint_vel" in finite:
        fast.append(f"joints up to {np.abs(finite['joint_vel']).max():.3g} rad/s")
    if "projected_gravity" in finite:
        gravity = finite["projected_gravity"]
        known = np.isfinite(states["projected_gravity"]).all(axis=1)
        when = float(fall_time(gravity, period))
        lean = math.degrees(math.acos(np.clip(-gravity[:, 2], -1.0, 1.0).min()))
        fell = f"no: leaned by {lean:.0f}° at most"
        if not known.all():
            fell = (
                f"not known: no attitude in {1.0 - known.mean():.0%} of the time; else {fell[4:]}"
            )
        if not math.isnan(when):
            fell = f"yes, at {np.flatnonzero(known)[round(when / period)] * period:.2f} s"
    if "velocity_command" in finite:
        command = finite["velocity_command"]
        moving = command[np.abs(command).max(axis=1) > 0.0]
        asked = "to stand: velocity 0 from beginning to end"
        if len(moving):
            vx, vy, wz = moving.mean(axis=0)
            asked = (
                f"forward {vx:+.2f} m/s, left {vy:+.2f} m/s, turning {wz:+.2f} rad/s on average "
                f"in {len(moving) / len(command):.0%} of the time, else 0"
            )
    return "; ".join(fast) or "not known: no speed is recorded", fell, asked
