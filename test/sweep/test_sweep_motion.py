"""Figures of sweeps and transfers against what is known by construction, and NaN."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from unicon_base.arrays import Array
from unicon_base.errors import UniconError
from unicon_lab.analysis.run import Run, read_run
from unicon_lab.sweep.figures import apart, finite_rows, moved

PERIOD = 0.02


def driven(command: Array, share: float = 1.0, yaw: float = 0.0) -> dict[str, Array]:
    """Return states of a base that does a share of what it is commanded, without delay."""
    count = len(command)
    heading = yaw + np.concatenate([[0.0], np.cumsum(command[:-1, 2] * PERIOD)])
    cos, sin = np.cos(heading), np.sin(heading)
    velocity = share * np.stack(
        [cos * command[:, 0] - sin * command[:, 1], sin * command[:, 0] + cos * command[:, 1]], 1
    )
    position = np.zeros((count, 3))
    position[1:, :2] = np.cumsum(velocity[:-1] * PERIOD, axis=0)
    quat = np.stack([np.cos(heading / 2), 0 * cos, 0 * cos, np.sin(heading / 2)], axis=1)
    turning = np.zeros((count, 3))
    turning[:, 2] = command[:, 2]
    return {
        "joint_pos": np.zeros((count, 12)),
        "base_pos_w": position,
        "base_quat": quat,
        "base_ang_vel": turning,
        "projected_gravity": np.tile((0.0, 0.0, -1.0), (count, 1)),
        "velocity_command": command,
    }


def commanded(*parts: tuple[float, float, float], ticks: int = 100) -> Array:
    return np.repeat(np.array(parts), ticks, axis=0)


@pytest.mark.parametrize("yaw", [0.0, 2.5, -math.pi])
def test_who_does_as_commanded_has_all_of_the_distance_and_no_error(yaw: float) -> None:
    command = commanded((0, 0, 0), (0.8, 0, 0), (0.5, 0, 0.8), (0, 0.3, 0), (-0.4, 0, 0), (0, 0, 0))
    figures = moved(driven(command, yaw=yaw), PERIOD)
    assert figures["commanded_m"] == pytest.approx((0.8 + 0.5 + 0.3 + 0.4) * 2.0)
    assert figures["distance_m"] == pytest.approx(figures["commanded_m"])
    assert figures["speed_error"] == pytest.approx(0.0, abs=1e-9)
    assert figures["turn_error"] == 0.0
    assert figures["fall_s"] is None


def test_who_does_half_has_half_and_errs_by_the_other_half() -> None:
    figures = moved(driven(commanded((0.0, 0.0, 0.0), (0.8, 0.0, 0.0)), share=0.5), PERIOD)
    assert figures["distance_m"] == pytest.approx(0.5 * 0.8 * 1.98)
    assert figures["speed_error"] == pytest.approx(0.4)  # the ticks before are not counted
    assert figures["speed_bias"] == pytest.approx(0.4)


def test_sway_is_an_error_but_no_bias() -> None:
    states = dict(driven(commanded((0.5, 0.0, 0.0), ticks=400)))
    sway = np.sin(np.arange(400) * (2.0 * math.pi / 40.0))
    states["base_ang_vel"] = states["base_ang_vel"] + np.outer(sway, (0.0, 0.0, 0.5))
    states["base_pos_w"] = states["base_pos_w"] + np.outer(sway, (0.0, 0.01, 0.0))
    figures = moved(states, PERIOD)
    errors = [figures[name] for name in ("speed_error", "turn_error")]
    biases = [figures[name] for name in ("speed_bias", "turn_bias")]
    assert min(error or 0.0 for error in errors) > 0.05
    assert biases == pytest.approx([0.0, 0.0], abs=2e-3)


def test_way_aside_and_backwards_is_not_walked() -> None:
    states = driven(commanded((0.5, 0.0, 0.0)))
    states["base_pos_w"][:, 1] += np.linspace(0.0, 3.0, 100)
    assert moved(states, PERIOD)["distance_m"] == pytest.approx(0.5 * 1.98)
    assert moved(driven(commanded((0.5, 0.0, 0.0)), share=-1.0), PERIOD)[
        "distance_m"
    ] == pytest.approx(-0.99)


def test_nothing_counts_after_a_fall_and_one_sample_says_nothing() -> None:
    states = driven(commanded((0.5, 0.0, 0.0)))
    states["projected_gravity"][60:] = (1.0, 0.0, 0.0)
    states["base_pos_w"][60:, 0] += 2.0  # it topples ahead, which is not a walk
    figures = moved(states, PERIOD)
    assert figures["fall_s"] == pytest.approx(1.2)
    assert figures["distance_m"] == pytest.approx(0.5 * 1.2, rel=0.02)
    assert figures["commanded_m"] == pytest.approx(0.5 * 1.98)
    assert figures["speed_error"] == pytest.approx(0.0, abs=1e-9)
    states["projected_gravity"][:] = (1.0, 0.0, 0.0)
    figures = moved(states, PERIOD)
    assert (figures["fall_s"], figures["distance_m"], figures["speed_error"]) == (0.0, 0.0, None)
    states["projected_gravity"][:35] = (0.0, 0.0, -1.0)
    assert moved(states, PERIOD)["fall_s"] == 0.7  # and not 0.7000000000000001
    short = {name: values[:37] for name, values in states.items()}
    assert moved(short, PERIOD)["fall_s"] == 0.7
    assert moved(short, PERIOD, whole=True)["fall_s"] is None  # it leans at the end
    one = {name: values[:1] for name, values in states.items()}
    assert set(moved(one, PERIOD).values()) == {None}


def test_rows_end_before_what_is_not_a_number() -> None:
    states = driven(commanded((0.5, 0.0, 0.0)))
    assert finite_rows(states) == 100
    states["base_quat"][70, 1] = np.inf
    states["joint_pos"][40, 3] = np.nan
    assert finite_rows(states) == 40
    states["joint_pos"][0] = np.nan
    assert finite_rows(states) == 0


def saved(path: Path, positions: Array) -> Run:
    names = np.array([f"joint_{k}" for k in range(positions.shape[1])])
    np.savez(path, joint_pos=positions, joint_names=names, dt=PERIOD)
    return read_run(path)


def test_mse_is_sample_by_sample_and_the_unfolded_one_forgives_part_of_a_delay(
    tmp_path: Path,
) -> None:
    time = np.arange(500) * PERIOD
    wave = np.sin(2 * np.pi * 0.7 * time[:, None] + np.arange(3)) * np.exp(-0.1 * time[:, None])
    first = saved(tmp_path / "first.npz", wave)
    late = saved(tmp_path / "late.npz", np.concatenate([np.tile(wave[:1], (5, 1)), wave[:-5]]))
    off = saved(tmp_path / "off.npz", wave + 0.1)
    delayed = apart(first, late)
    assert delayed["mse"] == pytest.approx(
        np.mean((wave - late.states["joint_pos"]) ** 2), rel=1e-9
    )
    assert delayed["shift_s"] == pytest.approx(-0.1)
    half = [np.mean((wave[:250] - late.states["joint_pos"][p : p + 250]) ** 2) for p in range(251)]
    other = [np.mean((wave[p : p + 250] - late.states["joint_pos"][:250]) ** 2) for p in range(251)]
    assert min(half) < 1e-9
    assert delayed["unfolded_mse"] == pytest.approx(0.5 * min(other))
    assert delayed["unfolded_mse"] < 0.2 * delayed["mse"]
    beside = apart(first, off)
    assert beside["mse"] == pytest.approx(0.01)
    assert beside["unfolded_mse"] <= 0.01 + 1e-12
    assert beside["unfolded_mse"] == pytest.approx(0.01, rel=0.05)
    with pytest.raises(UniconError, match="6 samples"):
        read_run(first.path, (0.0, 0.1))
