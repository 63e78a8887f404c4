"""Statistics of features, as LeRobot's training normalizes by them.

What is counted, and how episodes become one, is that of LeRobot 0.4: minimum, maximum, mean,
standard deviation, count and five quantiles of each element; of pictures for each colour, from 0 to
1, of some pictures alone and of every few pixels.
https://github.com/huggingface/lerobot, src/lerobot/datasets/compute_stats.py
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from unicon_base.arrays import Array, Float64, Int64
from unicon_lab.datasets.pictures import Shown

Statistics: TypeAlias = dict[str, Array]
"""`min`, `max`, `mean`, `std`, `count`, `q01` … to values."""

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
FEWEST, MOST, POWER = 100, 10_000, 0.75
"""Of n pictures n ** 0.75 are counted, within these bounds."""
LARGE, WANTED = 300, 150
"""Of a picture whose longer side is so long every few pixels are counted, about 150 of it."""


def of_values(values: Array) -> Statistics:
    """Return the statistics of numbers; NaN count for nothing, and 0 stands where all are.

    Args:
        values: shape (frames, elements), at least one frame.
    """
    numbers = values.astype(np.float64)
    lost = np.isnan(numbers).all(axis=0)
    numbers[:, lost] = 0.0
    found = {
        "min": np.nanmin(numbers, axis=0),
        "max": np.nanmax(numbers, axis=0),
        "mean": np.nanmean(numbers, axis=0),
        "std": np.nanstd(numbers, axis=0),
        "count": np.array([len(numbers)]),
    }
    quantiles = np.nanquantile(numbers, [*QUANTILES.values()], axis=0)
    return found | dict(zip(QUANTILES, quantiles))


def of_pictures(shown: Shown) -> Statistics:
    """Return the statistics of colours, each of shape (3, 1, 1).

    Args:
        shown: the pictures of an episode, at least one.
    """
    count = len(shown)
    some = max(min(FEWEST, count), min(int(count**POWER), MOST))
    chosen = np.round(np.linspace(0, count - 1, some)).astype(int).tolist()
    counts = np.zeros((3, 256), np.int64)
    for index in chosen:
        pixels = shown.rgb(index)
        height, width, _ = pixels.shape
        if max(height, width) >= LARGE:
            step = int(max(height, width) / WANTED)
            pixels = pixels[::step, ::step]
        for color in range(3):
            counts[color] += np.bincount(pixels[..., color].reshape(-1), minlength=256)
    return {name: value.reshape(3, 1, 1) for name, value in _of_counts(counts).items()} | {
        "count": np.array([some])
    }


def _of_counts(counts: Int64) -> Statistics:
    """Return the statistics of bytes by how often each is there, shape (colours, 256)."""
    levels, total = np.arange(256) / 255.0, counts.sum(axis=1)
    mean = counts @ levels / total
    below = np.cumsum(counts, axis=1)

    def at(share: float) -> Float64:
        places = (below < share * total[:, None]).sum(axis=1).clip(0, 255)
        return np.asarray(levels[places])

    return {
        "min": levels[(counts > 0).argmax(axis=1)],
        "max": levels[255 - (counts[:, ::-1] > 0).argmax(axis=1)],
        "mean": mean,
        "std": np.sqrt(np.maximum(counts @ levels**2 / total - mean**2, 0.0)),
        **{name: at(share) for name, share in QUANTILES.items()},
    }


def joined(episodes: Sequence[Mapping[str, Statistics]]) -> dict[str, Statistics]:
    """Return the statistics of all episodes: quantiles are means of those of the episodes."""
    found: dict[str, Statistics] = {}
    for key in episodes[0]:
        each = [episode[key] for episode in episodes]
        counts = np.array([one["count"][0] for one in each], np.float64)
        weights = (counts / counts.sum()).reshape(-1, *[1] * each[0]["mean"].ndim)

        def mean(name: str, each: Any = each, weights: Any = weights) -> Float64:
            total: Float64 = (np.stack([one[name] for one in each]) * weights).sum(0)
            return total

        spread = np.stack([one["std"] ** 2 + (one["mean"] - mean("mean")) ** 2 for one in each])
        found[key] = {
            "min": np.min([one["min"] for one in each], axis=0),
            "max": np.max([one["max"] for one in each], axis=0),
            "mean": mean("mean"),
            "std": np.sqrt((spread * weights).sum(0)),
            "count": np.array([int(counts.sum())]),
            **{name: mean(name) for name in QUANTILES},
        }
    return found
