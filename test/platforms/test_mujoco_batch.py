"""A batch in MuJoCo: neither the threads nor the other robots change a bit of one."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_base.errors import Fault, PlatformError
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.mujoco import MujocoPlatform, make
from unicon_core.platforms.mujoco.batch import shares
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states

Build = Callable[..., tuple[MujocoPlatform, States]]
Trace = list[bytes]

COUNT = 6


@pytest.fixture
def cores(monkeypatch):
    def use(count: int) -> None:
        monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(count)))

    return use


def threads():
    return [each.name for each in threading.enumerate() if each.name.startswith("mujoco")]


def commanded(platform, states, ticks):
    """Every robot gets commands and gains of its own, and is pushed; all bytes of every tick."""
    rng = np.random.default_rng(7)
    trace = []
    for tick in range(ticks):
        platform.recv()
        for name in platform.facts.reads:
            states[name] = rng.uniform(0, 2, states[name].shape)
        if tick == 5:
            platform.push(rng.uniform(-1, 1, (COUNT, 2)))
        if tick == 12:
            platform.put({"joint_pos": np.full(4, 0.2)})
        platform.send()
        trace.append(bytes(states.snapshot().data))
        for robot in platform.robots:
            kept = robot.data.qpos, robot.data.qacc_warmstart, robot.data.qfrc_actuator
            trace.append(b"".join(each.tobytes() for each in kept))
    return trace


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"model": {"integrator": "RK4"}},
        {"joints": {"*": {"strength": 0.8}}},
        {"joints": {"*": {"delay": 0.004}, "elbow_joint": {"delay": 0.016}}},
    ],
    ids=["plain", "RK4", "weak", "late"],
)
def test_the_number_of_threads_changes_nothing(build, cores, options):
    traces = []
    for count in (1, 2, 3, 16):
        cores(count)
        platform, states = build(num_robots=COUNT, **options)
        assert len(threads()) == min(count, COUNT // 2) - 1
        traces.append(commanded(platform, states, 20))
        platform.reset()
        again = commanded(platform, states, 3)
        assert again == traces[-1][: len(again)]
        platform.close()
        assert threads() == []
    assert traces[0] == traces[1] == traces[2] == traces[3]
    assert len(set(traces[0])) == len(traces[0])  # robots and ticks do differ


@pytest.mark.parametrize("delay", [0.0, 0.012])
def test_a_robot_does_in_a_batch_what_it_does_alone(build, cores, delay):
    cores(3)
    joints = {"joints": {"wrist_joint": {"delay": delay, "strength": 0.7}}}
    many, of_many = build(num_robots=COUNT, **joints)
    singles = [build(**joints) for _ in range(COUNT)]
    rng = np.random.default_rng(1)
    for _ in range(15):
        for name in many.facts.reads:
            of_many[name] = rng.uniform(0, 2, of_many[name].shape)
            for k, (_, states) in enumerate(singles):
                states[name] = of_many[name][k]
        many.send()
        many.recv()
        for k, (single, states) in enumerate(singles):
            single.send()
            single.recv()
            for name in single.facts.writes:
                assert states[name].tobytes() == of_many[name][k, ...].tobytes(), (k, name)
            assert single.data.qacc_warmstart.tobytes() == (
                many.robots[k].data.qacc_warmstart.tobytes()
            )
    many.close()


@pytest.mark.parametrize("scene", [{}, {"joints": {"*": {"strength": 0.6}}}], ids=["", "weak"])
def test_what_is_told_of_a_batch_is_what_would_be_pushed(build, scene):
    platform, _ = build(**scene)
    servo = platform.servo
    model = platform.model
    ctrl = platform.data.ctrl
    written = ctrl, model.actuator_gainprm, model.actuator_biasprm

    @settings(max_examples=40, deadline=None, derandomize=True)
    @given(seed=st.integers(0, 2**32 - 1), factor=st.sampled_from([0.0, -0.0, 1.0, 1e6]))
    def alike(seed: int, factor: float) -> None:
        command = np.random.default_rng(seed).normal(size=(5, 3, 4)) * factor
        for k, told in enumerate(servo.told(command)):
            left = []
            for tell, what in ((servo.write, told), (servo.push, command[:, k])):
                for array in written:
                    array[...] = 9.0
                tell(ctrl, what)
                left.append(b"".join(array.tobytes() for array in written))
            assert left[0] == left[1]

    alike()


@pytest.mark.parametrize("wrong", [0, 3, 5])
def test_a_command_that_is_not_finite_names_its_robot_and_steps_nobody(build, cores, wrong):
    cores(3)
    platform, states = build(num_robots=COUNT)
    platform.send()
    before = [robot.data.qpos.copy() for robot in platform.robots]
    states.joint_pos_target[wrong, 1] = np.nan
    with pytest.raises(Fault, match=f"^robot {wrong}, joint_pos_target of joint elbow_joint"):
        platform.send()
    for robot, was in zip(platform.robots, before):
        np.testing.assert_array_equal(robot.data.qpos, was)
    states.joint_pos_target[...] = 0.0
    platform.send()
    platform.close()


@pytest.mark.parametrize("wrong", [(4,), (5, 2), (1, 0, 3)])
def test_of_the_robots_that_blow_up_the_first_is_named(build, cores, wrong):
    cores(3)
    platform, _ = build(num_robots=COUNT)
    for rank in wrong:
        platform.robots[rank].data.qvel[:] = 1e8
    with pytest.raises(Fault, match=f"^robot {min(wrong)}, the physics blew up"):
        platform.send()
    platform.close()
    assert threads() == []


def test_a_batch_of_one_says_so_and_a_robot_alone_does_not(build):
    for num_robots, who in ((1, "robot 0, "), (None, "")):
        platform, states = build(num_robots=num_robots)
        states.joint_stiffness[...] = np.inf
        with pytest.raises(Fault, match=f"^{who}joint_stiffness of joint shoulder_joint is inf"):
            platform.send()
        platform.reset()
        platform.data.qvel[:] = 1e8
        states.joint_stiffness[...] = 0.0
        with pytest.raises(Fault, match=f"^{who}the physics blew up"):
            platform.send()


def test_a_closed_batch_steps_on_without_threads(build, cores):
    cores(2)
    traces = []
    for closed in (False, True):
        platform, states = build(num_robots=COUNT)
        assert len(threads()) == 1
        if closed:
            platform.close()
            platform.close()
            assert threads() == []
        traces.append(commanded(platform, states, 5))
        platform.close()
    assert traces[0] == traces[1]


def test_a_batch_that_cannot_be_built_leaves_no_thread(cores):
    cores(4)
    robot = load_robot("go2")
    states = States(standard_states(robot.joint_names), 8)
    with pytest.raises(PlatformError):
        make(states, robot, 0.02, scene=Scene(initial_pose="nowhere"))
    assert threads() == []


def test_limits_are_lifted_for_every_robot(build, cores):
    cores(3)
    platform, states = build(num_robots=COUNT)

    def torques() -> list[float]:
        platform.reset()
        states.joint_effort_ff[...] = 100.0
        platform.send()
        platform.recv()
        return [float(each) for each in np.abs(states.joint_effort).max(axis=1)]

    limited = torques()
    with platform.unlimited():
        assert min(torques()) > 90.0
    assert torques() == limited
    assert max(limited) < 10.0
    platform.close()


def test_joints_are_locked_for_every_robot(build, cores):
    cores(3)
    platform, states = build(num_robots=COUNT)

    def moved() -> list[bool]:
        platform.reset()
        platform.recv()
        before = states.joint_pos.copy()
        states.joint_effort_ff[...] = 5.0
        for _ in range(10):
            platform.send()
            platform.recv()
        return (np.abs(states.joint_pos - before).min(axis=0) > 1e-3).tolist()

    free = moved()
    assert all(free[:3])
    with platform.locked([0, 2]):
        assert moved()[:3] == [False, True, False]
    assert moved() == free
    platform.close()


@pytest.mark.parametrize(
    ("count", "cores_", "expected"),
    [(1, 8, [1]), (3, 8, [3]), (4, 8, [2, 2]), (7, 2, [3, 4]), (64, 3, [21, 21, 22]), (5, 1, [5])],
)
def test_threads_share_the_robots(count, cores_, expected, cores):
    cores(cores_)
    found = shares(count)
    assert [len(each) for each in found] == expected
    assert [rank for each in found for rank in each] == list(range(count))
