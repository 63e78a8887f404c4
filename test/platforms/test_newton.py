"""Robots walk in Newton by one word, alone and beside each other."""

from __future__ import annotations

import sys
from contextlib import nullcontext

import numpy as np
import pytest

from unicon_base.errors import Fault, MissingDependencyError, PlatformError
from unicon_core.conformance import Rig
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow
from unicon_sims.newton.platform import NewtonPlatform

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "vendor"

pytest.importorskip("mujoco", reason="pip install 'unicon_ros[sim]'")
INSTALL = "pip install 'unicon_ros[sim-newton]'"


@pytest.fixture
def newton():
    """Return the module; where it is not installed, the test is skipped."""
    return pytest.importorskip("newton", reason=INSTALL)


def walked(name, seconds):
    """Run a workflow in Newton; return its states, and its share of the commanded way."""
    workflow = load_workflow(name, ["platform=newton"])
    runner = Runner(workflow, RunOptions(speed="max"))
    states = workflow.states
    asked = gone = 0.0
    try:
        for _ in range(round(seconds / workflow.period)):
            runner.tick(0)
            command = np.array(states["velocity_command"][:2], np.float64)
            speed = float(np.hypot(*command))
            if speed > 0.0:
                asked += speed
                gone += float(states["base_lin_vel"][:2] @ command) / speed
            assert states["projected_gravity"][2] < -0.9
    finally:
        runner.close()
    return states, gone / asked


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("name", "seconds", "least"), [("go2_walk", 20, 3.5), ("g1_walk", 10, 4.0)]
)
def test_it_walks(newton, name, seconds, least):
    pytest.importorskip("onnxruntime", reason="the policy needs onnxruntime")
    states, share = walked(name, seconds)
    assert np.hypot(*states["base_pos_w"][:2]) >= least
    assert share >= 0.6


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_warp_does_what_mujoco_does(newton, tmp_path):
    ends = []
    for solver in ("mujoco", "warp"):
        (tmp_path / solver).mkdir()
        it = Rig("newton", tmp_path / solver, {"solver": solver}, num_robots=3, initial_height=0.06)
        it.command(robot=0, joint_effort_ff={"yaw": 0.1})
        it.command(robot=2, joint_pos_target=0.4, joint_stiffness=15.0, joint_damping=0.4)
        told = it.run(30)
        ends.append(
            np.hstack([told[name][-1] for name in ("joint_pos", "base_pos_w", "base_quat")])
        )
        begin = it.bytes()
        it.platform.reset()  # type: ignore[attr-defined]
        it.run(30)
        assert it.bytes() == begin
        it.close()
    assert np.abs(ends[0][0] - ends[0][2]).max() > 0.1
    assert ends[1] == pytest.approx(ends[0], abs=2e-4)


@pytest.mark.slow
def test_physics_that_blow_up_are_a_fault_and_begin_nothing_anew(newton, tmp_path):
    it = Rig("newton", tmp_path)
    platform = it.platform
    assert isinstance(platform, NewtonPlatform)
    platform.step(np.full((1, 4), 1e15))
    with pytest.raises(Fault, match=r"^the physics blew up before \d\.\d+ s: joint \w+ moves at"):
        it.run(3)
    it.close()


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["mujoco", "warp"])
def test_joints_do_without_their_damping_for_a_while(newton, tmp_path, solver):
    model = {"joint": 'damping="0.05"', "gravity": 0.0}
    it = Rig("newton", tmp_path, {"solver": solver}, floating=False, model=model)
    it.command(joint_effort_ff={"yaw": 0.1})
    platform = it.platform
    yaw = it.joint("yaw")
    assert isinstance(platform, NewtonPlatform)
    assert platform.passive_damping.tolist() == pytest.approx([0.05] * 4)
    speeds = []
    for free in (False, True, False):
        platform.reset()
        with platform.undamped() if free else nullcontext():
            speeds.append(it.run(10)["joint_vel"][-1][yaw])
    assert speeds[0] == speeds[2]
    assert speeds[1] > 1.2 * speeds[0]
    it.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("option", "message"),
    [
        (
            {"solver": "mujocoo"},
            r"solver 'mujocoo' is not known; did you mean 'mujoco'\? known: mujoco, warp",
        ),
        ({"device": "cuda:99"}, r"device is 'cuda:99'; .*known: cpu"),
        ({"passive": "maybe"}, r"passive 'maybe' is not known; known: keep, replace"),
    ],
)
def test_options_that_are_wrong_are_told(newton, tmp_path, option, message):
    with pytest.raises(PlatformError, match=message):
        Rig("newton", tmp_path, option)


@pytest.mark.slow
def test_nothing_is_printed(newton, tmp_path, capfd):
    it = Rig("newton", tmp_path)
    it.run(3)
    it.close()
    told = capfd.readouterr()
    assert told.out == ""
    assert [line for line in told.err.splitlines() if not line.startswith("newton: ")] == []


def test_without_newton_the_install_command_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "newton", None)
    with pytest.raises(MissingDependencyError) as error:
        load_workflow("go2_stand", ["platform=newton"])
    assert str(error.value) == f"platform 'newton' needs newton: {INSTALL}"


def test_newton_without_its_part_sim_is_named_as_such(tmp_path, monkeypatch):
    (tmp_path / "newton").mkdir()
    (tmp_path / "newton" / "__init__.py").touch()
    (tmp_path / "warp.py").write_text("import warp_of_newton_sim", "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in [name for name in sys.modules if name.split(".")[0] in ("newton", "warp")]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(PlatformError) as error:
        load_workflow("go2_stand", ["platform=newton"])
    assert str(error.value) == (
        "platform 'newton': newton is installed without its part sim (No module named "
        f"'warp_of_newton_sim'): {INSTALL}"
    )
