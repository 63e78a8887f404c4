"""ChildPolicy: a policy whose network runs in a process of its own, for networks that are slow.

    policies:
      plan: {path: ./plan, child: {delay: 3}}
      walk: {path: ./walk, remote: {address: tcp://10.0.0.5:5560, keys: keys}}   # `unicon serve`

It runs in every tick of the workflow. At its own period it hands its observation over, unless the
network is still at work on one; `delay` ticks later it takes the action, and holds it until the
next. At real rate no tick waits: an action that is late is taken when it is there, and its age
grows. Where ticks are not paced the answer is waited for, so that each action comes after exactly
`delay` ticks and two runs are bit-exact.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from unicon_base import Fault, PolicyError, TextSink
from unicon_core.policies.chunks import DELAY, PREFIX, ChunkSpec, Plan, RemoteSpec
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.controller import PackedStates, PrefixedStates
from unicon_core.policies.networks.child import ChildNetwork, Question
from unicon_core.policies.networks.remote import RemoteNetwork
from unicon_core.policies.policy import Policy
from unicon_core.robots import Robot

AGE = "action_age"
"""State: how old the observation is of the action that is held, in [s]."""

TIMEOUT = 0.25
"""Shortest `timeout` unless it is given, in [s]: as old as a robot's command may be by `hang`."""


class ChildPolicy(Policy):
    """A policy as a block, its network in a child or at a server.

    Until its first action is there, it holds the targets that were sent last, limp joints where
    they were measured, with the gains of the policy.

    Args:
        contract: the policy, with `child`.
        states: as of `Policy`, with `action_age`.
        robot: as of `Policy`.
        period: of a tick in [s].
        paced: tells whether ticks are paced by the clock; else answers are waited for.
        tell: takes why the flow goes on where it does so at an underrun of `chunk`.
        network: of the contract, in its child or remote; None starts or reaches one.
        options: as of `Policy`.

    Raises:
        PolicyError: as of `Policy`; what only works in the process of the ticks.
        UniconError: what was raised in the child.
    """

    memory = ("_question", "_plan", "_computed", "_tick", "_asked", "_of", "_due")

    every_tick = True
    """It keeps its period by itself."""

    def __init__(
        self,
        contract: PolicyContract,
        states: PackedStates,
        robot: Robot,
        *,
        period: float,
        paced: Callable[[], bool],
        tell: TextSink = print,
        network: ChildNetwork | RemoteNetwork | None = None,
        **options: Any,
    ) -> None:
        spec = contract.child
        assert spec is not None
        kind: Any = RemoteNetwork if isinstance(spec, RemoteSpec) else ChildNetwork
        self._spec, self._period, self._paced = spec, period, paced
        self._every = max(round(contract.period / period), 1)
        chunk, moved = contract.chunk, len(contract.action.joints)
        row = period if chunk is None else chunk.period or contract.period
        self._plan = Plan(chunk or ChunkSpec(1), row, period, moved, PREFIX in contract.inputs)
        self._ends, self._tell = chunk is not None and chunk.underrun == "done", tell
        due = max(spec.delay, self._plan.steps)  # a new observation goes when the last is answered
        oldest = (spec.delay + -(-due // self._every) * self._every - 1) * period
        self._timeout, key = spec.timeout or max(TIMEOUT, 2.0 * oldest), f"{spec.key}.timeout"
        if chunk is not None:
            end = (self._plan.ticks - 1) * period + chunk.hold
            if spec.timeout is None or end < spec.timeout:
                self._timeout, key = end, "the time of a chunk with chunk.hold"
        if self._timeout < oldest:
            raise PolicyError(
                f"policy {contract.name}: {key} is {self._timeout:g} s, and by its delay "
                f"and period an action is up to {oldest:g} s old; give more"
            )
        self._late = f"is too slow, hangs or was stopped ({key})"
        if states.num_robots is not None:
            raise PolicyError(
                f"policy {contract.name}: in a child it drives one robot, not num_robots "
                f"{states.num_robots}; leave out {spec.key}"
            )
        mine = network is None
        self.network: Any = network or kind(contract)
        try:
            super().__init__(contract, states, robot, network=self.network, **options)
            if self._motion:
                raise PolicyError(
                    f"policy {contract.name}: its network gives the motion that it follows, "
                    f"which would come late from a child; leave out {spec.key}, or give motion.file"
                )
        except BaseException:
            if mine:
                self.network.close()
            raise
        named: Any = self.made[1]
        named.update(period=period, paced=paced, tell=tell)
        question = self.lane.infer
        assert isinstance(question, Question)
        self._question = question
        view = self._states
        names = ("joint_pos", "joint_pos_target", "joint_stiffness")
        self._there = [view[name].reshape(1, -1) for name in names]
        self._age = view[AGE]
        self._expected = [view[n] if n in contract.inputs else None for n in (PREFIX, DELAY)]
        self._tick, self._asked, self._of, self._due = 0, -1, -1, 0
        self.endless = self.endless and not self._ends
        measured = self.network.measured
        self._published += tuple((view[name], value) for name, value in measured.items())
        names = (AGE, *measured)
        own = [view.actual(n) if isinstance(view, PrefixedStates) else n for n in names]
        self.writes = (*self.writes, *own)
        self.reads = tuple(dict.fromkeys([*self.reads, "joint_pos"]))

    def __call__(self, warm_up: bool = False) -> bool:
        """Run one tick; of a warm-up only what changes nothing.

        Raises:
            Fault: as of `Policy`; the child has died, or its newest action is too old.
        """
        lane, tick = self.lane, self._tick
        if warm_up:
            lane.assemble()
            return False
        try:
            self._answer(tick)
        except Fault as fault:
            if not self._ends:
                raise
            self._tell(f"{fault}; the flow goes on (chunk.underrun)")
            return True
        if self._of >= 0:
            lane.action[...] = self._plan.at(tick)
            self._command()
            for state, values in self._published:
                state[...] = values
        else:
            self._hold(tick)
        done = False
        if tick % self._every == 0:
            done = self._observe()
        self._tick = tick + 1
        return done

    def _answer(self, tick: int) -> None:
        """Take an answer that is due; refuse one that is too old."""
        self.network.receive()
        if self._asked >= 0 and tick - self._asked >= self._spec.delay:
            self._take(tick)
        self._age[...] = age = (tick - max(self._of, 0)) * self._period
        if age > self._timeout:
            raise Fault(
                f"policy {self.name}: its newest action is {age:.3g} s old, at most "
                f"{self._timeout:g} s are allowed: {self.network.culprit} {self._late}"
            )

    def _take(self, tick: int) -> None:
        lane = self.lane
        if not self._question.take(wait=not self._paced()):
            return
        if not lane.action_finite():
            raise Fault(self._blame_action())
        self._plan.add(lane.output.reshape(-1, lane.action.shape[1]), self._asked, tick)
        for source, target in lane.recurrent:
            target[...] = source
        self._of, self._asked = self._asked, -1

    def _hold(self, tick: int) -> None:
        measured, target, stiffness = self._there
        position, *rates = self._computed
        if tick == 0:
            np.copyto(position, np.where(stiffness > 0.0, target, measured))
            for rate in rates:
                rate[...] = 0.0
        for state, values in self._published:
            state[...] = values

    def _observe(self) -> bool:
        """Look at the robot, and hand that over where the network is free."""
        lane = self.lane
        for part in self._before:
            part()
        if self.tracker is not None:
            self.tracker()
        self._plan.expect(self._tick, *self._expected)
        lane.assemble()
        if not lane.finite():
            raise Fault(self._blame_observation())
        if self._asked < 0 and self._tick >= self._due:
            self._question.ask()
            self._asked, self._due = self._tick, self._tick + self._plan.steps
        for state, values in lane.published:
            state[...] = values
        lane.advance()
        return self.tracker is not None and self.tracker.done

    def reset(self) -> None:
        """Forget what was asked and answered, and all that a policy forgets."""
        super().reset()
        self._question.forget()
        self._plan.reset()
        self._age[...] = 0.0
        self._tick, self._asked, self._of, self._due = 0, -1, -1, 0

    def close(self) -> None:
        """End the child, or leave the server."""
        self.network.close()
