"""Both ends of a network: terms of its observation and joints of its action, aligned by name.

Terms are resolved against states, for the observation, tables and checks. `ActionMap` makes targets
of all joints from the action.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from unicon_base import PolicyError, RobotError, alternatives
from unicon_base.arrays import Float32, Index
from unicon_core.policies.contract import ObservationSpec, ObservationTerm, PolicyContract
from unicon_core.policies.controller import ControllerContract, PackedStates
from unicon_core.policies.phase import Filter, make_filter
from unicon_core.robots import Robot, joint_index


@dataclass(frozen=True)
class TermSlice:
    """A term as it stands in one frame: its elements and the names and unit of its state.

    Attributes:
        term: of the contract.
        elements: elements of the state in its own order, shape (d,).
        start: first place in the frame.
        names: names of the elements, such as joints; may be empty.
        unit: unit of the state.
        subtract: shape (d,), unit of the state.
        scale: shape (d,).
        low, high: bounds before scaling, shape (d,); infinite where there is no clip.
    """

    term: ObservationTerm
    elements: Index
    start: int
    names: tuple[str, ...]
    unit: str
    subtract: Float32
    scale: Float32
    low: Float32
    high: Float32

    @property
    def stop(self) -> int:
        """One past the last place in the frame."""
        return self.start + self.elements.size


def term_slices(
    contract: PolicyContract,
    states: PackedStates,
    robot_joints: Sequence[str],
    spec: ObservationSpec | None = None,
) -> tuple[TermSlice, ...]:
    """Resolve the terms of an observation against states: which elements, and every number.

    Args:
        contract: the policy.
        states: the states; a state whose element names are the robot's joints is taken in policy
            order, and so is another policy's action, of the joints that this policy moves.
        robot_joints: the robot's joint order.
        spec: another observation than the contract's own.

    Raises:
        PolicyError: no such state, a joint the robot has not, or an index or number of values that
            does not fit.
    """
    slices: list[TermSlice] = []
    start = 0
    for term in (contract.observation if spec is None else spec).terms:
        label = f"policy {contract.name}: term {term.name!r}"
        if term.state not in states:
            known = alternatives(term.state, list(states))
            raise PolicyError(f"{label}: no state {term.state!r}; {known}")
        state, dtype = states.spec(term.state), states[term.state].dtype
        if dtype != np.float32:
            text = f"state {term.state!r} is {dtype}; a network takes float32 states"
            raise PolicyError(f"{label}: {text}")
        names, elements = tuple(state.names), np.arange(state.size, dtype=np.intp)
        whole = {*names} == {*robot_joints}
        own = contract.joints if whole else contract.action.joints
        if term.state != "action" and (whole or {*names} == {*own}):
            try:
                elements = joint_index(own, names)
            except RobotError as error:
                raise PolicyError(f"{label}: the robot has {error}") from error
            names = own
        subtract = 0.0 if term.subtract is None else term.subtract
        default = contract.default_joint_pos if names == contract.joints else None
        if term.index is not None:
            if max(term.index) >= elements.size:
                # Sources do not agree upon what stands where in a gait clock.
                order = f" ({', '.join(names)})" if term.state.startswith("gait_phase") else ""
                raise PolicyError(
                    f"{label}: index {max(term.index)} of state {term.state!r}, which has "
                    f"{elements.size} elements{order}; the last is {elements.size - 1}"
                )
            index = list(term.index)
            elements = elements[index]
            names = tuple(names[i] for i in index) if names else ()
            default = None if default is None else default[index]
        if isinstance(subtract, str):
            if default is None:
                raise PolicyError(
                    f"{label}: subtract {subtract} needs a joint state, and {term.state!r} has no "
                    "joint names; give numbers, or take joint_pos"
                )
            subtract = default
        low, high = (-np.inf, np.inf) if term.clip is None else term.clip
        spread = []
        for what, values in (
            ("subtract", subtract), ("scale", term.scale), ("clip", low), ("clip", high),
        ):  # fmt: skip
            array, size = np.atleast_1d(np.asarray(values, np.float32)), elements.size
            if array.size not in (1, size):
                raise PolicyError(
                    f"{label}: {what} has {array.size} values for {size} elements; give 1 or {size}"
                )
            spread.append(np.array(np.broadcast_to(array, (size,))))
        slices.append(TermSlice(term, elements, start, names, str(state.unit), *spread))
        start += elements.size
    return tuple(slices)


# Values of what most policies see, the last one of one phase; then what many do without, which is
# named where nothing else would fit.
_USUAL = (
    {"projected_gravity": 3, "base_ang_vel": 3, "velocity_command": 3, "gait_phase": 2},
    {"base_lin_vel": 3},
)


def explain_size(
    slices: Sequence[TermSlice], takes: int, joints: Collection[str], counts: Collection[int]
) -> str:
    """Return what would make the observation fit; "" where nothing or more than one thing would.

    Args:
        slices: the terms.
        takes: size of the network's input.
        joints: names of the robot's joints.
        counts: plausible numbers of joints: the robot's, the policy's, the network's.
    """
    missing = takes - sum(part.elements.size * part.term.history for part in slices)
    moved = [part for part in slices if not {*joints}.isdisjoint(part.names)]
    found = set()
    for count in counts:
        for size in {part.elements.size for part in moved} - {count}:
            alike = [part for part in moved if part.elements.size == size]
            histories = [part.term.history for part in alike]
            # Which of some terms cannot be told, and how many only where all have one history.
            many = len(alike) * missing / ((count - size) * sum(histories))
            if many == len(alike) or (many in range(1, len(alike)) and len({*histories}) == 1):
                some = "" if many == len(alike) else f"{many:g} of "
                has = f"{size} of {count}" if count > size else f"{size}"
                has += " joints" if count > size else f" joints, not {count},"
                names = ", ".join(part.term.name for part in alike)
                found.add(f"it has {has} in {some}{names}")
    frame, history = sum(part.elements.size for part in slices), 1
    if len(ages := {part.term.history for part in slices}) == 1:
        (history,) = ages
        if takes % frame == 0:
            found.add(f"it would fit with a history of {takes // frame}, and has {history}")
    seen = " ".join(part.term.state for part in slices).replace("slewed", "velocity")
    for usual in _USUAL:
        for name, size in usual.items() if usual is _USUAL[0] or not found else ():
            if name not in seen and missing == size * history:
                found.add(f"it would fit with a term of {name} ({size} values)")
    return found.pop() if len(found) == 1 else ""


def lacking_joints(contract: ControllerContract, robot: Robot) -> str:
    """Return a message that names the joints of a policy that a robot has not, "" if it has all.

    Args:
        contract: of the policy, or of another controller.
        robot: the robot that is to move.
    """
    lacking = [name for name in contract.joints if name not in robot.joint_names]
    if not lacking:
        return ""
    if len(lacking) == 1:
        name = lacking[0]
        return f"robot {robot.name} has no joint {name!r}; {alternatives(name, robot.joint_names)}"
    lacks = (
        f"robot {robot.name} lacks {len(lacking)} of the {len(contract.joints)} joints needed: "
        f"{', '.join(lacking)}; "
    )
    with suppress(RobotError):
        meant = joint_index(lacking, robot.joint_names, loose=True)
        names = ", ".join(robot.joint_names[i] for i in meant)
        how = "import it (unicon policies import) and name them in its joints"
        return f"{lacks}did you mean {names}? {how}"
    return f"{lacks}choose a robot that has them, or a policy made for {robot.name}"


class ActionMap:
    """`target = offset + scale · filter(clip(action))`; other joints are held at default.

    Args:
        contract: the policy.
        robot: the robot that is to move.
        rows: number of robots.

    Attributes:
        stiffness: gain of every joint in the robot's order in [N·m/rad], shape (n,).
        damping: likewise in [N·m·s/rad].
        positions_only: all that it gives are positions.
        filter: of the clipped action, shape (rows, m), or None.

    Raises:
        PolicyError: a joint the robot has not, or a held joint whose pose or gains are unknown.
    """

    def __init__(self, contract: PolicyContract, robot: Robot, rows: int = 1) -> None:
        action = contract.action
        lacking = lacking_joints(contract, robot)
        if lacking:
            raise PolicyError(f"policy {contract.name}: {lacking}")
        robot_from_policy = joint_index(contract.joints, robot.joint_names)
        robot_from_action = joint_index(action.joints, robot.joint_names)
        n, m = robot.num_joints, len(action.joints)
        held = []
        for fact, own, said in (
            ("default", robot.default_joint_pos, contract.default_joint_pos),
            ("stiffness", robot.joint_stiffness, contract.stiffness),
            ("damping", robot.joint_damping, contract.damping),
        ):
            array = own.astype(np.float32)
            array[robot_from_policy] = said
            if (unknown := np.isnan(array)).any():
                joint = robot.joint_names[int(unknown.argmax())]
                raise PolicyError(
                    f"policy {contract.name} does not move joint {joint!r}, and robot {robot.name} "
                    f"has no {fact} to hold it with; add 'joints.{fact}' to "
                    f"{robot.file_of(joint).name}"
                )
            held.append(array)
        offset, self.stiffness, self.damping = held
        by_position = action.of_kind("position")
        self.positions_only = bool(by_position.all())
        offset[robot_from_action[by_position]] = action.offset[by_position]
        # One gather covers all joints: held ones take action 0 with scale 0.
        index = np.zeros(n, np.intp)
        index[robot_from_action] = np.arange(m)
        scale = np.zeros(n, np.float32)
        scale[robot_from_action[by_position]] = action.scale[by_position]
        self._of_action = robot_from_action
        self._index = (index[None, :] + np.arange(rows)[:, None] * m).reshape(-1)
        self._scale, self._offset = np.tile(scale, rows), np.tile(offset, rows)
        self._feed_clipped = action.feedback == "clipped"
        self.filter: Filter | None = None
        if action.filter is not None:
            self.filter = make_filter(action.filter, (rows, m), contract.period)
        self._spec, self._rows = action, rows
        closed = dict(zip(robot.joint_names, robot.by_position))
        for name, kind in zip(action.joints, action.kinds):
            if kind != "position" and closed[name]:
                raise PolicyError(
                    f"policy {contract.name} gives joint {name!r} a {kind}, and robot {robot.name} "
                    "takes positions alone; choose a policy that gives positions"
                )
        # Of velocities and torques as of positions: figures of all joints, 0 where they are none.
        self._rates = []
        for kind in ("velocity", "torque"):
            at, figures = action.of_kind(kind), np.zeros((2, n), np.float32)
            figures[:, robot_from_action[at]] = action.scale[at], action.offset[at]
            self._rates.append(np.tile(figures, rows))
        limp = np.zeros(n, np.bool_)
        limp[robot_from_action[~by_position]] = True
        self._limp = limp & (self.stiffness == 0.0)
        self._clip: Float32 | None = None
        if action.clip is not None:
            sides = action.clip if self._feed_clipped else action.clip[:, index]
            self._clip = np.tile(sides, rows)

    def inverse(self, target: Float32) -> Float32:
        """Return the action that gives these targets of positions, as clipped and filtered.

        Args:
            target: joint position targets of one robot in its order in [rad], shape (n,).

        Returns:
            Action of shape (m,); 0 where the scale is.
        """
        offset, scale = self._spec.offset, self._spec.scale
        action = np.zeros_like(scale)
        np.divide(target[self._of_action] - offset, scale, out=action, where=scale != 0.0)
        return action

    def bind_all(
        self,
        action: Float32,
        position: Float32,
        velocity: Float32,
        torque: Float32,
        measured: Float32,
    ) -> Callable[[], None]:
        """Return a function that writes the targets of a tick of any kind.

        A joint without stiffness that is given a velocity or torque has its measured position as
        target: whatever gives it stiffness later, such as a blend, holds it where it is.

        Args:
            action: the network's output, shape (rows, m), to be finite when called; replaced by
                what was clipped or filtered of it where that is fed back.
            position: targets in the robot's order in [rad], shape (rows, n).
            velocity: likewise in [rad/s].
            torque: likewise in [N·m].
            measured: joint positions in [rad], shape (rows, n).
        """
        spec, index, smooth = self._spec, self._index, self.filter
        work, limp = np.zeros_like(action), np.tile(self._limp, (self._rows, 1))
        source = work.reshape(-1)
        rates = [
            (out.reshape(-1), *figures) for out, figures in zip((velocity, torque), self._rates)
        ]
        places = position.reshape(-1), self._scale, self._offset
        outs = [places] if self.positions_only else [places, *rates]

        def all_kinds() -> None:
            work[...] = action
            if spec.clip is not None:
                np.maximum(work, spec.clip[0], out=work)
                np.minimum(work, spec.clip[1], out=work)
            if spec.feedback == "clipped":
                action[...] = work
            if smooth is not None:
                smooth(work)
            if spec.feedback == "filtered":
                action[...] = work
            for out, scale, offset in outs:
                source.take(index, None, out, "clip")
                np.multiply(out, scale, out=out)
                np.add(out, offset, out=out)
            np.copyto(position, measured, where=limp)

        return all_kinds

    def bind(self, action: Float32, target: Float32) -> Callable[[], None]:
        """Return a function that writes the targets of a tick.

        Args:
            action: the network's output, shape (rows, m), to be finite when called; clipped in
                place where the policy was trained with the clipped action fed back.
            target: joint position targets in the robot's order in [rad], shape (rows, n).
        """
        source, out = action.reshape(-1), target.reshape(-1)
        take, index = source.take, self._index
        scale, offset, clip = self._scale, self._offset, self._clip
        multiply, add = np.multiply, np.add
        maximum, minimum = np.maximum, np.minimum

        def plain() -> None:
            take(index, None, out, "clip")
            multiply(out, scale, out)
            add(out, offset, out)

        if clip is None:
            return plain
        low, high = clip
        fed = source if self._feed_clipped else out

        def clipped() -> None:
            if fed is out:
                take(index, None, out, "clip")
            maximum(fed, low, out=fed)
            minimum(fed, high, out=fed)
            if fed is source:
                take(index, None, out, "clip")
            multiply(out, scale, out)
            add(out, offset, out)

        return clipped
