"""One robot in one MjData: reads its states, steps its physics; a batch holds N of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import Fault
from unicon_core.platforms.sim.mujoco.imu import BaseReader
from unicon_core.platforms.sim.mujoco.servo import Servo, actuator_kind, index_of
from unicon_core.states.stacked import stacked
from unicon_core.states.standard import COMMAND_STATES

__all__ = ["Disturbances", "SimulatedRobot"]

Float = NDArray[np.float64]

_TOO_FAST = 1e10  # squared norm of all velocities: no robot's joint turns at 1e5 rad/s


@dataclass(frozen=True)
class Disturbances:
    """What makes a simulation less perfect.

    Attributes:
        delay: ticks by which commands come late.
        noise: state to standard deviation of white noise, in the state's unit.
        push_every: seconds between pushes of the base, 0 for none.
        push_velocity: largest horizontal velocity of a push in [m/s].
        seed: of noise and pushes; robot k of a batch draws from (seed, k).
    """

    delay: int = 0
    noise: Mapping[str, float] | None = None
    push_every: float = 0.0
    push_velocity: float = 0.0
    seed: int = 0


class SimulatedRobot:
    """A robot's physics.

    Positions and velocities are those of the end of the tick: a tick is `mj_step2`, the whole steps
    between, and `mj_step1` of the next one, which are the same physics as `decimation` times
    `mj_step` but leave kinematics and sensors fresh (plain `mj_step` leaves them one step old).

    Args:
        views: this robot's state arrays by name, without a batch axis.
        qpos: initial positions of the model.
        rank: number of the robot in its batch.
    """

    def __init__(
        self,
        mujoco: Any,
        model: Any,
        joints: Sequence[int],
        joint_names: Sequence[str],
        base: int | None,
        servo: Servo,
        decimation: int,
        views: dict[str, NDArray[Any]],
        qpos: Float,
        disturbances: Disturbances,
        rank: int = 0,
    ) -> None:
        self.data = mujoco.MjData(model)
        self._mujoco, self._model, self._base, self._servo = mujoco, model, base, servo
        self._names, self._rank, self._decimation = tuple(joint_names), rank, decimation
        self._initial, self._disturbances = qpos, disturbances
        self._extra_ctrl = _holding(mujoco, model, servo, qpos)
        data = self.data
        q_index = index_of([int(model.jnt_qposadr[j]) for j in joints])
        v_index = index_of([int(model.jnt_dofadr[j]) for j in joints])
        sources = ((data.qpos, q_index), (data.qvel, v_index), (data.qfrc_actuator, v_index))
        self._copies = [
            (views[name], source[index] if isinstance(index, slice) else None, source, index)
            for name, (source, index) in zip(("joint_pos", "joint_vel", "joint_effort"), sources)
            if name in views
        ]
        self._base_reader = None if base is None else BaseReader(mujoco, model, data, base, views)
        self.sources = {} if self._base_reader is None else dict(self._base_reader.source)
        self._noise = [
            (views[name], np.float32(std)) for name, std in (disturbances.noise or {}).items()
        ]
        noisy_quat = "base_quat" in (disturbances.noise or {})
        self._noisy_quat = views["base_quat"] if noisy_quat else None
        self._stamp = views.get("stamp_ns")
        step_ns = Fraction(repr(float(model.opt.timestep))) * 10**9
        self._step_ns: Fraction | int = int(step_ns) if step_ns.denominator == 1 else step_ns
        count = len(joint_names)
        self._command = np.zeros((5, count))
        commands = [views[name] for name in COMMAND_STATES]
        whole = stacked(commands)
        self._commands = (
            list(zip(self._command, commands)) if whole is None else [(self._command, whole)]
        )
        self._flat, self._qvel = self._command.reshape(-1), data.qvel
        self._queue = np.zeros((disturbances.delay + 1, 5, count))
        self._split = model.opt.integrator != int(mujoco.mjtIntegrator.mjINT_RK4)
        push_ticks = disturbances.push_every / (decimation * float(model.opt.timestep))
        self._push_ticks = round(push_ticks) if base is not None else 0
        self.reset()

    def reset(self) -> None:
        """Put the robot back where it began, time 0."""
        mujoco, data = self._mujoco, self.data
        mujoco.mj_resetData(self._model, data)
        data.qpos[:] = self._initial
        data.ctrl[:] = self._extra_ctrl
        self._rng = np.random.default_rng((self._disturbances.seed, self._rank))
        self._ticks = 0
        # Limp until the first command: the model's gains may be those of another robot by now.
        self._command[...] = 0.0
        self._servo.push(data.ctrl, self._command)
        mujoco.mj_forward(self._model, data)

    def read(self) -> None:
        """Copy what the simulation says into the states."""
        for out, view, source, index in self._copies:
            out[...] = source[index] if view is None else view
        if self._base_reader is not None:
            self._base_reader()
        for out, std in self._noise:
            out += std * self._rng.standard_normal(out.shape, dtype=np.float32)
        if self._noisy_quat is not None:
            self._noisy_quat /= np.linalg.norm(self._noisy_quat)
        if self._stamp is not None:
            self._stamp[...] = round(self._ticks * self._decimation * self._step_ns)

    def step(self) -> None:
        """Take the command states and simulate one tick.

        Raises:
            Fault: a command is not finite, or the physics blew up.
        """
        for row, source in self._commands:
            row[...] = source
        if not self._flat.dot(self._flat) < math.inf:  # false for NaN too: one call finds both
            raise Fault(self._bad_command())
        if self._disturbances.delay:
            self._delayed()
        if self._push_ticks and self._ticks and self._ticks % self._push_ticks == 0:
            self._push()
        mujoco, model, data = self._mujoco, self._model, self.data
        self._servo.push(data.ctrl, self._command)
        if self._split:
            mujoco.mj_step2(model, data)
            if self._decimation > 1:
                mujoco.mj_step(model, data, self._decimation - 1)
            mujoco.mj_step1(model, data)
        else:
            mujoco.mj_step(model, data, self._decimation)
            mujoco.mj_forward(model, data)
        self._ticks += 1
        if not self._qvel.dot(self._qvel) < _TOO_FAST:  # false for NaN too
            raise Fault(self._blown_up())

    def _delayed(self) -> None:
        size = len(self._queue)
        if self._ticks == 0:  # before the first command the motors hold what it says
            self._queue[:] = self._command
        self._queue[self._ticks % size] = self._command
        self._command[...] = self._queue[(self._ticks + 1) % size]

    def _push(self) -> None:
        largest = self._disturbances.push_velocity
        start = int(self._model.jnt_dofadr[self._base])
        self.data.qvel[start : start + 2] += self._rng.uniform(-largest, largest, 2)

    def _who(self) -> str:
        return f"robot {self._rank}, " if self._rank else ""

    def _bad_command(self) -> str:
        row, joint = (int(i) for i in np.argwhere(~np.isfinite(self._command))[0])
        return (
            f"{self._who()}command {COMMAND_STATES[row]} of joint {self._names[joint]} is "
            f"{self._command[row, joint]} at tick {self._ticks}; nothing was sent"
        )

    def _blown_up(self) -> str:
        mujoco, model, qvel = self._mujoco, self._model, self._qvel
        if np.isfinite(qvel).any():
            dof = int(np.argmax(np.nan_to_num(np.abs(qvel), nan=np.inf)))
            joint = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, int(model.dof_jntid[dof]))
            what = f"joint {joint} moves at {qvel[dof]:.3g} rad/s"
        else:  # it went through every joint within the tick: name the likeliest cause
            joint_index = int(np.argmax(np.abs(self._command[3])))
            what = (
                "no velocity is finite any more (largest stiffness: "
                f"{self._command[3, joint_index]:.6g} N·m/rad at joint {self._names[joint_index]})"
            )
        time = self._ticks * self._decimation * float(model.opt.timestep)
        return (
            f"{self._who()}the physics blew up before {time:.3f} s: {what}; "
            "lower the gains or the physics step (timestep)"
        )


def _holding(mujoco: Any, model: Any, servo: Servo, qpos: Float) -> Float:
    """Return controls that hold the joints of other position actuators (hands, objects)."""
    ctrl = np.zeros(model.nu)
    own = {*servo.actuators, *servo.silenced}
    for i in range(model.nu):
        if i not in own and model.actuator_trntype[i] == int(mujoco.mjtTrn.mjTRN_JOINT):
            joint = int(model.actuator_trnid[i, 0])
            if actuator_kind(mujoco, model, i) == "position":
                ctrl[i] = qpos[model.jnt_qposadr[joint]] * model.actuator_gear[i, 0]
    return ctrl
