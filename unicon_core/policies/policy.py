"""The policy block: states in, joint targets out, once a tick, for workflows.

Observation → network → check → targets; a NaN or infinity is a Fault before any target is written.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import Fault, PolicyError
from unicon_base.arrays import Float32
from unicon_core.policies.action_map import ActionMap
from unicon_core.policies.bind import Binding
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.controller import PackedStates
from unicon_core.policies.derived import RPY, RollPitchYaw, derived_states
from unicon_core.policies.height_scan import HeightScan
from unicon_core.policies.motion.follow import own_reference, tracker_of
from unicon_core.policies.networks import Network, open_network
from unicon_core.policies.phase import GaitPhase
from unicon_core.policies.policy_states import fed_back, own_states, reads_writes
from unicon_core.robots import Robot
from unicon_core.terrain.heights import Heights

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
        smooth = self.action_map.filter
        if self.action_map.positions_only and smooth is None:
            self._command = self.action_map.bind(self.lane.action, computed)
        else:
            measured = states["joint_pos"].reshape(rows, n)
            self._command = self.action_map.bind_all(
                self.lane.action, computed, velocity, torque, measured
            )
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
        scratch = [np.zeros_like(view) for view, _ in self._published]
        self._discarded = tuple(
            (thrown, side)
            for (view, values), thrown in zip(self._published, scratch)
            for side in (view, values)
        )
        self._actions = fed_back(contract, states)
        self.phase: GaitPhase | None = None
        if contract.phase is not None and "gait_phase" in states:
            self.phase = GaitPhase(contract.phase, states, contract.period)
        angles = RollPitchYaw(states) if RPY in derived_states(contract) else None
        self.scan = None
        if contract.height_scan is not None and ground is not None:
            self.scan = HeightScan(contract.height_scan, states, ground)
        before = (angles, self.slew, self.phase, self.scan)
        self._before = tuple(part for part in before if part is not None)
        self.tracker = tracker_of(contract, states, robot, self.lane, model)
        self.endless = self.tracker is None or self.tracker.ticks is None
        self._motion = own_reference(contract, states)
        self._begun = False
        self.reads, self.writes = reads_writes(
            contract, states, self._before, self.tracker, targets
        )
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
        if self.slew is not None:
            self.slew.reset()
        if self.phase is not None:
            self.phase.reset()
        if self.tracker is not None:
            self.tracker.reset()

    def _reference(self) -> None:
        for part, source in self._motion:
            part[...] = source

    def _blame_observation(self) -> str:
        lane = self.lane
        bad = np.argwhere(~np.isfinite(lane.obs))
        if lane.observation is not None and bad.size:
            row, column = (int(i) for i in bad[0])
            place = lane.observation.place_of(column)
            return (
                f"policy {self.name}: the observation is not finite: {place} is "
                f"{lane.obs[row, column]}{self._of_robot(row)}; the network was not run"
            )
        return f"policy {self.name}: an input of the network is not finite; it was not run"

    def _blame_action(self) -> str:
        joints = self.contract.action.joints
        output = self.lane.output.reshape(-1, len(joints))
        row, column = (int(i) for i in np.argwhere(~np.isfinite(output))[0])
        of = self._of_robot(row) if self.contract.chunk is None else f" in row {row}"
        return (
            f"policy {self.name}: the action is not finite: joint {joints[column]!r} is "
            f"{output[row, column]}{of}; no target was written"
        )

    def _of_robot(self, row: int) -> str:
        return f" of robot {row}" if self._states.num_robots else ""
