"""Joint servos: PD torques computed by MuJoCo itself, in every physics step, for the platform.

A motor of the robot computes, at each of its own steps,

    tau = kp (q* - q) + kd (qd* - qd) + tau_ff,   clipped to the effort limits.

That is MuJoCo's affine actuator `gain·ctrl + b0 + b1·length + b2·velocity` with ctrl = q*,
gain = kp, b0 = kd·qd* + tau_ff, b1 = -kp, b2 = -kd and a force range; so every actuator of a robot
joint, `<motor>` or `<position>`, is turned into one in memory and a whole tick needs no Python
between its physics steps. `test/platforms/test_servo.py` holds it against the equation in NumPy.

With the integrators `implicit` and `implicitfast` MuJoCo also takes b2 into its velocity update, as
it does for every position actuator: the torque at a state is the same, the step is more stable.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.models.actuators import actuator_kind, effort_range
from unicon_core.models.joints import drives
from unicon_core.models.rows import index_of

Float = NDArray[np.float64]


class Servo:
    """The actuators of a robot's joints in one model.

    Args:
        mujoco: the module.
        model: the `MjModel`, changed in place.
        joints: joint id of each robot joint.
        effort_limit: largest torque of each joint in [N·m], NaN for none, shape (n,).
        strength: what the motors give of the torque above, and of its limits, shape (n,); None for
            all of it.

    Attributes:
        kinds: what each actuator was in the model: `motor`, `position`, `velocity` or `general`.
        effort_lower, effort_upper: torque limits in use in [N·m], shape (n,), infinite for none.
    """

    def __init__(
        self,
        mujoco: Any,
        model: Any,
        joints: Sequence[int],
        effort_limit: NDArray[np.float32],
        strength: Float | None = None,
    ) -> None:
        driven = drives(mujoco, model)
        self.actuators = [driven[joint][0] for joint in joints]
        self.silenced = [i for joint in joints for i in driven[joint][1:]]
        count = len(joints)
        self.kinds: list[str] = []
        self.effort_lower = np.full(count, -np.inf)
        self.effort_upper = np.full(count, np.inf)
        self.gear = np.array([float(model.actuator_gear[i, 0]) for i in self.actuators])
        for k, (joint, i) in enumerate(zip(joints, self.actuators)):
            self.kinds.append(actuator_kind(mujoco, model, i))
            found = effort_range(mujoco, model, joint, i, float(effort_limit[k]))
            self.effort_lower[k], self.effort_upper[k] = found
            model.actuator_gaintype[i] = int(mujoco.mjtGain.mjGAIN_FIXED)
            model.actuator_biastype[i] = int(mujoco.mjtBias.mjBIAS_AFFINE)
            if self.kinds[k] != "position":  # its range was one of torques or speeds
                model.actuator_ctrllimited[i] = 0
            limits = np.array([self.effort_lower[k], self.effort_upper[k]]) / self.gear[k]
            model.actuator_forcelimited[i] = int(np.isfinite(limits).all())
            model.actuator_forcerange[i] = np.sort(limits)
        # Silenced is a second actuator on a joint (position and velocity pairs).
        for i in (*self.actuators, *self.silenced):
            model.actuator_gainprm[i, :] = 0.0
            model.actuator_biasprm[i, :] = 0.0
        if strength is not None:
            self.effort_lower *= strength
            self.effort_upper *= strength
            model.actuator_forcerange[self.actuators] *= strength[:, None]
        self._strength, self._weakened = strength, np.zeros((5, count))
        weak = np.ones(count) if strength is None else strength
        self._factor = np.stack([np.ones(count)] * 2 + [weak] * 3)
        self.index = index_of(self.actuators)
        self._gain = model.actuator_gainprm[:, 0]
        self._bias = model.actuator_biasprm
        self._unit_gear = bool((self.gear == 1.0).all())
        self._target = np.zeros(count)
        self._b0 = np.zeros(count)
        self._written = b""

    def push(self, ctrl: Float, command: Float) -> None:
        """Put one robot's command into the model and its controls.

        Args:
            ctrl: `MjData.ctrl` of the robot.
            command: rows q*, qd*, tau_ff, kp, kd in [rad], [rad/s], [N·m], [N·m/rad],
                [N·m·s/rad], shape (5, n).
        """
        if self._strength is not None:
            command = np.multiply(command, self._factor, out=self._weakened)
        index, b0 = self.index, self._b0
        np.multiply(command[4], command[1], out=b0)
        b0 += command[2]
        if self._unit_gear:
            ctrl[index] = command[0]
        else:
            np.multiply(command[0], self.gear, out=self._target)
            ctrl[index] = self._target
            b0 /= self.gear
        self._bias[index, 0] = b0
        gains = command[3:].tobytes()
        if gains != self._written:
            # Torque = gear · force and length = gear · q, hence the square.
            stiffness, damping = command[3:] / self.gear**2
            self._gain[index] = stiffness
            self._bias[index, 1] = -stiffness
            self._bias[index, 2] = -damping
            self._written = gains
