"""ShadowedPolicy: a policy with another one beside it, which may replace it while the robot moves.

Policy A drives. Policy B ticks behind `send` on the same states and writes states of its own: no
command waits for it. `ask` (`~/swap`) lets B drive where its gates hold: the command goes from A's
targets to B's over a blend in which both tick. A second `ask`, or a fault of B, leads back to A.

What a policy sees as its last action is what was executed, in its own action space, while another
one drives or both do: action = (target sent - offset) / scale. Its own outputs moved nothing.
"""

from __future__ import annotations

import math
import time
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from unicon_base import AnyDict, Fault, TextSink
from unicon_base.arrays import Float32
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.policy import Policy
from unicon_core.states import States

if TYPE_CHECKING:
    from unicon_core.workflow.file import ShadowEntry

CALM = 1.0
"""For so long B has to agree with A, finite and in time, before it may drive, in [s]."""
LATE = 3
"""Ticks in a row that take too long, after which B is out."""
PAIRED = ("joint_pos_target", "joint_stiffness", "joint_damping")
"""Commands that B writes into states of its own, and that a blend mixes."""


def disagreement(a: PolicyContract, b: PolicyContract) -> str:
    """Return why one policy cannot replace another while the robot moves, "" where it can."""
    for each in (a, b):
        kinds = {
            "in a child": each.child,
            "of action chunks": each.chunk,
            "of a motion": each.motion or "motion_joint_pos" in each.outputs,
            "of velocities or torques": not each.action.of_kind("position").all(),
        }
        for kind, found in kinds.items():
            if found:
                return f"{each.name} is {kind}, which cannot be swapped"
    if seen := {*PAIRED} & {term.state for term in b.terms}:
        return f"{b.name} sees {seen.pop()}, which it does not command yet"
    if not math.isclose(a.period, b.period, rel_tol=1e-6):
        return f"{b.name} has period {b.period:g} s and {a.name} {a.period:g} s"
    if None not in (a.robot, b.robot) and a.robot != b.robot:
        return f"{b.name} is of robot {b.robot} and {a.name} of {a.robot}"
    odd = {*a.joints} ^ {*b.joints} or {*a.action.joints} ^ {*b.action.joints}
    if odd:
        return f"joints of {b.name} and {a.name} differ in {', '.join(sorted(odd))}"
    for axis, (low, high) in b.command_ranges.items():
        lowest, highest = a.command_ranges.get(axis, (-math.inf, math.inf))
        if lowest < low or high < highest:
            return (
                f"{b.name} has {axis} [{low:g}, {high:g}], which is less than [{lowest:g}, "
                f"{highest:g}] of {a.name}"
            )
    return ""


class ShadowedPolicy:
    """A policy as a block, and the one beside it.

    Args:
        a: the policy that drives at first.
        b: the other one, which writes `PAIRED` into states of its own.
        states: of the workflow.
        names: of A and B in the workflow; the second begins the names of B's states.
        entry: `blend` [s], `bound` [rad] and `limit` [s] of the workflow.
        every: ticks of the workflow in one of the policies.
        tell: takes what happens, one line.

    Attributes:
        contract: of A.
        names: of A and B in the workflow.
        driving: 1 where B drives or is to, else 0.
        reads, writes: states.
    """

    memory = (
        "a", "b", "driving", "_step", "_good", "_late", "_lost", "_armed", "_frozen", "_idle",
        "_last", "_largest", "_sum", "_count", "_events", "_why", "_asked",
    )  # fmt: skip

    def __init__(
        self,
        a: Policy,
        b: Policy,
        states: States,
        names: tuple[str, str],
        entry: ShadowEntry,
        every: int,
        tell: TextSink,
    ) -> None:
        self.a, self.b, self.contract = a, b, a.contract
        self.names, self.endless, self.holds = names, True, (*a.holds, *b.holds)
        period, prefix = a.contract.period, f"{names[1]}_"
        self._tell, self._bound, self._every = tell, entry.bound, every
        self._limit = entry.limit or 0.5 * period
        self._steps = max(round(entry.blend / period), 1) + 1
        self._joints = states.layout.specs["joint_pos_target"].names
        self._live = [states[name] for name in PAIRED]
        self._mine, self._theirs = a.target.reshape(-1), states[prefix + PAIRED[0]]
        self._pairs = [
            (target, policy.action_map.stiffness, policy.action_map.damping)
            for policy, target in ((a, self._mine), (b, self._theirs))
        ]
        own = ("target_difference", "share", "time", "request")
        self._difference, self._share, self._time, self._request = (
            states[prefix + name] for name in own
        )
        self._last = np.full_like(self._live[0], np.nan)
        self.driving = self._step = self._good = self._late = self._idle = self._count = 0
        self._lost, self._why = ["", ""], "it did not run before"
        self._armed = self._frozen = False
        ours, theirs = seen_at(a), seen_at(b)
        common = [key for key in ours if key in theirs]
        self._terms = np.array([term for term, *_ in common])
        self._seen = [
            partial(policy.lane.obs[0].take, np.array([at[key] for key in common], np.intp))
            for policy, at in ((a, ours), (b, theirs))
        ]
        # Of the targets, then of what both see.
        self._largest, self._sum = np.zeros((2, len(self._last) + len(common)))
        self._events: list[str] = []
        self._ran = self._alone = self._asked = False
        self._spent = 0.0
        *told, spent, request = (prefix + name for name in (*PAIRED, *own))
        self.heard = (spent, request)
        self.writes = tuple(dict.fromkeys([*a.writes, *b.writes, *told]))
        reads = dict.fromkeys([*a.reads, *b.reads, *self.heard])
        self.reads = tuple(name for name in reads if name not in self.writes)

    # -- requests -------------------------------------------------------------------------------

    def ask(self) -> tuple[bool, str]:
        """Ask for the other policy, from any thread; return whether that is granted, and a line."""
        reason = "it was asked for just now" if self._asked else self.refusal()
        if reason:
            return False, f"refused: {reason}"
        self._asked = True
        a, b = self.names
        return True, f"back to {a}" if self.driving else f"{b} takes over from {a}"

    def refusal(self) -> str:
        """Return why the other policy may not drive now, "" where it may."""
        a, b = self.names
        other = not self.driving
        if self._idle > self._every:
            return f"policy {a} does not run"
        if self._lost[other]:
            return f"{self.names[other]} is out: {self._lost[other]}"
        if self.driving:
            return ""
        if self._armed:
            return f"{b} waits for its gait phase already"
        if self._step:
            return f"the blend back to {a} goes on"
        if (seconds := self._good * self.contract.period) < CALM:
            return f"{b} has been fit for {seconds:.2f} s of {CALM:g} s: {self._why}"
        return ""

    def hear(self) -> None:
        """Write request and time of B into their states, right behind `recv`: a replay has them."""
        self._request[...] = self._asked
        self._time[...] = self._spent

    # -- in the tick ----------------------------------------------------------------------------

    def __call__(self) -> bool:
        """Run one tick of what drives.

        Raises:
            Fault: as of `Policy`, of A where it drives or B cannot.
        """
        self._ran = True
        if self._request:
            self._asked = False
            if reason := self.refusal():
                self._note(f"swap refused: {reason}")
            elif self.driving:
                self.driving = 0
                self._note(f"back to {self.names[0]}")
            else:
                self._armed = True
        clock = self.b.phase
        if self._armed and (clock is None or clock.begins):
            self._armed, self.driving, self._good, self._why = False, 1, 0, "it has just driven"
            self._note(f"{self.names[1]} takes over")
        self._alone = not (self.driving or self._step)
        if self._alone:
            return self.a()
        self._both()
        return False

    def _both(self) -> None:
        error = self._tick(0)
        if error is not None and not self.driving:
            raise error
        if (slow := self._slow()) and self.driving:
            self._return(slow)
        if not self._frozen:
            self._tick(1)
            if reason := self._lost[1] or self._far(self._last, "steps by"):
                self._theirs[...] = self._last
                self._return(reason)
            self._last[...] = self._theirs
        self._step = min(max(self._step + (1 if self.driving else -1), 0), self._steps)
        self._share[...] = share = self._step / self._steps
        for live, own, other in zip(self._live, *self._pairs):  # exact at both ends
            live[...] = (1.0 - share) * own + share * other
        if not self._step and self._frozen:
            self._begin()

    def _tick(self, number: int) -> BaseException | None:
        """Run A or B, whose mistake is returned and noted: it is out then."""
        if self._lost[number]:
            return None
        began = time.perf_counter()
        try:
            (self.a, self.b)[number]()
        except Exception as error:  # whatever a network raises, the other one goes on
            self._out(number, f"{type(error).__name__}: {error}")
            return error
        if number:
            self._spent = time.perf_counter() - began
        return None

    def _out(self, number: int, reason: str) -> None:
        self._lost[number], self._good, self._armed = reason, 0, False
        self._note(f"{self.names[number]} is out: {reason}")

    def _slow(self) -> str:
        self._late = self._late + 1 if self._time > self._limit else 0
        return f"{LATE} ticks took over {self._limit * 1e3:.3g} ms" if self._late >= LATE else ""

    def _far(self, other: Float32, text: str) -> str:
        """Return which target of B is beyond the bound from others, NaN where there are none."""
        apart = np.nan_to_num(np.abs(self._theirs - other), nan=0.0)
        worst = int(np.argmax(apart))
        if apart[worst] <= self._bound:
            return ""
        return f"its target of {self._joints[worst]} {text} {apart[worst]:.2f} rad"

    def _return(self, reason: str) -> None:
        """Let A drive again, from B's last good target on."""
        if self._lost[0]:
            raise Fault(f"policy {self.names[1]}: {reason}; {self.names[0]}: {self._lost[0]}")
        if self.driving:
            self._note(f"back to {self.names[0]} by itself: {self.names[1]}: {reason}")
        self.driving, self._frozen, self._good, self._why = 0, True, 0, reason

    def _note(self, text: str) -> None:
        self._events.append(text)
        self._tell(f"shadow: {text}")

    # -- behind send ----------------------------------------------------------------------------

    def observe(self) -> None:
        """Tick B where it does not drive, compare, and give both what was executed."""
        if not self._ran:
            self._idle += 1
            if self._idle > self._every:
                self._good, self._armed, self._asked = 0, False, False
            return
        self._ran, self._idle = False, 0
        if self._alone and not self._lost[1]:
            self._shadow()
        if self.driving or self._step:
            self.a.executed(self._live[0])
        if not (self.driving and self._step == self._steps):
            self.b.executed(self._live[0])
        if not (any(self._lost) or self._frozen):
            self._difference[...] = self._theirs - self._mine
            ours, theirs = (take() for take in self._seen)
            apart = np.append(self._difference, theirs - ours)
            self._sum += apart**2
            np.maximum(self._largest, np.abs(apart), out=self._largest)
            self._count += 1
        self._frozen = self._frozen and self._step > 0

    def _shadow(self) -> None:
        if slow := self._slow():
            self._out(1, slow)
        elif self._tick(1) is None:
            why = self._far(self._last, "steps by")
            why = why or self._far(self._mine, f"differs from {self.names[0]} by")
            self._last[...] = self._theirs
            if not why and self._late:
                why = f"a tick took {float(self._time) * 1e3:.3g} ms"
            self._good = 0 if why else self._good + 1
            self._why = why or self._why
            if why and self._armed:
                self._armed = False
                self._note(f"swap given up: {why}")

    def _begin(self) -> None:
        self.b.reset()
        self._last[...] = np.nan
        self._good = self._late = 0

    # -- as of a policy -------------------------------------------------------------------------

    def warm_up(self) -> None:
        """Take the path of a tick and discard the result."""
        with suppress(Exception):  # its tick raises it again, where it can be returned from
            (self.a, self.b)[self.driving].warm_up()

    def reset(self) -> None:
        """Begin anew with the policy that drives."""
        self.a.reset()
        self._begin()
        self._step = self._steps if self.driving else 0
        self._armed = self._frozen = False

    def found(self) -> AnyDict:
        """Return what was seen, for a report; terms as the networks get them, scaled."""
        n, mean = len(self._joints), self._sum / max(self._count, 1)
        rms, (largest, seen) = np.sqrt(mean[:n]).round(4), np.split(self._largest, [n])
        worst = int(np.argmax(largest))
        says = f"{largest[worst]:.3g} rad apart at most, of {self._joints[worst]}, in "
        says += "; ".join([f"{self._count} ticks", *self._events[-3:]])
        terms = {term: self._terms == term for term in dict.fromkeys(self._terms.tolist())}
        return {
            "says": says,
            "policy": str(self.b.contract.path),
            "drives": self.names[self.driving],
            "ticks": self._count,
            "largest_rad": round(float(largest[worst]), 4),
            "joint": self._joints[worst],
            "rms_rad": dict(zip(self._joints, rms.tolist())),
            "rms_seen": {t: float(np.sqrt(mean[n:][at].mean())) for t, at in terms.items()},
            "largest_seen": {t: float(seen[at].max()) for t, at in terms.items()},
            "events": list(self._events),
        }


def seen_at(policy: Policy) -> dict[tuple[str, str | int, int], int]:
    """Return term, element and age in frames of what a policy observes, each with its place."""
    seen, found = policy.lane.observation, dict[tuple[str, str | int, int], int]()
    if seen is None:
        return found
    for place in range(seen.size):
        part, i, age = seen.element_of(place)
        found[part.term.name, part.names[i] if part.names else i, age] = place
    return found
