"""A fit finds the joints that were put into a simulator, and says how sure it is."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")

from motions import motion

from unicon_base.errors import UniconError
from unicon_core.platforms.kit.disturbances import PLACE
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import load_robot
from unicon_core.states.standard import COMMAND_STATES
from unicon_lab.identify.fit import fit
from unicon_lab.identify.found import Fit, Parameter, overlay_text
from unicon_lab.identify.replays import Motion, replayed

GO2 = load_robot("go2")
CALF = {"RL_calf_joint": {"strength": 0.5}}


def test_a_replay_with_the_right_joints_is_the_run(tmp_path: Path) -> None:
    """Delay, too: the command of the tick before is on its way when a window begins."""
    joints = {"RL_calf_joint": {"strength": 0.5, "friction": 1.0, "armature": 0.03, "delay": 0.014}}
    it = motion(tmp_path, joints, seconds=2.0, most=10)
    apart = replayed(GO2, Scene(), it, joints) - it.answers
    wrong = replayed(GO2, Scene(), it, {}) - it.answers
    assert np.abs(apart).max() < 2e-3  # windows begin in float32
    assert np.abs(wrong[..., 11]).max() > 0.02


def test_it_finds_a_weak_motor(tmp_path: Path) -> None:
    told: list[str] = []
    found = fit(
        motion(tmp_path, CALF, seconds=2.0, most=8),
        GO2,
        words=["strength"],
        joints=["RL_calf_joint", "FR_calf_joint"],
        tell=told.append,
    )
    assert found.joints()["RL_calf_joint"]["strength"] == pytest.approx(0.5, abs=0.02)
    assert "FR_calf_joint" not in found.joints()
    assert found.better
    assert found.after < 0.01 * found.before
    assert told[0].startswith("round 1: 1 figures, aligned MSE ")
    before, after = found.by_joint["RL_calf_joint"]
    assert after < 0.01 * before


@pytest.mark.slow
def test_a_simulator_that_is_right_stays_as_it_is(tmp_path: Path) -> None:
    found = fit(
        motion(tmp_path, {}, seconds=2.0, most=10), GO2, words=["strength"], joints=["RL_*"]
    )
    assert found.joints() == {}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_it_finds_every_kind_of_figure(tmp_path: Path) -> None:
    joints = {
        "RL_calf_joint": {"strength": 0.6},
        "FR_thigh_joint": {"friction": 1.5},
        "FL_calf_joint": {"armature": 0.04},
        "RR_thigh_joint": {"delay": 0.012},
    }
    it = motion(tmp_path, joints, seconds=5.0, quick=6.0, most=30)
    found = fit(it, GO2, joints=list(joints), processes=2)
    said = found.joints()
    assert said["RL_calf_joint"]["strength"] == pytest.approx(0.6, abs=0.06)
    assert said["FR_thigh_joint"]["friction"] == pytest.approx(1.5, abs=0.3)
    assert said["FL_calf_joint"]["armature"] == pytest.approx(0.04, abs=0.01)
    assert said["RR_thigh_joint"]["delay"] == pytest.approx(0.012, abs=0.003)
    assert found.better


def states(ticks: int = 100) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    joints = dict.fromkeys((*PLACE[:2], *COMMAND_STATES), rng.normal(size=(ticks, 12)))
    base = {"base_quat": np.tile((1.0, 0.0, 0.0, 0.0), (ticks, 1))}
    return joints | base | {"base_pos_w": np.zeros((ticks, 3))}


def test_windows_leave_out_gaps_falls_and_what_is_not_a_number() -> None:
    usable = np.ones(400, np.bool_)
    usable[50] = False
    told = states(400)
    told["joint_pos"] = told["joint_pos"].copy()
    told["joint_pos"][120, 3] = np.nan
    told["projected_gravity"] = np.tile((0.0, 0.0, -1.0), (400, 1))
    told["projected_gravity"][300:] = (0.0, -1.0, 0.0)
    it = Motion.of(told, 0.02, usable)
    assert it.length == 10
    assert sorted(it.measured) == ["joint_pos", "joint_vel"]  # a base that stands is not measured
    for start in it.starts:
        ticks = set(range(int(start) - 1, int(start) + 11))
        assert not ticks & {50, 120, 300}
        assert max(ticks) < 300
    assert it.answers.shape == (len(it.starts), 10, 12)
    assert np.isfinite(it.answers).all()


def test_too_little_is_one_line() -> None:
    with pytest.raises(UniconError, match=r"needs joint_stiffness, which was not recorded"):
        Motion.of({k: v for k, v in states().items() if k != "joint_stiffness"}, 0.02, _all(100))
    with pytest.raises(UniconError, match=r"at least 8 windows of 0\.2 s .* the run has 0"):
        Motion.of(states(9), 0.02, _all(9))
    with pytest.raises(UniconError, match=r"joints move by 0\.000 rad; .* excite"):
        Motion.of({k: 0.0 * v for k, v in states().items()}, 0.02, _all(100))


def _all(ticks: int) -> Any:
    return np.ones(ticks, np.bool_)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"words": ["strenght"]}, r"no figure 'strenght' of joints; did you mean 'strength'"),
        ({"words": []}, r"nothing to estimate"),
        ({"joints": []}, r"nothing to estimate"),
        ({"joints": ["tail"]}, r"no joint like 'tail'"),
    ],
)
def test_nonsense_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(UniconError, match=message):
        fit(Motion.of(states(), 0.02, _all(100)), GO2, **options)


def test_an_overlay_is_read_as_it_was_found(tmp_path: Path) -> None:
    parameters = (
        Parameter("RL_calf_joint", "strength", 1.0, 0.51234, 0.02),
        Parameter("RL_calf_joint", "friction", 0.2, 0.25, 0.2),
        Parameter("FR_hip_joint", "delay", 0.0, 0.004, 0.001),
    )
    found = Fit(parameters, 1.0, 0.1, 1.0, 0.2, {}, (30, 10), 5, 0.01)
    path = tmp_path / "fitted.yaml"
    path.write_text(overlay_text(GO2, "go2", found, "real.mcap"))
    robot = load_robot(path)
    assert robot.simulated == {
        "RL_calf_joint": {"strength": 0.5123},
        "FR_hip_joint": {"delay": 0.004},
    }
    assert re.search(r"RL_calf_joint.*# 95 %: strength ±0\.02$", path.read_text(), re.MULTILINE)
    again = Fit((), 1.0, 1.0, 1.0, 1.0, {}, (30, 10), 1, 0.01)
    path.write_text(overlay_text(robot, "go2", again, "real.mcap"))
    assert load_robot(path).simulated == robot.simulated  # what was found before stays
