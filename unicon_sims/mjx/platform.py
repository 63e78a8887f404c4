"""MJX behind the platform contract, for workflows that say `platform: mjx`.

A tick of all robots is one compiled call: the servo and a physics step as often as a tick has them.
It is compiled once for a number of robots and a structure of the model: masses, gains, gravity and
the number of physics steps are arguments, so that another robot like it needs no second time.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from unicon_base import AnyDict, ModelError, imported, one_line
from unicon_core.models.load import effort_ranges
from unicon_core.platforms.kit.command import strength_of
from unicon_core.platforms.kit.stepped import (
    BODY_PHYSICS,
    JOINT_PHYSICS,
    SIMULATED,
    Facts,
    Float64,
    Passive,
    Robot,
    Scene,
    Setup,
    Start,
    States,
    SteppedSimulator,
    WorldPose,
    import_mujoco,
    patience,
    quiet,
    rotation,
    setup_of,
)

FINEST = 1e-6
"""Tolerance of the solver: float32 seldom gets further, however often it iterates. With MuJoCo's
own 1e-8 sixteen Go2 took 1.6 times as long."""


class MjxPlatform(SteppedSimulator):
    """N robots in one batch of MJX, in float32; built by `make`."""

    facts = Facts(
        "mjx", simulated=True, batch=True, writes=SIMULATED, physics=(*JOINT_PHYSICS, *BODY_PHYSICS)
    )
    represents = (
        "armature",
        "damping",
        "friction",
        "limits",
        "self-collision",
        "meshes",
        "contact friction",
        "constraints",
        "terrain",
    )

    def __init__(self, setup: Setup) -> None:
        import jax
        from mujoco import mjx

        count = setup.num_robots
        robot = setup.robot
        start = setup.start
        self._nothing = np.zeros((5, count, robot.num_joints), np.float32)
        model = _model(setup)
        compiled, first = _put(mjx, model, start)
        places = Places.of(model, start)
        # On the same device as all else: JAX would compile anew for the first tick.
        qpos = jax.device_put(start.qpos.astype(np.float32), first.qpos.device)
        first = first.replace(qpos=qpos)
        self._first = jax.tree.map(lambda leaf: jax.numpy.stack([leaf] * count), first)
        self._moving = slice(places.base_vel, places.base_vel + 3)
        limits = np.array(effort_ranges(start.loaded, robot.effort_limit), np.float32)
        strength = strength_of(start.physics)
        factor = np.ones_like(limits[0]) if strength is None else strength.astype(np.float32)
        self._tick = partial(compiled_tick(places), compiled, limits, factor)
        with patience(f"mjx: compiling the physics of {count} robots for JAX"):
            self.place()
        super().__init__(setup)

    def _command_of(self, torque: Float64 | float) -> Any:
        """Return the command of a torque [N·m] alone, shape (5, N, n)."""
        command = self._nothing.copy()
        command[2] = torque
        return command

    def place(self) -> None:
        self._state, told = self._tick(self._first, self._command_of(0.0), 0)
        self._read = _arrays(told)

    def joints(self) -> tuple[Float64, Float64]:
        return self._read["pos"], self._read["vel"]

    def base(self) -> WorldPose:
        return _pose(self._read["base"])

    def simulate(self, parts: Iterable[tuple[int, Float64]]) -> WorldPose:
        for steps, command in parts:
            self._state, told = self._tick(self._state, command.astype(np.float32), steps)
        self._read = _arrays(told)
        self.torque[...] = self._read["torque"]
        return _pose(self._read["before"]) if self.start.floating else self.nowhere()

    def step(self, torque: Float64) -> None:
        self.simulate([(1, self._command_of(torque))])

    def add_velocity(self, velocity: Float64) -> None:
        qvel = self._state.qvel.at[:, self._moving].add(velocity.astype(np.float32))
        self._state = self._state.replace(qvel=qvel)

    def close(self) -> None:
        pass  # memory goes with the arrays

    def info(self) -> AnyDict:
        devices = sorted({str(device) for device in self._state.qpos.devices()})
        return super().info() | {"devices": devices}


class Places(NamedTuple):
    """Where joints and the free joint stand in `qpos` and `qvel`; a base that is fixed has none."""

    pos: tuple[int, ...]
    vel: tuple[int, ...]
    floating: bool
    base_pos: int
    base_vel: int

    @classmethod
    def of(cls, model: Any, start: Start) -> Places:
        """Return those of a robot in a model."""
        loaded, base = start.loaded, start.loaded.base
        joints = tuple(loaded.addresses.tolist()), tuple(loaded.dofs.tolist())
        if base is None:
            return cls(*joints, False, 0, 0)
        return cls(*joints, True, int(model.jnt_qposadr[base]), int(model.jnt_dofadr[base]))


@cache
def compiled_tick(places: Places) -> Any:
    """Return (model, limits, factor, data, command, steps) to (data, what is told).

    `limits` of the torque have shape (2, n), `factor` (n,), the command (5, N, n); told are `pos`,
    `vel`, `torque`, `base` and, one physics step before, `before`: qpos and qvel of the free joint.
    The servo's equation is that of `kit/servo.py`.
    """
    import jax
    from mujoco import mjx

    jnp = jax.numpy
    pos = jnp.array(places.pos)
    vel = jnp.array(places.vel)

    def where(data: Any) -> Any:
        if not places.floating:
            return jnp.zeros(13)
        at = places.base_pos
        by = places.base_vel
        return jnp.concatenate((data.qpos[at : at + 7], data.qvel[by : by + 6]))

    def one(model: Any, limits: Any, factor: Any, data: Any, command: Any, steps: Any) -> Any:
        target, velocity, feed_forward, stiffness, damping = command

        def step(_: Any, carried: Any) -> Any:
            data, _, _ = carried
            error = target - data.qpos[pos]
            slip = velocity - data.qvel[vel]
            asked = stiffness * error + (damping * slip + feed_forward)
            torque = jnp.clip(asked, *limits) * factor
            applied = jnp.zeros_like(data.qfrc_applied).at[vel].set(torque)
            return mjx.step(model, data.replace(qfrc_applied=applied)), where(data), torque

        begin = (data, where(data), jnp.zeros_like(target))
        data, before, torque = jax.lax.fori_loop(0, steps, step, begin)
        told = {"pos": data.qpos[pos], "vel": data.qvel[vel], "torque": torque}
        return data, told | {"base": where(data), "before": before}

    return jax.jit(jax.vmap(one, in_axes=(None, None, None, 0, 1, None)))


def _model(setup: Setup) -> Any:
    """Return the model with the joints' figures and without its own actuators."""
    mujoco = import_mujoco()
    loaded = setup.start.loaded
    model = loaded.model
    model.opt.timestep = setup.timestep
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    model.opt.tolerance = max(float(model.opt.tolerance), FINEST)
    setup.figures.tell(model, loaded)
    return model


def _put(mjx: Any, model: Any, start: Start) -> tuple[Any, Any]:
    """Return model and data of MJX.

    Raises:
        ModelError: it lacks something that the model has.
    """
    try:
        compiled = mjx.put_model(model)
        data = mjx.make_data(compiled)
    except (NotImplementedError, ValueError) as error:
        raise ModelError(
            f"platform 'mjx' cannot simulate model {start.loaded.path}: {one_line(error)}; change "
            "the model, or take platform: mujoco"
        ) from error
    pyramid = import_mujoco().mjtCone.mjCONE_PYRAMIDAL
    if not data._impl.ncon and model.opt.cone != pyramid:
        # MJX 3.17 fails with elliptic cones where nothing can touch, where they mean nothing.
        model.opt.cone = pyramid
        return _put(mjx, model, start)
    return compiled, data


def _arrays(told: AnyDict) -> dict[str, Float64]:
    return {name: np.asarray(value, np.float64) for name, value in told.items()}


def _pose(base: Float64) -> WorldPose:
    """Return where bases are, of their free joints; its rates are along the base's own axes."""
    position, quat, linear, angular = np.split(base, (3, 7, 10), axis=1)
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    return WorldPose(position, quat, linear, (rotation(quat) @ angular[:, :, None])[:, :, 0])


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    scene: Scene,
    timestep: float | None = None,
    passive: Passive = "keep",
) -> MjxPlatform:
    """Build the platform.

    Args:
        states: with `num_robots` set, as many robots are simulated, in one batch.
        robot: its joints are found in the model by name.
        period: of a tick in [s].
        scene: how it begins.
        timestep: physics step in [s]; the model's own if None.
        passive: damping of the joints in the model: `keep` it beside that of the command, or
            `replace` it by that.

    Raises:
        MissingDependencyError: mujoco-mjx or jax is not installed.
        ModelError: MJX cannot simulate the model.
    """
    # Else JAX takes most of a GPU's memory for itself.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    what = "platform 'mjx'", "sim-mjx", "mujoco-mjx"
    with quiet():  # it tells that warp is not there
        jax = imported("jax", *what)
        imported("mujoco.mjx", *what)
    if jax.config.jax_compilation_cache_dir is None:  # nobody wants it elsewhere
        home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        # With compiled physics kept there, the next start is four times as quick.
        jax.config.update("jax_compilation_cache_dir", str(Path(home) / "unicon_ros" / "jax"))
    return MjxPlatform(setup_of(states, robot, period, scene, timestep, passive))
