"""Reward terms of the Go2 velocity task: name -> (weight, value per environment).

Values are unscaled and of shape (num_envs,); the environment multiplies by weight and period.
"""

from __future__ import annotations

from dataclasses import dataclass

import contract
import numpy as np

BASE_HEIGHT = 0.29  # [m]: the standing pose under load
FOOT_CLEARANCE = 0.075  # [m] of the foot's centre above the floor in mid swing
SOFT_IMPACT = 90.0  # [N] of a touchdown that costs nothing: a diagonal pair carries 75 N each
_HIPS = np.arange(0, 12, 3)
_LOWER = np.tile([-0.9, -0.4, -2.6], 4).astype(np.float32)  # soft joint limits in [rad]
_UPPER = np.tile([0.9, 2.6, -0.95], 4).astype(np.float32)


@dataclass
class Tick:
    """What one policy step of all environments looked like; shapes start with num_envs."""

    command: np.ndarray  # (3,)
    lin_vel: np.ndarray  # base, heading frame, (3,)
    ang_vel: np.ndarray  # base frame, (3,)
    bias: np.ndarray  # error of vx, vy, wz, averaged over a stride or so, (3,)
    gravity: np.ndarray  # base frame, (3,)
    height: np.ndarray  # ()
    joint_pos: np.ndarray  # (12,)
    joint_vel: np.ndarray  # (12,)
    last_joint_vel: np.ndarray  # (12,)
    torque: np.ndarray  # (decimation, 12)
    actions: tuple[np.ndarray, np.ndarray, np.ndarray]  # this, last, the one before, (12,)
    contact: np.ndarray  # (4,) bool
    touchdown: np.ndarray  # (4,) bool
    force: np.ndarray  # largest normal force of each foot in the step in [N], (4,)
    air_time: np.ndarray  # of the swing that just ended, (4,)
    foot_pos: np.ndarray  # (4, 3)
    foot_vel: np.ndarray  # (4, 3)


def reward_terms(t: Tick) -> dict[str, tuple[float, np.ndarray]]:
    """All terms; those with negative weight are costs and are faded in by the curriculum."""
    moving = (np.abs(t.command).max(axis=1) > 0.05).astype(np.float32)
    still = 1.0 - moving
    lin_error = np.square(t.command[:, :2] - t.lin_vel[:, :2]).sum(axis=1)
    ang_error = np.square(t.command[:, 2] - t.ang_vel[:, 2])
    offset = t.joint_pos - contract.DEFAULT_JOINT_POS
    action, last, before = t.actions
    speed = np.linalg.norm(t.foot_vel[:, :, :2], axis=2)
    clearance = np.square(t.foot_pos[:, :, 2] - FOOT_CLEARANCE) * speed
    diagonal = (t.contact[:, 0] == t.contact[:, 3]) & (t.contact[:, 1] == t.contact[:, 2])
    trot = diagonal & (t.contact[:, 0] != t.contact[:, 1])
    airborne = np.minimum(t.air_time, 0.25).max(axis=1) / 0.25
    peak = np.abs(t.torque).max(axis=1) / contract.EFFORT_LIMIT
    limits = np.maximum(_LOWER - t.joint_pos, 0.0) + np.maximum(t.joint_pos - _UPPER, 0.0)
    impact = t.touchdown * np.square(np.maximum(t.force - SOFT_IMPACT, 0.0) / 100.0)
    swing = t.touchdown * (np.minimum(t.air_time, 0.3) - 0.12)
    return {
        # Costs alone would make it pay to end an episode that goes badly, by standing still.
        "alive": (2.0, np.ones(len(moving))),
        "track_lin": (1.5, np.exp(-lin_error / 0.25)),
        "track_lin_fine": (0.8, np.exp(-lin_error / 0.03)),
        "track_ang": (0.75, np.exp(-ang_error / 0.4)),
        "track_ang_fine": (0.5, np.exp(-ang_error / 0.04)),
        "error_lin_abs": (-1.0, np.sqrt(lin_error)),
        "error_ang_abs": (-1.2, np.sqrt(ang_error)),
        "lin_bias": (-4.0, np.linalg.norm(t.bias[:, :2], axis=1)),
        "yaw_bias": (-2.5, np.abs(t.bias[:, 2])),
        "trot": (1.0, moving * trot * airborne),
        "air_time": (8.0, moving * swing.sum(axis=1)),
        "lin_vel_z": (-2.0, np.square(t.lin_vel[:, 2])),
        "ang_vel_xy": (-0.06, np.square(t.ang_vel[:, :2]).sum(axis=1)),
        "orientation": (-4.0, np.square(t.gravity[:, :2]).sum(axis=1)),
        "height": (-20.0, np.square(t.height - BASE_HEIGHT)),
        "torque": (-2e-4, np.square(t.torque[:, -1]).sum(axis=1)),
        "torque_peak": (-8.0, np.square(np.maximum(peak - 0.4, 0.0)).sum(axis=1)),
        "torque_over": (-80.0, np.square(np.maximum(peak - 0.52, 0.0)).sum(axis=1)),
        "joint_acc": (-6e-5, np.square(t.joint_vel - t.last_joint_vel).sum(axis=1)),
        "action_rate": (-0.012, np.square(action - last).sum(axis=1)),
        "action_jerk": (-0.006, np.square(action - 2 * last + before).sum(axis=1)),
        "joint_limits": (-5.0, limits.sum(axis=1)),
        "hip_pose": (-0.3, np.square(offset[:, _HIPS]).sum(axis=1)),
        "pose": (-0.05, np.square(offset).sum(axis=1)),
        "impact": (-0.4, moving * impact.sum(axis=1)),
        "slip": (-0.1, (np.square(speed) * t.contact).sum(axis=1)),
        "clearance": (-20.0, moving * clearance.sum(axis=1)),
        "idle": (-1.0, moving * t.contact.all(axis=1)),
        "still_pose": (-1.0, still * np.square(offset).sum(axis=1)),
        "still_vel": (-0.02, still * np.square(t.joint_vel).sum(axis=1)),
        "still_feet": (-0.25, still * (~t.contact).sum(axis=1)),
    }
