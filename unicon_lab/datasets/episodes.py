"""Episodes: the stretches of recordings that become episodes of a data set, at its rate."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from unicon_base.arrays import Int64
from unicon_base.errors import UniconError
from unicon_lab.datasets.pictures import Pictures, Shown
from unicon_lab.recording import Record

LONGEST_STEP = 1.0
"""Between two ticks in [s]; where the clock says more, or goes back, somebody has set it."""


@dataclass(frozen=True, eq=False)
class Episode:
    """Frames of a data set, one behind the other, all of one recording.

    Attributes:
        path: of the recording.
        record: it.
        rows: index of the tick of each frame, shape (frames,).
        shown: camera to its picture at each frame.
        held: camera to the number of frames whose own picture is not there.
    """

    path: Path
    record: Record
    rows: Int64
    shown: Mapping[str, Shown] = field(default_factory=dict)
    held: Mapping[str, int] = field(default_factory=dict)


def rate_of(record: Record) -> float:
    """Return the ticks a second of a recording, a whole number where it is one to 1e-6."""
    rate = 1.0 / record.period
    return float(round(rate)) if abs(rate - round(rate)) < 1e-6 * rate else rate


def episodes_of(
    path: Path,
    record: Record,
    fps: int,
    phases: Collection[str],
    pictures: Mapping[str, Pictures],
) -> list[Episode]:
    """Return an episode for each stretch of ticks of the phases, none where there are no such.

    An episode begins where every camera has given a picture. A picture is the one whose handle the
    tick held; where that was not recorded, or the camera was gone, the one before it.

    Args:
        path: of the recording.
        record: it.
        fps: frames a second.
        phases: of the ticks that count.
        pictures: camera to its pictures.

    Raises:
        UniconError: a camera has no picture in any tick of a stretch.
    """
    found = []
    for rows in _stretches(record, phases):
        rows = sampled(record, rows, fps)
        shown, held = {}, {}
        for name, each in pictures.items():
            handles = record.states(f"{name}_handle").reshape(-1)[rows]
            there = each.frames.at(handles & 0xFFFFFFFF)
            exact = (there >= 0) & (each.frames.handles[there] == handles & 0xFFFFFFFF)
            shown[name], held[name] = np.maximum.accumulate(there), exact
            if (there < 0).all():
                raise UniconError(
                    f"{path}: no picture of {name!r} in ticks {record.ticks[rows[0]]} to "
                    f"{record.ticks[rows[-1]]} of {record.phases[rows[0]]}; leave the recording "
                    f"out, or name other cameras: --cameras"
                )
        begin = max((int(np.argmax(each >= 0)) for each in shown.values()), default=0)
        cut = {name: Shown(pictures[name], each[begin:]) for name, each in shown.items()}
        missing = {name: int((~exact[begin:]).sum()) for name, exact in held.items()}
        found.append(Episode(path, record, rows[begin:], cut, missing))
    return found


def _stretches(record: Record, phases: Collection[str]) -> list[Int64]:
    """Return the rows of ticks that follow each other in these phases and came to their end."""
    wanted = np.array([phase in phases for phase in record.phases], bool) & record.ended
    names = np.array(record.phases)
    rows = np.flatnonzero(wanted)
    if not len(rows):
        return []
    ends = (
        (np.diff(rows) > 1)
        | (np.diff(record.ticks[rows]) <= 0)
        | (names[rows[1:]] != names[rows[:-1]])
    )
    return np.split(rows, np.flatnonzero(ends) + 1)


def sampled(record: Record, rows: Int64, fps: int) -> Int64:
    """Return the rows at even times, each the nearest tick.

    Args:
        record: whose clock counts.
        rows: that follow each other, at least one, shape (ticks,).
        fps: of them a second.
    """
    steps = np.diff(record.stamps[rows]) * 1e-9
    counted = np.diff(record.ticks[rows]) * record.period
    steps = np.where((steps > 0.0) & (steps <= np.maximum(LONGEST_STEP, counted)), steps, counted)
    times = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.arange(int(times[-1] * fps + 0.5) + 1) / fps
    if len(times) == 1:
        return rows
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    nearer = wanted - times[after - 1] < times[after] - wanted
    chosen: Int64 = rows[after - nearer]
    return chosen
