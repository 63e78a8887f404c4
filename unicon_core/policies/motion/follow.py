"""What follows the motion of a contract, put together once when its policy is built."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import PolicyError
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.lane import Lane
from unicon_core.policies.motion.anchor import Chain, chain_in_model, chain_of_axes
from unicon_core.policies.motion.clip import read_clip
from unicon_core.policies.motion.tracker import MotionTracker
from unicon_core.policies.prefixed import PackedStates
from unicon_core.robots import Robot

FAR = 1 << 20
"""A step that no motion has, 5 hours at 50 Hz: networks hold their last frame from its end on."""

_ANCHORED = (
    "motion_anchor_quat",
    "motion_anchor_ori_b",
    "motion_anchor_pos",
    "motion_anchor_pos_b",
)


def tracker_of(
    contract: PolicyContract,
    states: PackedStates,
    robot: Robot,
    lane: Lane,
    model: Path | None,
) -> MotionTracker | None:
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
    joints = tuple(robot.joint_names)
    wanted = {term.state for term in contract.terms} | set(contract.inputs)
    if spec.file is not None:
        chain = _chain(contract, robot, model)
        clip = read_clip(spec, contract, joints, chain)
        return MotionTracker(contract, states, joints, clip, chain, len(clip.joint_pos))
    for name in ("motion_joint_pos", "motion_joint_vel"):
        if name not in contract.outputs:
            raise PolicyError(
                f"policy {contract.name}: nothing tells {name}; give motion.file, or name the "
                "network's output for it under 'outputs'"
            )
    found = _chain(contract, robot, model) if wanted.intersection(_ANCHORED) else None
    lane.first_step = float(round(spec.start / contract.period))
    lane.held = float(round(spec.hold / contract.period))
    lane.reset()
    length = None
    if spec.end is not None:
        length = round((spec.end - spec.start) / contract.period) + 1
    elif "time_step" in contract.inputs:
        length = _length(lane, states, contract)
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


def _length(lane: Lane, states: PackedStates, contract: PolicyContract) -> int | None:
    """Return how many frames a network's own motion has from its start on; None for no end.

    From its end on a network holds the last frame (HybridRobotics/whole_body_tracking
    `utils/exporter.py` clamps the step), so that the first one like it is the last.
    """
    names = ("motion_joint_pos", "motion_joint_vel")
    shown: list[NDArray[np.float32]] = [
        values
        for view, values in lane.published
        if any(np.shares_memory(view, states[name]) for name in names)
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
    position, velocity = states["motion_joint_pos"], states["motion_joint_vel"]
    n = position.shape[-1]
    return ((command[..., :n], position), (command[..., n:], velocity))
