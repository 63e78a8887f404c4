"""velocity_command, predicates, projected_gravity, copy and linear_map."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import WorkflowError
from unicon_core.blocks import BUILTIN
from unicon_core.states import States, StateSpec, standard_states
from unicon_core.workflow.registry import import_target

Bench = Any
Build = Callable[..., Bench]


def test_every_builtin_target_exists():
    for name, target in BUILTIN.items():
        assert callable(import_target(target, name, WorkflowError))


def commands(it, block, ticks):
    rows = []
    for _ in range(ticks):
        block.tick()
        rows.append(it.states.velocity_command.copy())
    return np.array(rows)


def test_constant_command_is_written_every_tick(bench):
    it = bench()
    rows = commands(it, it.block("velocity_command", constant=[0.5, 0.0, -0.2]), 3)
    np.testing.assert_allclose(rows, [[0.5, 0.0, -0.2]] * 3, rtol=1e-6)


def test_schedule_switches_at_its_times_and_begins_anew(bench):
    it = bench()
    schedule = [[0.04, 1, 0, 0], [0.1, 0, 0, 0.5]]
    block = it.block("velocity_command", schedule=schedule, duration=0.16)
    for _ in range(2):
        rows = commands(it, block, 7)
        assert rows[:, 0].tolist() == [0, 0, 1, 1, 1, 0, 0]
        assert rows[:, 2].tolist() == [0, 0, 0, 0, 0, 0.5, 0.5]
        assert block.tick()
        assert block.reset is not None
        block.reset()


def test_ramp_and_limits_bound_the_command(bench):
    it = bench()
    block = it.block(
        "velocity_command",
        constant=[3.0, -3.0, 1.0],
        ramp=[1.0, 2.0, 50.0],
        limits=[[-0.5, 0.06], [-0.1, 0.1], [-1, 1]],
    )
    rows = commands(it, block, 4)
    np.testing.assert_allclose(rows[:, 0], [0.02, 0.04, 0.06, 0.06], rtol=1e-5)
    np.testing.assert_allclose(rows[:, 1], [-0.04, -0.08, -0.1, -0.1], rtol=1e-5)
    np.testing.assert_allclose(rows[:, 2], 1.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "give either constant: [vx, vy, wz] or schedule: [[t, vx, vy, wz], …]"),
        ({"constant": [1.0]}, "constant is [1.0]; write [vx, vy, wz], or null"),
        ({"schedule": [[0, 1, 0]]}, "schedule.0 is [0, 1, 0]; write [t, vx, vy, wz]"),
        (
            {"schedule": [[1, 0, 0, 0], [1, 0, 0, 0]]},
            "the schedule's times [1.0, 1.0] do not rise; correct them",
        ),
        (
            {"constant": [0, 0, 0], "limits": [[1, 0], [0, 1], [0, 1]]},
            "limits are [[1.0, 0.0], [0.0, 1.0], [0.0, 1.0]]; give [[lowest, highest]] of vx, vy "
            "and wz",
        ),
        ({"constant": [0, 0, 0], "ramp": 0.0}, "ramp is 0.0; write a number above 0, or null"),
    ],
)
def test_wrong_commands(bench, options, message):
    with pytest.raises(WorkflowError) as error:
        bench().block("velocity_command", **options)
    assert str(error.value) == f"block 'velocity_command': {message}"


def test_elapsed_counts_ticks_and_stays_true(bench):
    block = bench().block("elapsed", seconds=0.1)
    assert [block.tick() for _ in range(7)] == [False] * 4 + [True] * 3
    assert block.reset is not None
    block.reset()
    assert not block.tick()


def test_settled_needs_uninterrupted_rest(bench):
    it = bench()
    block = it.block("settled", velocity=0.1, duration=0.06)
    speeds = (0.0, 0.05, 0.2, -0.05, 0.0, 0.0, np.nan, 0.0)
    results = []
    for speed in speeds:
        it.states.joint_vel[5] = speed
        results.append(bool(block.tick()))
    assert results == [False, False, False, False, False, True, False, False]


@pytest.mark.parametrize("num_robots", [None, 4])
def test_projected_gravity_is_the_rotated_vertical(bench, num_robots):
    it = bench(num_robots=num_robots)
    rng = np.random.default_rng(0)
    block = it.block("projected_gravity")
    for _ in range(20):
        it.randomize(rng)
        block.tick()
        quats = np.atleast_2d(it.states.base_quat).astype(np.float64)
        for (w, *v), got in zip(quats, np.atleast_2d(it.states.projected_gravity)):
            # q* (0, 0, -1) q, with u = -v: g + 2 u x (u x g + w g)
            u = -np.array(v)
            g = np.array((0.0, 0.0, -1.0))
            expected = g + 2 * np.cross(u, np.cross(u, g) + w * g)
            np.testing.assert_allclose(got, expected, atol=1e-6)


def with_extra(it, num_robots=None):
    it.states = States(
        {
            **standard_states(it.robot.joint_names),
            "legs": StateSpec((2,)),
            "scalar": StateSpec(()),
            "ticks_f": StateSpec((), "float64"),
        },
        num_robots,
    )


@pytest.mark.parametrize("num_robots", [None, 3])
def test_linear_map_scales_and_shifts_chosen_elements(bench, num_robots):
    it = bench()
    with_extra(it, num_robots)
    it.states.joint_pos = np.arange(12)
    block = it.block(
        "linear_map",
        source="joint_pos",
        target="legs",
        index=["FL_hip_joint", 1],
        scale=[2.0, -1.0],
        offset=0.5,
    )
    assert (block.reads, block.writes) == (("joint_pos",), ("legs",))
    block.tick()
    expected = np.broadcast_to([6.5, -0.5], it.states.legs.shape)
    assert it.states.legs.tolist() == expected.tolist()
    data = block.tick
    assert data.source_name == "joint_pos"
    assert data.index.tolist() == [3, 1]
    assert data.scale.tolist() == [2.0, -1.0]
    assert data.offset.tolist() == [0.5, 0.5]
    assert np.shares_memory(data.source, it.states.joint_pos)
    assert np.shares_memory(data.target, it.states.legs)


def test_copy_converts_types_and_takes_scalars(bench):
    it = bench()
    with_extra(it)
    it.states.tick = 7
    it.block("copy", source="tick", target="ticks_f").tick()
    assert float(it.states.ticks_f) == 7.0
    it.states.joint_pos = 0.25
    it.block("copy", source="joint_pos", target="joint_pos_target").tick()
    assert it.states.joint_pos_target.tolist() == [0.25] * 12
    it.block("copy", source="joint_pos", target="scalar", index=[4]).tick()
    assert float(it.states.scalar) == 0.25


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"source": "joint_pos", "target": "legs"},
            "legs from joint_pos: shape (12,) into (2,); give an index of as many elements",
        ),
        (
            {"source": "joint_pos", "target": "legs", "index": [0, 12]},
            "legs from joint_pos: no element 12; there are 0 to 11",
        ),
        (
            {"source": "base_quat", "target": "legs", "index": ["w", "v"]},
            "state 'base_quat' has no element 'v'; known: w, x, y, z",
        ),
        (
            {"source": "velocity_command", "target": "legs", "index": [0, 1], "scale": [1, 2, 3]},
            "legs from velocity_command: scale has 3 values for 2 elements; give one, or one for "
            "each",
        ),
        (
            {"source": "velocity_comand", "target": "legs"},
            "no state 'velocity_comand'; did you mean 'velocity_command'? known: ",
        ),
    ],
)
def test_wrong_maps(bench, options, message):
    it = bench()
    with_extra(it)
    with pytest.raises(WorkflowError) as error:
        it.block("linear_map", **options)
    assert str(error.value).startswith(f"block 'linear_map': {message}")
