"""Gantry: springs and dampers that hold the base of a robot in a MuJoCo model, upright."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

GANTRY = "gantry"
"""Word of `Facts.physics`: a base that is held."""

FREQUENCY = 2.0
"""Of the critically damped springs in [Hz]: slow against a physics step, quick against a leg."""
RADIUS = 0.3
"""Of gyration that the turning dampers are made for, in [m]."""


def hold(model: Any, base: int, qpos: NDArray[np.float64]) -> None:
    """Let the model's own springs hold a base where it begins.

        f = k (p* - p) - 2 m w v,   t = k (q* - q) - 2 sqrt(k m) r omega,   k = m w²

    with the mass m [kg] of all that hangs, and p* higher by g / w², so that the springs bear it.
    MuJoCo's free joint has one stiffness, in [N/m] and in [N·m/rad]. A light base on limp legs
    needs dampers that are integrated implicitly, so Euler does that from here on, even where the
    model forbids it (`eulerdamp`).

    Args:
        model: the `MjModel`, which is changed.
        base: number of its free joint.
        qpos: where the robot begins, shape (nq,).
    """
    from mujoco import mjtDisableBit

    model.opt.disableflags &= ~int(mjtDisableBit.mjDSBL_EULERDAMP)
    w, mass = 2.0 * math.pi * FREQUENCY, float(model.body_subtreemass[model.jnt_bodyid[base]])
    pose, twist = int(model.jnt_qposadr[base]), int(model.jnt_dofadr[base])
    model.jnt_stiffness[base] = mass * w * w
    model.qpos_spring[pose : pose + 7] = qpos[pose : pose + 7]
    model.qpos_spring[pose : pose + 3] -= model.opt.gravity / (w * w)
    model.dof_damping[twist : twist + 3] = 2.0 * mass * w
    model.dof_damping[twist + 3 : twist + 6] = 2.0 * mass * w * RADIUS


def let_go(model: Any, base: int) -> None:
    """Hold it no longer."""
    twist = int(model.jnt_dofadr[base])
    model.jnt_stiffness[base] = 0.0
    model.dof_damping[twist : twist + 6] = 0.0
