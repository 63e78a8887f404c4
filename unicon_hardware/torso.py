"""Torso: an IMU above a waist joint, told as if it sat in the pelvis; for H1, H1-2 and Atom.

With the waist angle θ (and its rate θ'), torso to pelvis is a turn about z:
R_pelvis = R_torso Rz(θ)ᵀ and ω_pelvis = Rz(θ) ω_torso - (0, 0, θ') (unitreerobotics/unitree_rl_gym
deploy/deploy_real/common/rotation_helper.py: transform_imu_data). The accelerometer keeps its
place, only its axes are turned.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from unicon_base.arrays import Array
from unicon_core.platforms.kit.base import IMU_STATES

__all__ = ["IMU_STATES", "turned"]


def turned(
    source: Mapping[str, Array],
    into: Mapping[str, Array],
    angle: float,
    rate: float,
) -> None:
    """Write an IMU's readings as one below a joint about z would have them.

    The other way, from pelvis to torso, angle and rate are the negative ones.

    Args:
        source: quaternion wxyz, angular velocity in [rad/s], specific force in [m/s²], by state.
        into: takes the same.
        angle: of the upper to the lower body in [rad].
        rate: its change in [rad/s].
    """
    c, s = math.cos(angle), math.sin(angle)
    half_c, half_s = math.cos(angle / 2), math.sin(angle / 2)
    w, x, y, z = source["base_quat"].tolist()
    # q ⊗ conj(cos(θ/2), 0, 0, sin(θ/2))
    into["base_quat"][...] = (
        w * half_c + z * half_s,
        x * half_c - y * half_s,
        y * half_c + x * half_s,
        z * half_c - w * half_s,
    )
    for state, less in (("base_ang_vel", rate), ("base_lin_acc", 0.0)):
        x, y, z = source[state].tolist()
        into[state][...] = (c * x - s * y, s * x + c * y, z - less)
