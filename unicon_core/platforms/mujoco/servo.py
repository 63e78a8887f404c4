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

import numpy as np

from unicon_base.arrays import Array, Float64
from unicon_core.models.load import actuator_kind, effort_ranges
from unicon_core.models.loaded import LoadedModel, drives, import_mujoco, index_of
from unicon_core.robots import Robot

Told = tuple[Array, Array, Array]
"""Controls, gains and biases of one robot's actuators: shapes (n,), (n,) and (n, 3)."""


class Servo:
    """The actuators of a robot's joints in one model.

    Args:
        loaded: the model, changed in place.
        robot: says the largest torques.
        strength: what the motors give of the torque above, and of its limits, shape (n,); None for
            all of it.

    Attributes:
        kinds: what each actuator was in the model: `motor`, `position`, `velocity` or `general`.
        effort_lower, effort_upper: torque limits in use in [N·m], shape (n,), infinite for none.
    """

    def __init__(self, loaded: LoadedModel, robot: Robot, strength: Float64 | None = None) -> None:
        mujoco = import_mujoco()
        model = loaded.model
        driven = [drives(model)[joint] for joint in loaded.joints]
        self.actuators = [first for first, *_ in driven]
        self.silenced = [i for _, *others in driven for i in others]
        self.kinds = [actuator_kind(model, i) for i in self.actuators]
        self.gear = np.array([float(model.actuator_gear[i, 0]) for i in self.actuators])
        self.effort_lower, self.effort_upper = lower, upper = effort_ranges(
            loaded, robot.effort_limit
        )
        for k, i in enumerate(self.actuators):
            model.actuator_gaintype[i] = int(mujoco.mjtGain.mjGAIN_FIXED)
            model.actuator_biastype[i] = int(mujoco.mjtBias.mjBIAS_AFFINE)
            if self.kinds[k] != "position":  # its range was one of torques or speeds
                model.actuator_ctrllimited[i] = 0
            limits = np.array([lower[k], upper[k]]) / self.gear[k]
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
        count = len(self.actuators)
        self._strength = strength
        self._weakened = np.zeros((5, count))
        weak = np.ones(count) if strength is None else strength
        self._factor = np.stack([np.ones(count)] * 2 + [weak] * 3)
        self.index = index_of(self.actuators)
        self._model = model
        self._gain = model.actuator_gainprm[:, 0]
        self._bias = model.actuator_biasprm
        self._unit_gear = bool((self.gear == 1.0).all())
        self._target = np.zeros(count)
        self._b0 = np.zeros(count)
        self._written = b""

    def push(self, ctrl: Float64, command: Float64) -> None:
        """Put one robot's command into the model and its controls.

        Args:
            ctrl: `MjData.ctrl` of the robot.
            command: rows q*, qd*, tau_ff, kp, kd in [rad], [rad/s], [N·m], [N·m/rad],
                [N·m·s/rad], shape (5, n).
        """
        if self._strength is not None:
            command = np.multiply(command, self._factor, out=self._weakened)
        index = self.index
        b0 = self._b0
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

    def told(self, command: Array) -> list[Told]:
        """Return what `push` would bring into the model, of every robot of a batch at once.

        Args:
            command: rows as of `push`, shape (5, N, n).

        Returns:
            What `write` takes, for each robot.
        """
        if self._strength is not None:
            command = np.concatenate((command[:2], command[2:] * self._strength))
        stiffness, damping = command[3:] / self.gear**2
        b0 = (command[4] * command[1] + command[2]) / self.gear
        bias = np.stack((b0, -stiffness, -damping), axis=-1)
        return list(zip(command[0] * self.gear, stiffness, bias))

    def write(self, ctrl: Array, told: Told) -> None:
        """Put what `told` returned of one robot into the model and its controls (`MjData.ctrl`)."""
        index = self.index
        ctrl[index], self._gain[index], self._bias[index, :3] = told
        self._written = b""  # it is not what was pushed any more

    def holding(self, qpos: Float64) -> Float64:
        """Return controls that hold the joints of other position actuators (hands, objects).

        Args:
            qpos: positions that are held, as of `MjData.qpos`; controls are as of its `ctrl`.
        """
        model = self._model
        ctrl = np.zeros(model.nu)
        kind = int(import_mujoco().mjtTrn.mjTRN_JOINT)
        for i in {*range(model.nu)} - {*self.actuators, *self.silenced}:
            if model.actuator_trntype[i] == kind and actuator_kind(model, i) == "position":
                place = model.jnt_qposadr[model.actuator_trnid[i, 0]]
                ctrl[i] = qpos[place] * model.actuator_gear[i, 0]
        return ctrl
