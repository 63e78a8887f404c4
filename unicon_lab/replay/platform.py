"""Platform `replay`: recorded sensors drive the graph, which moves nothing (open loop).

`StandIn` is what `--verify` has in the place of the recorded platform, which is never opened.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import AnyMapping, PlatformError, UniconError
from unicon_core.platforms.kit.scene import DISTURBANCES, TERRAIN
from unicon_core.platforms.platform import SIMULATED, Facts
from unicon_core.robots import Robot
from unicon_core.robots.load import JOINT_PHYSICS
from unicon_core.states import States
from unicon_core.states.standard import HARDWARE_STATES
from unicon_core.workflow import WorkflowDocument
from unicon_core.workflow.hardware import declared_facts
from unicon_core.workflow.registry import find_factory
from unicon_core.workflow.settings import MOMENTS
from unicon_lab.recording import Record
from unicon_lab.replay.series import Series, opened

TARGET = f"{__name__}:make"
"""What a workflow may call it, registered or not."""


class ReplayPlatform:
    """Gives what was received, tick by tick, and ends with the record; commands go nowhere.

    Attributes:
        series: what is given.
        loop: begin anew at the end.
        tick: the next one.
    """

    # What joints and ground are like is in the record: what is said of them is no reason to refuse.
    facts = Facts(
        "replay",
        simulated=True,
        batch=True,
        writes=(*SIMULATED, *HARDWARE_STATES),
        physics=(*JOINT_PHYSICS, TERRAIN),
    )

    def __init__(self, series: Series, loop: bool, driven: bool = True) -> None:
        self.series, self.loop = series, loop
        reads = self.facts.reads if driven else ()
        self.facts = replace(self.facts, writes=series.names, reads=reads)
        self.tick = 0

    def recv(self) -> bool:
        """Write the states of the next recorded tick; True with the last one."""
        last = len(self.series) - 1
        self.series.put(min(self.tick, last))
        ended = self.tick >= last
        self.tick = 0 if ended and self.loop else self.tick + 1
        return ended and not self.loop

    def send(self) -> None:
        """Do nothing: what was recorded has happened."""

    def seek(self, ticks: int) -> None:
        """Go on so many ticks farther on, or back; safe from any thread."""
        self.tick = min(max(self.tick + ticks, 0), len(self.series) - 1)

    def reset(self) -> None:
        """Begin anew."""
        self.tick = 0

    def close(self) -> None:
        """Let go; there is nothing to damp."""

    def info(self) -> AnyMapping:
        """Return what is replayed."""
        record = self.series.record
        return {
            "model": None,
            "recorded_on": record.facts.get("platform", ""),
            "ticks": len(self.series),
        }


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    bag: str = "",
    start: float = 0.0,
    loop: bool = False,
    moment: str = "received",
    also: Sequence[str] = (),
    each: bool = False,
    driven: bool = True,
    relative_to: Path | None = None,
) -> ReplayPlatform:
    """Build the platform.

    Args:
        period: of a tick in [s].
        bag: recording or fault record: a file or a folder, beside the workflow or from here.
        start: how much is left out at the beginning, in [s].
        loop: begin anew at the end.
        moment: of the recorded ticks: `received`, or `sent` for what was there at their ends.
        also: states to write besides what was measured, such as velocity_command.
        each: give a recorded tick in every tick, also where the two have other rates.
        driven: a flow commands; False for a player, whose record may have no commands.
        relative_to: folder of the workflow.

    Raises:
        PlatformError: no bag is given, or it does not fit the robot.
    """
    if not bag:
        raise PlatformError(
            "platform 'replay' needs a recording; give platforms: {replay: {bag: FILE.mcap}}, or "
            "run unicon replay FILE.mcap WORKFLOW"
        )
    try:
        record = opened(bag, relative_to)
        record.need(moment, also)
        names = [*_measured(record), *also]
        series = Series(record, names, moment, states, None if each else period, start)
    except UniconError as error:
        raise PlatformError(f"platform 'replay': {bag}: {error}") from error
    if "joint_pos" not in series.names:
        raise PlatformError(f"platform 'replay': {bag} has no joint_pos of robot {robot.name}")
    return ReplayPlatform(series, loop, driven)


def replayed_on(document: WorkflowDocument, bag: str | Path, **options: Any) -> None:
    """Let a workflow run on this platform: what disturbs a simulation is in the record."""
    told = {name: value for name, value in options.items() if value}
    document.values["platform"] = TARGET
    document.values["platforms"] = {TARGET: {"bag": str(Path(bag).absolute()), **told}}
    scene = document.values.get("scene")
    if isinstance(scene, dict):
        document.values["scene"] = {  # the ground and its seed are seen by height scans
            k: v for k, v in scene.items() if k == "seed" or k not in DISTURBANCES
        }
    start = document.values.get("start")
    if isinstance(start, dict):  # that moment has passed, and nobody else is there
        document.values["start"] = {k: v for k, v in start.items() if k not in MOMENTS}


def _measured(record: Record) -> Sequence[str]:
    """Return the states that the recorded platform wrote, or may have written."""
    every = (*SIMULATED, *HARDWARE_STATES)
    writes = record.told("platform_facts", dict).get("writes")
    if not isinstance(writes, list):
        return every
    return [*(name for name in every if name in writes), "stamp_ns"]


class StandIn:
    """Reads and writes what the recorded platform did, and does nothing.

    Args:
        facts: of the recorded platform.
        states: of the program; what is not among them is left out.

    Attributes:
        done: what `recv` says: set it where the recorded tick was the last of its phase.
    """

    def __init__(self, facts: Facts, states: States) -> None:
        reads = tuple(name for name in facts.reads if name in states)
        writes = tuple(name for name in facts.writes if name in states)
        self.facts = replace(facts, reads=reads, writes=writes, examine=None)
        self.done = False

    def recv(self) -> bool:
        """Do nothing, as what was received is fed behind it; True in the last tick."""
        return self.done

    def send(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    def wait(self, timeout: float) -> bool:
        """Return True: a program that ticks with its data can be built; nobody waits."""
        return True


def recorded_facts(record: Record) -> tuple[Facts, bool]:
    """Return the facts of the platform that a record was made on, and whether nothing was sent."""
    name = record.facts.get("platform", "")
    said = record.told("platform_facts", dict)
    try:
        reads, writes = tuple(map(str, said["reads"])), tuple(map(str, said["writes"]))
        simulated, silent = said["simulated"] is True, said["silent"] is True
        return Facts(name, simulated=simulated, batch=True, reads=reads, writes=writes), silent
    except (KeyError, TypeError):  # of a version that did not write them
        pass
    try:
        facts = declared_facts(find_factory("platforms", name, PlatformError), name)
    except UniconError:  # simulators alone stamp ticks with the time of their data
        stamped = "stamp_ns" in record.layout.slots
        simulated = stamped and np.array_equal(record.states("stamp_ns"), record.stamps)
        facts = Facts(name, simulated=bool(simulated), batch=True, writes=SIMULATED)
    return facts, False
