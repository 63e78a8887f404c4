"""DrivenPolicy: a policy that moves some of its joints, and does not see what others move.

    policy: {policy: walk, drives: [legs, waist], sees_default_for: [arms]}

It works on a copy of the states in which the hidden joints stand still in its default pose, as most
policies were trained; seen, arms that somebody else moves make it fall.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from typing import Any

import numpy as np

from unicon_base import RobotError, WorkflowError
from unicon_base.arrays import Array, Float32
from unicon_core.flow import Block
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.policy import Policy
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.stacked import spans
from unicon_core.states.standard import COMMAND_STATES


class DrivenPolicy:
    """A policy as a block that writes the targets and gains of some joints alone.

    Args:
        make: makes the policy with the states that it is given.
        states: of the workflow.
        robot: that is to move.
        drives: groups or joints that it moves; all but the hidden ones if none are named.
        sees_default_for: groups or joints that it sees at its default pose, at rest.

    Attributes:
        policy: it, with its states.
        contract: of the policy.
        moves: groups or joints that it moves, by the words that were given.
        places: of these joints in the robot's order.
        hidden: likewise of those that it does not see.
        reads, writes: states of the workflow.

    Raises:
        WorkflowError: the robot has no such group or joint; it would not see joints that it moves,
            or move none.
    """

    memory = ("policy", "_kept")

    def __init__(
        self,
        make: Callable[[States], Policy],
        states: States,
        robot: Robot,
        drives: Sequence[str],
        sees_default_for: Sequence[str] = (),
    ) -> None:
        try:
            hidden = robot.group(_listed(sees_default_for))
            places = robot.group(_listed(drives) or robot.joint_names)
        except RobotError as error:
            raise WorkflowError(str(error)) from error
        if not drives:
            places = np.setdiff1d(places, hidden)
        self.moves = _listed(drives) or tuple(robot.joint_names[i] for i in places)
        self._states, self._copy = states, States(states.layout)
        self.policy = make(self._copy)
        self.contract, self.name = self.policy.contract, self.policy.name
        both = [robot.joint_names[i] for i in np.intersect1d(places, hidden)]
        if both or not len(places):
            what = f"drives {both[0]!r} and would not see it" if both else "drives no joint"
            raise WorkflowError(
                f"policy {self.name} {what}; name other groups in drives or sees_default_for"
            )
        self.places, self.hidden = places, hidden
        self.reads, self.writes = self.policy.reads, self.policy.writes
        self.endless, self.holds = self.policy.endless, self.policy.holds
        self.every_tick = getattr(self.policy, "every_tick", False)
        targets = [name for name in self.writes if name in COMMAND_STATES]
        brought = spans(states.layout, {*self.reads, *targets})
        there, here = (memoryview(each.buffer.data).cast("B") for each in (self._copy, states))
        self._brought = [(there[part], here[part]) for part in brought]
        at: Any = places
        if places[-1] - places[0] + 1 == len(places):
            at = slice(int(places[0]), int(places[-1]) + 1)
        self._at, self._targets = at, [(states[n], self._copy[n]) for n in targets]
        own = [name for name in self.writes if name not in targets]
        self._kept = [self._copy[name] for name in own]
        self._own = [(states[name], kept) for name, kept in zip(own, self._kept)]
        default = robot.default_joint_pos.copy()
        for name, position in zip(self.contract.joints, self.contract.default_joint_pos):
            default[robot.joint_names.index(name)] = position
        self._seen: list[tuple[Array, Float32]] = []
        if len(hidden):
            self._seen = [
                (self._copy["joint_pos"], default[hidden]),
                (self._copy["joint_vel"], np.zeros(len(hidden), np.float32)),
            ]

    def __call__(self) -> bool:
        """Run one tick of the policy.

        Raises:
            Fault: as of `Policy`; no target is written.
        """
        self._bring()
        done = self.policy()
        at = self._at
        for live, found in self._targets:
            live[..., at] = found[..., at]
        for live, found in self._own:
            live[...] = found
        return done

    def like(self, contract: PolicyContract) -> DrivenPolicy:
        """Return one with another contract, made with the same states and network."""
        made = copy(self)
        made.policy, made.contract = self.policy.like(contract), contract
        return made

    def warm_up(self) -> None:
        """Take the path of a tick and discard the result."""
        self._bring()
        self.policy.warm_up()

    def reset(self) -> None:
        """Begin anew, as the policy does."""
        self.policy.reset()
        for live, found in self._own:
            live[...] = found

    def close(self) -> None:
        """Close the policy."""
        close = getattr(self.policy, "close", None)
        if close is not None:
            close()

    def _bring(self) -> None:
        for there, here in self._brought:
            there[:] = here
        for seen, value in self._seen:
            seen[..., self.hidden] = value


def policy_of(block: Block) -> Policy | None:
    """Return the policy that a block runs, None where it runs none."""
    tick = block.tick.policy if isinstance(block.tick, DrivenPolicy) else block.tick
    return tick if isinstance(tick, Policy) else None


def _listed(words: Sequence[str]) -> tuple[str, ...]:
    return (words,) if isinstance(words, str) else tuple(words)
