"""A rehearsed physics step leaves nothing behind but warm caches."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

from unicon_base.errors import Fault
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.mujoco import MujocoPlatform, make
from unicon_core.platforms.mujoco import reader as rehearsal
from unicon_core.platforms.platform import WarmsUp
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States, standard_states
from unicon_core.workflow import load_workflow

Build = Callable[..., tuple[MujocoPlatform, States]]

INTEGRATORS = ["Euler", "implicitfast", "RK4"]
# Arrays that nothing has written here: up to MuJoCo 3.16 they show what lay there before.
UNWRITTEN = ("efc_AR", "efc_Y", "efm_", "tree_island", "map_itree2tree")


def everything(platform):
    """All that can be seen of a robot's data, and what the platform goes on from."""
    data = platform.data
    found = {}
    for name in dir(data):
        value = None if name.startswith(("_", *UNWRITTEN)) else getattr(data, name)
        if isinstance(value, np.ndarray):
            found[name] = value.tobytes()
        elif isinstance(value, (int, float)):
            found[name] = repr(value)
    for name in ("dist", "pos", "frame", "geom", "efc_address", "friction"):
        found[f"contact.{name}"] = getattr(data.contact, name).tobytes()
    found["warning"] = data.warning.number.tobytes() + data.warning.lastinfo.tobytes()
    found["timer"] = data.timer.number.tobytes() + data.timer.duration.tobytes()
    found["solver"] = data.solver.niter.tobytes() if hasattr(data.solver, "niter") else b""
    found["pickled"] = pickle.dumps(data)
    found["memory"] = pickle.dumps(platform.save())
    found["ticks"] = str(platform.robots[0].ticks)
    model = platform.model
    found["gains"] = model.actuator_gainprm.tobytes() + model.actuator_biasprm.tobytes()
    return found


def command(states, rng):
    for name in ("joint_pos_target", "joint_stiffness", "joint_damping"):
        states[name] = rng.uniform(0, 2, states[name].shape)


def rehearsed(platform, times=2):
    """Rehearse, and see that a step was made."""
    steps: list[int] = []
    real = platform.robots[0].rehearse._mujoco

    class Watched:
        def __getattr__(self, name: str) -> Any:
            if name in ("mj_step", "mj_step2"):
                steps.append(1)
            return getattr(real, name)

    platform.robots[0].rehearse._mujoco = Watched()
    try:
        for _ in range(times):
            platform.warm_up()
    finally:
        platform.robots[0].rehearse._mujoco = real
    assert len(steps) >= times - 1  # the first one only makes room


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("base", ["<freejoint/>", ""])
def test_nothing_that_can_be_seen_changes(build, integrator, base):
    platform, states = build(model={"integrator": integrator, "base": base})
    assert isinstance(platform, WarmsUp)
    rng = np.random.default_rng(0)
    for _ in range(12):
        command(states, rng)
        platform.send()
        platform.recv()
        told = bytes(states.snapshot().data)
        before = everything(platform)
        rehearsed(platform, 3)
        assert bytes(states.snapshot().data) == told
        after = everything(platform)
        assert {name for name in before if before[name] != after[name]} == set()


def standing():
    """A Go2 on its feet: contacts, friction, a warm start."""
    robot = load_robot("go2")
    states = States(standard_states(robot.joint_names))
    states.joint_pos_target = robot.default_joint_pos
    states.joint_stiffness = robot.joint_stiffness
    states.joint_damping = robot.joint_damping
    return make(states, robot, 0.02, scene=Scene()), states


def test_neither_do_contacts_nor_arrays_that_somebody_holds():
    platform, _ = standing()
    for _ in range(30):
        platform.send()
    data = platform.data
    assert data.ncon >= 4
    held = {name: getattr(data, name) for name in ("qpos", "qacc", "efc_force", "sensordata")}
    values = {name: array.copy() for name, array in held.items()}
    before = everything(platform)
    rehearsed(platform, 5)
    after = everything(platform)
    assert {name for name in before if before[name] != after[name]} == set()
    for name, array in held.items():
        np.testing.assert_array_equal(array, values[name])
        assert np.shares_memory(array, getattr(data, name))


def test_the_ticks_that_follow_are_the_same_to_the_bit():
    traces = []
    for warm in (False, True):
        platform, states = standing()
        rng = np.random.default_rng(5)
        trace = []
        for tick in range(60):
            for _ in range(int(rng.integers(0, 4))):
                if warm:
                    platform.warm_up()
            states.joint_pos_target += rng.normal(0.0, 0.02, 12).astype(np.float32)
            if tick == 20:
                platform.push(np.array([0.4, -0.3]))
            if tick == 30:
                platform.put({"joint_vel": np.zeros(12)})
            if tick == 40:
                platform.reset()
            if tick == 50:
                platform.load(platform.save())
            platform.send()
            platform.recv()
            seen = everything(platform)
            seen.pop("timer"), seen.pop("pickled")  # how long it took differs in any two runs
            trace.append((bytes(states.snapshot().data), seen))
        traces.append(trace)
    assert traces[0] == traces[1]


def test_a_robot_of_a_batch_is_rehearsed_alike(build):
    platform, states = build(num_robots=5)
    command(states, np.random.default_rng(1))
    platform.send()
    told = bytes(states.snapshot().data)
    before = everything(platform)
    rehearsed(platform, 3)
    assert (bytes(states.snapshot().data), everything(platform)) == (told, before)
    platform.close()


def test_a_rehearsal_that_blows_up_says_nothing_and_the_real_step_does(build, monkeypatch):
    said: list[str] = []
    was = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(said.append)
    try:
        platform, _ = build()
        platform.data.qvel[:] = 1e12
        before = everything(platform)
        rehearsed(platform, 4)
        after = everything(platform)
        assert {name for name in before if before[name] != after[name]} == set()
        assert said == []
        assert platform.info()["warnings"] == {}
        with pytest.raises(Fault, match="blew up"):
            platform.send()
        assert said
    finally:
        mujoco.set_mju_user_warning(was)


def test_nan_is_left_where_it_is(build):
    platform, states = build()
    platform.data.qpos[3] = np.nan
    states.joint_pos_target[0] = np.nan
    before = bytes(states.snapshot().data), platform.data.qpos.tobytes()
    rehearsed(platform, 3)
    assert (bytes(states.snapshot().data), platform.data.qpos.tobytes()) == before


def test_a_step_that_is_broken_off_is_set_back(build):
    platform, _ = build()
    platform.warm_up()
    before = everything(platform)
    real = mujoco

    class Broken:
        def __getattr__(self, name: str) -> Any:
            if name == "mj_step1":
                raise KeyboardInterrupt
            return getattr(real, name)

    platform.robots[0].rehearse._mujoco = Broken()
    with pytest.raises(KeyboardInterrupt):
        platform.warm_up()
    assert everything(platform) == before


def test_long_steps_are_not_rehearsed_but_for_a_look_now_and_then(build, monkeypatch):
    monkeypatch.setattr(rehearsal, "REST", 10)
    monkeypatch.setattr(rehearsal, "LONGEST_NS", -1)  # all are longer
    platform, _ = build()
    steps: list[int] = []
    rehearse = platform.robots[0].rehearse
    rehearse._read = lambda: steps.append(len(calls))  # type: ignore[assignment, method-assign]
    calls: list[int] = []
    for _ in range(80):
        calls.append(1)
        platform.warm_up()
    first = [2, 3, 4, 5]
    second = [16, 17, 18, 19]
    third = [40, 41, 42, 43]
    assert steps == [*first, *second, *third]
    monkeypatch.setattr(rehearsal, "LONGEST_NS", 10**12)
    for _ in range(100):
        calls.append(1)
        platform.warm_up()
    assert steps[len(first) * 3 :] == list(range(84, 181))


def test_a_model_with_a_plugin_is_not_rehearsed(build):
    platform, _ = build()
    robot = platform.robots[0]

    class Plugged:
        nplugin = 1

    rehearse = rehearsal.Rehearsal(mujoco, Plugged(), None, lambda: 1 / 0, True)  # type: ignore
    for _ in range(3):
        rehearse()
    assert robot.model.nplugin == 0


@pytest.mark.usefixtures("time_passes")
def test_a_run_in_real_time_sends_the_bytes_of_one_at_full_speed(tmp_path):
    digests = set()
    calls = []
    for options in ({"duration": 1.5}, {"duration": 1.5, "speed": "max"}):
        program = load_workflow("go2_walk")
        rehearse = program.platform.robots[0].rehearse  # type: ignore[attr-defined]
        read = rehearse._read
        rehearse._read = lambda read=read: (calls.append(1), read())
        digests.add(Runner(program, RunOptions(**options)).run().sha256_commands)  # type: ignore
    assert len(digests) == 1
    assert len(calls) > 10
