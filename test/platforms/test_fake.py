"""The fake platform: joints follow their targets, nothing else is needed."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scenes import in_scene

from unicon_base.errors import Fault, PlatformError, WorkflowError
from unicon_core.platforms.fake import FakePlatform, make, make_robot
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states
from unicon_core.workflow import Program

PERIOD = 0.01


@pytest.fixture
def build():
    def make_it(num_robots: int | None = None, **options: Any) -> tuple[FakePlatform, States]:
        robot = load_robot("go2")
        states = States(standard_states(robot.joint_names), num_robots)
        platform = in_scene(make, states, robot, PERIOD, **options)
        platform.recv()
        states.joint_stiffness = robot.joint_stiffness
        states.joint_damping = robot.joint_damping
        return platform, states

    return make_it


Build = Callable[..., tuple[FakePlatform, States]]


@pytest.mark.parametrize("num_robots", [None, 3])
def test_ideal_joints_are_at_their_targets_after_a_tick(build, num_robots):
    platform, states = build(num_robots)
    before = states.joint_pos.copy()
    states.joint_pos_target = before + np.float32(0.1)
    platform.send()
    platform.recv()
    np.testing.assert_allclose(states.joint_pos, before + 0.1, atol=1e-6)
    np.testing.assert_allclose(states.joint_vel, 0.1 / PERIOD, rtol=1e-4)
    np.testing.assert_allclose(states.joint_effort, 6.0, rtol=1e-4)  # 60 N·m/rad · 0.1 rad


def test_first_order_joints_reach_63_percent_in_a_time_constant(build):
    platform, states = build(time_constant=0.2)
    before = states.joint_pos.copy()
    states.joint_pos_target = before + np.float32(0.1)
    for _ in range(20):
        platform.send()
    platform.recv()
    np.testing.assert_allclose(states.joint_pos - before, 0.1 * (1 - np.exp(-1)), rtol=1e-4)


def test_limp_joints_stay_and_limits_hold(build):
    platform, states = build()
    robot = load_robot("go2")
    before = states.joint_pos.copy()
    states.joint_pos_target = 10.0
    states.joint_stiffness[:6] = 0.0
    platform.send()
    platform.recv()
    assert states.joint_pos[:6].tolist() == before[:6].tolist()
    assert states.joint_pos[6:].tolist() == robot.upper[6:].tolist()
    assert (np.abs(states.joint_effort) <= robot.effort_limit).all()


def test_clock_is_simulated_or_monotonic(build):
    platform, states = build()
    for _ in range(3):
        platform.send()
    platform.recv()
    assert (platform.facts.simulated, int(states.stamp_ns)) == (True, 30_000_000)
    platform.reset()
    platform.recv()
    assert int(states.stamp_ns) == 0
    robot = load_robot("go2")
    platform = make_robot(states, robot, PERIOD)
    first = time.monotonic_ns()
    platform.recv()
    assert not platform.facts.simulated
    assert int(states.stamp_ns) >= first > 0


def test_command_that_is_not_finite_is_a_fault(build):
    platform, states = build()
    states.joint_pos_target[1] = np.nan
    with pytest.raises(Fault) as error:
        platform.send()
    assert str(error.value) == ("joint_pos_target of joint FR_thigh_joint is nan")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"initial_pose": "defualt"},
            "scene.initial_pose is 'defualt'; did you mean 'default'? known: default, "
            "keyframe:NAME, lie, model, policy:NAME, rest, stand; or joints to [rad]",
        )
    ],
)
def test_wrong_options(build, options, message):
    with pytest.raises(PlatformError) as error:
        build(**options)
    assert str(error.value) == message


def test_a_time_that_is_none_is_refused():
    with pytest.raises(WorkflowError, match="'fake': time_constant is -1; write a number from 0"):
        Program(
            robot="go2",
            platform="fake",
            platforms={"fake": {"time_constant": -1}},
            rate=50,
            flow="hold",
        )


def test_platform_modules_import_no_simulator():
    code = (
        "import sys, unicon_core.platforms.fake, unicon_core.platforms.mujoco; "
        "import unicon_core.blocks; "
        "print([m for m in ('mujoco', 'rclpy', 'onnxruntime') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
