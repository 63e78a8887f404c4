"""`joint_sensor_stop` and `imu_stop` find sensors that contradict each other, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_blocks_detectors import rest, tripped

from unicon_base.errors import Fault, WorkflowError
from unicon_core.robots import load_robot

Build = Callable[..., Any]
PERIOD = 0.02
KNEE = 5


class Gait:
    """Joints that swing, and a base that turns and nods, as sensors tell of them.

    Args:
        it: states and robot.
        noise: half of its range, as training has it: [rad/s] of velocities; positions have a
            hundredth of it in [rad].
    """

    def __init__(self, it: Any, noise: float = 0.0) -> None:
        self.it = rest(it)
        self.noise = noise
        self.rng = np.random.default_rng(3)
        self.time = 100.0
        self.turns = 0.6
        self.phase = np.arange(len(it.robot.joint_names)) * 1.3

    def frame(self, k: int, *, time: float | None = None) -> None:
        """Measure in tick k."""
        states = self.it.states
        rng = self.rng
        n = len(self.phase)
        t = PERIOD * k if time is None else time
        swing = 12.0 * t + self.phase
        noise = [self.noise * scale * rng.uniform(-1, 1, n) for scale in (0.01, 1.0)]
        states.joint_pos = self.it.robot.default_joint_pos + 0.25 * np.sin(swing) + noise[0]
        states.joint_vel = 3.0 * np.cos(swing) + noise[1]
        yaw = self.turns * t
        nod = 0.06 * np.sin(12.0 * t)
        w = np.cos(yaw / 2)
        z = np.sin(yaw / 2)
        y = np.sin(nod / 2)
        quat = np.array([w * np.cos(nod / 2), -z * y, w * y, z * np.cos(nod / 2)])
        states.base_quat = quat
        rate = 0.06 * 12.0 * np.cos(12.0 * t)
        states.base_ang_vel = (-self.turns * np.sin(nod), rate, self.turns * np.cos(nod))
        states.projected_gravity = (np.sin(nod), 0.0, -np.cos(nod))
        states.stamp_ns = round((self.time + t) * 1e9)


def add(state, value, place=...):
    def lie(states: Any, k: int) -> None:
        states[state][place] += value

    return lie


def scaled(state, factor):
    def lie(states: Any, k: int) -> None:
        states[state] *= np.float32(factor)

    return lie


def frozen(state):
    kept: list[Any] = []

    def lie(states: Any, k: int) -> None:
        kept or kept.append(np.array(states[state]))
        states[state][...] = kept[0]

    return lie


@pytest.mark.parametrize(
    ("block", "lie", "within", "words"),
    [
        ("joint_sensor_stop", add("joint_pos", 0.3, KNEE), 0.02, "is its encoder sound"),
        ("joint_sensor_stop", add("joint_pos", -0.3, KNEE), 0.02, "joint FL_calf_joint went from"),
        ("joint_sensor_stop", frozen("joint_vel"), 0.3, "than their velocities say"),
        ("joint_sensor_stop", scaled("joint_vel", 0.0), 0.3, "than their velocities say"),
        ("joint_sensor_stop", scaled("joint_vel", -1.0), 0.3, "than their velocities say"),
        ("imu_stop", add("base_ang_vel", 2.0, 2), 0.3, "than the gyroscope says"),
        ("imu_stop", add("base_ang_vel", -2.0, 0), 0.3, "than the gyroscope says"),
        ("imu_stop", scaled("base_ang_vel", -1.0), 0.6, "than the gyroscope says"),
    ],
)
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_sensors_that_contradict_each_other_are_a_fault(bench, block, lie, within, words, noise):
    gait = Gait(bench(), noise)
    made = gait.it.block(block)
    for k in range(150):
        gait.frame(k)
        made.tick()

    def lies(k: int) -> None:
        gait.frame(150 + k)
        lie(gait.it.states, k)

    k, fault = tripped(made, lies)
    assert (k + 1) * PERIOD <= within + 1e-9
    assert words in fault


@pytest.mark.parametrize("block", ["joint_sensor_stop", "imu_stop"])
def test_sound_sensors_are_none(bench, block):
    """With noise; frames that come twice, are late, are lost; pauses; a clock that is set."""
    gait = Gait(bench(), 1.5)
    made = gait.it.block(block)
    rng = np.random.default_rng(4)
    last = 0.0
    for k in range(3000):
        if rng.random() > 0.05:  # else nothing has come
            last = max(last, PERIOD * k - rng.uniform(0.0, 0.02))
            gait.frame(k, time=last)
        if k == 1000:
            gait.time += 3600.0
        if k == 2000:
            gait.time -= 1.0
        made.tick()
    last += 0.3
    gait.frame(0, time=last)
    made.tick()
    made.reset()
    gait.frame(0, time=last + 5.0)
    made.tick()


@pytest.mark.parametrize("late", [0.008, 0.012, 0.016])
def test_every_other_frame_stamped_late_is_none(bench, late):
    """On a busy machine: the next frame is on time, hence early against the one before it."""
    gait = Gait(bench(), 0.5)
    made = gait.it.block("joint_sensor_stop")
    for k in range(400):
        t = PERIOD * k
        states = gait.it.states
        gait.frame(k)
        states.joint_pos = 0.5 * gait.phase + 6.0 * t + 0.005 * gait.rng.uniform(-1, 1, 12)
        states.joint_vel = 6.0 + 0.5 * gait.rng.uniform(-1, 1, 12)
        states.stamp_ns = round((gait.time + t + late * (k % 2)) * 1e9)
        made.tick()
    lies = tripped(made, lambda k: _lie_on(gait, 400 + k, late))
    assert (lies[0] + 1) * PERIOD <= 0.3 + 1e-9


def _lie_on(gait, k, late):
    """Go on so, with velocities that stand at 0."""
    t = PERIOD * k
    gait.it.states.joint_pos = 0.5 * gait.phase + 6.0 * t
    gait.it.states.joint_vel = np.zeros(12)
    gait.it.states.stamp_ns = round((gait.time + t + late * (k % 2)) * 1e9)


def test_an_old_frame_behind_a_pause_is_none(bench):
    """A burst: its first frame was measured 50 ms ago, and is stamped as if it had just been."""
    gait = Gait(bench())
    made, gait.phase = gait.it.block("joint_sensor_stop"), np.zeros(12)  # all are quick at once
    for k in range(51):
        gait.frame(k)
        made.tick()
    for measured, stamped in ((1.02, 1.07), (1.08, 1.08), (1.10, 1.10), (1.12, 1.12)):
        gait.frame(0, time=measured)
        gait.it.states.stamp_ns = round((gait.time + stamped) * 1e9)
        made.tick()
    gait.frame(0, time=1.14)
    gait.it.states.joint_pos[KNEE] += 0.3
    with pytest.raises(Fault, match="encoder"):
        made.tick()


def test_velocities_of_the_same_bits_are_a_fault_where_joints_move_slowly(bench):
    gait = Gait(bench())
    made = gait.it.block("joint_sensor_stop")
    pos = gait.it.states.joint_pos
    gait.it.states.joint_vel = 0.0

    def crept(k: int) -> None:
        pos[...] += 0.002
        gait.it.states.stamp_ns = 20_000_000 * k

    k, fault = tripped(made, crept)
    assert k == 13  # twelve joints, 0.024 rad a frame
    assert "joint velocities stand still: the same bits for 0.2" in fault
    made.reset()
    for k in range(500):  # they stand, and their encoders flicker
        pos[3] += 0.001 * (-1) ** k
        gait.it.states.stamp_ns = 20_000_000 * (2000 + k)
        made.tick()


def test_an_imu_of_another_topic_than_the_stamps_is_sound(bench):
    gait = Gait(bench(), 1.0)
    made = gait.it.block("imu_stop")
    rng = np.random.default_rng(5)
    gait.turns = 3.0
    stamp = 0
    for k in range(2000):
        gait.frame(k)
        if rng.random() < 0.3:  # joint states are late, and their stamp
            gait.it.states.stamp_ns = stamp
        stamp = int(gait.it.states.stamp_ns)
        made.tick()


def test_nan_is_left_to_others_and_what_follows_is_looked_at(bench):
    gait = Gait(bench())
    made = gait.it.block("joint_sensor_stop")
    for k in range(100):
        gait.frame(k)
        if k in (50, 51):
            gait.it.states.joint_vel[3] = np.nan
        made.tick()
    gait.frame(100)
    gait.it.states.joint_pos[KNEE] += 0.3
    with pytest.raises(Fault, match="encoder"):
        made.tick()


@pytest.mark.parametrize("what", ["wheel", "finger", "leg"])
def test_joints_that_turn_for_ever_or_take_positions_are_not_looked_at(bench, what):
    robot = load_robot("go2")
    knee = np.arange(robot.num_joints) == KNEE
    if what == "wheel":
        lower = np.where(knee, -np.inf, robot.lower)
        upper = np.where(knee, np.inf, robot.upper)
        robot = replace(robot, lower=lower, upper=upper)
    elif what == "finger":
        robot = replace(robot, transport={**robot.transport, "command": "position"})
    gait = Gait(bench(robot))
    made = gait.it.block("joint_sensor_stop")

    def jumping(k: int) -> None:
        gait.frame(k)
        gait.it.states.joint_pos[KNEE] += 0.5 * (k % 2)

    if what == "leg":
        assert tripped(made, jumping)[0] == 1
        return
    for k in range(50):
        jumping(k)
        made.tick()


def test_it_is_for_one_robot_and_plausible_bounds(bench):
    with pytest.raises(WorkflowError, match="one robot"):
        bench(num_robots=2).block("joint_sensor_stop")
    with pytest.raises(WorkflowError, match="step is -1"):
        bench().block("joint_sensor_stop", step=-1.0)
