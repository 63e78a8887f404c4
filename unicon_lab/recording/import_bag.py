"""Import of plain ROS bags through a message map, of either storage, with rosbags alone."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import TextSink, UniconError, imported, one_line
from unicon_base.arrays import Array, UInt8
from unicon_base.resources import find_config
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import BASE_STATES, JOINT_STATES
from unicon_lab.recording.imported import layout_of, write_imported
from unicon_lab.recording.read import missing
from unicon_msgs_map import Decoder, MapStateError, load_map
from unicon_ros.bridge.bindings import robot_variables

# States without which there is no tick; others are NaN where nothing tells them yet.
_SENSED = frozenset((*JOINT_STATES, *BASE_STATES))

MAP = "ros_robot"
"""The map that says what a bag's topics mean, unless told: those of a robot behind ROS."""


def open_bag(path: Path) -> Any:
    """Return a bag that is open, of rosbags: a folder or a file of either storage.

    Raises:
        MissingDependencyError: rosbags is not installed.
        UniconError: it cannot be read.
    """
    any_reader = imported("rosbags.highlevel", "reading bags", "bags").AnyReader
    from rosbags.typesys import Stores, get_typestore

    if not os.path.exists(path):  # of a name that is too long, too
        raise UniconError(missing(path))
    if not (path.is_file() or path.is_dir()):  # a pipe would never open
        raise UniconError(f"{path} is neither a file nor a folder; give a bag")
    try:
        reader = any_reader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
        reader.open()
    except Exception as error:  # whatever its storages raise
        raise UniconError(
            f"{path} is not a bag that can be read: {one_line(error)[:300]}; give a recording of "
            "unicon, or a bag of ROS 2: a folder, .mcap or .db3"
        ) from error
    return reader


def import_bag(
    source: Path,
    out: Path,
    robot: Robot,
    map_name: str = MAP,
    rate: float | None = None,
    tell: TextSink = print,
) -> int:
    """Write a record of ticks; return how many.

    There is a tick for each message of the map's first topic that the bag has; the others' newest
    values before it count, or of its very time. Ticks begin once each topic with states of joints
    or base has come; what others bring is NaN until their first message. A state that no message
    tells is absent.

    Args:
        source: the bag.
        out: of the record.
        robot: whose states they are.
        map_name: message map whose `subscribe` says what topics mean, a name or path.
        rate: ticks per second in [Hz], at even times, instead.
        tell: takes a line for what the record lacks at its beginning.

    Raises:
        UniconError: the bag, the map or the robot is wrong.
    """
    mapping = load_map(find_config("maps", map_name))
    specs = {spec.topic.strip("/"): spec for spec in mapping.subscribe}
    named = {state for spec in mapping.subscribe for state in spec.states}
    states = States(layout_of(robot, named))
    arrays = {name: states[name] for name in states}
    layout = states.layout.specs
    names = {name: spec.names for name, spec in layout.items() if spec.names}
    reader = open_bag(source)
    try:
        decoders = {}
        for connection in reader.connections:
            topic = connection.topic.strip("/")
            spec = specs.get(topic)
            if spec is None or topic in decoders or not connection.msgcount:
                continue
            if spec.type != connection.msgtype:
                raise UniconError(
                    f"{source}: topic /{topic} is {connection.msgtype}, and map {map_name} says "
                    f"{spec.type}; give another with --map"
                )
            try:
                decoders[topic] = Decoder.build(spec, arrays, names, robot_variables(robot))
            except MapStateError:
                if not spec.optional:
                    raise
        if not decoders:
            there = sorted({connection.topic for connection in reader.connections})
            raise UniconError(
                f"{source} has no topic of map {map_name} ({', '.join(sorted(specs)) or 'none'}); "
                f"it has {', '.join(there) or 'none'}: give another with --map"
            )
        lead = next(topic for topic in specs if topic in decoders)
        rows = _rows(reader, decoders, lead, states, rate, tell)
    except UniconError:
        raise
    except Exception as error:  # whatever its storages raise at damaged content
        raise UniconError(f"{source} cannot be read to its end: {one_line(error)[:300]}") from error
    finally:
        reader.close()
    refused = [decoder for decoder in decoders.values() if not decoder.received]
    if refused:
        raise UniconError(
            f"{source}: every message of a topic was refused: "
            f"{refused[0].last_error or refused[0].spec.topic}; give another map with --map"
        )
    stamps = np.array([stamp for stamp, _ in rows], np.int64)
    given = {s for each in decoders.values() for s in each.spec.states} - {"stamp_ns"}
    table = np.stack([raw for _, raw in rows]) if rows else np.zeros((0, states.buffer.size))
    columns = {name: _column(states, table, name) for name in layout if name in given}
    columns = {name: values for name, values in columns.items() if not np.isnan(values).all()}
    return write_imported(out, source, robot, stamps, columns)


def _rows(
    reader: Any,
    decoders: dict[str, Decoder],
    lead: str,
    states: States,
    rate: float | None,
    tell: TextSink,
) -> list[tuple[int, UInt8]]:
    """Return time in [ns] and all states of each tick."""
    step = None if rate is None else 1e9 / rate
    rows: list[tuple[int, UInt8]] = []
    awaited = {t for t, each in decoders.items() if not _SENSED.isdisjoint(each.spec.states)}
    awaited.add(lead)
    for name in states:
        if states[name].dtype.kind == "f":
            states[name].fill(np.nan)
    heard: dict[str, int] = {}  # topic to the time of its first message
    due: int | None = None  # time of a tick that gets what else comes at that time
    connections = [c for c in reader.connections if c.topic.strip("/") in decoders]
    for connection, stamp, raw in reader.messages(connections):
        topic, complete = connection.topic.strip("/"), awaited <= heard.keys()
        if due is not None and (topic == lead or stamp > due):
            if complete:
                rows.append((due, states.buffer.copy()))
            due = None
        if step is not None and complete:
            first = max(heard[each] for each in awaited)
            while first + round(len(rows) * step) < stamp:
                rows.append((first + round(len(rows) * step), states.buffer.copy()))
        if decoders[topic].decode(bytes(raw)):
            heard.setdefault(topic, stamp)
            due = stamp if topic == lead and step is None else due
    if due is not None and awaited <= heard.keys():
        rows.append((due, states.buffer.copy()))
    if rows:
        _tell_of_beginning(rows[0][0], heard, lead, decoders, tell)
    return rows


def _tell_of_beginning(
    begin: int,
    heard: dict[str, int],
    lead: str,
    decoders: dict[str, Decoder],
    tell: TextSink,
) -> None:
    """Name what a record lacks at its beginning, which is at a time in [ns]."""
    if begin > heard[lead]:
        late = max((t for t in heard if heard[t] <= begin), key=lambda each: heard[each])
        tell(
            f"ticks begin {(begin - heard[lead]) * 1e-9:.3g} s after the first message of /{lead}: "
            f"/{late} had none before"
        )
    for topic, stamp in heard.items():
        if stamp > begin:
            named = ", ".join(sorted({*decoders[topic].spec.states} - {"stamp_ns"}))
            tell(f"/{topic} begins {(stamp - begin) * 1e-9:.3g} s later: until then {named} is NaN")


def _column(states: States, table: Array, name: str) -> Array:
    slot = states.layout.slots[name]
    packed = np.ascontiguousarray(table[:, slot.offset : slot.offset + slot.nbytes])
    return packed.view(slot.dtype).reshape(-1, *slot.shape)
