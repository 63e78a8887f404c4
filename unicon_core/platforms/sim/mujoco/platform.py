"""MuJoCo behind the platform contract, for workflows that say `platform: mujoco`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from unicon_core.errors import ModelError, PlatformError, alternatives
from unicon_core.models.find import pick_model
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.platforms.sim.mujoco.initial import Pose, initial_positions
from unicon_core.platforms.sim.mujoco.servo import Servo
from unicon_core.platforms.sim.mujoco.simulated_robot import Disturbances, SimulatedRobot
from unicon_core.platforms.sim.mujoco.viewer import Viewer
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import BASE_STATES, COMMAND_STATES, JOINT_STATES

__all__ = ["MujocoPlatform", "make"]


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    model: str | Path | None = None,
    timestep: float | None = None,
    keyframe: str | None = None,
    initial_pose: Pose = "default",
    initial_height: float | None = None,
    seed: int = 0,
    delay: int = 0,
    noise: Mapping[str, float] | None = None,
    push: Mapping[str, float] | None = None,
    relative_to: Path | None = None,
) -> MujocoPlatform:
    """Build the platform.

    Args:
        states: with `num_robots` set, as many robots are simulated, each in a world of its own.
        robot: its joints are found in the model by name.
        period: of a tick in [s], a whole number of physics steps.
        model: MJCF or URDF file, `assets:PATH` or `robot_descriptions:NAME`; the robot file's model
            if None.
        timestep: physics step in [s]; the model's own if None.
        keyframe: key frame of the model to begin in.
        initial_pose: `default` or `rest` of the robot file, `model`, or joints to [rad].
        initial_height: of the base in [m]; None sets the robot on the floor.
        seed: of noise and pushes.
        delay: ticks by which commands reach the motors late.
        noise: state to standard deviation of white noise, in the state's unit.
        push: `every` in [s] and `velocity` in [m/s]: random horizontal pushes of the base.
        relative_to: folder of the workflow, for a relative model path.

    Raises:
        MissingDependencyError: mujoco is not installed.
        ModelError: the model is missing, wrong, lacks a joint, or does not fit the period.
        PlatformError: an option is wrong.
    """
    mujoco = import_mujoco()
    loaded = load_model(pick_model(robot, model, relative_to), robot, timestep)
    disturbances = _disturbances(seed, delay, noise, push)
    return MujocoPlatform(
        mujoco, states, robot, period, loaded, disturbances, initial_pose, keyframe, initial_height
    )


class MujocoPlatform:
    """One or more robots in MuJoCo; build it with `make`.

    Attributes:
        model: the `MjModel`.
        model_path: the file that it was read from.
        robots: the simulated robots, one unless the states have a batch axis.
        period: of a tick in [s].
        decimation: physics steps in a tick.
    """

    name = "mujoco"
    simulated = True

    def __init__(
        self,
        mujoco: Any,
        states: States,
        robot: Robot,
        period: float,
        loaded: LoadedModel,
        disturbances: Disturbances,
        pose: Pose,
        keyframe: str | None,
        height: float | None,
    ) -> None:
        model = self.model = loaded.model
        self._mujoco, self._robot, self._loaded = mujoco, robot, loaded
        self.model_path = loaded.path
        self.period = period
        self.decimation = _decimation(period, float(model.opt.timestep), loaded.path)
        base = loaded.base
        names = JOINT_STATES + (() if base is None else BASE_STATES) + ("stamp_ns",)
        self.writes = tuple(name for name in names if name in states)
        self.reads = COMMAND_STATES
        for state in disturbances.noise or {}:
            if state not in self.writes or state == "stamp_ns":
                known = alternatives(state, set(self.writes) - {"stamp_ns"})
                raise PlatformError(f"platform 'mujoco': no state {state!r} for noise; {known}")
        qpos = initial_positions(mujoco, loaded, robot, base, pose, keyframe, height)
        # A blow-up must be seen: by itself MuJoCo would go on from the initial state.
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self._servo = Servo(mujoco, model, loaded.joints, robot.effort_limit)
        count = states.num_robots
        self.robots = [
            SimulatedRobot(
                mujoco,
                model,
                loaded.joints,
                robot.joint_names,
                base,
                self._servo,
                self.decimation,
                # `[k, ...]` keeps a scalar state a view
                {
                    name: states[name] if count is None else states[name][k, ...]
                    for name in (*self.writes, *self.reads)
                },
                qpos,
                disturbances,
                k,
            )
            for k in range(count or 1)
        ]
        self._base = base
        if len(self.robots) == 1:  # one call less in every tick
            self.recv = self.robots[0].read  # type: ignore[method-assign]
            self.send = self.robots[0].step  # type: ignore[method-assign]

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
        for robot in self.robots:
            robot.step()
        return None

    def reset(self) -> None:
        """Put every robot back where it began, at time 0."""
        for robot in self.robots:
            robot.reset()

    def close(self) -> None:
        """Let go; a simulation has no motors to damp."""

    @contextmanager
    def unlimited(self) -> Iterator[None]:
        """Do without the limits of effort for a while, for `--twin`."""
        limits = self.model.actuator_forcelimited, self.model.jnt_actfrclimited
        before = [limit.copy() for limit in limits]
        try:
            for limit in limits:
                limit[:] = 0
            yield
        finally:
            for limit, was in zip(limits, before):
                limit[:] = was

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

    def info(self) -> Mapping[str, Any]:
        """Return model, physics step, actuators, limits, IMU sources and what was changed."""
        mujoco, model, servo = self._mujoco, self.model, self._servo
        own = set(self._loaded.joints) | ({self._base} if self._base is not None else set())
        others = [
            mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, i) or f"joint {i}"
            for i in range(model.njnt)
            if i not in own
        ]
        notes = list(self._loaded.notes)
        if others:
            notes.append(f"joints beyond the robot's, left to the model: {', '.join(others)}")
        body = None if self._base is None else int(model.jnt_bodyid[self._base])
        return {
            "model": str(self._loaded.path),
            "mujoco": mujoco.__version__,
            "physics_step_s": float(model.opt.timestep),
            "physics_steps_per_tick": self.decimation,
            "integrator": mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_"),
            "num_robots": len(self.robots),
            "base": None
            if body is None
            else mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body),
            "imu": self.robots[0].sources,
            "actuators": dict(zip(self._robot.joint_names, servo.kinds)),
            "effort_lower": dict(zip(self._robot.joint_names, servo.effort_lower.tolist())),
            "effort_upper": dict(zip(self._robot.joint_names, servo.effort_upper.tolist())),
            "warnings": self._warnings(),
            "notes": notes,
        }


def _decimation(period: float, timestep: float, path: Path) -> int:
    ratio = period / timestep
    steps = round(ratio)
    if steps >= 1 and abs(ratio - steps) < 1e-6 * steps:
        return steps
    down, up = max(math.floor(ratio), 1), max(math.ceil(ratio), 1)
    timesteps = " or ".join(f"{period / n:.6g}" for n in dict.fromkeys((down, up)))
    periods = " or ".join(f"{n * timestep:.6g}" for n in dict.fromkeys((down, up)))
    raise ModelError(
        f"a tick of {period:.6g} s is no whole number of physics steps of {timestep:.6g} s "
        f"(model {path}); set timestep to {timesteps}, or the period to {periods}"
    )


def _disturbances(
    seed: int, delay: int, noise: Mapping[str, float] | None, push: Mapping[str, float] | None
) -> Disturbances:
    if delay < 0:
        raise PlatformError(f"platform 'mujoco': delay is {delay} ticks; give 0 or more")
    for state, std in (noise or {}).items():
        if not std >= 0.0:
            raise PlatformError(f"platform 'mujoco': noise of {state} is {std}; give 0 or more")
    for key in push or {}:
        if key not in ("every", "velocity"):
            known = alternatives(key, ("every", "velocity"))
            raise PlatformError(f"platform 'mujoco': no push option {key!r}; {known}")
    every, velocity = (float((push or {}).get(key, 0.0)) for key in ("every", "velocity"))
    if push and not (every > 0.0 and velocity > 0.0):
        raise PlatformError(
            f"platform 'mujoco': push every {every} s with {velocity} m/s does nothing; "
            "give every [s] and velocity [m/s] above 0"
        )
    return Disturbances(delay, dict(noise or {}), every, velocity, seed)
