"""60 s of walking with pushes and noise on leg_odometry, whose estimate the policy may read."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from odometry_runs import NOISE, run

# [s, m/s, m/s, rad/s]: forwards, in a curve, sideways, backwards, and all at once.
COMMANDS = [
    *([0.0, 0.0, 0.0, 0.0], [2.0, 0.8, 0.0, 0.0], [12.0, 0.6, 0.0, 0.8], [22.0, 0.0, 0.3, 0.0]),
    *(
        [30.0, -0.4, 0.0, 0.0],
        [36.0, 0.8, 0.2, -0.5],
        [48.0, 0.3, -0.2, 0.6],
        [56.0, 0.0, 0.0, 0.0],
    ),
]
PUSHED: dict[str, Any] = {
    "duration": None,
    "commands": [{"velocity_command": {"schedule": COMMANDS}}],
}
GO1 = {"model": "assets:models/go1/go1.xml", "initial_pose": "keyframe:home"}
GO2 = {"initial_pose": "rest"}
RISING = {"chain": [{"pose": {"to": "stand", "duration": 2.0}}, {"policy": "walk"}]}


def walk(workflow, scene, **more):
    """Run for 60 s, with pushes of up to 0.5 m/s every 3 s."""
    around = {"noise": NOISE, "push": {"every": 3.0, "velocity": 0.5}}
    estimate = {"estimate": [{"leg_odometry": {"position": True}}]}
    return run(workflow, PUSHED | estimate | more | {"scene": scene | around}, 60.0)


def held(seen, ticks):
    """Hold what is asked of every walk."""
    assert seen.report.faults == []
    assert not seen.report.fell
    assert len(seen.truth) == ticks
    assert np.abs(seen.truth[:, :2]).max() > 0.6
    assert seen.rms <= 0.1
    per_axis = np.sqrt(((seen.estimate - seen.truth) ** 2).mean(axis=0))
    assert (per_axis <= 0.08).all()
    told = float(np.sqrt(3.0 * seen.variance.mean()))
    assert 0.5 * told < seen.rms < 2.0 * told


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_go1_walks_for_a_minute_on_the_velocity_that_is_estimated(seed, assets):
    """Its policy reads `base_lin_vel`: the estimate is in the loop, and it follows its commands."""
    held(walk("go1_walk", GO1 | {"seed": seed}), 3000)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [50, 250])
def test_go2_is_estimated_at_both_rates(rate):
    held(walk("go2_walk", GO2, flow=RISING, rate=rate), 60 * rate)


@pytest.mark.slow
def test_a_humanoid_is_estimated_better_the_more_often_it_is_looked_at(assets):
    """Its legs are long: what the joints' velocities and the gyroscope err by counts twice."""
    seen = [walk("g1_walk", {}, rate=rate) for rate in (50, 250)]
    assert not any(each.report.faults for each in seen)
    assert seen[0].rms <= 0.15
    assert seen[1].rms <= 0.1


@pytest.mark.slow
def test_the_way_that_is_integrated_is_off_by_a_few_percent():
    changes = {"flow": RISING, "scene": GO2, "estimate": [{"leg_odometry": {"position": True}}]}
    seen = run("go2_walk", PUSHED | changes, 56.0)
    way = float(np.linalg.norm(np.diff(seen.place[:, :2], axis=0), axis=1).sum())
    assert way > 20.0
    assert seen.report.base_displacement_m is not None
    true = seen.place[-1, :2] - seen.place[0, :2]
    off = np.asarray(seen.report.base_displacement_m[:2]) - true
    assert np.linalg.norm(off) < 0.05 * way
