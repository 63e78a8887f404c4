"""Meeting: what robots that start together tell one another, for `start: {together: …}`.

    start: {together: {robots: [left, right], me: left}}                     # of one machine
    start: {together: {robots: {left: tcp://10.0.0.1:5700, right: tcp://10.0.0.2:5700}, me: left,
                       keys: keys}}

Each robot publishes one small group: over shared memory, where all see the same clock, or over zmq,
where wall clocks have to agree (NTP, PTP); one that is off by more than `CLOCKS` is told by name.
"""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from unicon_base import AnyDict, Fault, StateError, UniconError, WorkflowError, alternatives
from unicon_base.arrays import Int64
from unicon_base.schema.marks import Made, Matches, Write, positive
from unicon_base.schema.types import Here, show
from unicon_core.states import Layout, States, StateSpec
from unicon_core.states.backends import Reader, Writer
from unicon_core.states.links import AGAIN_NS
from unicon_core.synchronised_start.agreement import BEGUN, FRESH_NS, READY, Agreement, Word

PATIENCE = 30.0
"""How long the others are waited for in [s], unless told."""

LONGEST = 3600.0
"""Of `timeout` in [s]: a robot stands under torque meanwhile."""

CLOCKS = 0.05
"""By how much another machine's clock may differ, in [s]; what is less cannot be told here from the
time that a word takes and waits for the next tick."""

SLOWEST = 0.05
"""Longest period of a tick in [s]: words count for a quarter of a second."""

STATE = "together"
FIELDS = ("stage", "impatient", "moment_ns", "clock_ns")
GROUP = Layout({STATE: StateSpec((len(FIELDS),), "int64", names=FIELDS)})


_NAME = r"[A-Za-z0-9_-]{1,40}"


def _robots(value: Any) -> dict[str, str]:
    """Return each robot's name and address.

    Raises:
        WorkflowError: they are not two or more names.
    """
    if isinstance(value, list):
        for name in value:
            if value.count(name) > 1:
                raise WorkflowError(f"has {name!r} twice; name each robot once")
        value = {name if isinstance(name, str) else repr(name): "" for name in value}
        wanted = ("", "")
    else:
        wanted = (r"(tcp|ipc)://\S+", ", or {left: tcp://HOST:PORT, …} on several machines")
    if not isinstance(value, dict) or len(value) < 2:
        raise WorkflowError(f"is {value!r:.60}; name two or more, as [left, right]")
    for name, address in value.items():
        if not (isinstance(name, str) and re.fullmatch(_NAME, name)):
            raise WorkflowError(f"has {name!r:.60}; use up to 40 letters, digits, '_' and '-'")
        if not (isinstance(address, str) and re.fullmatch(wanted[0], address)):
            raise WorkflowError(
                f"has {address!r:.60} as the address of {name!r}; give "
                "tcp://HOST:PORT, or ipc://PATH on one machine"
            )
        if address and list(value.values()).count(address) > 1:
            raise WorkflowError(f"has two robots of address {address!r}")
    return dict(value)


@dataclass(frozen=True)
class Party:
    """What `together:` says.

    Attributes:
        robots: name of each to its address; empty addresses on one machine.
        me: which this one is.
        group: of the robots that mean one another.
        timeout: how long the others are waited for in [s].
        keys: folder with the CURVE keys of the group, the same for each robot; None: without.
    """

    robots: Annotated[Mapping[str, str], Made(_robots), Write("[left, right]")]
    me: str
    group: Annotated[str, Matches(_NAME, "up to 40 letters, digits, '_' and '-'")] = "together"
    timeout: Annotated[float, positive(LONGEST, "s")] = PATIENCE
    keys: Annotated[Path | None, Matches(r".+", "the folder of the group's keys")] = None

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note a robot that is none of the group, and keys without addresses."""
        robots = found.get("robots", {})
        me = found.get("me")
        if robots and me is not None and me not in robots:
            here.value(
                f"is {show(me)}, which of the robots this one is; {alternatives(me, robots)}, as "
                f"--set start.together.me={next(iter(robots))}",
                "me",
            )
        if found.get("keys") is not None and robots and not any(robots.values()):
            here.value("is for robots with addresses (docs/howto/zmq.md); leave it out", "keys")

    def within(self, folder: Path) -> Party:
        """Return the party with its keys reckoned from a folder."""
        keys = self.keys
        return self if keys is None else replace(self, keys=(folder / keys).expanduser().resolve())

    @property
    def over_zmq(self) -> bool:
        """Whether they are on several machines."""
        return any(self.robots.values())


class _Other:
    """What is heard of one of the others.

    Args:
        party: who means one another.
        name: of the other one.
    """

    def __init__(self, party: Party, name: str) -> None:
        self._party, self._name = party, name
        self._states = States(GROUP)
        self._reader: Reader | None = None
        self._tried, self._alive = 0, False
        self.reason = "is not there"
        if party.over_zmq:
            from unicon_core.states.backends.zmq import ZmqReader

            late = FRESH_NS * 1e-9
            self._reader = ZmqReader(
                party.robots[name], STATE, GROUP, self._states, late=late, keys=party.keys
            )

    def hear(self, clock_ns: int) -> Word | None:
        """Return its word where it is fresh; `reason` says why not, and what is waited for."""
        now = time.monotonic_ns()
        reader = self._reader
        if reader is None:
            reader = self._find(now)
        if reader is None:
            return None
        reader.take()
        stage, impatient, moment, clock = map(int, self._states[STATE])
        if now - reader.stamp_ns > FRESH_NS:
            if now - self._tried > AGAIN_NS:
                self._tried = now
                self._alive = self._lives(reader)
            if not (self._alive and stage == BEGUN):
                return None
            self.reason = "has begun already"  # it says nothing any more
            return Word(stage, False, moment)
        # Since it said so: by how much longer than the fastest word this one took.
        ahead = (clock - clock_ns + max(now - reader.stamp_ns, 0)) * 1e-9
        if self._party.over_zmq and abs(ahead) > CLOCKS:
            order = "ahead of" if ahead > 0.0 else "behind"
            self.reason = (
                f"has a clock {abs(ahead):.3f} s {order} the one here; synchronise both (NTP, PTP)"
            )
            return None
        self.reason = "is there and not ready: gates, operator or approach"
        if stage == BEGUN:
            self.reason = "has begun already"
        elif stage == READY:
            self.reason = "is ready"
        return Word(stage, bool(impatient), moment)

    def _find(self, now: int) -> Reader | None:
        """Look for its segment now and then."""
        if now - self._tried > AGAIN_NS:
            self._tried = now
            from unicon_core.states.backends.shm import ShmReader

            name = segment_name(self._party, self._name)
            try:
                self._reader = ShmReader(name, STATE, self._states, GROUP)
            except StateError as error:
                self.reason = "is not there" if "no segment" in str(error) else str(error)
        return self._reader

    def _lives(self, reader: Reader) -> bool:
        """Return whether the one that is silent lives; a new one is taken up where it has died."""
        try:
            alive = reader.alive()
        except StateError as error:
            self.reason = str(error)
            return False
        if not reader.number:
            self.reason = "is not there"
        else:
            self.reason = "is silent" if alive else "has gone: it ended or was killed"
        return alive

    def close(self) -> None:
        """Let go."""
        if self._reader is not None:
            self._reader.close()


class Meeting:
    """Asked in each tick: the moment once all have agreed on it; see `Rendezvous`.

    Args:
        party: who means one another.
        alone: begin without who lacks once the time-out is over, else that is a fault.
        period: of a tick in [s].

    Raises:
        UniconError: the ticks are too slow.
        StateError: another run is this robot, or the address cannot be had.
        MissingDependencyError: pyzmq is not installed.
    """

    def __init__(self, party: Party, alone: bool, period: float) -> None:
        if period > SLOWEST:
            raise UniconError(
                f"start: together needs {1 / SLOWEST:g} ticks a second and more, and there are "
                f"{1 / period:.3g}; give a higher rate, or start: {{at: …}}"
            )
        self._party, self._alone = party, alone
        self.clock = time.time_ns if party.over_zmq else time.monotonic_ns
        self._agreement = Agreement(
            tuple(party.robots), party.me, round(party.timeout * 1e9), alone
        )
        self.reason = self.late = ""
        self._states = States(GROUP)
        self._said: Int64 = self._states[STATE]
        self._writer = _writer(party, self._states)
        self._others: dict[str, _Other] = {}
        try:
            for name in party.robots:
                if name != party.me:
                    self._others[name] = _Other(party, name)
        except BaseException:
            self.close()
            raise

    def ask(self, ready: bool) -> int:
        """Tell and hear; return the moment that all have agreed on in [ns], 0 before that.

        Raises:
            Fault: somebody lacks for too long, or this one has missed the moment.
        """
        agreement, now = self._agreement, self.clock()
        heard = {
            name: word
            for name, other in self._others.items()
            if (word := other.hear(now)) is not None
        }
        agreement(now, ready, heard)
        self._tell(agreement.mine)
        if agreement.moment_ns:
            if agreement.late:
                behind = (now - agreement.moment_ns) * 1e-9
                self.late = f"it is late: it missed the agreed moment by {behind:.3f} s"
                if not self._alone:
                    raise Fault(f"not started, {self.late}")
            elif agreement.lacking and not self.late:
                self.late = f"it goes without {self._lacking()}"
            self.reason = "the moment that all have agreed on"
            return max(agreement.moment_ns, now) if agreement.late else agreement.moment_ns
        self.reason = self._lacking() or "the others to agree on a moment"
        if agreement.expired and agreement.lacking and not self._alone:
            raise Fault(f"not started, waited {self._party.timeout:g} s for {self._lacking()}")
        return 0

    def begun(self) -> None:
        """Tell the others that this one begins."""
        self._tell(Word(BEGUN, moment_ns=self._agreement.moment_ns))

    def close(self) -> None:
        """Let go."""
        for other in self._others.values():
            other.close()
        self._writer.close()

    def facts(self) -> AnyDict:
        """Return what the report tells."""
        return {"robots": list(self._agreement.among)}

    def _lacking(self) -> str:
        lacking = self._agreement.lacking
        return "; ".join(f"{name!r}, which {self._others[name].reason}" for name in lacking)

    def _tell(self, word: Word) -> None:
        self._said[:] = word.stage, word.impatient, word.moment_ns, self.clock()
        self._writer.publish()


def _writer(party: Party, states: States) -> Writer:
    if party.over_zmq:
        from unicon_core.states.backends.zmq import ZmqWriter

        address = party.robots[party.me]
        # `check` refuses an address that others reach where there are no keys.
        return ZmqWriter(address, STATE, GROUP, states, keys=party.keys, without_keys=True)
    from unicon_core.states.backends.shm import Segment, ShmWriter

    try:
        segment = Segment.create(segment_name(party, party.me), {STATE: GROUP})
    except StateError as error:
        raise StateError(
            f"start: together: this one cannot be robot {party.me!r} of group {party.group!r}: "
            f"{str(error).partition(';')[0]}; end that run, or give another one of robots: --set "
            "start.together.me=NAME"
        ) from error
    return ShmWriter(segment, STATE, states)


def segment_name(party: Party, robot: str) -> str:
    """Return the name of a robot's segment."""
    return f"start-{party.group}-{robot}"
