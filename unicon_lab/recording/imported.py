"""What is imported from others becomes a record of ticks: states by name, as of one robot."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from unicon_base.arrays import Array, Int64
from unicon_base.errors import UniconError
from unicon_core.blocks.maps import projected_gravity
from unicon_core.robots import Robot
from unicon_core.runtime.phases import Phase
from unicon_core.runtime.tick_ring import HEAD, PHASES
from unicon_core.states import Layout, States
from unicon_core.states.standard import COMMAND_STATES, hardware_states, standard_states
from unicon_lab.recording.facts import robot_facts, versions_here
from unicon_lab.recording.read import LONGEST, SHORTEST
from unicon_lab.recording.tick_file import write_ticks
from unicon_lab.recording.tick_message import RecordedSubset, kept_moments

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
