"""The `newton` platform: Newton steps the robot's model, MuJoCo or MuJoCo Warp in it.

Newton 1.8 has quaternions xyzw. Its free joint has seven coordinates, the position of the body's
origin and the quaternion, and six velocities along the world's axes: that of the centre of mass,
then the rate. https://newton-physics.github.io/newton/latest/concepts/conventions.html
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from unicon_base import MissingDependencyError, PlatformError, TextSink, alternatives, one_line
from unicon_base.arrays import Float32
from unicon_core.platforms.kit.stepped import (
    SIMULATED,
    DampedSimulator,
    Facts,
    Float64,
    Passive,
    Robot,
    Scene,
    Setup,
    States,
    WorldPose,
    import_mujoco,
    patience,
    quiet,
    rotation,
    setup_of,
)
from unicon_sims.newton.world import build_world, not_told, solver_options

Solver = Literal["mujoco", "warp"]
"""MuJoCo's own library, robot by robot, or MuJoCo Warp, all of them in one step."""

_COMPILES = "newton: loading its kernels, which compile for a minute or two the first time"


class Engine:
    """A model of one world or of several that are equal, with a solver.

    Args:
        model: finalized; where its joints stand is where a reset leads.
        solver: of that model, a `SolverMuJoCo`.
        joints: numbers of Newton's joints in the first world, in the robot's order, n.

    Attributes:
        worlds: how many there are.
    """

    def __init__(self, model: Any, solver: Any, joints: list[int]) -> None:
        self.worlds = max(int(model.world_count), 1)
        self._model = model
        self._solver = solver
        self._q = model.joint_q_start.numpy()[joints]
        self._v = model.joint_qd_start.numpy()[joints]
        self._centre = np.array(model.body_com.numpy()[0], np.float64)  # of the base
        self._now = model.state()
        self._next = model.state()
        self._control = model.control()
        self._force = np.zeros((self.worlds, model.joint_dof_count // self.worlds), np.float32)

    def _rows(self, array: Any) -> Float32:
        """Return what Newton has in one array for all worlds, one row each."""
        rows: Float32 = array.numpy().reshape(self.worlds, -1)
        return rows

    def place(self) -> None:
        """Put all joints where the model has them, at rest, and forget contacts and warm starts."""
        self._control.joint_f.zero_()
        self._solver.reset(self._now)

    def joints(self) -> tuple[Any, Any]:
        """Return positions and velocities, float32, shape (worlds, n) each."""
        now = self._now
        return self._rows(now.joint_q)[:, self._q], self._rows(now.joint_qd)[:, self._v]

    def base(self) -> tuple[Float64, Float64, Float64, Float64]:
        """Return the values of a `WorldPose`, shape (worlds, 3) or (worlds, 4)."""
        pose = self._rows(self._now.joint_q)[:, :7].astype(np.float64)
        twist = self._rows(self._now.joint_qd)[:, :6].astype(np.float64)
        quat = pose[:, (6, 3, 4, 5)]
        rate = twist[:, 3:]
        quat /= np.linalg.norm(quat, axis=1, keepdims=True)
        centre = rotation(quat) @ self._centre  # from the origin, along the world's axes
        return pose[:, :3], quat, twist[:, :3] - np.cross(rate, centre), rate

    def step(self, torque: Float64, timestep: float) -> None:
        """Apply torques [N·m], shape (worlds, n), and step the physics."""
        self._force[:, self._v] = torque
        self._control.joint_f.assign(self._force.ravel())
        self._solver.step(self._now, self._next, self._control, None, timestep)
        self._now, self._next = self._next, self._now

    def add_velocity(self, velocity: Float64) -> None:
        """Add to the bases' velocities [m/s] in the world, shape (worlds, 3)."""
        rows = self._rows(self._now.joint_qd).copy()
        rows[:, :3] += velocity
        self._now.joint_qd.assign(rows.ravel())

    def damp(self, damping: Float64) -> None:
        """Give the joints damping [N·m·s/rad], in the robot's order, shape (n,)."""
        from newton import ModelFlags

        rows = self._rows(self._model.joint_damping).copy()
        rows[:, self._v] = damping
        self._model.joint_damping.assign(rows.ravel())
        self._solver.notify_model_changed(ModelFlags.JOINT_DOF_FORCE_PROPERTIES)


class NewtonPlatform(DampedSimulator):
    """Robots, each in a world of its own; built by `make`."""

    facts = Facts(
        "newton",
        simulated=True,
        batch=True,
        writes=SIMULATED,
        physics=("strength", "friction", "armature", "delay"),
    )
    represents = (
        "armature",
        "damping",
        "friction",
        "limits",
        "self-collision",
        "meshes",
        "contact friction",
        "terrain",
    )

    def __init__(self, engines: Sequence[Engine], setup: Setup) -> None:
        self._engines = list(engines)
        bounds = np.cumsum([0, *(engine.worlds for engine in engines)])
        self._parts = [slice(*ends) for ends in pairwise(bounds)]
        super().__init__(setup)
        self.step(self.torque)  # else the first tick would compile kernels
        self.reset()

    def damp(self, damping: Float64) -> None:
        for engine in self._engines:
            engine.damp(damping)

    def place(self) -> None:
        for engine in self._engines:
            engine.place()

    def joints(self) -> tuple[Float64, Float64]:
        pos, vel = zip(*(engine.joints() for engine in self._engines))
        return np.concatenate(pos, dtype=np.float64), np.concatenate(vel, dtype=np.float64)

    def base(self) -> WorldPose:
        poses = [engine.base() for engine in self._engines]
        return WorldPose(*map(np.concatenate, zip(*poses)))

    def step(self, torque: Float64) -> None:
        for engine, part in zip(self._engines, self._parts):
            engine.step(torque[part], self.timestep)

    def add_velocity(self, velocity: Float64) -> None:
        for engine, part in zip(self._engines, self._parts):
            engine.add_velocity(velocity[part])

    def close(self) -> None:
        self._engines.clear()


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    scene: Scene,
    timestep: float | None = None,
    passive: Passive = "keep",
    device: str = "cpu",
    solver: Solver | None = None,
) -> NewtonPlatform:
    """Build the platform.

    Args:
        states: with `num_robots` set, as many robots are simulated, each in a world of its own.
        robot: its joints are found in the model by name.
        period: of a tick in [s].
        scene: how it begins.
        timestep: physics step in [s], that of the model unless said.
        passive: damping of the joints in the model: `keep` it beside that of the command, or
            `replace` it by that.
        device: of Warp: `cpu`, `cuda:0`, ….
        solver: `mujoco` or `warp`; unless said `mujoco` on the CPU, and `warp` elsewhere.

    Raises:
        PlatformError: no such device, the solver has it not, or Newton refuses the model.
    """
    newton, warp = _imported(device)
    if solver == "mujoco" and device != "cpu":
        raise PlatformError("platform 'newton': solver mujoco has device cpu alone; give warp")
    setup = setup_of(states, robot, period, scene, timestep, passive)
    start = setup.start
    world, numbers = build_world(newton, warp, start, robot, setup.figures)
    start.loaded.notes += not_told(start)
    joints = [numbers[name] for name in robot.joint_names]
    count = setup.num_robots
    options = solver_options(start)

    def engine(builder: Any, **more: Any) -> Engine:
        model = builder.finalize()
        with _noted(start.loaded.notes.append):
            solving = newton.solvers.SolverMuJoCo(model, **options, **more)
        if more:  # a robot that blew up would go on from where it began, and nobody would know
            off = int(import_mujoco().mjtDisableBit.mjDSBL_AUTORESET)
            solving.mj_model.opt.disableflags |= off
        return Engine(model, solving, joints)

    with patience(_COMPILES), warp.ScopedDevice(device):
        if (solver or ("mujoco" if device == "cpu" else "warp")) == "mujoco":
            engines = [engine(world, use_mujoco_cpu=True) for _ in range(count)]
        else:
            worlds = newton.ModelBuilder(gravity=warp.vec3(*start.gravity))
            newton.solvers.SolverMuJoCo.register_custom_attributes(worlds)
            worlds.replicate(world, count)
            engines = [engine(worlds)]
        return NewtonPlatform(engines, setup)


def _imported(device: str) -> tuple[Any, Any]:
    """Return the modules newton and warp, which is to use a device.

    Raises:
        MissingDependencyError: newton is not installed.
        PlatformError: newton is installed without its part `sim`, or there is no such device.
    """
    import_mujoco()  # our way, without a window library
    try:
        import newton
        import warp
        from newton.solvers import SolverMuJoCo

        SolverMuJoCo.import_mujoco()
    except ImportError as error:
        install = "pip install 'unicon_ros[sim-newton]'"
        if find_spec("newton") is not None:
            raise PlatformError(
                "platform 'newton': newton is installed without its part sim "
                f"({one_line(error)}): {install}"
            ) from error
        raise MissingDependencyError("platform 'newton'", "newton", install) from error
    warp.config.log_level = max(warp.config.log_level, warp.LOG_ERROR)
    with quiet(2):  # that there is no CUDA is nothing to complain of
        warp.init()
    names = [str(known) for known in warp.get_devices()]
    if device not in names:
        raise PlatformError(
            f"platform 'newton': device is {device!r}; {alternatives(device, names)}"
        )
    return newton, warp


@contextmanager
def _noted(note: TextSink) -> Iterator[None]:
    """Tell warnings as notes, and what Newton refuses as a PlatformError."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            yield
        except (NotImplementedError, ValueError) as error:
            raise PlatformError(f"platform 'newton': {one_line(error)}") from error
        finally:
            for text in dict.fromkeys(" ".join(str(one.message).split()) for one in told):
                note(f"newton: {text}")
