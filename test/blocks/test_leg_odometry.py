"""leg_odometry against the simulator's truth, and where sensors fail, feet slip, or none stands."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from odometry_runs import NOISE, run

from unicon_base.errors import UniconError, WorkflowError
from unicon_core.blocks.odometry.velocity_filter import PERIOD, VelocityFilter
from unicon_core.check import check_workflow
from unicon_core.robots import load_robot
from unicon_core.states import States
from unicon_core.testing import Bench
from unicon_core.workflow import Program, load_document
from unicon_core.workflow.registry import find_factory

WALK = {
    "estimate": ["leg_odometry"],
    "commands": [{"velocity_command": {"constant": [0.6, 0.1, 0.4]}}],
    "flow": {"chain": [{"pose": {"to": "stand", "duration": 1.0}}, {"policy": "walk"}]},
}
STAND = WALK | {"commands": [], "flow": {"chain": [{"pose": {"to": "stand"}}, "hold"]}}


def bench(**options):
    """A Go2 that stands, and the block's tick."""
    declares = find_factory("blocks", "leg_odometry", WorkflowError).declares
    made = Bench("go2", states=declares(robot=load_robot("go2")))
    made.stand()
    made.states.base_lin_acc = (0.0, 0.0, 9.81)
    return made, made.block("leg_odometry", **options).tick


def test_a_walk_with_noise_and_pushes_is_estimated():
    """A short one of the slow test's."""
    scene = {"initial_pose": "rest", "noise": NOISE, "push": {"every": 2.0, "velocity": 0.4}}
    seen = run("go2_walk", WALK | {"scene": scene}, 8.0)
    assert not seen.report.faults
    assert not seen.report.fell
    assert np.abs(seen.truth[200:, :2]).max() > 0.4
    assert seen.rms < 0.1
    told = np.sqrt(3.0 * seen.variance[100:].mean())
    assert 0.5 * told < seen.rms < 2.0 * told  # the variance is not made up


def test_feet_are_told_to_stand_and_to_swing():
    seen = run("go2_walk", WALK, 5.0)
    assert (seen.contact[60:] >= 0.0).all()
    assert (seen.contact[60:] <= 1.0).all()
    standing = (seen.contact[150:] > 0.5).mean(axis=0)
    assert ((standing > 0.3) & (standing < 0.9)).all()


@pytest.mark.parametrize(
    "sensor",
    ["joint_pos", "joint_vel", "joint_effort", "base_lin_acc", "base_quat", "base_ang_vel"],
)
@pytest.mark.parametrize("value", [math.nan, math.inf, 3e38])
def test_values_that_are_none_are_ridden_out(sensor, value):
    """0.2 s of them in a bench that stands: never a number that is none, and at rest afterwards."""
    made, tick = bench()
    for _ in range(20):
        tick()
    good = made.states[sensor].copy()
    made.states[sensor][...] = value
    for _ in range(10):
        tick()
        assert np.isfinite(made.states.base_lin_vel).all()
        assert np.isfinite(made.states.base_pos_w).all()
        assert np.abs(made.states.base_lin_vel).max() < 0.1
    made.states[sensor][...] = good
    for _ in range(50):
        tick()
    np.testing.assert_allclose(made.states.base_lin_vel, 0.0, atol=0.02)


def test_a_walk_goes_on_over_values_that_are_none():
    def spoil(states: States, tick: int) -> None:
        if 200 <= tick < 210:
            states["base_lin_acc"][...] = np.nan
        if 240 <= tick < 250:
            states["joint_effort"][3] = np.nan

    seen = run("go2_walk", WALK, 7.0, spoil)  # what the policy reads would be a fault
    assert np.isfinite(seen.estimate).all()
    assert not seen.report.faults
    assert seen.rms < 0.15


def test_silence_changes_nothing():
    """The same data again, as of a robot that is not heard: the estimate stays as it is."""

    def spoil(states: States, tick: int) -> None:
        if tick >= 200:
            for name, value in held.items():
                states[name][...] = value
        else:
            held.update({name: states[name].copy() for name in SILENT})

    SILENT = ("stamp_ns", "joint_pos", "joint_vel", "base_lin_acc", "base_quat", "base_ang_vel")
    held: dict[str, Any] = {}
    seen = run("go2_walk", WALK, 5.0, spoil)
    assert (seen.estimate[201:] == seen.estimate[200]).all()


def test_a_foot_that_slips_is_not_believed():
    """One of four moves at 1.5 m/s or more while it bears as much as the others."""
    made, tick = bench()
    for _ in range(20):
        tick()
    made.states.joint_vel[2] = 8.0  # a calf of 0.2 m
    for _ in range(25):
        tick()
    assert np.abs(made.states.base_lin_vel).max() < 0.05


def test_all_feet_in_the_air_leave_the_accelerometer():
    """Dropped from 1 m: it falls for 0.4 s, lands and stands."""
    scene = {"initial_pose": "default", "initial_height": 1.0}
    seen = run("go2_walk", STAND | {"scene": scene}, 3.0)
    assert not seen.contact[:18].any()
    assert seen.truth[:18, 2].min() < -3.0
    assert seen.error[:18].max() < 0.05
    assert seen.error[60:].max() < 0.1


def test_a_robot_that_hangs_comes_to_rest():
    """Legs that bear nothing, and an accelerometer that is off by a tilt of 2°."""
    program = Program(robot="go2", platform="fake", rate=50, estimate=["leg_odometry"], flow="hold")
    tick = next(b.tick for b in program.blocks if b.name == "leg_odometry")
    program.platform.recv()
    states = program.states
    states.base_lin_acc = (0.3, 0.0, 9.81)
    states.joint_vel = 5.0
    for _ in range(1000):
        states.joint_vel *= -1.0
        states.stamp_ns += 20_000_000
        tick()
    assert not states.foot_contact.any()
    assert np.abs(states.base_lin_vel).max() < 0.5
    program.close()


def test_without_torques_the_height_of_the_feet_tells():
    """The bench's platform tells none; a leg that is drawn up hangs."""
    made, tick = bench()
    tick()
    assert made.states.foot_contact.tolist() == [1.0] * 4
    made.states.joint_pos[1:3] = (1.3, -2.4)
    tick()
    assert made.states.foot_contact.tolist() == [0.0, 1.0, 1.0, 1.0]


def test_height_is_that_over_the_feet_that_stand():
    made, tick = bench()
    for _ in range(10):
        tick()
    assert made.states.base_pos_w[2] == pytest.approx(0.32, abs=0.05)
    assert made.states.base_pos_w[:2].tolist() == pytest.approx([0.0, 0.0], abs=1e-3)


def test_a_simulator_that_is_put_back_begins_anew():
    document = load_document("go2_walk", WALK)
    program = Program(document)
    blocks = {block.name: block for block in program.blocks}
    tick = blocks["leg_odometry"].tick
    states = program.states
    program.platform.recv()
    tick()
    states.stamp_ns += 10**9
    states.base_lin_acc[0] = 50.0
    tick()
    states.stamp_ns[...] = 0
    states.base_lin_acc[0] = 0.0
    tick()
    assert np.abs(states.base_lin_vel).max() < 0.2
    program.close()


def test_warming_up_changes_nothing():
    program = Program(load_document("go2_walk", WALK))
    block = next(b for b in program.blocks if b.name == "leg_odometry")
    program.platform.recv()
    block.tick()
    before = program.states.buffer.copy()
    assert block.warm_up is not None
    for _ in range(5):
        block.warm_up()
    assert (program.states.buffer == before).all()
    block.tick()  # no new data
    assert (program.states.buffer == before).all()
    program.close()


def test_truth_stays_where_the_estimate_has_another_name():
    changes = WALK | {
        "states": {"estimated": {"shape": [3], "unit": "m/s", "frame": "base"}},
        "estimate": [{"leg_odometry": {"states": {"base_lin_vel": "estimated"}}}],
    }
    program = Program(load_document("go2_walk", changes))
    block = next(b for b in program.blocks if b.name == "leg_odometry")
    assert "estimated" in block.writes
    assert "base_lin_vel" not in (*block.writes, *block.amends)
    program.close()


def test_position_is_estimated_where_nobody_measures_it_or_where_asked():
    for options, written in (({}, False), ({"position": True}, True)):
        changes = WALK | {"estimate": [{"leg_odometry": options}]}
        program = Program(load_document("go2_walk", changes))
        block = next(b for b in program.blocks if b.name == "leg_odometry")
        assert ("base_pos_w" in block.amends) is written
        program.close()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_robots": 2}, "it is for one robot; leave num_robots out"),
        ({"estimate": [{"leg_odometry": {"joint_noise": 0.0}}]}, "joint_noise is 0.0; write"),
        ({"estimate": [{"leg_odometry": {"acceleration_noise": ".nan"}}]}, "acceleration_noise"),
        ({"estimate": ["leg_odometry", "leg_odometry"]}, "writes 'base_lin_vel_variance' in the"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(changes, message):
    with pytest.raises(UniconError, match=message) as raised:
        Program(load_document("go2_walk", WALK | changes)).close()
    assert "\n" not in str(raised.value)


def test_an_arm_has_no_feet():
    with pytest.raises(UniconError, match=r"robot arx_x5 \(arm\) has no feet"):
        Program(
            robot="arx_x5", platform="fake", rate=50, estimate=["leg_odometry"], flow="hold"
        ).close()


FORCES = """
from dataclasses import replace

from unicon_core.platforms.fake import FakePlatform, make as fake

WRITES = (*FakePlatform.facts.writes, "foot_force")
FACTS = replace(FakePlatform.facts, name="sensed", writes=WRITES)


def make(states, robot, period):
    made = fake(states, robot, period)
    made.facts = FACTS
    return made


make.facts = FACTS
"""


@pytest.fixture
def sensed(tmp_path, monkeypatch):
    """A workflow whose platform tells what the feet's sensors read."""
    (tmp_path / "sensed_platform.py").write_text(FORCES, "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    return {
        "robot": "go2",
        "platform": "sensed_platform:make",
        "rate": 50,
        "states": {"foot_force": {"shape": [4]}},
        "flow": "hold",
    }


def test_force_sensors_tell_which_feet_stand(sensed):
    program = Program(**sensed, estimate=[{"leg_odometry": {"foot_force": 30.0}}])
    tick = next(b.tick for b in program.blocks if b.name == "leg_odometry")
    program.platform.recv()
    program.states.foot_force = (80.0, 10.0, np.nan, 30.0)
    tick()
    assert program.states.foot_contact.tolist() == [1.0, 0.0, 0.0, 1.0]
    program.close()


def test_a_force_without_a_threshold_is_asked_for(sensed):
    with pytest.raises(UniconError, match="say from which reading on a foot stands"):
        Program(**sensed, estimate=["leg_odometry"]).close()


HARDWARE = """
from unicon_core.platforms.platform import Facts, Platform
from unicon_core.states.standard import JOINT_STATES

TOLD = (*JOINT_STATES, "base_quat", "base_ang_vel", "base_lin_acc", "projected_gravity", "stamp_ns")


def make(states, robot, period) -> Platform:
    raise AssertionError("a check opens no hardware")


make.facts = Facts("toy", writes=TOLD)
"""


def test_check_offers_it_where_a_policy_reads_what_nobody_measures(tmp_path, monkeypatch, assets):
    (tmp_path / "toy_robot.py").write_text(HARDWARE, "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    changes = {"platform": "toy_robot:make", "platforms": {}, "scene": {}}
    without = check_workflow("go1_walk", changes | {"estimate": []})
    (finding,) = without.findings
    assert "block 'policy' reads 'base_lin_vel', which no block writes" in str(finding)
    assert "that writes 'base_lin_vel', as leg_odometry does (estimate: [leg_odometry])" in str(
        finding
    )
    given = check_workflow("go1_walk", changes)
    assert not [f for f in given.findings if f.code in ("build", "observation.measured")]


# -- the filter beside a plain one ----------------------------------------------------------------

number = st.floats(-2.0, 2.0)
vector = st.tuples(number, number, number)
step = st.tuples(vector, st.lists(st.tuples(vector, st.floats(0.01, 1.0)), max_size=4))


class Plain:
    """The same filter as a book has it, with matrices: x = (v, b), F = [[1, -R dt], [0, 1]]."""

    def __init__(self, noise: float) -> None:
        self.x = np.zeros(6)
        self.p = np.diag([1.0] * 3 + [0.25] * 3)
        self.noise = noise
        self.last: Any = None

    def __call__(self, dt: float, force: Any, feet: Any) -> None:
        now = np.asarray(force) - self.x[3:] - (0.0, 0.0, 9.81)
        self.x[:3] += 0.0 if self.last is None else 0.5 * dt * (now + self.last)
        self.last = now
        f = np.eye(6)
        f[:3, 3:] = -dt * np.eye(3)
        q = np.diag([self.noise**2 * PERIOD * dt] * 3 + [0.02**2 * dt] * 3)
        self.p = f @ self.p @ f.T + q
        told = [np.asarray(velocity) - self.x[:3] for velocity, _ in feet]
        rows = []
        for error, (_, own) in zip(told, feet):
            far = error @ error / (8.0 * (self.p[0, 0] + own))
            rows.append(own * max(far, 1.0) ** 2 * PERIOD / dt)
        if not rows:
            return
        h = np.tile(np.hstack([np.eye(3), np.zeros((3, 3))]), (len(rows), 1))
        s = h @ self.p @ h.T + np.kron(np.diag(rows), np.eye(3))
        k = self.p @ h.T @ np.linalg.inv(s)
        self.x += k @ np.concatenate(told)
        self.x[3:] = np.clip(self.x[3:], -2.0, 2.0)
        self.p = (np.eye(6) - k @ h) @ self.p


@given(st.lists(step, min_size=1, max_size=12), st.sampled_from([0.002, 0.02]))
def test_the_filter_is_that_of_the_book(steps, dt):
    upright = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    fast = VelocityFilter(1.5)
    plain = Plain(1.5)
    for (x, y, z), feet in steps:
        force = (x, y, z + 9.81)
        fast.predict(dt, upright, force)
        fast.correct(dt, upright, [at for at, _ in feet], [own for _, own in feet])
        plain(dt, force, feet)
        np.testing.assert_allclose(fast.velocity, plain.x[:3], atol=1e-9)
        np.testing.assert_allclose(fast.bias, plain.x[3:], atol=1e-9)
        assert fast.variance == pytest.approx(plain.p[0, 0], rel=1e-9)
