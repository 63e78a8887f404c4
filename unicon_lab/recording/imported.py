"""What is imported from others becomes a record of ticks: states by name, as of one robot."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from unicon_base.arrays import Array, Float32, Float64, Int64
from unicon_base.errors import UniconError, alternatives, one_line
from unicon_core.blocks.projected_gravity import projected_gravity
from unicon_core.platforms.kit.base import quat_of_rpy
from unicon_core.robots import Robot
from unicon_core.runtime.phases import Phase
from unicon_core.runtime.tick_ring import HEAD, PHASES
from unicon_core.states import Layout, States
from unicon_core.states.standard import COMMAND_STATES, hardware_states, standard_states
from unicon_lab.recording.facts import robot_facts, versions_here
from unicon_lab.recording.read import LONGEST, SHORTEST
from unicon_lab.recording.ticks import RecordedSubset, kept_moments, write_ticks

CDR = bytes((0, 1, 0, 0))


def layout_of(robot: Robot, names: Iterable[str]) -> Layout:
    """Return those of a robot's states that are named, and time and number of the tick."""
    known = standard_states(robot.joint_names) | hardware_states(robot.joint_names)
    wanted = {*names, "stamp_ns", "tick"}
    return Layout({name: spec for name, spec in known.items() if name in wanted})


def write_imported(
    path: Path,
    source: Path,
    robot: Robot,
    stamps: Int64,
    states: Mapping[str, Array],
) -> int:
    """Write a record of what was imported; return the number of ticks.

    Commands are where the tick ends alone: they did not come from outside before it.

    Args:
        path: of the record.
        source: where it comes from, for its facts.
        robot: whose states they are, joints in its order.
        stamps: time of each tick in [ns], shape (ticks,).
        states: name to values, shape (ticks, …). The record has these alone, `projected_gravity`
            where there is `base_quat`, and time and number of the tick: what the source lacks is
            absent, so that nobody takes an initial value for a measured one.

    Raises:
        UniconError: there is nothing in it, or it cannot be written.
    """
    if not len(stamps):
        raise UniconError(f"{source} has nothing that could be imported; is it the right map?")
    made = {"projected_gravity"} if "base_quat" in states else set()
    layout = layout_of(robot, {*states, *made})
    given = frozenset({*layout.specs} - {*COMMAND_STATES})
    kept: RecordedSubset = {"received": given, "sent": None}
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
    return write_ticks(path, layout, kept, facts, _ticks(layout, kept, stamps, states))


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
    for number, stamp in enumerate(stamps.tolist()):
        for name, values in states.items():
            live[name][...] = values[number]
        live["stamp_ns"][...] = stamp
        live["tick"][...] = number
        if turn is not None:
            turn()
        for to, source in copies:
            row[to] = live.buffer[source].tobytes()
        HEAD.pack_into(row, 0, CDR, stamp, number, run, 1)
        yield bytes(row)


KEYS = {
    "states_q": "joint_pos",
    "states_qd": "joint_vel",
    "states_q_tau": "joint_effort",
    "states_q_ctrl": "joint_pos_target",
    "states_tau_ctrl": "joint_effort_ff",
    "states_q_temp": "motor_temperature",
    "states_quat": "base_quat",
    "states_ang_vel": "base_ang_vel",
    "states_lin_acc": "base_lin_acc",
    "states_lin_vel": "base_lin_vel",
    "states_pos": "base_pos_w",
    "states_cmd": "velocity_command",
}
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
        arrays: what was asked for and is there.
    """

    path: Path
    keys: tuple[str, ...]
    arrays: dict[str, Array]

    def joint_names(self) -> tuple[str, ...]:
        """Return the names of the joints in the file's order, empty where it has none."""
        found = next((self.arrays[key] for key in NAMES if key in self.arrays), ())
        return tuple(str(name) for name in np.ravel(np.asarray(found)))

    def written(self, rows: int) -> int:
        """Return how many of the rows were written: UniCon makes more, and `len` is the last one.

        Raises:
            UniconError: `len` is not a whole number.
        """
        if not {"ts", *KEYS} & set(self.keys):  # somebody else's `len` may be anything
            return rows
        last = self.number("len")
        if last is None:
            return rows
        if not math.isfinite(last) or last != int(last):
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
        return float(value.reshape(-1)[0])

    def times(self, rows: int) -> Float64 | None:
        """Return `ts` of the first rows in [s], None where it does not tell their time."""
        times = self.arrays.get("ts")
        if times is None or times.dtype.kind not in "iuf":
            return None
        times = times.reshape(-1)[:rows]
        return times.astype(np.float64) if len(times) == rows else None

    def base_quat(self) -> Array | None:
        """Return UniCon's orientation as wxyz, base to world, shape (frames, 4); None without.

        Raises:
            UniconError: it has too few columns, or not numbers.
        """
        if "states_quat" in self.arrays:
            return self._columns("states_quat", 4)[:, [3, 0, 1, 2]]
        if "states_rpy" in self.arrays:
            return quat_of_rpy(self._columns("states_rpy", 3))
        return None

    def _columns(self, key: str, count: int) -> Array:
        values = self.arrays[key]
        if values.ndim != 2 or values.shape[1] < count or values.dtype.kind not in "fiu":
            raise UniconError(
                f"{self.path}: {key} has shape {values.shape} and type {values.dtype}; give "
                f"numbers of shape (frames, {count})"
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
                    values = file[key]
                except ValueError:  # an object
                    if key in wanted:
                        raise
                    continue
                if not isinstance(values, np.ndarray):
                    raise ValueError(f"{key} is not an array")
                arrays[key] = values
    except UniconError:
        raise
    except OSError as error:
        raise UniconError(f"cannot read {path}: {error.strerror or error}") from error
    except MemoryError:
        raise too_large(path) from None
    except Exception as error:  # whatever zip files and headers of arrays raise
        # What NumPy adds, nobody is to do.
        reason = one_line(error)[:300].partition(". If you trust")[0]
        raise UniconError(
            f"{path} is not an .npz of arrays: {reason}; give one of numpy.savez, or of UniCon"
        ) from error
    return Archive(path, keys, arrays)


def too_large(path: Path) -> UniconError:
    """Return the error for a file that memory does not hold."""
    return UniconError(f"{path} does not fit into memory; cut it into pieces")


def import_npz(
    source: Path,
    out: Path,
    robot: Robot,
    joints: Sequence[str] = (),
    rate: float | None = None,
) -> int:
    """Write a record of ticks; return how many.

    Args:
        source: the .npz file.
        out: of the record.
        robot: whose joints they are.
        joints: names in the file's order; those in the file unless told.
        rate: frames per second in [Hz]; by `rec_dt`, else `ts`, unless told.

    Raises:
        UniconError: it is not such a file, or does not fit the robot.
    """
    archive = read_archive(source, KEYS, (*NAMES, *UNICONS))
    arrays = {key: values for key, values in archive.arrays.items() if key in KEYS}
    if not arrays:
        raise UniconError(
            f"{source} has no key of UniCon; known: {', '.join(KEYS)}; it has: "
            f"{', '.join(sorted(archive.keys)) or 'none'}"
        )
    quat = archive.base_quat()
    lengths = {len(v) for v in (*arrays.values(), *(() if quat is None else (quat,))) if v.ndim}
    if len(lengths) != 1 or any(values.ndim != 2 for values in arrays.values()):
        shapes = ", ".join(f"{key} {v.shape}" for key, v in archive.arrays.items() if v.ndim)
        raise UniconError(f"{source}: arrays are (frames, elements) of one length; it has {shapes}")
    frames = archive.written(*lengths)
    names = tuple(joints) or archive.joint_names()
    states = {}
    for key, values in arrays.items():
        state = KEYS[key]
        if state.startswith(("joint_", "motor_")):
            states[state] = _fitting(source, state, _ordered(source, values, names, robot))
        elif state != "base_quat":
            states[state] = _fitting(source, state, values, 3)
    if quat is not None:
        states["base_quat"] = _fitting(source, "base_quat", quat)
    states = {name: values[:frames] for name, values in states.items()}
    return write_imported(out, source, robot, _stamps(archive, frames, rate), states)


def _ordered(source: Path, values: Array, names: Sequence[str], robot: Robot) -> Array:
    """Return columns in the robot's order of joints, aligned by name."""
    if not names:
        raise UniconError(
            f"{source} does not say the order of its {values.shape[1]} joints (DOF_NAMES); give "
            f"--joints with their names; robot {robot.name} has {', '.join(robot.joint_names)}"
        )
    if len(names) != values.shape[1]:
        raise UniconError(f"{source} has {values.shape[1]} joints, and {len(names)} names for them")
    for name in robot.joint_names:
        if name not in names:
            raise UniconError(
                f"{source} has no joint {name!r} of robot {robot.name}; {alternatives(name, names)}"
            )
    return values[:, [list(names).index(name) for name in robot.joint_names]]


def _fitting(source: Path, state: str, values: Array, wanted: int | None = None) -> Float32:
    """Return the first columns of a state of the base, all of others."""
    if values.shape[1] < (wanted or 0):
        raise UniconError(
            f"{source}: {state} has shape {values.shape}; (frames, {wanted}) is wanted"
        )
    if values.dtype.kind not in "fiu":
        raise UniconError(f"{source}: {state} is {values.dtype}; numbers are wanted")
    return np.ascontiguousarray(values[:, :wanted], np.float32)


def _stamps(archive: Archive, frames: int, rate: float | None) -> Int64:
    """Return the time of each frame in [ns] from 0: float32 seconds of `ts` are too coarse."""
    source = archive.path
    period = archive.number("rec_dt") if rate is None else 1.0 / rate
    if period is None:
        times = archive.times(frames)
        if times is None:
            raise UniconError(f"{source} has neither rec_dt nor ts; give --rate HZ")
        with np.errstate(invalid="ignore"):  # of infinite ones
            told = np.round((times - times[:1]) * 1e9)
        if not np.isfinite(told).all() or (np.diff(told) <= 0).any() or (told > 2.0**62).any():
            raise UniconError(f"{source}: ts does not grow with every frame; give --rate HZ")
        return told.astype(np.int64)
    if not SHORTEST <= period <= LONGEST:
        raise UniconError(f"{source}: rec_dt is {period:g} s; give --rate HZ")
    return np.round(np.arange(frames) * period * 1e9).astype(np.int64)
