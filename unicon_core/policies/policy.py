"""The policy block: states in, joint targets out, once a tick, for workflows.

Observation → network → check → targets; a NaN or infinity is a Fault before any target is written.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import Fault, PolicyError, RobotError, WorkflowError
from unicon_base.arrays import Array, Float32
from unicon_core.flow import Block
from unicon_core.policies.action_map import ActionMap
from unicon_core.policies.bind import Binding
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.controller import PackedStates
from unicon_core.policies.motion.follow import own_reference, tracker_of
from unicon_core.policies.networks import Network, open_network
from unicon_core.policies.perception import HeightScan
from unicon_core.policies.phase import RPY, GaitPhase, RollPitchYaw, derived_states
from unicon_core.policies.policy_states import fed_back, own_states, reads_writes
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.states.states import spans
from unicon_core.terrain.height_map import Heights

_TARGETS = ("joint_pos_target", "joint_stiffness", "joint_damping")
_RATES = ("joint_vel_target", "joint_effort_ff")


class Policy:
    """A policy as a block: its network fed from the states, its action as targets of the joints.

    Args:
        contract: the policy.
        states: packed states; `joint_pos_target`, `joint_stiffness` and `joint_damping` are
            written, `observation` and `action` too where they are declared, and
            `joint_vel_target` and `joint_effort_ff` where its actions are such.
        robot: the robot that is to move; joints are aligned by name.
        prefix: of the policy's own states, as given to `policy_states`.
        network: another one than that of the contract.
        model: the robot's model file, in which a motion's anchor is found.
        every_target: write `joint_vel_target` and `joint_effort_ff` whatever its actions are: as
            another policy does, which may have run before.
        ground: heights of the ground for `height_scan`; without it something else writes that.

    Attributes:
        name: of the policy.
        reads: states that the observation is taken from.
        writes: states that are written.
        holds: its action, which others may read before it runs: that of its last tick.
        action_map: what turns the action into targets.
        target: positions that its last tick gave in [rad], the robot's order, shape (rows, n).
        lane: arrays and bound calls.
        tracker: of the motion that it follows, or None.
        made: what it was made with, beside contract and network.
        endless: it is never done, as it follows no motion, or one without an end.

    Raises:
        PolicyError: states, joints or sizes that do not fit, or missing files.
        MissingDependencyError: the runtime of its network is not installed.
    """

    memory: tuple[str, ...] = ("lane", "phase", "tracker", "_begun")

    def __init__(
        self,
        contract: PolicyContract,
        states: PackedStates,
        robot: Robot,
        *,
        prefix: str = "",
        network: Network | None = None,
        model: Path | None = None,
        every_target: bool = False,
        ground: Heights | None = None,
    ) -> None:
        self.made = (
            (states, robot),
            {"prefix": prefix, "model": model, "every_target": every_target, "ground": ground},
        )
        if contract.chunk is not None and contract.child is None:
            raise PolicyError(
                f"policy {contract.name}: its network answers with chunks, in a process of its own "
                "alone; add child: true beside its path"
            )
        states, self.slew = own_states(contract, states, prefix)
        self.name = contract.name
        self.contract = contract
        self.network = open_network(contract) if network is None else network
        self._states = states
        rows = states.num_robots or 1
        self.lane = Binding(contract, states, robot.joint_names, self.network).lane()
        self.action_map = ActionMap(contract, robot, rows)
        n = robot.num_joints
        self.every_target = every_target or not self.action_map.positions_only
        targets = (*_TARGETS, *_RATES) if self.every_target else _TARGETS
        for name in targets:
            if name not in states or states[name].size != rows * n:
                raise PolicyError(
                    f"policy {contract.name}: state {name!r} must hold {n} joints of robot "
                    f"{robot.name}; declare the standard states of this robot"
                )
        target, stiffness, damping, *rates = (states[name].reshape(rows, n) for name in targets)
        self._computed = [np.zeros_like(target) for _ in range(3)]
        computed, velocity, torque = self._computed
        self.target = computed
        smooth, action = self.action_map.filter, self.lane.action
        if self.action_map.positions_only and smooth is None:
            self._command = self.action_map.bind(action, computed)
        else:
            measured = states["joint_pos"].reshape(rows, n)
            self._command = self.action_map.bind_all(action, computed, velocity, torque, measured)
        if smooth is not None:
            self.lane.behind(smooth)
        self._published = (
            *self.lane.published,
            (target, computed),
            (stiffness.reshape(-1), np.tile(self.action_map.stiffness, rows)),
            (damping.reshape(-1), np.tile(self.action_map.damping, rows)),
            *zip(rates, (velocity, torque)),
        )
        # A warm-up does these copies instead, which fetch both sides: what is behind the network
        # costs 17 µs when it is cold, as much as the network.
        self._discarded = tuple(
            (thrown, side)
            for pair in self._published
            for thrown in [np.zeros_like(pair[0])]
            for side in pair
        )
        self._actions = fed_back(contract, states)
        self.phase: GaitPhase | None = None
        if contract.phase is not None and "gait_phase" in states:
            what = f"policy {contract.name}: gait phase"
            self.phase = GaitPhase(contract.phase, states, contract.period, what)
        angles = RollPitchYaw(states) if RPY in derived_states(contract) else None
        scan = None
        if contract.height_scan is not None and ground is not None:
            scan = HeightScan(contract.height_scan, states, ground)
        before = (angles, self.slew, self.phase, scan)
        self._before = tuple(part for part in before if part is not None)
        self.tracker = tracker_of(contract, states, robot, self.lane, model)
        self.endless = self.tracker is None or self.tracker.ticks is None
        self._motion = own_reference(contract, states)
        self._begun = False
        own = contract, states, self._before, self.tracker, targets
        self.reads, self.writes = reads_writes(*own)
        self.holds = (f"{prefix}action",)

    def __call__(self, warm_up: bool = False) -> bool:
        """Run one tick, or take its path and discard the result.

        Returns:
            Whether the motion that it follows, if any, has shown its last frame.

        Raises:
            Fault: the observation or the action holds a NaN or infinity; no target is written.
        """
        lane = self.lane
        if not warm_up:
            for part in self._before:
                part()
            if self._motion and not self._begun:
                # The reference of step 0 is an output of the network: run it once to read it.
                lane.step_zero()
                self._reference()
                self._begun = True
            if self.tracker is not None:
                self.tracker()
        lane.assemble()
        if not lane.finite():
            if warm_up:
                return False
            raise Fault(self._blame_observation())
        lane.infer()
        if not lane.action_finite():
            if warm_up:
                return False
            raise Fault(self._blame_action())
        self._command()
        for state, values in self._discarded if warm_up else self._published:
            state[...] = values
        lane.advance(warm_up)
        if self._motion and not warm_up:
            self._reference()
        return self.tracker is not None and self.tracker.done

    def like(self, contract: PolicyContract) -> Policy:
        """Return one with another contract, made with the same states and network."""
        places, options = self.made
        made: Any = type(self)  # in a child, or here
        other: Policy = made(contract, *places, network=self.network, **options)
        return other

    def executed(self, target: Float32) -> None:
        """Take targets in [rad], shape (n,), that another one gave, for its own last action."""
        action = self._actions[0]
        action[...] = self.action_map.inverse(target).reshape(action.shape)

    def warm_up(self) -> None:
        """Take the path of a tick and discard the result: caches get warm, nothing changes.

        By the very same call: each bit of code that only the tick runs costs it 2 µs.
        """
        self(True)

    def reset(self) -> None:
        """Forget history, memory and last action, as at the start of training episodes."""
        self.lane.reset()
        for action in self._actions:
            action[...] = 0.0
        self._begun = False
        for part in (self.slew, self.phase, self.tracker):
            if part is not None:
                part.reset()

    def _reference(self) -> None:
        for part, source in self._motion:
            part[...] = source

    def _blame_observation(self) -> str:
        lane = self.lane
        for name, image in self.contract.images.items():
            if np.isnan(self._states[name]).any():
                return (
                    f"policy {self.name}: {name} shows no frame of the last {image.max_age:g} s; "
                    f"see to {image.handle!r}, or leave the policy while {name}_age is more"
                )
        bad = np.argwhere(~np.isfinite(lane.obs))
        if lane.observation is not None and bad.size:
            row, column = bad[0].tolist()
            place = lane.observation.place_of(column)
            return (
                f"policy {self.name}: the observation is not finite: {place} is "
                f"{lane.obs[row, column]}{self._of_robot(row)}; the network was not run"
            )
        return f"policy {self.name}: an input of the network is not finite; it was not run"

    def _blame_action(self) -> str:
        joints = self.contract.action.joints
        output = self.lane.output.reshape(-1, len(joints))
        row, column = np.argwhere(~np.isfinite(output))[0].tolist()
        of = self._of_robot(row) if self.contract.chunk is None else f" in row {row}"
        return (
            f"policy {self.name}: the action is not finite: joint {joints[column]!r} is "
            f"{output[row, column]}{of}; no target was written"
        )

    def _of_robot(self, row: int) -> str:
        return f" of robot {row}" if self._states.num_robots else ""


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
