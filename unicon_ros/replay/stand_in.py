"""StandIn: what a replay has in the place of the recorded platform, which is never opened."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from unicon_core.errors import PlatformError, UniconError
from unicon_core.platforms.platform import SIMULATED, Facts
from unicon_core.states import States
from unicon_core.workflow.hardware import declared_facts
from unicon_core.workflow.registry import find_factory
from unicon_ros.recording import Record


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
