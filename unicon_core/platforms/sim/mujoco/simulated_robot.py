"""One robot in one MjData: reads its states, steps its physics; a batch holds N of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import Fault
from unicon_core.models.loaded import LoadedModel
from unicon_core.platforms.kit.clock import tick_ns
from unicon_core.platforms.kit.command import Command
from unicon_core.platforms.kit.joint_delay import JointDelay
from unicon_core.platforms.sim.mujoco.imu import BaseReader
from unicon_core.platforms.sim.mujoco.servo import Servo, actuator_kind, index_of

__all__ = ["SimulatedRobot"]

Float = NDArray[np.float64]

_TOO_FAST = 1e10  # squared norm of all velocities: no robot's joint turns at 1e5 rad/s


class SimulatedRobot:
    """A robot's physics.

    Positions and velocities are those of the end of the tick: a tick is `mj_step2`, the whole steps
    between, and `mj_step1` of the next one, which are the same physics as `decimation` times
    `mj_step` but leave kinematics and sensors fresh (plain `mj_step` leaves them one step old).

    Args:
        joint_names: of the robot's joints, in its order.
        decimation: physics steps in a tick.
        views: this robot's state arrays by name, without a batch axis.
        qpos: initial positions of the model.
        rank: number of the robot in its batch.
        delay: by which each joint's commands come late in physics steps, shape (n,); None for none.
    """

    def __init__(
        self,
        mujoco: Any,
        loaded: LoadedModel,
        joint_names: Sequence[str],
        servo: Servo,
        decimation: int,
        views: dict[str, NDArray[Any]],
        qpos: Float,
        rank: int,
        delay: NDArray[np.int64] | None = None,
    ) -> None:
        model, joints, base = loaded.model, loaded.joints, loaded.base
        self.data = mujoco.MjData(model)
        self._mujoco, self._model, self._base, self._servo = mujoco, model, base, servo
        self._names, self._decimation, self._initial = tuple(joint_names), decimation, qpos
        self._who = f"robot {rank}, " if rank else ""
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
        self._stamp = views.get("stamp_ns")
        self._tick_ns = tick_ns(float(model.opt.timestep), decimation)
        command = Command(views, self._names, self._who)
        self._take, self.command = command.take, command.rows
        self.delay = None if delay is None else JointDelay(self.command, delay, decimation)
        self._qvel = data.qvel
        self._split = model.opt.integrator != int(mujoco.mjtIntegrator.mjINT_RK4)
        self.reset()

    def reset(self) -> None:
        """Put the robot back where it began, time 0."""
        mujoco, data = self._mujoco, self.data
        mujoco.mj_resetData(self._model, data)
        data.qpos[:] = self._initial
        data.ctrl[:] = self._extra_ctrl
        self.ticks = 0
        # Limp until the first command: the model's gains may be those of another robot by now.
        self.command[...] = 0.0
        if self.delay is not None:
            self.delay.reset()
        self._servo.push(data.ctrl, self.command)
        mujoco.mj_forward(self._model, data)

    def read(self) -> None:
        """Copy what the simulation says into the states."""
        for out, view, source, index in self._copies:
            out[...] = source[index] if view is None else view
        if self._base_reader is not None:
            self._base_reader()
        if self._stamp is not None:
            self._stamp[...] = round(self.ticks * self._tick_ns)

    def step(self) -> None:
        """Take the command states and simulate one tick.

        Raises:
            Fault: a command is not finite, or the physics blew up.
        """
        self._take()
        mujoco, model, data = self._mujoco, self._model, self.data
        parts = ((self._decimation, self.command),) if self.delay is None else self.delay()
        fresh = self._split  # kinematics of the next step are there: the first one needs half
        for steps, command in parts:
            self._servo.push(data.ctrl, command)
            if fresh:
                mujoco.mj_step2(model, data)
                steps -= 1
                fresh = False
            if steps:
                mujoco.mj_step(model, data, steps)
        if self._split:
            mujoco.mj_step1(model, data)
        else:
            mujoco.mj_forward(model, data)
        self.ticks += 1
        if not self._qvel.dot(self._qvel) < _TOO_FAST:  # false for NaN too
            raise Fault(self._blown_up())

    def push(self, velocity: Float) -> None:
        """Add to the base's horizontal velocity in [m/s], shape (2,)."""
        start = int(self._model.jnt_dofadr[self._base])
        self.data.qvel[start : start + 2] += velocity

    def _blown_up(self) -> str:
        mujoco, model, qvel = self._mujoco, self._model, self._qvel
        if np.isfinite(qvel).any():
            dof = int(np.argmax(np.nan_to_num(np.abs(qvel), nan=np.inf)))
            joint = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, int(model.dof_jntid[dof]))
            what = f"joint {joint} moves at {qvel[dof]:.3g} rad/s"
        else:  # it went through every joint within the tick: name the likeliest cause
            joint_index = int(np.argmax(np.abs(self.command[3])))
            what = (
                "no velocity is finite any more (largest stiffness: "
                f"{self.command[3, joint_index]:.6g} N·m/rad at joint {self._names[joint_index]})"
            )
        time = self.ticks * self._decimation * float(model.opt.timestep)
        return (
            f"{self._who}the physics blew up before {time:.3f} s: {what}; "
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
