"""Foreign recordings become records of ticks: states by name, as of one robot; and `.npz` files.

The recorder of UniCon (`--rec`) writes `states_q`, `states_qd`, … of shape (frames, …), with `ts`
[s], `rec_dt` [s] and `DOF_NAMES`; quaternions are xyzw. https://github.com/CreeperLin/unicon
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from unicon_base import UniconError, alternatives, cannot, one_line
from unicon_base.arrays import Array, Float64, Int64
from unicon_base.located_yaml import read_yaml
from unicon_core.blocks.maps import projected_gravity
from unicon_core.page import ROOM, refuse_existing
from unicon_core.platforms.kit.base import quat_of_rpy
from unicon_core.robots import Robot
from unicon_core.runtime.phases import Phase
from unicon_core.runtime.tick_ring import HEAD, PHASES
from unicon_core.states import Layout, States
from unicon_core.states.standard import COMMAND_STATES, hardware_states, standard_states
from unicon_lab.recording.mcap_file import McapFile
from unicon_lab.recording.read import LONGEST, SHORTEST
from unicon_lab.recording.records import metadata
from unicon_lab.recording.run_recording import robot_facts, versions_here
from unicon_lab.recording.ticks import (
    RecordedSubset,
    add_ticks,
    kept_moments,
    layout_facts,
    tick_channel,
)

CDR = bytes((0, 1, 0, 0))


def layout_of(robot: Robot, names: Iterable[str]) -> Layout:
    """Return the layout of those of a robot's states, and of time and number of the tick."""
    known = standard_states(robot.joint_names) | hardware_states(robot.joint_names)
    wanted = {*names, "stamp_ns", "tick"}
    return Layout({name: spec for name, spec in known.items() if name in wanted})


def write_imported(
    path: Path, source: Path, robot: Robot, stamps: Int64, states: Mapping[str, Array]
) -> int:
    """Write a record of what was imported; return the number of ticks. An error leaves no file.

    Commands are where the tick ends alone: they did not come from outside before it.

    Args:
        path: of the record.
        source: where it comes from, for its facts.
        robot: whose states they are, joints in its order.
        stamps: time of each tick in [ns], shape (ticks,).
        states: name to values, shape (ticks, …). The record has these alone, `projected_gravity`
            where there is `base_quat`, and time and number of the tick: what the source lacks is
            absent, so that no initial value is taken for a measured one.

    Raises:
        UniconError: there is nothing in it, the record exists, or it cannot be written.
    """
    if not len(stamps):
        raise UniconError(f"{source} has nothing that could be imported; is it the right map?")
    made = {"projected_gravity"} if "base_quat" in states else set()
    layout = layout_of(robot, {*states, *made})
    kept = {"received": frozenset(layout.specs) - {*COMMAND_STATES}, "sent": None}
    period = float(np.median(np.diff(stamps))) * 1e-9 if len(stamps) > 1 else 0.0
    if not SHORTEST <= period <= LONGEST:
        raise UniconError(
            f"{source}: {len(stamps)} ticks have no period (median {period:g} s); its times are "
            "wrong: give --rate HZ"
        )
    facts = {
        "run": "",
        "period_s": repr(period),
        "workflow": "",
        "platform": "imported",
        **robot_facts(robot),
        "imported_from": str(source),
        "imported_states": json.dumps(sorted(states)),
        "policies": "{}",
        "versions": json.dumps(versions_here()),
    }
    refuse_existing(path)
    with cannot(f"write {path}", ROOM):
        path.parent.mkdir(parents=True, exist_ok=True)
        file = McapFile(path)
        try:
            file.begin()
            file.add_record(metadata("unicon", facts | layout_facts(layout, kept)))
            file.add(tick_channel(1, layout, kept, {}))
            add_ticks(file, _ticks(layout, kept, stamps, states))
            if file.finish():
                path.unlink()
                raise UniconError(f"cannot write {path}: the medium is full; {ROOM}")
        except BaseException:
            file.discard()
            raise
    return file.messages


def _ticks(
    layout: Layout, kept: RecordedSubset, stamps: Int64, states: Mapping[str, Array]
) -> Iterator[bytes]:
    live = States(layout)
    turn = None
    if "base_quat" in states and "projected_gravity" not in states:
        turn = projected_gravity(live["base_quat"], live["projected_gravity"])
    moments = kept_moments(layout, kept).values()
    copies = [pair for moment in moments for pair in moment.copies(layout)]
    row = bytearray(HEAD.size + sum(moment.size for moment in moments))
    run = PHASES.index(Phase.RUN)
    columns = {**states, "stamp_ns": stamps, "tick": np.arange(len(stamps))}
    for number, stamp in enumerate(stamps.tolist()):
        for name, values in columns.items():
            live[name][...] = values[number]
        if turn is not None:
            turn()
        for to, source in copies:
            row[to] = live.buffer[source].tobytes()
        HEAD.pack_into(row, 0, CDR, stamp, number, run, 1)
        yield bytes(row)


KEYS: Mapping[str, str] = read_yaml(Path(__file__).with_name("unicon_keys.yaml")).value
"""Key of UniCon to our state. `states_rpy` counts where there is no quaternion."""

NAMES = ("joint_names", "dof_names", "DOF_NAMES")
"""Keys under which files name their joints, the first that is there."""

UNICONS = ("states_rpy", "ts", "rec_dt", "len")
"""What UniCon writes besides."""

LARGEST = 8 << 30
"""Bytes of an unpacked file: an hour of 29 joints at 500 Hz has 2 GB."""


@dataclass(frozen=True, eq=False)
class Archive:
    """What was read of a file.

    Attributes:
        path: of the file.
        keys: of everything in it.
        arrays: those that are needed and there.
    """

    path: Path
    keys: tuple[str, ...]
    arrays: dict[str, Array]

    def joint_names(self) -> tuple[str, ...]:
        """Return the names of the joints in the file's order, empty where it has none."""
        found = next((self.arrays[key] for key in NAMES if key in self.arrays), ())
        return tuple(map(str, np.ravel(np.asarray(found))))

    def written(self, rows: int) -> int:
        """Return how many of the rows were written: UniCon makes more, and `len` is the last one.

        Raises:
            UniconError: `len` is not a whole number.
        """
        if not {"ts", *KEYS} & set(self.keys):  # the `len` of others may be anything
            return rows
        last = self.number("len")
        if last is None:
            return rows
        if not last.is_integer():
            raise UniconError(f"{self.path}: len is {last:g}, not the number of the last row")
        return min(rows, max(int(last) + 1, 0))

    def number(self, key: str) -> float | None:
        """Return a single number, None where there is none.

        Raises:
            UniconError: it is something else.
        """
        value = self.arrays.get(key)
        if value is None:
            return None
        if value.size != 1 or value.dtype.kind not in "fiu":
            raise UniconError(
                f"{self.path}: {key} is {value.dtype} of shape {value.shape}; give one number"
            )
        return float(value.item())

    def times(self, rows: int) -> Float64 | None:
        """Return `ts` of the first rows in [s], None where it does not have their time."""
        times = self.arrays.get("ts")
        if times is None or times.dtype.kind not in "iuf" or times.size < rows:
            return None
        return times.reshape(-1)[:rows].astype(np.float64)

    def base_quat(self) -> Array | None:
        """Return UniCon's orientation as wxyz, base to world, shape (frames, 4); None without.

        Raises:
            UniconError: it has too few columns, or not numbers.
        """
        if "states_quat" in self.arrays:
            return self.columns("states_quat", 4)[:, [3, 0, 1, 2]]
        if "states_rpy" in self.arrays:
            return quat_of_rpy(self.columns("states_rpy", 3))
        return None

    def columns(self, key: str, count: int | None = None) -> Array:
        """Return the first columns of numbers, shape (frames, count); all of them where None.

        Raises:
            UniconError: it has too few columns, or not numbers.
        """
        values = self.arrays[key]
        shape, kind = values.shape, values.dtype
        if len(shape) != 2 or shape[1] < (count or 0) or kind.kind not in "fiu":
            raise UniconError(
                f"{self.path}: {key} has shape {shape} and type {kind}; give numbers of shape "
                f"(frames, {count or 'elements'})"
            )
        return values[:, :count]


def read_archive(path: Path, wanted: Collection[str], plain: Collection[str] = ()) -> Archive:
    """Read arrays of a file; nothing is ever unpickled.

    Args:
        path: the file.
        wanted: keys that are read; objects among them are refused.
        plain: keys that are read where they are not objects, and left out where they are.

    Raises:
        UniconError: it cannot be read, unpacks to too much, or is not such a file.
    """
    if path.exists() and not path.is_file():  # a pipe would never end
        raise UniconError(f"{path} is not a file; give an .npz")
    arrays: dict[str, Array] = {}
    try:
        with zipfile.ZipFile(path) as packed:
            size = sum(entry.file_size for entry in packed.infolist())
        if size > LARGEST:
            raise UniconError(
                f"{path} unpacks to {size >> 30} GiB; at most {LARGEST >> 30} are read"
            )
        with np.load(path, allow_pickle=False) as file:
            keys = tuple(file.files)
            for key in keys:
                if key not in wanted and key not in plain:
                    continue
                try:
                    arrays[key] = file[key]
                except ValueError:  # an object
                    if key in wanted:
                        raise
                    continue
                if not isinstance(arrays[key], np.ndarray):
                    raise ValueError(f"{key} is not an array")
    except UniconError:
        raise
    except OSError as error:
        raise UniconError(f"cannot read {path}: {error.strerror or error}") from error
    except MemoryError:
        raise too_large(path) from None
    except Exception as error:  # of any kind that zip files and headers of arrays raise
        # Without the advice that NumPy adds.
        reason = one_line(error)[:300].partition(". If you trust")[0]
        raise UniconError(
            f"{path} is not an .npz of arrays: {reason}; give one of numpy.savez, or of UniCon"
        ) from error
    return Archive(path, keys, arrays)


def too_large(path: Path) -> UniconError:
    """Return the error for a file that memory does not hold."""
    return UniconError(f"{path} does not fit into memory; cut it into pieces")


def import_npz(
    source: Path, out: Path, robot: Robot, joints: Sequence[str] = (), rate: float | None = None
) -> int:
    """Write a record of ticks; return how many.

    Args:
        source: the .npz file.
        out: of the record.
        robot: whose joints they are.
        joints: names in the file's order; those in the file if empty.
        rate: frames per second in [Hz]; if None by `rec_dt`, else `ts`.

    Raises:
        UniconError: it is not such a file, or does not fit the robot.
    """
    archive = read_archive(source, KEYS, (*NAMES, *UNICONS))
    keys = [key for key in archive.arrays if key in KEYS]
    if not keys:
        raise UniconError(
            f"{source} has no key of UniCon; known: {', '.join(KEYS)}; it has: "
            f"{', '.join(sorted(archive.keys)) or 'none'}"
        )
    arrays, quat = {key: archive.arrays[key] for key in keys}, archive.base_quat()
    lengths = {len(v) for v in (*arrays.values(), *(() if quat is None else (quat,))) if v.ndim}
    if len(lengths) != 1 or any(values.ndim != 2 for values in arrays.values()):
        shapes = ", ".join(f"{key} {v.shape}" for key, v in archive.arrays.items() if v.ndim)
        raise UniconError(f"{source}: arrays are (frames, elements) of one length; it has {shapes}")
    frames = archive.written(*lengths)
    names = tuple(joints) or archive.joint_names()
    states = {} if quat is None else {"base_quat": quat}
    for key in keys:
        state = KEYS[key]
        if state.startswith(("joint_", "motor_")):
            states[state] = archive.columns(key)[:, _order(archive, key, names, robot)]
        elif state != "base_quat":
            states[state] = archive.columns(key, 3)
    states = {k: np.ascontiguousarray(v[:frames], np.float32) for k, v in states.items()}
    return write_imported(out, source, robot, _stamps(archive, frames, rate), states)


def _order(archive: Archive, key: str, names: Sequence[str], robot: Robot) -> list[int]:
    """Return the column of each of the robot's joints, aligned by name."""
    source, count = archive.path, archive.arrays[key].shape[1]
    if not names:
        raise UniconError(
            f"{source} does not say the order of its {count} joints (DOF_NAMES); give --joints "
            f"with their names; robot {robot.name} has {', '.join(robot.joint_names)}"
        )
    if len(names) != count:
        raise UniconError(f"{source} has {count} joints, and {len(names)} names for them")
    for name in robot.joint_names:
        if name not in names:
            raise UniconError(
                f"{source} has no joint {name!r} of robot {robot.name}; {alternatives(name, names)}"
            )
    return [list(names).index(name) for name in robot.joint_names]


def _stamps(archive: Archive, frames: int, rate: float | None) -> Int64:
    """Return the time of each frame in [ns] from 0: float32 seconds of `ts` are too coarse."""
    period = archive.number("rec_dt") if rate is None else 1.0 / rate
    if period is None:
        times = archive.times(frames)
        why = "has neither rec_dt nor ts"
        if times is not None:
            with np.errstate(invalid="ignore"):  # of infinite ones
                told = np.round((times - times[:1]) * 1e9)
            if np.isfinite(told).all() and (np.diff(told) > 0).all() and (told <= 2.0**62).all():
                return told.astype(np.int64)
            why = "has a ts that does not grow with every frame"
    else:
        if SHORTEST <= period <= LONGEST:
            return np.round(np.arange(frames) * period * 1e9).astype(np.int64)
        why = f"has rec_dt {period:g} s"
    raise UniconError(f"{archive.path} {why}; give --rate HZ")
