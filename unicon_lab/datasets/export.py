"""Export of recordings as one LeRobot data set, for `unicon bag export --lerobot`."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import UniconError, alternatives, one_line
from unicon_core.page import refuse_existing
from unicon_core.runtime.tick_ring import PHASES
from unicon_lab.datasets.columns import (
    ACTION,
    COMMANDS,
    TICK,
    Column,
    Episode,
    Kept,
    default_actions,
    default_states,
    episodes_of,
    features_of,
    made_columns,
    rate_of,
)
from unicon_lab.datasets.pictures import Pictures, pictures_of
from unicon_lab.datasets.writer import DatasetWriter, PackageWriter, import_lerobot, import_pyarrow
from unicon_lab.recording import Record, open_record


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
        if _listed(pictures) != _listed(cameras[0]):
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


KEPT = "episodes.json"
"""File beside recordings: name, first and last tick and task of each episode that was kept."""


def kept_in(path: Path) -> dict[Path, list[Kept]]:
    """Return recordings, each with the episodes that were kept; of a recording itself no episode.

    Args:
        path: of a recording, or of a folder with `KEPT`.

    Raises:
        UniconError: that file cannot be read.
    """
    if not (path / KEPT).exists():
        return {path: []}
    found: dict[Path, list[Kept]] = {}
    try:
        for name, *episode in json.loads((path / KEPT).read_bytes()):
            found.setdefault(path / Path(name).name, []).append(Kept(*episode))
    except (OSError, TypeError, ValueError) as error:
        raise UniconError(
            f"{path / KEPT} cannot be read: {one_line(error)}; mend it, or move it away"
        ) from error
    if not found:
        raise UniconError(f"{path}: no episode was kept; collect some first")
    return found


def export_dataset(paths: Sequence[Path], out: Path, wanted: Wanted) -> list[str]:
    """Write recordings as one data set; return what to tell, a line each.

    Args:
        paths: of recordings of one robot, in the order of their episodes, or of folders with
            `episodes.json`, of which those that were kept count.
        out: folder of the data set, which does not exist.
        wanted: what it is to have.

    Raises:
        UniconError: a recording cannot be read or does not fit the first one, there is nothing to
            write, or it cannot be written.
        StateError: no such state.
        MissingDependencyError: a package is missing.
    """
    refuse_existing(out)
    import_pyarrow()
    for phase in wanted.phases:
        if phase not in (known := [each.value for each in PHASES]):
            raise UniconError(f"--phases: no phase {phase!r}; {alternatives(phase, known)}")
    kept = {each: marks for path in paths for each, marks in kept_in(path).items()}
    records = [(path, open_record(path)) for path in kept]
    told: list[str] = []
    cameras = [cameras_of(path, record, wanted, told) for path, record in records]
    refuse_others(records, cameras, wanted)
    fps = fps_of(records[0][1], cameras[0], wanted)
    episodes: list[Episode] = []
    for (path, record), pictures in zip(records, cameras):
        found = episodes_of(path, record, fps, wanted.phases, pictures, kept[path])
        lost = [each.last for each in kept[path] if each.last not in record.ticks]
        told += [f"{path}: tick {last}, the end of an episode, was not recorded" for last in lost]
        if not found:
            counts = ", ".join(dict.fromkeys(record.phases)) or "none"
            raise UniconError(
                f"{path} has no whole tick of phase {' or '.join(wanted.phases)}; it has {counts}: "
                "give --phases, or leave it out"
            )
        episodes += found
    first = records[0][1]
    states = wanted.states or default_states(first)
    actions = wanted.actions or default_actions(episodes)
    columns, missing = made_columns(episodes, states, actions)
    told += missing
    if not columns:
        raise UniconError(f"{paths[0]}: none of its states is ever a number; give --states")
    features = features_of(columns, cameras[0], wanted.video)
    writer = _writer(wanted, _count_nan(episodes, columns, told), told)
    with _whole(out, writer is DatasetWriter) as place:
        made = writer(place, fps, features, first.facts.get("robot", ""))
        for episode in episodes:
            values = {each.key: each.values(episode) for each in columns}
            values[TICK] = episode.record.ticks[episode.rows].reshape(-1, 1)
            task = wanted.task or episode.task or episode.record.facts.get("workflow") or "unicon"
            made.add(episode, values, task)
        made.finish()
        _write_sources(place, episodes)
    frames = sum(len(episode.rows) for episode in episodes)
    line = f"{out}: {len(episodes)} episodes, {frames} frames at {fps} fps, written by {made.name}"
    for camera in cameras[0]:
        held = sum(episode.held[camera] for episode in episodes)
        if held:
            told.append(f"{camera}: {held} of {frames} frames show the picture before theirs")
    return [line, *_described(columns), *told]


def _count_nan(episodes: Sequence[Episode], columns: Sequence[Column], told: list[str]) -> bool:
    """Tell of numbers that are none; return whether there are any."""
    found = False
    for column in columns:
        values = [np.isnan(column.values(each).astype(np.float64)) for each in episodes]
        count = sum(int(each.sum()) for each in values)
        if count:
            found = True
            some = np.concatenate(values).any(axis=0)
            name = column.names[int(np.argmax(some))]
            told.append(f"{column.key}: {count} numbers are NaN, as recorded; first {name}")
    return found


def _writer(wanted: Wanted, nan: bool, told: list[str]) -> Any:
    """Return the class of who writes; tell why the package does not where it is installed."""
    if wanted.writer == "own":
        return DatasetWriter
    if wanted.writer == "lerobot":
        if nan:
            raise UniconError(
                "--writer lerobot: it takes no NaN, and there are some; give --writer own, or "
                "--states and --actions without"
            )
        return PackageWriter
    if nan or find_spec("lerobot") is None:
        return DatasetWriter
    try:
        import_lerobot()
    except UniconError as error:
        told.append(f"not written by lerobot: {error}")
        return DatasetWriter
    return PackageWriter


@contextmanager
def _whole(out: Path, ours: bool) -> Iterator[Path]:
    """Yield a place for a folder, which gets its name when it is whole, and errors one line.

    Args:
        out: the folder.
        ours: our own writer writes it, whose other exceptions pass.
    """
    beside = None
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        beside = Path(tempfile.mkdtemp(prefix=f"{out.name}.partial-", dir=out.parent))
        yield beside / out.name
        os.rename(beside / out.name, out)
    except OSError as error:
        refuse_existing(out)
        raise UniconError(
            f"cannot write {out}: {error.strerror or one_line(error)}; make room or give another "
            "path"
        ) from error
    except UniconError:
        raise
    except Exception as error:
        if ours:
            raise
        raise UniconError(
            f"lerobot cannot write {out}: {one_line(error)[:300]}; give --writer own"
        ) from error
    finally:
        if beside is not None:
            shutil.rmtree(beside, ignore_errors=True)


def _write_sources(root: Path, episodes: Sequence[Episode]) -> None:
    """Write where each episode comes from, beside what LeRobot reads."""
    told = [
        {
            "recording": episode.path.name,
            "run": episode.record.facts.get("run", ""),
            "workflow": episode.record.facts.get("workflow", ""),
            "phase": episode.record.phases[int(episode.rows[0])],
            "first_tick": int(episode.record.ticks[episode.rows[0]]),
            "last_tick": int(episode.record.ticks[episode.rows[-1]]),
            "first_stamp_ns": int(episode.record.stamps[episode.rows[0]]),
            "policies": {n: p["sha256"] for n, p in episode.record.policies.items()},
        }
        for episode in episodes
    ]
    path = root / "meta/unicon.json"
    path.write_text(json.dumps({"episodes": told}, indent=2), "utf-8")


def _described(columns: Sequence[Column]) -> list[str]:
    """Return of what the action is made, one line."""
    for column in columns:
        if column.key == ACTION:
            parts = ", ".join(f"{state} ({len(places)})" for state, places in column.states)
            return [f"action: {parts}"]
    return ["there is no action: nothing was commanded"]
