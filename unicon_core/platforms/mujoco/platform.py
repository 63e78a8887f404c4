"""MuJoCo behind the platform contract, for workflows that say `platform: mujoco`."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from copy import copy
from dataclasses import asdict, replace
from functools import cached_property
from typing import Any

import numpy as np

from unicon_base import AnyDict, AnyMapping, PlatformError, one_line
from unicon_base.arrays import Array, Float64
from unicon_core.models.loaded import import_mujoco
from unicon_core.models.posed import PosedModel
from unicon_core.models.terrain import Models
from unicon_core.platforms.kit.command import Command, delay_of, steps_in, strength_of
from unicon_core.platforms.kit.joint_model import Passive
from unicon_core.platforms.kit.scene import BODY_PHYSICS, GANTRY, TERRAIN, Scene
from unicon_core.platforms.kit.start import hold, initial_positions, tell_bodies, tell_joints
from unicon_core.platforms.mujoco.batch import Batch, shares
from unicon_core.platforms.mujoco.servo import Servo
from unicon_core.platforms.mujoco.simulated_robot import SimulatedRobot
from unicon_core.platforms.platform import SIMULATED, Facts
from unicon_core.robots import Robot
from unicon_core.robots.load import JOINT_PHYSICS, joint_physics
from unicon_core.states import States
from unicon_core.states.standard import BASE_STATES, EXTERNAL_FORCE, external_states

# Rotor in [kg·m²] that no joint moves: 300 N·m turn it by 4 mrad in 0.5 s.
_IMMOVABLE = 1e4


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    scene: Scene | None = None,
    timestep: float | None = None,
    passive: Passive = "keep",
) -> MujocoPlatform:
    """Build the platform.

    Args:
        states: with `num_robots` set, as many robots are simulated, each in a world of its own.
        robot: its joints are found in the model by name.
        period: of a tick in [s], a whole number of physics steps.
        scene: how it begins; None for the robot file's model and default pose.
        timestep: physics step in [s]; the model's own if None.
        passive: damping of the robot's joints in the model: `keep` it beside that of the command,
            or `replace` it by that.

    Raises:
        MissingDependencyError: mujoco is not installed.
        ModelError: the model is missing, wrong, lacks a joint, or does not fit the period.
        PlatformError: the scene has no such pose.
    """
    mujoco = import_mujoco()
    scene = scene or Scene()
    models = Models(scene.model_path(robot), robot, timestep)
    return MujocoPlatform(mujoco, states, robot, period, models, scene, passive)


class MujocoPlatform:
    """One or more robots in MuJoCo; build it with `make`.

    Attributes:
        model: the `MjModel`; of a batch, that of the robots of its first thread.
        model_path: the file that it was read from.
        terrain: the ground under the robots, the same for all; None for flat.
        robots: the simulated robots, one unless the states have a batch axis.
        decimation: physics steps in a tick.
        servo: the actuators of the robot of `model`.
    """

    facts = Facts(
        "mujoco",
        simulated=True,
        batch=True,
        writes=SIMULATED,
        physics=(*JOINT_PHYSICS, *BODY_PHYSICS, GANTRY, TERRAIN, EXTERNAL_FORCE),
    )

    def __init__(
        self,
        mujoco: Any,
        states: States,
        robot: Robot,
        period: float,
        models: Models,
        scene: Scene,
        passive: Passive = "keep",
        qpos: Float64 | None = None,
    ) -> None:
        self._mujoco = mujoco
        self._robot = robot
        self._read = models
        self._states = states
        self._period = period
        self.terrain = scene.uneven
        loaded = self._loaded = models.on(self.terrain)
        model = self.model = loaded.model
        tell_bodies(loaded, scene.payload, scene.contact_friction)
        self.model_path = loaded.path
        self.decimation = steps_in(period, float(model.opt.timestep), loaded.path, "mujoco")
        unmeasured = BASE_STATES if loaded.base is None else ()
        writes = [name for name in SIMULATED if name in states and name not in unmeasured]
        self.facts = replace(self.facts, writes=tuple(writes))
        if qpos is None:
            qpos = initial_positions(models.flat, robot, scene)  # all ground is flat at the start
        self._scene, self._begins = scene, qpos
        if scene.gantry and loaded.base is not None:
            hold(model, loaded.base, qpos)
        # A blow-up must be seen: by itself MuJoCo would go on from the initial state.
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self._physics = physics = joint_physics(robot, scene.joints)
        tell_joints(loaded, physics)
        self._passive = passive
        self._dofs = loaded.dofs
        if passive == "replace":
            model.dof_damping[self._dofs] = 0.0
        delay = delay_of(physics, float(model.opt.timestep))
        count, self._batch = states.num_robots, None
        command = Command(states, robot.joint_names)
        forces = [name for name in external_states() if name in states]
        ranks = shares(count or 1)
        self._models = [model, *(copy(model) for _ in ranks[1:])]
        self.robots: list[SimulatedRobot] = []
        servos = [
            Servo(replace(loaded, model=own), robot, strength_of(physics)) for own in self._models
        ]
        for own, servo, share in zip(self._models, servos, ranks):
            for k in share:
                # `[k, ...]` keeps a scalar state a view
                views = {
                    name: states[name] if count is None else states[name][k, ...]
                    for name in (*self.facts.writes, *self.facts.reads, *forces)
                }
                one = SimulatedRobot(
                    mujoco,
                    replace(loaded, model=own),
                    robot.joint_names,
                    servo,
                    self.decimation,
                    views,
                    qpos,
                    command,
                    None if count is None else k,
                    delay,
                )
                self.robots.append(one)
        self.servo = servos[0]
        if len(self.robots) == 1:  # one call less in every tick
            self.recv = self.robots[0].read  # type: ignore[method-assign]
            self.send = self.robots[0].step  # type: ignore[method-assign]
        else:
            self._batch = Batch(command, self.robots, self.decimation, ranks, servos)

    @cached_property
    def _posed(self) -> PosedModel:
        return PosedModel(self._read.flat)

    @property
    def data(self) -> Any:
        """The `MjData` of the (first) robot."""
        return self.robots[0].data

    def recv(self) -> bool | None:
        """Copy joints, base and time of every robot into the states."""
        for robot in self.robots:
            robot.read()
        return None

    def send(self) -> bool | None:
        """Give every robot its command and simulate one tick.

        Raises:
            Fault: a command is not finite, or the physics blew up.
        """
        assert self._batch is not None
        self._batch()
        return None

    def warm_up(self) -> None:
        """Rehearse `recv` and a physics step of the (first) robot; nothing that is seen changes."""
        self.robots[0].rehearse()

    def reset(self) -> None:
        """Put every robot back where it began, at time 0."""
        for robot in self.robots:
            robot.reset()

    def change(self, scene: Scene) -> None:
        """Be as one that was built with this scene: 2 ms, where a model takes 6 ms to be read.

        On other ground the model is read again.

        Raises:
            ModelError: no such key frame, or the model has surroundings of its own.
            PlatformError: the scene is wrong, or these are robots of a batch.
        """
        if self._batch is not None:
            raise PlatformError("platform 'mujoco' cannot change the scene of several robots")
        how = self._states, self._robot, self._period, self._read, scene, self._passive
        begins = self._begins if scene.begins_as(self._scene) else None  # 0.4 ms to find
        other = MujocoPlatform(self._mujoco, *how, begins)
        # A holder of `recv` and `send` holds methods of the robot, which is another one now.
        other.robots[0].postponed = self.robots[0].postponed
        self.robots[0].become(other.robots[0])
        own = ("robots", "recv", "send", "reset", "change")
        kept = {name: value for name, value in vars(self).items() if name in own}
        vars(self).clear()
        vars(self).update(vars(other) | kept)

    def postpone(self) -> Callable[[], None] | None:
        """Only take the commands in `send`; see `Postpones`. Not of a batch."""
        if self._batch is not None:
            return None
        self.robots[0].postponed = True
        return self.robots[0].act

    def push(self, velocity: Float64) -> None:
        """Add to the bases' horizontal velocity [m/s], shape (2,), of a batch (N, 2).

        Raises:
            PlatformError: they cannot move.
        """
        if self._loaded.base is None:
            raise PlatformError("platform 'mujoco' cannot push a base that is fixed")
        for robot, each in zip(self.robots, np.atleast_2d(velocity)):
            robot.push(each)

    @cached_property
    def bodies(self) -> tuple[str, ...]:
        """Names of the model's bodies, "" for none; see `TakesForces`."""
        return tuple(self.model.body(i).name for i in range(self.model.nbody))

    @property
    def weight(self) -> float:
        """Weight of the (first) robot in [N]."""
        model = self.model
        root = model.body_rootid[model.dof_bodyid[self._dofs[0]]]
        return float(model.body_subtreemass[root] * np.linalg.norm(model.opt.gravity))

    def point(self, body: int, place: Float64) -> Float64:
        """Return where a point of a body is; see `TakesForces`."""
        return np.asarray(self.data.xpos[body] + self.data.xmat[body].reshape(3, 3) @ place)

    def put(self, measured: Mapping[str, Array]) -> None:
        """Put the robot where one was measured, every one of a batch; see `Placeable`."""
        for robot in self.robots:
            robot.put(measured, self._posed)

    def save(self) -> list[AnyDict]:
        """Return what the physics go on from, for a replay."""
        return [robot.save() for robot in self.robots]

    def load(self, saved: list[AnyDict]) -> None:
        """Go on as another platform would that was built alike."""
        for robot, kept in zip(self.robots, saved, strict=True):
            robot.load(kept)

    def close(self) -> None:
        """Let go; a simulation has no motors to damp."""
        if self._batch is not None:
            self._batch.close()

    def unlimited(self) -> AbstractContextManager[None]:
        """Do without the limits of effort for a while, for `--twin`."""
        words = "actuator_forcelimited", "jnt_actfrclimited"
        limits = [getattr(model, word) for model in self._models for word in words]
        return _set_to(0, limits, slice(None))

    def undamped(self) -> AbstractContextManager[None]:
        """Do without the joints' own damping for a while, as with `passive: replace`."""
        return _set_to(0, [model.dof_damping for model in self._models], self._dofs)

    def locked(self, joints: Sequence[int]) -> AbstractContextManager[None]:
        """Hold joints where they are for a while, for `--twin`: no torque moves their rotors.

        Args:
            joints: places in the robot's order, as if the model had them welded.
        """
        armatures = [model.dof_armature for model in self._models]
        return _set_to(_IMMOVABLE, armatures, np.asarray(self._dofs)[list(joints)])

    @property
    def passive_damping(self) -> Float64:
        """Damping of the robot's joints themselves in [N·m·s/rad], shape (n,)."""
        return np.array(self.model.dof_damping[self._dofs])

    def viewer(self, rate: float = 60.0) -> Viewer:
        """Return a block that shows the (first) robot in a window, at most `rate` times a second.

        Raises:
            PlatformError: there is no display.
        """
        return Viewer(self.model, self.data, rate)

    def _warnings(self) -> dict[str, int]:
        """Return how often MuJoCo warned, by kind, over all robots."""
        total = np.sum([robot.data.warning.number for robot in self.robots], axis=0)
        kinds = [self._mujoco.mjtWarning(i).name.removeprefix("mjWARN_") for i in range(len(total))]
        return {kind: int(count) for kind, count in zip(kinds, total) if count}

    def info(self) -> AnyMapping:
        """Return model, physics step, actuators, limits, IMU sources and what was changed."""
        mujoco, model, servo, loaded = self._mujoco, self.model, self.servo, self._loaded
        physics = self._physics
        own, body = {*loaded.joints, loaded.base}, None
        if loaded.base is not None:
            body = model.body(int(model.jnt_bodyid[loaded.base])).name or None
        beyond = (i for i in range(model.njnt) if i not in own)
        others = [model.joint(i).name or f"joint {i}" for i in beyond]
        notes = list(loaded.notes)
        if others:
            notes.append(f"joints beyond the robot's, left to the model: {', '.join(others)}")
        return {
            "model": str(loaded.path),
            "mujoco": mujoco.__version__,
            "physics_step_s": float(model.opt.timestep),
            "physics_steps_per_tick": self.decimation,
            "integrator": mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_"),
            "num_robots": len(self.robots),
            "base": body,
            "imu": self.robots[0].sources,
            "actuators": dict(zip(self._robot.joint_names, servo.kinds)),
            "effort_lower": dict(zip(self._robot.joint_names, servo.effort_lower.tolist())),
            "effort_upper": dict(zip(self._robot.joint_names, servo.effort_upper.tolist())),
            "passive": self._passive,
            "terrain": None if self.terrain is None else asdict(self.terrain),
            "joints": {word: getattr(physics, word).tolist() for word in physics.words},
            "warnings": self._warnings(),
            "notes": notes,
        }


@contextmanager
def _set_to(value: float, arrays: list[Array], places: Any) -> Iterator[None]:
    """Parts of arrays have another value for a while."""
    before = [array[places].copy() for array in arrays]
    try:
        for array in arrays:
            array[places] = value
        yield
    finally:
        for array, was in zip(arrays, before):
            array[places] = was


class Viewer:
    """Block: shows a model, done when its window is closed.

    Args:
        model: the `MjModel`.
        data: the `MjData`, read between physics steps only (the block runs in the tick's thread).
        rate: largest number of pictures per second.

    Raises:
        PlatformError: there is no display.
    """

    name = "viewer"

    def __init__(self, model: Any, data: Any, rate: float = 60.0) -> None:
        on_linux = sys.platform.startswith("linux")
        if on_linux and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise PlatformError(
                "the viewer needs a display and neither DISPLAY nor WAYLAND_DISPLAY is set; "
                "give --view for a page in the browser, or run it under a desktop, `ssh -X` or "
                "`xvfb-run`"
            )
        import mujoco.viewer

        try:
            self._handle = mujoco.viewer.launch_passive(model, data)
        except Exception as error:  # glfw raises classes of its own
            raise PlatformError(
                f"the viewer cannot open a window: {one_line(error)}; "
                "give --view for a page in the browser"
            ) from error
        self._interval = 1.0 / rate
        self._due = 0.0

    def __call__(self) -> bool:
        now = time.monotonic()
        if now >= self._due:
            self._due = now + self._interval
            self._handle.sync()
        return not self._handle.is_running()

    def close(self) -> None:
        """Close the window; safe to call twice."""
        self._handle.close()
