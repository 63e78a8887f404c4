"""Simulators of vendors that cannot be installed here, against stand-ins that mind each call."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Fault, MissingDependencyError, PlatformError
from unicon_core.conformance import Conformance, Rig
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow
from unicon_sims.isaaclab import platform as isaaclab
from unicon_sims.webots import platform as webots

pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")

MODULES = Path(__file__).parent / "vendor_modules"
# What says how to install each.
REMEDIES = {
    "isaacgym": "unpack NVIDIA's Isaac Gym Preview 4",
    "isaaclab": "pip install 'isaaclab[isaacsim,all]==2.3.2.post1'",
    "webots": "install Webots, and put $WEBOTS_HOME/lib/controller/python on PYTHONPATH",
}

OURS = tuple({path.stem for path in MODULES.iterdir()})


def _forget():
    for name in [name for name in sys.modules if name.split(".")[0] in OURS]:
        del sys.modules[name]


@pytest.fixture
def vendors(monkeypatch):
    """The stand-ins, fresh, in place of what may be installed."""
    kept = {name: module for name, module in sys.modules.items() if name.split(".")[0] in OURS}
    _forget()
    monkeypatch.syspath_prepend(str(MODULES))
    monkeypatch.setattr(isaaclab, "_APP", [])
    for name in ("_HELD", "_SUPERVISORS"):
        monkeypatch.setattr(webots, name, [])
    yield
    _forget()
    sys.modules.update(kept)


class _Left(Conformance):
    """Conformance of an engine that has no dry friction in N·m."""

    def test_dry_friction_holds_and_brakes(self, rig: Any) -> None:
        joints = {"yaw": {"friction": 0.06}}
        it = rig(floating=False, model={"gravity": 0.0}, joints=joints)
        (note,) = [note for note in it.info["notes"] if "dry friction" in note]
        assert note == "left out: dry friction of 1 joints, at most 0.06 N·m (yaw)"
        assert "friction" not in it.platform.facts.physics  # so a workflow is refused


@pytest.mark.slow
@pytest.mark.usefixtures("vendors")
class TestIsaacGym(_Left):
    platform = "isaacgym"


@pytest.mark.slow
@pytest.mark.usefixtures("vendors")
class TestIsaacLab(Conformance):
    platform = "isaaclab"

    @pytest.fixture(autouse=True)
    def several(self, vendors: None, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(import_module("isaaclab"), "SINGLE", False)


@pytest.mark.slow
@pytest.mark.usefixtures("vendors")
class TestIsaacLab3(TestIsaacLab):
    """The same, told with w at the end and behind proxies."""

    platform = "isaacsim"

    @pytest.fixture(autouse=True)
    def newer(self, several: None, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(import_module("isaaclab"), "QUAT", "xyzw")


@pytest.mark.slow
@pytest.mark.usefixtures("vendors")
class TestWebots(_Left):
    """One robot alone; the world is made of each rig's model."""

    platform = "webots_world:make"

    @pytest.mark.skip(reason="a process is the controller of one robot")
    def test_robots_of_a_batch_do_not_know_each_other(self, rig: Any) -> None: ...

    @pytest.mark.skip(reason="a process is the controller of one robot")
    def test_a_robot_of_a_batch_does_as_it_would_alone(self, rig: Any) -> None: ...

    def test_a_fault_of_a_batch_names_its_robot(self, rig: Any) -> None:
        with pytest.raises(PlatformError, match=r"^platform 'webots' has one robot; leave num_"):
            rig(num_robots=3)


@pytest.mark.slow
@pytest.mark.usefixtures("vendors")
@pytest.mark.parametrize("word", ["isaacgym", "isaaclab", "webots_world:make"])
def test_go2_walk_walks_through_a_stand_in_by_one_word(word):
    program = load_workflow("go2_walk", [f"platform={word}"])
    report = Runner(program, RunOptions(speed="max")).run()
    assert report.faults == []
    assert not report.fell
    assert float(program.states.base_pos_w.reshape(-1, 3)[0, 0]) > 3.0


@pytest.mark.parametrize("word", list(REMEDIES))
def test_what_is_not_installed_is_one_line(word, tmp_path):
    with pytest.raises(MissingDependencyError) as said:
        Rig(word, tmp_path)
    (line,) = str(said.value).splitlines()
    assert line.startswith(f"platform '{word}' needs "), line
    assert REMEDIES[word] in line


@pytest.mark.usefixtures("vendors")
def test_isaac_gym_says_what_is_wrong_and_leaves_nothing(tmp_path):
    with pytest.raises(PlatformError, match=r"^platform 'isaacgym': no simulation on cuda"):
        Rig("isaacgym", tmp_path, {"device": "cuda:0"})
    import torch  # noqa: F401
    from isaacgym import gymapi

    assert gymapi.LIVE == []
    it = Rig("isaacgym", tmp_path, num_robots=2)
    assert len(gymapi.LIVE) == 1
    it.close()
    it.close()
    assert gymapi.LIVE == []


@pytest.mark.usefixtures("vendors")
def test_the_stand_in_of_isaac_gym_refuses_what_gym_would():
    from isaacgym import gymapi
    from vendor_world import Refused

    gym = gymapi.acquire_gym()
    params = gymapi.SimParams()
    params.up_axis = gymapi.UP_AXIS_Z
    sim = gym.create_sim(0, -1, gymapi.SIM_PHYSX, params)
    assert sim is not None
    for early in (gym.simulate, gym.acquire_dof_state_tensor, gym.refresh_dof_state_tensor):
        with pytest.raises(Refused, match="before prepare_sim"):
            early(sim)
    with pytest.raises(AttributeError, match="SimParams has no gravitiy"):
        params.gravitiy = gymapi.Vec3()
    with pytest.raises(Refused, match=r"SimParams.gravity is a tuple"):
        params.gravity = (0.0, 0.0, -9.81)
    gym.add_ground(sim, _plane(gymapi))
    gym.prepare_sim(sim)
    with pytest.raises(Refused, match="after prepare_sim"):
        gym.create_env(sim, gymapi.Vec3(), gymapi.Vec3(), 1)
    gym.simulate(sim)
    with pytest.raises(Refused, match="simulate without fetch_results"):
        gym.simulate(sim)
    gym.destroy_sim(sim)
    with pytest.raises(Refused, match="destroyed"):
        gym.simulate(sim)


def _plane(gymapi):
    plane = gymapi.PlaneParams()
    plane.normal = gymapi.Vec3(0.0, 0.0, 1.0)
    return plane


@pytest.mark.usefixtures("vendors")
def test_isaac_lab_has_one_simulation_and_lets_go_of_it(tmp_path):
    folders = [tmp_path / name for name in ("one", "other", "third")]
    for folder in folders:
        folder.mkdir()
    one = Rig("isaaclab", folders[0])
    with pytest.raises(PlatformError, match=r"one simulation in a process, and there is one"):
        Rig("isaaclab", folders[1])
    one.run(1)
    one.close()
    one.close()
    Rig("isaacsim", folders[2]).close()
    with pytest.raises(PlatformError, match=r"'isaaclab': device is 'gpu'; write cpu or"):
        Rig("isaaclab", folders[1], {"device": "gpu"})


@pytest.mark.usefixtures("vendors")
def test_the_stand_in_of_isaac_lab_refuses_what_lab_would(tmp_path):
    from vendor_world import Refused

    with pytest.raises(Refused, match="modules of Isaac Sim before the app"):
        import_module("isaaclab.sim")
    it = Rig("isaaclab", tmp_path)
    lab = import_module("isaaclab.lab")
    torch = import_module("torch")
    context, robot = lab.SimulationContext.instance(), it.platform._robot  # type: ignore[attr-defined]
    it.run(1)
    with pytest.raises(Refused, match="a step without write_data_to_sim"):
        context.step(render=False)
    with pytest.raises(Refused, match="a step that renders"):
        context.step()
    with pytest.raises(Refused, match=r"a tensor float64 \(1, 4\)"):
        robot.set_joint_effort_target(torch.from_numpy(np.zeros((1, 4))))
    with pytest.raises(TypeError, match="unexpected keyword argument 'friktion'"):
        lab.ImplicitActuatorCfg(friktion=0.0)
    with pytest.raises(Refused, match="cleared before its callbacks"):
        context.clear_instance()
    it.close()


def test_webots_says_what_is_wrong_with_a_world(vendors, tmp_path):
    it = Rig("webots_world:make", tmp_path)
    controller = import_module("controller")
    with pytest.raises(PlatformError, match=r"the controller of one robot, and is so already"):
        Rig("webots", _folder(tmp_path, "second"))
    it.close()
    again = Rig("webots", _folder(tmp_path, "again"))  # by the same supervisor
    again.run(1)
    controller.WORLD[-1].ended = True
    with pytest.raises(Fault, match=r"^Webots ended the simulation$"):
        again.run(1)
    again.close()
    with pytest.raises(PlatformError, match=r"basicTimeStep is 1 ms, not 2 ms; correct it in"):
        Rig("webots", _folder(tmp_path, "slow"), {"timestep": 0.002})
    controller.WORLD[-1].strongest = 5.0
    with pytest.raises(PlatformError, match=r"motor left gives at most 5 N·m, and the robot file"):
        Rig("webots", _folder(tmp_path, "weak"))
    del webots._SUPERVISORS[0].devices["knee_sensor"]
    controller.WORLD[-1].strongest = 9.0
    with pytest.raises(PlatformError, match=r"has no device 'knee_sensor'; did you mean") as said:
        Rig("webots", _folder(tmp_path, "blind"))
    assert len(str(said.value).splitlines()) == 1


def test_stops_that_webots_does_not_have_are_told(vendors, tmp_path):
    it = Rig("webots_world:make", tmp_path, model={"upper": 4.5})
    note = "left out: stops beyond ±π, which Webots does not have, of left, knee, right, yaw"
    assert note in it.info["notes"]
    assert note in it.platform.facts.notes


def test_the_stand_in_of_webots_refuses_what_webots_would(vendors, tmp_path):
    from vendor_world import Refused

    it = Rig("webots_world:make", tmp_path)
    supervisor = webots._SUPERVISORS[0]
    it.run(1)
    with pytest.raises(Refused, match="torque is a int"):
        supervisor.getDevice("yaw").setTorque(1)
    with pytest.raises(Refused, match=r"no field Robot\.rotatoin"):
        supervisor.getSelf().getField("rotatoin")
    with pytest.raises(Refused, match="value is a tuple"):
        supervisor.getSelf().getField("translation").setSFVec3f((0.0, 0.0, 1.0))
    with pytest.raises(Refused, match="a step of 2 ms"):
        supervisor.step(2)
    supervisor.getSelf().setVelocity([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(Refused, match="a push of some solids only"):
        supervisor.step(1)


def _folder(path, name):
    (path / name).mkdir()
    return path / name
