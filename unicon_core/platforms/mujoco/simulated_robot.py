"""One robot in one MjData: reads its states, steps its physics; a batch holds N of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from unicon_base import AnyDict, Fault
from unicon_base.arrays import Array, Float64, Int64
from unicon_core import memory
from unicon_core.models.loaded import LoadedModel
from unicon_core.models.posed import PosedModel
from unicon_core.platforms.kit.command import Command, JointDelay, tick_ns
from unicon_core.platforms.mujoco.reader import Reader, Rehearsal, without_sensors
from unicon_core.platforms.mujoco.servo import Servo
from unicon_core.states.standard import EXTERNAL_FORCE

_TOO_FAST = 1e10  # squared norm of all velocities: no robot's joint turns at 1e5 rad/s
# Results of the tick that the next one reads, and `mj_step1` does not compute.
_COMPUTED = ("sensordata", "qacc", "qfrc_actuator")


class SimulatedRobot:
    """A robot's physics.

    Positions and velocities are those of the end of the tick: a tick is `mj_step2`, the whole steps
    between, and `mj_step1` of the next one, which are the same physics as `decimation` times
    `mj_step` but leave kinematics and sensors fresh (plain `mj_step` leaves them one step old).
    Only the last step of a tick reckons sensors, which saves a Go2, whose model has 41, 5 %.

    Args:
        loaded: the model, whose gains the robot shares at most with others of its thread.
        joint_names: of the robot's joints, in its order.
        servo: of that model.
        decimation: physics steps in a tick.
        views: this robot's state arrays by name, without a batch axis.
        qpos: initial positions of the model.
        command: of the platform.
        rank: number of the robot in its batch, None where there is none.
        delay: by which each joint's commands come late in physics steps, shape (n,); None for none.

    Attributes:
        model: the `MjModel`, of `loaded`.
        data: the robot's `MjData`.
        servo: as given.
        command: this robot's rows of the platform's command, shape (5, n).
        delay: holds commands back; None for none.
        sources: what the base states are read from.
        ticks: since the beginning.
        tell_again: brings what acted last into the model, of a robot that shares it.
        postponed: `step` leaves the physics to `act`.
    """

    def __init__(
        self,
        mujoco: Any,
        loaded: LoadedModel,
        joint_names: Sequence[str],
        servo: Servo,
        decimation: int,
        views: dict[str, Array],
        qpos: Float64,
        command: Command,
        rank: int | None = None,
        delay: Int64 | None = None,
    ) -> None:
        model = self.model = loaded.model
        data = self.data = mujoco.MjData(model)
        self.servo = servo
        self._mujoco = mujoco
        self._base = loaded.base
        self._names = tuple(joint_names)
        self._decimation = decimation
        self._initial = qpos
        self._who = "" if rank is None else f"robot {rank}, "
        self._extra_ctrl = servo.holding(qpos)
        self.loaded = loaded
        self._views = views
        self._reader = Reader(loaded, data, views)
        self.sources = self._reader.sources
        self._stamp = views.get("stamp_ns")
        self._tick_ns = tick_ns(float(model.opt.timestep), decimation)
        self._take = command.take
        self.command = command.rows if rank is None else command.rows[:, rank]
        self.delay = None if delay is None else JointDelay(self.command, delay, decimation)
        self._qvel = data.qvel
        self._option = model.opt
        self._unseen = without_sensors(model)
        self.postponed = False
        self._pulled = -1  # body on which a force acts; -1: not known
        self._takes_force = EXTERNAL_FORCE in views
        self._split = model.opt.integrator != int(mujoco.mjtIntegrator.mjINT_RK4)
        self.reset()

    def become(self, other: SimulatedRobot) -> None:
        """Be another robot, for those who hold methods of this one; that one is of no use then."""
        vars(self).clear()
        vars(self).update(vars(other))

    def reset(self) -> None:
        """Put the robot back where it began, time 0."""
        mujoco = self._mujoco
        data = self.data
        mujoco.mj_resetData(self.model, data)
        self._pulled = 0
        data.qpos[:] = self._initial
        data.ctrl[:] = self._extra_ctrl
        self.ticks = 0
        self.command[...] = 0.0  # limp until the first command
        if self.delay is not None:
            self.delay.reset()
        self.servo.push(data.ctrl, self.command)
        self.tell_again: Callable[[], None] | None = None
        self.forward()

    def forward(self) -> None:
        """Compute what follows from positions, velocities and the last command."""
        if self.tell_again is not None:  # the model's gains may be those of another robot by now
            self.tell_again()
        self._mujoco.mj_forward(self.model, self.data)

    def read(self) -> None:
        """Copy what the simulation says into the states."""
        self._reader()
        if self._stamp is not None:
            self._stamp[...] = round(self.ticks * self._tick_ns)

    def step(self) -> None:
        """Take the command states and simulate one tick, of a robot that is alone.

        Raises:
            Fault: a command is not finite, or the physics blew up.
        """
        self._take()
        if not self.postponed:
            self.act()

    def act(self) -> None:
        """Simulate one tick under the command that was taken last; see `simulate`."""
        parts = ((self._decimation, self.command),) if self.delay is None else self.delay()
        self.simulate(self.servo.push, parts)

    def simulate(
        self, tell: Callable[[Float64, Any], None], parts: Iterable[tuple[int, Any]]
    ) -> None:
        """Simulate one tick.

        Args:
            tell: brings a command into the model and the controls: a servo's method.
            parts: physics steps, and the command that acts in them as `tell` takes it.

        Raises:
            Fault: the physics blew up.
        """
        mujoco = self._mujoco
        model = self.model
        data = self.data
        option = self._option
        left = self._decimation
        if self._takes_force:
            self._pull()
        told = option.disableflags
        fresh = self._split  # kinematics of the next step are there: the first one needs half
        option.disableflags = told | self._unseen
        try:
            for steps, command in parts:
                tell(data.ctrl, command)
                left -= steps
                if fresh and self._decimation > 1:
                    mujoco.mj_step2(model, data)
                    steps -= 1
                    fresh = False
                steps -= not left  # the last one is seen
                if steps:
                    mujoco.mj_step(model, data, steps)
        finally:
            option.disableflags = told
        (mujoco.mj_step2 if fresh else mujoco.mj_step)(model, data)
        (mujoco.mj_step1 if self._split else mujoco.mj_forward)(model, data)
        self.ticks += 1
        if not self._qvel.dot(self._qvel) < _TOO_FAST:  # false for NaN too
            time = self.ticks * self._decimation * float(option.timestep)
            raise Fault(
                f"{self._who}the physics blew up before {time:.3f} s: {self._too_fast()}; lower "
                "the gains or the physics step (timestep)"
            )

    def _too_fast(self) -> str:
        """Return the joint that moves too fast; where it went through all, the likeliest cause."""
        model = self.model
        qvel = self._qvel
        stiffness = self.command[3]
        if np.isfinite(qvel).any():
            dof = int(np.argmax(np.nan_to_num(np.abs(qvel), nan=np.inf)))
            joint = model.joint(int(model.dof_jntid[dof])).name or None
            return f"joint {joint} moves at {qvel[dof]:.3g} rad/s"
        stiffest = int(np.argmax(np.abs(stiffness)))
        return (
            f"no velocity is finite any more (largest stiffness: {stiffness[stiffest]:.6g} N·m/rad "
            f"at joint {self._names[stiffest]})"
        )

    @cached_property
    def rehearse(self) -> Rehearsal:
        """What warms the robot's memory and code up before a tick; see `Rehearsal`."""
        unseen = {name: view.copy() for name, view in self._views.items()}
        read = Reader(self.loaded, self.data, unseen)
        return Rehearsal(self._mujoco, self.model, self.data, read, self._split)

    def _pull(self) -> None:
        """Let `external_force` act on its body for a tick."""
        views, forces = self._views, self.data.xfrc_applied
        body = int(views["external_force_body"])
        if not body and not self._pulled:
            return
        forces[...] = 0.0
        self._pulled = body
        if not body:
            return
        force, point = (views[n].astype(float) for n in (EXTERNAL_FORCE, "external_force_point"))
        if not 0 < body < len(forces) or not np.isfinite((force, point)).all():
            raise Fault(
                f"{self._who}external_force {force.tolist()} at {point.tolist()} on body {body} is "
                f"none; give finite numbers and a body from 1 to {len(forces) - 1}, or 0 for no one"
            )
        forces[body, :3] = force
        forces[body, 3:] = np.cross(point - self.data.xipos[body], force)

    def push(self, velocity: Float64) -> None:
        """Add to the base's horizontal velocity in [m/s], shape (2,)."""
        start = int(self.model.jnt_dofadr[self._base])
        self.data.qvel[start : start + 2] += velocity

    def put(self, measured: Mapping[str, Array], posed: PosedModel) -> None:
        """Put the robot where one was measured; commands on their way stay on it.

        Args:
            measured: as of `Placeable`.
            posed: the model on flat ground.
        """
        data = self.data
        loaded = self.loaded
        model = self.model
        if "joint_pos" in measured:
            data.qpos[loaded.addresses] = measured["joint_pos"]
        if "joint_vel" in measured:
            data.qvel[loaded.dofs] = measured["joint_vel"]
        if self._base is not None:
            mujoco = self._mujoco
            pose = data.qpos[model.jnt_qposadr[self._base] :][:7]
            twist = data.qvel[model.jnt_dofadr[self._base] :][:6]
            if "base_quat" in measured:
                pose[3:] = measured["base_quat"]
                mujoco.mju_normalize4(pose[3:])
            if "base_pos_w" in measured:
                pose[:3] = measured["base_pos_w"]
            else:
                posed.put(data.qpos[loaded.addresses], pose)
                pose[2] -= min(posed.heights().values(), default=0.0)
            if "base_ang_vel" in measured:
                twist[3:] = measured["base_ang_vel"]
            if "base_lin_vel" in measured:
                in_base = np.asarray(measured["base_lin_vel"], np.float64)
                mujoco.mju_rotVecQuat(twist[:3], in_base, pose[3:])
        data.qacc_warmstart[:] = 0.0  # what comes follows from the measured state alone
        self.forward()

    def save(self) -> AnyDict:
        """Return what the physics go on from."""
        mujoco = self._mujoco
        model = self.model
        data = self.data
        kind = int(mujoco.mjtState.mjSTATE_INTEGRATION)
        state = np.zeros(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, state, kind)
        return {
            **{name: getattr(data, name).copy() for name in _COMPUTED},
            "state": state,
            "ticks": self.ticks,
            "command": self.command.copy(),
            "delay": None if self.delay is None else memory.save(self.delay),
        }

    def load(self, kept: AnyDict) -> None:
        """Go on as a robot of another platform would that was built alike."""
        mujoco = self._mujoco
        model = self.model
        data = self.data
        mujoco.mj_setState(model, data, kept["state"], int(mujoco.mjtState.mjSTATE_INTEGRATION))
        self.ticks, self.command[...] = kept["ticks"], kept["command"]
        self._pulled = -1
        if self.delay is not None:
            memory.load(self.delay, kept["delay"])
        mujoco.mj_step1(model, data)
        for name in _COMPUTED:
            getattr(data, name)[:] = kept[name]
