"""Parts of data sets against slow twins: even times, statistics, PNG, episodes."""

from __future__ import annotations

import io
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_base.errors import UniconError
from unicon_lab.datasets.columns import _stretches, rate_of, sampled
from unicon_lab.datasets.pictures import IMAGE, JPEG, Pictures, png
from unicon_lab.datasets.statistics import joined, of_pictures, of_values
from unicon_lab.recording.scan import Frames
from unicon_ros.bridge.images import frame_message, jpeg_message


def record(steps_ns: list[int], period: float = 0.01, missing: frozenset[int] = frozenset()) -> Any:
    """What is needed of a record: the times of its ticks, some of which are not there."""
    stamps = np.cumsum([0, *steps_ns]).astype(np.int64)
    ticks = np.array([k for k in range(len(stamps)) if k not in missing or not k], np.int64)
    return SimpleNamespace(stamps=stamps[ticks], ticks=ticks, period=period)


@settings(max_examples=60)
@given(
    st.lists(st.integers(1_000_000, 30_000_000), min_size=0, max_size=80),
    st.integers(1, 120),
    st.frozensets(st.integers(1, 80), max_size=20),
)
def test_frames_are_the_ticks_nearest_to_even_times(
    steps: list[int], fps: int, missing: frozenset[int]
) -> None:
    told = record(steps, missing=missing)
    rows = np.arange(len(told.ticks))
    chosen = sampled(told, rows, fps)
    times = [(int(stamp) - int(told.stamps[0])) * 1e-9 for stamp in told.stamps]
    for frame, row in enumerate(chosen.tolist()):
        nearest = min(abs(time - frame / fps) for time in times)
        assert abs(times[row] - frame / fps) <= nearest + 1e-9
    assert len(chosen) >= 1
    assert (
        (len(chosen) - 1) / fps <= times[-1] + 0.5 / fps + 1e-9 < (len(chosen) + 1e-6) / fps + 1e-6
    )


def test_a_clock_that_was_set_counts_for_nothing() -> None:
    steps = [10_000_000] * 50
    steps[20], steps[30] = 3_600_000_000_000, -5_000_000_000
    told = record(steps)
    assert sampled(told, np.arange(51), 100).tolist() == list(range(51))
    assert sampled(told, np.arange(51), 50).tolist() == list(range(0, 51, 2))


def test_jitter_repeats_no_tick_and_leaves_none_out() -> None:
    rng = np.random.default_rng(3)
    late = rng.integers(0, 4_000_000, 500)
    late[0] = 2_000_000
    stamps = np.arange(500) * 10_000_000 + late
    told = record(np.diff(stamps).tolist())
    assert sampled(told, np.arange(500), 100).tolist() == list(range(500))


def test_an_episode_is_a_stretch_of_one_phase() -> None:
    phases = ("approach", "run", "run", "run", "soft", "run", "run", "run", "run")
    told: Any = SimpleNamespace(
        phases=phases,
        ended=np.array([True] * 8 + [False]),
        ticks=np.array([0, 0, 1, 2, 0, 5, 6, 0, 1]),
    )
    assert [rows.tolist() for rows in _stretches(told, ["run"])] == [[1, 2, 3], [5, 6], [7]]
    assert [rows.tolist() for rows in _stretches(told, ["run", "soft"])][:2] == [[1, 2, 3], [4]]
    assert _stretches(told, ["damp"]) == []


@pytest.mark.parametrize(("period", "rate"), [(0.02, 50.0), (1 / 30, 30.0), (0.003, 1000 / 3)])
def test_a_rate_is_whole_where_it_is_one(period: float, rate: float) -> None:
    found = rate_of(SimpleNamespace(period=period))  # type: ignore[arg-type]
    assert found == pytest.approx(rate)
    assert (found == round(found)) == (rate == round(rate))


def test_a_handle_finds_its_frame_or_the_one_before() -> None:
    frames = Frames("", np.array([2, 3, 7]), np.zeros(3, np.int64), [])
    handles = np.array([0, 1, 2, 3, 4, 6, 7, 9])
    assert frames.at(handles).tolist() == [-1, -1, 0, 1, 1, 1, 2, 2]


# -- statistics and PNG ----------------------------------------------------------------------------


@settings(max_examples=40)
@given(st.integers(1, 40), st.integers(1, 5), st.integers(0, 1000))
def test_statistics_are_those_of_numpy_and_nan_count_for_nothing(
    frames: int, width: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(frames, width)).astype(np.float32)
    values[rng.random(values.shape) < 0.2] = np.nan
    found = of_values(values)
    for column in range(width):
        numbers = [float(value) for value in values[:, column] if value == value]
        if not numbers:
            assert [found[name][column] for name in ("min", "max", "mean", "std")] == [0.0] * 4
            continue
        assert found["min"][column] == min(numbers)
        assert found["max"][column] == max(numbers)
        assert found["mean"][column] == pytest.approx(sum(numbers) / len(numbers), abs=1e-9)
        assert found["q50"][column] == pytest.approx(float(np.median(numbers)), abs=1e-9)
    assert found["count"].tolist() == [frames]


class Series:
    """Pictures as an episode shows them."""

    def __init__(self, pixels: Any) -> None:
        self._pixels = pixels

    def __len__(self) -> int:
        return len(self._pixels)

    def rgb(self, frame: int) -> Any:
        return self._pixels[frame]


def test_statistics_of_pictures_are_those_of_their_pixels() -> None:
    pixels = np.random.default_rng(5).integers(10, 240, (7, 20, 30, 3), np.uint8)
    found = of_pictures(Series(pixels))  # type: ignore[arg-type]
    for color in range(3):
        values = pixels[..., color].reshape(-1) / 255.0
        for name, value in (
            ("min", values.min()),
            ("max", values.max()),
            ("mean", values.mean()),
            ("std", values.std()),
            ("q10", np.quantile(values, 0.1)),
            ("q99", np.quantile(values, 0.99)),
        ):
            assert found[name].shape == (3, 1, 1)
            assert found[name][color, 0, 0] == pytest.approx(value, abs=0.5 / 255)
    assert found["count"].tolist() == [7]
    large = np.zeros((1, 480, 640, 3), np.uint8)
    assert of_pictures(Series(large))["max"].tolist() == [[[0.0]]] * 3  # type: ignore[arg-type]


def test_statistics_of_episodes_become_those_of_all() -> None:
    rng = np.random.default_rng(6)
    parts = [rng.normal(k, 1.0 + k, (20 * (k + 1), 3)) for k in range(3)]
    found = joined([{"x": of_values(part)} for part in parts])["x"]
    whole = np.concatenate(parts)
    for name, value in (("min", whole.min(0)), ("mean", whole.mean(0)), ("std", whole.std(0))):
        assert np.allclose(found[name], value, atol=1e-9)
    assert found["count"].tolist() == [120]


@settings(max_examples=20)
@given(st.integers(1, 20), st.integers(1, 20), st.integers(0, 100))
def test_a_png_has_the_pixels(height: int, width: int, seed: int) -> None:
    image = pytest.importorskip("PIL.Image")
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)
    file = image.open(io.BytesIO(png(pixels)))
    assert file.format == "PNG"
    assert np.array_equal(np.asarray(file), pixels)


@settings(max_examples=150)
@given(st.data())
def test_a_picture_that_is_damaged_is_one_clear_error(data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from([IMAGE, JPEG]))
    layout = frame_message("color", 8, 6, "front") if kind == IMAGE else jpeg_message(80, "front")
    raw = bytearray(layout.template)
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(4, len(raw) - 1))] = data.draw(st.integers(0, 255))
    cut = bytes(raw[: data.draw(st.integers(0, len(raw)))])
    places = [(np.frombuffer(cut, np.uint8), 0, len(cut))]
    frames = Frames(kind, np.array([1]), np.array([1]), places)
    pictures, told = Pictures(frames, 6, 8, "run.mcap, camera 'front'"), ""
    try:
        assert pictures.rgb(0).shape == (6, 8, 3)
        pictures.encoded(0)
    except UniconError as error:
        told = str(error)
    assert not told or told.startswith("run.mcap, camera 'front': a picture ")
    assert not told or told.endswith("; leave that camera out: --cameras")
