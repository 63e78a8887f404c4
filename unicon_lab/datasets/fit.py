"""What is wanted of a data set, and whether recordings fit it and each other; for `export`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from unicon_base.errors import UniconError, alternatives
from unicon_lab.datasets.columns import COMMANDS, default_states
from unicon_lab.datasets.episodes import rate_of
from unicon_lab.datasets.pictures import Pictures, pictures_of, sizes
from unicon_lab.recording import Record


@dataclass(frozen=True)
class Wanted:
    """What a data set is to have.

    Attributes:
        fps: frames a second; 0 for those of the fastest camera, or of the ticks without any.
        task: what is done, in words; the workflow's name if empty.
        states: that are observed; what is measured if empty.
        actions: states that make up the action; what was commanded if empty.
        cameras: whose pictures it has; None for all.
        phases: of a run whose ticks it has.
        video: pictures are videos, where an encoder is there.
        writer: one of WRITERS.
    """

    fps: int = 0
    task: str = ""
    states: Sequence[str] = ()
    actions: Sequence[str] = ()
    cameras: Sequence[str] | None = None
    phases: Sequence[str] = ("run",)
    video: bool = True
    writer: str = "auto"


def cameras_of(path: Path, record: Record, wanted: Wanted, told: list[str]) -> dict[str, Pictures]:
    """Return the cameras of a recording that are wanted; tell of frames that are not pictures.

    Args:
        path: of the recording.
        record: it.
        wanted: names them, or means all.
        told: gets a line for each kind of frames that is left out.

    Raises:
        UniconError: one that is named was not recorded, or is not a camera.
    """
    found, others = pictures_of(record, wanted.cameras)
    if wanted.cameras is None:
        lines = [
            f"{name}: {why}, left out: a picture is rgb8 or JPEG" for name, why in others.items()
        ]
        told += [line for line in lines if line not in told]
        return found
    for name in wanted.cameras:
        if name not in found:
            why = f" is {others[name]}, and a picture is rgb8 or JPEG" if name in others else ""
            known = alternatives(name, record.frame_names)
            raise UniconError(f"{path}: camera {name!r}{why or ' was not recorded'}; {known}")
    return found


def refuse_others(
    records: Sequence[tuple[Path, Record]], cameras: Sequence[dict[str, Pictures]], wanted: Wanted
) -> None:
    """Refuse recordings that do not fit the first one.

    Args:
        records: with their paths.
        cameras: of each.
        wanted: what the data set is to have.

    Raises:
        UniconError: one is of another robot, rate or size, or of many robots.
    """
    path, first = records[0]
    for (other, record), pictures in zip(records, cameras):
        if record.layout.num_robots is not None:
            raise UniconError(
                f"{other} is of {record.layout.num_robots} robots; a data set is of one: record "
                "without num_robots"
            )
        if record.facts.get("robot") != first.facts.get("robot"):
            raise UniconError(
                f"{other} is of robot {record.facts.get('robot')}, {path} of "
                f"{first.facts.get('robot')}; make a data set for each"
            )
        if not wanted.fps and abs(record.period / first.period - 1.0) > 1e-6:
            raise UniconError(
                f"{other} has {rate_of(record):g} ticks a second, {path} {rate_of(first):g}; say "
                "how many frames a second are meant: --fps"
            )
        for name in (*default_states(first), *COMMANDS, *wanted.states, *wanted.actions):
            if name not in first.layout.specs:
                continue
            here = record.layout.elements(name) if name in record.layout.specs else None
            if here != first.layout.elements(name):
                raise UniconError(
                    f"{other} has not the state {name!r} that {path} has; make a data set for "
                    "each, or give --states and --actions that both have"
                )
        if sizes(pictures) != sizes(cameras[0]):
            raise UniconError(
                f"{other} has cameras {_listed(pictures)}, {path} {_listed(cameras[0])}; give "
                "--cameras that are the same in all"
            )


def _listed(pictures: dict[str, Pictures]) -> str:
    each = [f"{name} ({p.width} x {p.height})" for name, p in sorted(pictures.items())]
    return ", ".join(each) or "none"


def fps_of(record: Record, cameras: dict[str, Pictures], wanted: Wanted) -> int:
    """Return the frames a second: as wanted, those of the fastest camera, or of the ticks.

    Args:
        record: the first one.
        cameras: of it.
        wanted: may say them.

    Raises:
        UniconError: more are wanted than there are ticks, or ticks have no whole number.
    """
    rate, path = rate_of(record), record.paths[0]
    if wanted.fps:
        if wanted.fps > rate + 0.5:
            raise UniconError(
                f"--fps {wanted.fps}: {path} has {rate:g} ticks a second; give at most that"
            )
        return wanted.fps
    steps = [
        np.diff(each.frames.stamps) for each in cameras.values() if len(each.frames.stamps) > 2
    ]
    fastest = min((float(np.median(each)) for each in steps), default=0.0)
    if fastest > 0.0:
        return max(round(min(1e9 / fastest, rate)), 1)
    if rate != round(rate):
        raise UniconError(
            f"{path} has {rate:g} ticks a second, and a data set a whole number of frames; give "
            "--fps"
        )
    return round(rate)
