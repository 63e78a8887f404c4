"""The motion that a policy follows, tick by tick: its reference, and the robot compared with it.

In tick k, counted from the end of `hold`, the observation holds the reference of frame k, as in
training: BeyondMimic's and mjlab's command managers advance before they observe. Where the network
itself gives the reference, that is what its run of the tick before told
(HybridRobotics/motion_tracking_controller `src/MotionPolicy.cpp`), and step 0 is run once to begin.

The anchor is compared as in HybridRobotics/whole_body_tracking `mdp/observations.py`: the
reference's pose in the frame of the robot's anchor, its rotation as the first two columns of the
matrix, row by row. At the start the motion is turned about the vertical so that both face the same
way (unitreerobotics/unitree_rl_mjlab `State_Mimic.cpp`, amazon-far/holosoma `policies/wbt.py`), and
shifted so that it begins where the robot stands.

`tracker_of` puts it together once, when the policy is built.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import PolicyError
from unicon_base.arrays import Float32
from unicon_core.models.frames import Floats, conjugate, multiply, plus, rotate, turned, yaw_of
from unicon_core.policies.bind import PolicyStep
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.controller import PackedStates
from unicon_core.policies.motion.clip import Chain, Clip, chain_in_model, chain_of_axes, read_clip
from unicon_core.robots import Robot, joint_index

_REFERENCE = ("motion_joint_pos", "motion_joint_vel")
_TURNS = ("motion_anchor_quat", "motion_anchor_ori_b")
_PLACES = ("motion_anchor_pos", "motion_anchor_pos_b")
_ORIGIN: Floats = (0.0, 0.0, 0.0)
_UP: Floats = (0.0, 0.0, 1.0)


class MotionClock:
    """Writes `motion_time` [s] and `motion_phase`, its share of the end, from 0 to 1.

    From fan-ziqi/rl_sar `rl_sdk.cpp` (RoboMimic_Deploy/phase) and LeCAR-Lab/ASAP
    (ref_motion_phase): time since the first frame over the duration.

    Args:
        contract: with a motion.
        states: that hold both.
        end: in [s] since the first frame, or None for a motion without an end.

    Attributes:
        ticks: after which it is done, or None.
        done: the last frame was shown.
        reads: states of the robot that are read.
        writes: states that are written.
    """

    memory: tuple[str, ...] = ("done", "_tick")
    reads: tuple[str, ...] = ()

    def __init__(self, contract: PolicyContract, states: PackedStates, end: float | None) -> None:
        spec = contract.motion
        assert spec is not None
        self._period, self._start, self._end = contract.period, spec.start, end
        self._hold = hold = round(spec.hold / contract.period)
        self.ticks: int | None = None
        self.writes: tuple[str, ...] = ("motion_time",)
        if end is not None:
            # As many whole periods as reach the end; rounding of the period adds none.
            self.ticks = hold + math.ceil((end - spec.start) / contract.period - 1e-6) + 1
            self.writes += ("motion_phase",)
        self._time, self._phase = states["motion_time"], states["motion_phase"]
        self.done, self._tick = False, 0

    def __call__(self) -> None:
        """Write time and phase of this tick."""
        time = self._start + max(self._tick - self._hold, 0) * self._period
        self._time[...] = time
        if self._end is not None:
            self._phase[...] = min(time / self._end, 1.0) if self._end else 1.0
        self._tick += 1
        self.done = self.ticks is not None and self._tick >= self.ticks

    def reset(self) -> None:
        """Begin the motion anew."""
        self._tick, self.done = 0, False


class MotionTracker(MotionClock):
    """Writes the `motion_*` states of a policy, once in each of its ticks.

    Args:
        contract: with a motion.
        states: that hold its states, and the robot's.
        robot_joints: the robot's joint order.
        clip: the motion of a file; None where outputs of the network are the reference.
        chain: from the base to the anchor, or None where no state of the anchor is wanted.
        length: number of frames from the start, or None for a motion without an end.

    Raises:
        PolicyError: what a term reads cannot be told.
    """

    memory = (*MotionClock.memory, "_begun", "_turn", "_shift")

    def __init__(
        self,
        contract: PolicyContract,
        states: PackedStates,
        robot_joints: tuple[str, ...],
        clip: Clip | None,
        chain: Chain | None,
        length: int | None,
    ) -> None:
        spec = contract.motion
        assert spec is not None
        end = None if length is None else spec.start + (length - 1) * contract.period
        super().__init__(contract, states, end)
        self._align, self._clip, self._chain = spec.align == "yaw", clip, chain
        rows = self._rows = states.num_robots or 1

        def view(name: str) -> Float32:
            return states[name].reshape(rows, -1)

        self._joint_pos, self._base_quat = view("joint_pos"), view("base_quat")
        self._base_pos = view("base_pos_w")
        self._own = joint_index(contract.joints, robot_joints)
        self._reference = tuple(map(view, _REFERENCE))
        self._command = view("motion_command")
        self._error = view("motion_error")
        self._off = np.zeros((rows, len(contract.joints)), np.float32)
        self._quats, self._places = _anchor_source(contract, states, clip, rows)
        self.reads = ("joint_pos",)
        self.writes += ("motion_command", "motion_error")
        self.writes += _REFERENCE if clip is not None else ()
        self._anchor, self._position = (tuple(map(view, names)) for names in (_TURNS, _PLACES))
        if chain is not None:
            if self._quats is None:
                raise PolicyError(
                    f"policy {contract.name}: nothing tells the orientation of the reference's "
                    "anchor; name an output motion_ref_quat_xyzw, or motion_body_quat_w with "
                    "motion.bodies, under 'outputs'"
                )
            self.reads += ("base_quat",)
            self.writes += _TURNS
        places = contract.seen.intersection(_PLACES)
        self._placed = bool(places)
        if places and (chain is None or not chain.placed or self._places is None):
            raise PolicyError(
                f"policy {contract.name}: {min(places)} needs positions of the reference's anchor "
                "(a file, or an output motion_ref_pos_xyz or motion_body_pos_w) and a model of the "
                "robot in place of motion.chain"
            )
        if self._placed:
            self.reads += ("base_pos_w",)
            self.writes += _PLACES
        self._turn: list[Floats] = [(1.0, 0.0, 0.0, 0.0)] * rows
        self._shift = [(_ORIGIN, _ORIGIN)] * rows
        self._begun = False

    def __call__(self) -> None:
        """Write the reference of this tick, and how the robot stands to it."""
        tick, clip = max(self._tick - self._hold, 0), self._clip
        pos, vel = self._reference
        if clip is not None:
            frame = min(tick, len(clip.joint_pos) - 1)
            pos[...], vel[...] = clip.joint_pos[frame], clip.joint_vel[frame]
        n = pos.shape[1]
        self._command[:, :n], self._command[:, n:] = pos, vel
        np.take(self._joint_pos, self._own, axis=1, out=self._off)
        self._off -= pos
        self._error[:, 0] = np.sqrt(np.einsum("ij,ij->i", self._off, self._off) / n)
        if self._chain is not None:
            for row in range(self._rows):
                self._compare(row, self._chain, tick)
            self._begun = True
        super().__call__()

    def _compare(self, row: int, chain: Chain, tick: int) -> None:
        assert self._quats is not None
        quat = self._quats(row, tick)
        place = _ORIGIN if self._places is None else self._places(row, tick)
        base = self._base_pos[row].tolist() if self._placed else _ORIGIN
        joints = self._joint_pos[row].tolist()
        own_place, own = chain(base, self._base_quat[row].tolist(), joints)
        if not self._begun and self._align:
            self._turn[row] = turned(_UP, yaw_of(own) - yaw_of(quat))
            self._shift[row] = (*place[:2], 0.0), (*own_place[:2], 0.0)
        turn = self._turn[row]
        quat = multiply(turn, quat)
        w, x, y, z = multiply(conjugate(own), quat)
        anchor, rotation = self._anchor
        anchor[row] = quat
        rotation[row] = (
            1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z),
            2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z),
            2.0 * (x * z - w * y), 2.0 * (y * z + w * x),
        )  # fmt: skip
        self._error[row, 1] = 2.0 * math.atan2(math.hypot(x, y, z), abs(w))
        if self._placed:
            begin, there = self._shift[row]
            goal = plus(rotate(turn, plus(place, begin, -1.0)), there)
            self._position[0][row] = goal
            self._position[1][row] = rotate(conjugate(own), plus(goal, own_place, -1.0))

    def reset(self) -> None:
        """Begin the motion anew, wherever the robot is in the next tick."""
        super().reset()
        self._begun = False


Published = Callable[[int, int], Any]


def _anchor_source(
    contract: PolicyContract, states: PackedStates, clip: Clip | None, rows: int
) -> list[Published | None]:
    """Return what gives the reference's orientation (wxyz) and position by row and tick."""
    spec = contract.motion
    assert spec is not None
    if clip is not None:
        frames = (clip.anchor_quat, clip.anchor_pos)
        return [None if each is None else _of_frames(each.tolist()) for each in frames]
    bodies: tuple[str, ...] = (spec.anchor_body,)
    names, order = ("ref_quat_xyzw", "ref_pos_xyz"), [3, 0, 1, 2]
    if spec.anchor_body in spec.bodies:
        bodies, names, order = spec.bodies, ("body_quat_w", "body_pos_w"), [0, 1, 2, 3]
    found: list[Published | None] = []
    for suffix, places in zip(names, (order, [0, 1, 2])):
        name, count, size = f"motion_{suffix}", len(bodies), len(places)
        if name not in contract.outputs or name not in states:
            found.append(None)
            continue
        if states[name].size != rows * count * size:
            raise PolicyError(
                f"policy {contract.name}: output {contract.outputs[name]!r} has "
                f"{states[name].size // rows} values, not {size} for each of {count} bodies; "
                "correct motion.bodies or 'outputs'"
            )
        view = states[name].reshape(rows, count, size)[:, bodies.index(spec.anchor_body)]
        found.append(_of_rows(view, places))
    return found


def _of_frames(frames: list[Any]) -> Published:
    return lambda row, tick: frames[min(tick, len(frames) - 1)]


def _of_rows(view: Float32, places: list[int]) -> Published:
    return lambda row, tick: view[row, places].tolist()


FAR = 1 << 20
"""A step that no motion has, 5 hours at 50 Hz: networks hold their last frame from its end on."""


def tracker_of(
    contract: PolicyContract,
    states: PackedStates,
    robot: Robot,
    lane: PolicyStep,
    model: Path | None,
) -> MotionClock | None:
    """Return what writes the motion's states, None for a policy that follows none.

    Args:
        contract: of the policy.
        states: with those that `policy_states` declares.
        robot: that is to move.
        lane: of the network, which is run to find the end of a motion of its own.
        model: the robot's, or None.

    Raises:
        PolicyError: the motion does not fit, or the anchor cannot be found.
    """
    spec = contract.motion
    if spec is None:
        return None
    if spec.duration is not None:
        return MotionClock(contract, states, spec.duration)
    joints = tuple(robot.joint_names)
    if spec.file is not None:
        chain = _chain(contract, robot, model)
        clip = read_clip(spec, contract, joints, chain)
        return MotionTracker(contract, states, joints, clip, chain, len(clip.joint_pos))
    for name in _REFERENCE:
        if name not in contract.outputs:
            raise PolicyError(
                f"policy {contract.name}: nothing tells {name}; give motion.file, or name the "
                "network's output for it under 'outputs'"
            )
    found = _chain(contract, robot, model) if contract.seen.intersection(_TURNS + _PLACES) else None
    lane.first_step = float(round(spec.start / contract.period))
    lane.held = float(round(spec.hold / contract.period))
    lane.reset()
    length = None
    if spec.end is not None:
        length = round((spec.end - spec.start) / contract.period) + 1
    elif "time_step" in contract.inputs:
        length = _length(lane, states, contract)
    if length is None and "motion_phase" in contract.seen:
        raise PolicyError(
            f"policy {contract.name}: motion_phase is a share of the motion, whose end nothing "
            "tells; give motion.end in [s]"
        )
    return MotionTracker(contract, states, joints, None, found, length)


def _chain(contract: PolicyContract, robot: Robot, model: Path | None) -> Chain:
    spec, what = contract.motion, f"policy {contract.name}"
    assert spec is not None
    if spec.chain or spec.anchor_body == robot.base_frame:
        return chain_of_axes(spec.chain, robot.joint_names, what)
    if model is None:
        raise PolicyError(
            f"{what}: it compares by {spec.anchor_body}, and no model of robot {robot.name} is at "
            "hand to find it in; say the joints between as motion.chain: {waist_yaw_joint: z, …}, "
            "or name a model: scene: {model: PATH}"
        )
    return chain_in_model(robot, model, spec.anchor_body, what)


def _length(lane: PolicyStep, states: PackedStates, contract: PolicyContract) -> int | None:
    """Return how many frames a network's own motion has from its start on; None for no end.

    From its end on a network holds the last frame (HybridRobotics/whole_body_tracking
    `utils/exporter.py` clamps the step), so that the first one like it is the last.
    """
    shown = [
        values
        for view, values in lane.published
        if any(np.shares_memory(view, states[name]) for name in _REFERENCE)
    ]

    def reference(step: int) -> bytes:
        lane.at_step(float(step))
        return b"".join(values.tobytes() for values in shown)

    try:
        last = reference(FAR)
        if last != reference(FAR - 7) or not np.isfinite(np.concatenate(shown, axis=None)).all():
            return None
        first = int(lane.first_step)
        low, high = first, FAR  # the frame at `high` is the last one's
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if reference(middle) == last else (middle, high)
        end = low if reference(low) == last else high
        return end - first + 1 if end > first else None
    except Exception:  # a runtime that refuses the step: its motion has an end that nobody knows
        return None
    finally:
        lane.reset()


def own_reference(contract: PolicyContract, states: PackedStates) -> tuple[tuple[Any, Any], ...]:
    """Return the parts of `motion_command` and the outputs that they are taken from, if any are.

    The command of such a policy is its own reference: positions, then velocities. From
    HybridRobotics/motion_tracking_controller, `src/MotionCommand.cpp` (getValue) and
    `src/MotionPolicy.cpp` (reset runs step 0 on a zero observation; the step then counts on).
    """
    from_file = contract.motion is not None and contract.motion.file is not None
    if from_file or "motion_command" not in states:
        return ()
    command = states["motion_command"]
    position, velocity = (states[name] for name in _REFERENCE)
    n = position.shape[-1]
    return ((command[..., :n], position), (command[..., n:], velocity))
