"""moving_target: a circle that begins without a jump, with the velocity that it has."""

from __future__ import annotations

import numpy as np
import pytest

from unicon_base.errors import UniconError
from unicon_core.models.find import pick_model
from unicon_core.models.frames import Frames
from unicon_core.models.load import load_model
from unicon_core.states.standard import target_states
from unicon_core.testing import Bench
from unicon_core.workflow import Program
from unicon_core.workflow.uses import block

pytest.importorskip("mujoco", reason="the centre needs mujoco")


def moving(robot, **options):
    bench = Bench(robot, period=0.01, states=target_states("tool"))
    return bench, bench.block("moving_target", effector="tool", **options)


def test_it_begins_at_the_default_pose_and_ends_on_the_circle(reacher):
    bench, made = moving(reacher, radius=0.1, frequency=0.5, ramp=1.0, plane="xz")
    assert np.isnan(bench.states.tool_target).all()
    loaded = load_model(pick_model(reacher), reacher, quiet=True)
    places = {"tool": reacher.end_effectors["tool"]}
    begin = Frames(loaded, reacher, places).of(reacher.default_joint_pos)["tool"]
    bench.states.stamp_ns = 123
    made.tick()
    np.testing.assert_allclose(bench.states.tool_target, begin, atol=1e-6)
    assert not bench.states.tool_target_velocity.any()
    assert bench.states.tool_target_stamp_ns == 123
    for _ in range(300):
        made.tick()
    off = bench.states.tool_target[:3] - begin[:3]
    assert np.hypot(off[0], off[2]) == pytest.approx(0.1, abs=1e-6)
    assert off[1] == pytest.approx(0.0, abs=1e-7)
    speed = np.linalg.norm(bench.states.tool_target_velocity[:3])
    assert speed == pytest.approx(0.1 * np.pi, abs=1e-6)
    np.testing.assert_allclose(bench.states.tool_target[3:], begin[3:], atol=1e-6)
    made.reset()
    made.tick()
    np.testing.assert_allclose(bench.states.tool_target, begin, atol=1e-6)


def test_the_velocity_is_that_of_the_target(reacher):
    bench, made = moving(reacher, radius=0.08, frequency=0.4, ramp=1.0, centre=[0.3, 0.0, 0.2])
    before = None
    for _ in range(200):
        made.tick()
        now = bench.states.tool_target[:3].copy()
        velocity = bench.states.tool_target_velocity[:3]
        if before is not None:
            mean = 0.5 * (velocity + before[1])
            np.testing.assert_allclose((now - before[0]) / 0.01, mean, atol=2e-4)
        before = now, velocity.copy()


def test_without_a_ramp_it_is_on_the_circle_at_once(reacher):
    bench, made = moving(reacher, radius=0.1, ramp=0.0, centre=[0.3, 0.0, 0.2])
    made.tick()
    np.testing.assert_allclose(bench.states.tool_target[:3], (0.3, 0.1, 0.2), atol=1e-7)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"effector": "tol"}, "no end effector 'tol'; did you mean 'tool'"),
        ({}, "needs the option 'effector'"),
        ({"effector": "tool", "radius": 3}, "radius is 3; write a number from 0 to 1 [m]"),
        ({"effector": "tool", "frequency": -1}, "frequency is -1"),
        ({"effector": "tool", "ramp": -1}, "ramp is -1"),
        ({"effector": "tool", "plane": "yx"}, "plane 'yx' is not known; known: xy, xz, yz"),
        ({"effector": "tool", "centre": [1, 2]}, "centre is [1, 2]; write a list of 3"),
        ({"effector": "tool", "centre": "there"}, "centre is 'there'; write default or a list"),
    ],
)
def test_a_wrong_option_is_told(reacher, options, message):
    with pytest.raises(UniconError) as told:
        Program(
            robot=str(reacher.path),
            platform="fake",
            rate=50,
            commands=[block("moving_target", **options)],
            flow=block("hold"),
        )
    assert message in str(told.value)


def test_a_batch_is_refused(reacher):
    bench = Bench(reacher, 2, states=target_states("tool"))
    with pytest.raises(UniconError, match="it is for one robot; leave num_robots out"):
        bench.block("moving_target", effector="tool")
