"""Several platforms as one: each member of a robot on its own, one tick for all.

A fault of one is the run's fault, and whatever one of them raises, the others are sent to and
closed: nothing of a body that stands depends on the cable of a finger.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence

from unicon_base import AnyMapping, Fault, PlatformError
from unicon_base.arrays import Array
from unicon_core.platforms.platform import (
    Facts,
    Platform,
    Prepares,
    RequiresStates,
    SeesCommanders,
    info_of,
)
from unicon_core.robots import Robot
from unicon_core.signals import SIGNALS
from unicon_core.states import States
from unicon_core.states.groups import STAMP, divided, stamp_of
from unicon_core.states.links import Incoming
from unicon_core.states.standard import JOINT_STATES, MOTOR_STATES

_OF_BASE = ("wait", "arrivals", "push", "viewer")
_OF_EACH = ("reset", "pause", "warm_up")
# Methods: what the base alone does, what all do that can, and what is put together.
_OF_SOME = ("prepare", "commanders", "require")


def joined_facts(each: Mapping[str, Facts]) -> Facts:
    """Return the facts of several platforms together.

    They are simulated only where all are: with one robot among them the rules of robots hold.

    Args:
        each: member to its platform's facts; the first one has the base.
    """
    facts = list(each.values())
    writes = dict.fromkeys(name for fact in facts for name in fact.writes)
    notes = [f"{member}: {note}" for member, fact in each.items() for note in fact.notes]
    for state in (*JOINT_STATES, *MOTOR_STATES):
        silent = [member for member, fact in each.items() if state not in fact.writes]
        if silent and state in writes:
            notes.append(f"{', '.join(silent)} does not tell {state}: it is 0 there")
    return Facts(
        "+".join(dict.fromkeys(fact.name for fact in facts)),
        simulated=all(fact.simulated for fact in facts),
        reads=tuple(dict.fromkeys(name for fact in facts for name in fact.reads)),
        writes=tuple(dict.fromkeys([*writes, STAMP, *map(stamp_of, each)])),
        physics=tuple(dict.fromkeys(word for fact in facts for word in fact.physics)),
        notes=tuple(notes),
    )


def members_of(platform: Platform, robot: Robot) -> Iterator[tuple[str, Platform, Robot]]:
    """Yield each member, its platform and its robot; of one platform "", that and the robot."""
    if isinstance(platform, JoinedPlatform):
        for member, each in platform.members.items():
            yield member, each, robot.members[member]
    else:
        yield "", platform, robot


class JoinedPlatform:
    """The platforms of a robot's members as one platform.

    What it can do besides is what its members can. The base's platform alone waits for data, counts
    them, is pushed and shown.

    Args:
        members: name to platform, the first one has the base; they write slices of `states`.
        robot: the whole robot.
        states: of the whole robot.
    """

    def __init__(self, members: Mapping[str, Platform], robot: Robot, states: States) -> None:
        self.members = dict(members)
        self.facts = joined_facts({name: each.facts for name, each in members.items()})
        base = next(iter(members))
        self._recvs = [(name, each.recv) for name, each in members.items()]
        self._sends = [(name, each.send) for name, each in members.items()]
        self._stamp = states[STAMP]
        self._of_base = states[stamp_of(base)]
        # A simulator among robots keeps a time of its own, which is nobody else's.
        self._mixed = members[base].facts.simulated and not self.facts.simulated
        # Told again in every tick: gates find out by a mark whether anybody tells a state.
        shared = divided(states.layout, robot.joint_names)
        self._untold: list[Array] = [
            states[state][robot.joints_of(name)]
            for name, each in members.items()
            for state in self.facts.writes
            if state in shared and state not in each.facts.writes
        ]
        self._ready: set[str] = set()
        self._failed: set[str] = set()
        self._able(members[base])

    def _able(self, base: Platform) -> None:
        """Take over abilities: the protocols look for methods."""
        every = self.members.values()
        for name in _OF_BASE:
            if hasattr(base, name):
                setattr(self, name, getattr(base, name))
        for name in _OF_EACH:
            calls = [getattr(each, name) for each in every if hasattr(each, name)]
            if len(calls) == len(every) or (calls and name != "reset"):
                setattr(self, name, _all(calls))
        for name in _OF_SOME:
            if any(hasattr(each, name) for each in every):
                setattr(self, name, getattr(self, f"_{name}"))

    def recv(self) -> bool | None:
        """Bring the data of all members into the states; True when one has gone for good.

        Raises:
            Fault: of a member, whose name it begins with.
        """
        gone = False
        for member, recv in self._recvs:
            try:
                gone = bool(recv()) or gone
            except Fault as fault:
                raise Fault(f"{member}: {fault}") from fault
        for view in self._untold:
            view[...] = 0
        self._stamp[...] = time.monotonic_ns() if self._mixed else self._of_base
        return gone

    def send(self) -> bool | None:
        """Send to every member, whatever another one raises.

        A member is told of once: that ends the run, and the damping that follows is for the others,
        and for it if it can still take it.

        Raises:
            Exception: what the first one raised; a fault begins with its name.
        """
        gone = False
        first: Exception | None = None
        for member, send in self._sends:
            try:
                gone = bool(send()) or gone
            except Exception as error:  # a vendor's code may raise anything
                if member not in self._failed:
                    self._failed.add(member)
                    told = isinstance(error, Fault)
                    first = first or (Fault(f"{member}: {error}") if told else error)
        if first is not None:
            raise first
        return gone

    def close(self) -> None:
        """Damp and let go of every member, whatever another one raises."""
        first: Exception | None = None
        for each in self.members.values():
            try:
                each.close()
            except Exception as error:
                first = first or error
        if first is not None:
            raise first

    def info(self) -> AnyMapping:
        """Return what each member tells of itself."""
        return {name: dict(info_of(each)) for name, each in self.members.items()}

    def _prepare(self) -> str:
        """Prepare one member after the other, the base last: nobody holds it until all are ready.

        A body whose own controller has let go stands on our commands alone.
        """
        for name, each in reversed(self.members.items()):
            if name in self._ready or not isinstance(each, Prepares):
                continue
            missing = each.prepare()
            if missing:
                return f"{name}: {missing}"
            self._ready.add(name)
        self._ready.clear()
        return ""

    def _commanders(self) -> Mapping[str, int]:
        return {
            where: count
            for each in self.members.values()
            if isinstance(each, SeesCommanders)
            for where, count in each.commanders().items()
        }

    def _require(self, states: Mapping[str, str]) -> None:
        for each in self.members.values():
            if isinstance(each, RequiresStates):
                told = each.facts.writes
                each.require({state: block for state, block in states.items() if state in told})


def _all(calls: Sequence[Callable[[], object]]) -> Callable[[], None]:
    def call() -> None:
        for each in calls:
            each()

    return call


START = 10.0
"""How long the first part is waited for, in [s]."""


class PartPlatform:
    """See the module.

    Args:
        part: name of this part.
        first: the part with the robot; it must be heard before this one starts.
        arrivals: bring the states of the others.
        patience: how long to wait for it in [s].

    Raises:
        PlatformError: it is not heard in time.
    """

    def __init__(self, part: str, first: str, arrivals: Sequence[Incoming]) -> None:
        writes = tuple(state for arrival in arrivals for state in arrival.writes)
        self.facts = Facts(f"part {part}", simulated=True, reads=(), writes=writes)
        self._arrivals = tuple(arrivals)
        self._first = next((a for a in arrivals if a.part == first), None)
        end = time.monotonic() + START
        while self._first is not None and not self._first.heard:
            self._first.quiet = True
            self._first()
            self._first.quiet = False
            if self._first.refused or time.monotonic() > end:
                raise PlatformError(
                    f"part {part!r}: {self._first.refused or f'part {first!r} is not heard'}; run "
                    f"it first: unicon run WORKFLOW --part {first}"
                )
            SIGNALS.check()
            if not self._first.heard:
                self._first.wait(0.02)

    def recv(self) -> None:
        """Take what has come."""
        for arrival in self._arrivals:
            arrival()

    def wait(self, timeout: float) -> bool:
        """Return True when the first part has published, False after `timeout` in [s]."""
        if self._first is None:
            time.sleep(timeout)
            return False
        return self._first.wait(timeout)

    def send(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Let go of the others."""
        for arrival in self._arrivals:
            arrival.close()
