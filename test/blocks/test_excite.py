"""excite: its signals, its limits, its fades, and what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, get_args

import numpy as np
import pytest

from unicon_base.errors import WorkflowError
from unicon_core.blocks.excite import Signal

Build = Callable[..., Any]


def path_of(it, **options):
    """Return the targets of every tick of a block that began in its pose, shape (ticks, n)."""
    it.stand()
    block = it.block("excite", **options)
    path = []
    done = False
    while not done:
        done = block.tick()
        path.append(it.states.joint_pos_target.copy())
        assert len(path) < 100_000
    return np.array(path)


@pytest.mark.parametrize("signal", get_args(Signal))
def test_signals_are_faded_stay_within_their_amplitude_and_end_in_the_pose(bench, signal):
    it = bench()
    options: dict[str, Any] = {"signal": signal, "amplitude": 0.2, "frequency": 2.0, "fade": 1.0}
    path = path_of(it, duration=6.0, **options) - it.robot.default_joint_pos
    assert len(path) == 350
    assert np.abs(path[:50]).max() == 0.0  # it is in the pose, and goes there all the same
    assert np.abs(path).max() <= 0.2 + 1e-6
    middle = np.abs(path[100:300]).max(axis=0)
    assert (middle > 0.12).all()
    assert np.abs(path[50:60]).max() < 0.03
    assert np.abs(path[-10:]).max() < 0.03
    assert np.abs(path[-1]).max() == 0.0
    if signal != "square":
        speed = np.abs(np.diff(path, axis=0)).max() / it.period
        assert speed < 0.2 * 2.0 * 2 * np.pi + 0.2 * np.pi / 2 + 0.01
    assert not it.states.joint_vel_target.any()
    assert it.states.joint_stiffness.tolist() == it.robot.joint_stiffness.tolist()


def test_a_sine_has_its_frequency_and_amplitude(bench):
    it = bench()
    path = path_of(it, signal="sine", frequency=2.0, duration=10.0, amplitude=0.2)
    wave = (path - it.robot.default_joint_pos)[100:500]  # faded in, 8 s = 16 periods
    spectrum = np.abs(np.fft.rfft(wave, axis=0)) / len(wave) * 2
    assert (spectrum.argmax(axis=0) == 16).all()
    np.testing.assert_allclose(spectrum[16], 0.2, atol=1e-4)
    assert spectrum[np.arange(len(spectrum)) != 16].max() < 1e-3


def test_a_triangle_is_straight_and_a_square_has_two_levels(bench):
    it = bench()
    for signal, wanted in (("triangle", {0.008}), ("square", {0.0, 0.4})):
        path = path_of(it, signal=signal, frequency=0.5, duration=10.0, amplitude=0.2)
        wave = np.round((path - it.robot.default_joint_pos)[100:500, 0], 5)
        assert {round(float(step), 4) for step in np.abs(np.diff(wave))} == wanted


def test_a_chirp_goes_from_the_first_frequency_to_the_second(bench):
    it = bench(period=0.005)
    path = path_of(it, signal="chirp", frequency=[0.5, 5.0], duration=20.0, amplitude=0.1, fade=0.1)
    wave = (path - it.robot.default_joint_pos)[20:, 0]
    crossings = np.flatnonzero(np.diff(np.sign(wave)) != 0) * 0.005
    halves = 0.5 / np.diff(crossings)
    assert 0.5 < halves[0] < 0.8
    assert halves[-2] == pytest.approx(5.0, rel=0.05)
    assert np.corrcoef(crossings[1:], halves)[0, 1] > 0.99


def test_random_joints_move_each_by_itself_and_the_same_each_time(bench):
    one, two, three = (
        path_of(bench(), signal="random", frequency=3.0, amplitude=0.1, duration=30.0, seed=seed)
        for seed in (4, 4, 5)
    )
    assert (one == two).all()
    assert not (one == three).all()
    together = np.corrcoef(one[100:-100].T) - np.eye(one.shape[1])
    assert np.abs(together).max() < 0.5


def test_joints_in_turn(bench):
    it = bench()
    options: dict[str, Any] = {"joints": ["R*_calf_joint"], "in_turn": True, "fade": 0.5}
    path = path_of(it, signal="sine", duration=2.0, amplitude=0.2, **options)
    moved = np.abs(path - it.robot.default_joint_pos) > 1e-6
    assert len(path) == 25 + 200
    assert np.flatnonzero(moved[25:125].any(axis=0)).tolist() == [8]
    assert np.flatnonzero(moved[125:].any(axis=0)).tolist() == [11]


def test_amplitudes_by_pattern(bench):
    it = bench()
    sizes = {"*": 0.1, "*_calf_joint": 0.3}
    path = path_of(it, signal="square", amplitude=sizes, joints=["RL_*"])
    largest = np.abs(path - it.robot.default_joint_pos).max(axis=0)
    np.testing.assert_allclose(largest, [0.0] * 9 + [0.1, 0.1, 0.3], atol=1e-6)


def test_a_robot_far_from_the_pose_goes_there_slowly_first(bench):
    it = bench()
    it.states.joint_pos = it.robot.rest_joint_pos
    block = it.block("excite", signal="sine", fade=0.1, duration=1.0)
    path = [it.robot.rest_joint_pos]
    while not block.tick():
        path.append(it.states.joint_pos_target.copy())
    assert np.abs(np.diff(path, axis=0)).max() / 0.02 < 10.1
    assert it.states.joint_pos_target.tolist() == it.robot.default_joint_pos.tolist()
    block.reset()
    assert block.tick() is False


def test_a_batch_moves_as_one_robot(bench):
    one = path_of(bench(), signal="random", duration=3.0)
    batch = path_of(bench(num_robots=3), signal="random", duration=3.0)
    assert (batch == one[:, None]).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"signal": "noise"}, r"signal 'noise' is not known; known: chirp, random"),
        (
            {"amplitude": 0.9},
            r"amplitude 0\.9 rad about -1\.6 rad .* FR_calf_joint; give at most 0",
        ),
        ({"amplitude": float("nan")}, r"amplitude is nan"),
        ({"amplitude": -0.1}, r"amplitude is -0\.1; write a number above 0"),
        ({"amplitude": {"RL_*": 0.1}}, r"amplitude says nothing of joint FR_hip_joint"),
        ({"joints": []}, r"joints is \[\]; write a list"),
        ({"joints": ["tail"]}, r"no joint like 'tail'"),
        ({"frequency": 0.0}, r"frequency is 0\.0"),
        ({"frequency": 40.0}, r"frequency is 40\.0; give a number above 0 to 12\.5 \[Hz\]"),
        ({"frequency": [1.0]}, r"frequency of a chirp is \[1\.0\]; give one, or \[first, last\]"),
        ({"frequency": [1.0, 2.0], "signal": "sine"}, r"frequency of a sine .* give one in \[Hz\]"),
        ({"frequency": [1.0, float("inf")]}, r"frequency is inf"),
        ({"duration": 0.0}, r"duration is 0\.0"),
        ({"fade": 8.0}, r"fade is 8\.0; give a number from 0\.1 to 5 \[s\]"),
        ({"fade": 0.0}, r"fade is 0\.0"),
        ({"seed": -1}, r"seed is -1"),
        ({"amplitude": 0.5, "frequency": 12.0}, r"37\.7 rad/s, its limit is 30\.1; lower"),
        ({"around": "rest"}, r"beyond the limits of joint FR_calf_joint; give at most 0\.0727"),
        ({"around": "sit"}, r"no pose 'sit'"),
    ],
)
def test_what_is_not_plausible_is_refused_at_build(bench, options, message):
    with pytest.raises(WorkflowError, match=message):
        bench().block("excite", **options)
