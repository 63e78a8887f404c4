"""Swaps of a walking Go2 at 50 moments of its gait: none falls, and a bad policy does not stay."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from shadow_helpers import LIMIT, WORKFLOW, Ran, ask, older, ran
from test_shadow import broken

from unicon_core.policies.shadow import ShadowedPolicy
from unicon_core.runtime import Runner

pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")
pytest.importorskip("onnxruntime", reason="pip install onnxruntime")
pytestmark = pytest.mark.slow

MOMENTS = range(100, 150)
"""Ticks of 0.02 s: more than two cycles of the gait, every phase of it."""
SECONDS = 6.0


def slow(shadowed: ShadowedPolicy, _: Runner) -> None:
    """Let B take longer than its limit from now on."""
    lane = shadowed.b.lane
    infer = lane.infer

    def late() -> None:
        time.sleep(1.1 * LIMIT)
        infer()

    lane.infer = late


def exchanged(a: int, b: int) -> Callable[[Path], Path]:
    """Return what writes a policy that takes two joints for each other."""

    def write(folder: Path) -> Path:
        names = yaml.safe_load((older(folder) / "policy.yaml").read_text("utf-8"))["joints"]
        names[a], names[b] = names[b], names[a]
        return older(folder, joints=names)

    return write


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    """A walk without a swap."""
    return ran(tmp_path_factory.mktemp("plain") / "w.yaml", None, SECONDS)


@pytest.mark.parametrize(
    ("a", "b"), [("go2_velocity", "go2_stairs"), ("go2_stairs", "go2_velocity")]
)
def test_one_that_sees_and_one_that_is_blind_replace_each_other(
    tmp_path: Path, a: str, b: str
) -> None:
    text, upright, largest = WORKFLOW.replace("go2_velocity", a), 0, 0.0
    alone = ran(tmp_path / "w.yaml", None, 5.0, text=text)
    for moment in MOMENTS[::4]:
        run = ran(tmp_path / "w.yaml", b, 5.0, {moment: ask, moment + 70: ask}, text=text)
        assert [done for done, _ in run.answers] == [True, True], run.answers
        assert run.rows["shadow_walk_share"].max() == 1.0
        upright += run.report.fell is False and not run.report.faults
        largest = max(largest, float(run.steps[98:].max()))
        seen = run.report.extra["shadow"]["largest_seen"]
        assert "height_scan" not in seen
        assert max(seen.values()) < 1e-5
    ours = np.abs(np.diff(alone.rows["joint_pos_target"], axis=0))[98:].max()
    print(f"{a} to {b} and back: upright {upright} of 13, step {largest / ours:.3f}")
    assert upright == len(MOMENTS[::4]) == 13
    assert largest <= 1.5 * ours


@pytest.mark.parametrize("bound", [0.4, 1.0])
def test_before_stairs_the_one_that_sees_takes_over_and_climbs_if_it_may_step_far(
    tmp_path: Path, bound: float
) -> None:
    stairs = "scene: {terrain: {stairs: {rise: 0.08, run: 0.3, steps: 5, landing: 8.0}}}\n"
    text, b = WORKFLOW.replace("0.6", "0.5") + stairs, {"path": "go2_stairs", "bound": bound}
    run = ran(tmp_path / "w.yaml", b, 9.0, {60: ask}, text=text)
    assert run.events[0] == "shadow_walk takes over"
    if bound == 0.4:  # the default: on stairs a calf steps farther, and the blind one drives again
        assert "its target of RR_calf_joint steps by 0.49 rad" in run.events[1]
    else:
        assert len(run.events) == 1
        assert run.report.fell is False
        assert run.report.base_displacement_m[2] > 0.35  # 5 steps


def largest(run: Ran) -> float:
    """Return the largest step of a target from the first moment on, in [rad]."""
    return float(run.steps[MOMENTS[0] - 2 :].max())


def plain_step(plain: Ran) -> float:
    return float(np.abs(np.diff(plain.rows["joint_pos_target"], axis=0))[98:].max())


def test_a_swap_while_walking_makes_nobody_fall(tmp_path: Path, plain: Ran) -> None:
    b = older(tmp_path / "b")
    upright, took, ratio, speed = 0, 0, 0.0, []
    for moment in MOMENTS:
        run = ran(tmp_path / "w.yaml", b, SECONDS, {moment: ask})
        upright += run.report.fell is False and not run.report.faults
        took += run.report.extra["shadow"]["drives"] == "shadow_walk"
        ratio = max(ratio, largest(run) / plain_step(plain))
        speed.append(run.report.base_displacement_m[0] / SECONDS)
    print(f"upright {upright}, took over {took}, step {ratio:.3f}, speed {np.mean(speed):.3f}")
    assert (upright, took) == (50, 50)
    assert ratio <= 1.5
    assert min(speed) > 0.45


@pytest.mark.parametrize(
    ("write", "breaks"),
    [
        (exchanged(2, 5), None),
        (exchanged(7, 10), None),
        (exchanged(1, 2), None),
        (older, broken("nan")),
        (older, broken("raises")),
        (older, broken("jumps")),
        (older, slow),
    ],
    ids=["calves", "thighs", "thigh and calf", "nan", "raises", "jumps", "slow"],
)
def test_a_bad_policy_is_refused_or_returned_from(
    tmp_path: Path, plain: Ran, write: Callable[[Path], Path], breaks: Any
) -> None:
    b = write(tmp_path / "b")
    upright, back, refused, ratio = 0, 0, 0, 0.0
    for number, moment in enumerate(MOMENTS):
        acts = {moment: ask}
        if breaks is not None:  # before, in the blend and behind it
            acts[moment + number - 10] = breaks
        run = ran(tmp_path / "w.yaml", b, SECONDS, acts)
        upright += run.report.fell is False and not run.report.faults
        back += run.report.extra["shadow"]["drives"] == "walk"
        refused += "shadow_walk takes over" not in run.events
        ratio = max(ratio, largest(run) / plain_step(plain))
    print(f"upright {upright}, back {back}, refused {refused}, step {ratio:.3f}")
    assert (upright, back) == (50, 50)
