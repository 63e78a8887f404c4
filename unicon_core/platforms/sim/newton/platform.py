"""The `newton` platform: NVIDIA's Newton steps a robot of its own, MuJoCo's solver inside.

Of Newton 1.8 (https://newton-physics.github.io/newton/latest/concepts/conventions.html):
quaternions are xyzw. A free joint has seven coordinates, position of the body's origin and
quaternion, and six velocities along the world's axes: of the centre of mass, then the rate. What is
in float32 there is so here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import MissingDependencyError, PlatformError, alternatives
from unicon_core.platforms.kit.base import WorldPose, rotation
from unicon_core.platforms.kit.joint_model import JointModel, Passive, joint_model
from unicon_core.platforms.kit.quiet import quiet
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.kit.start import Start, start_of
from unicon_core.platforms.kit.stepped import SteppedSimulator
from unicon_core.platforms.platform import SIMULATED, Facts
from unicon_core.platforms.sim.newton.world import build_world, solver_options
from unicon_core.robots import Robot
from unicon_core.states import States

__all__ = ["NewtonPlatform", "make"]

Float = NDArray[np.float64]


class NewtonPlatform(SteppedSimulator):
    """Robots, each in a world of its own; built by `make`."""

    facts = Facts(
        "newton",
        simulated=True,
        batch=True,
        writes=SIMULATED,
        physics=("strength", "friction", "armature", "delay"),
    )
    represents = frozenset(
        {
            "armature",
            "damping",
            "friction",
            "limits",
            "self-collision",
            "meshes",
            "contact friction",
            "terrain",
        }
    )

    def __init__(
        self,
        engines: Sequence[_Engine],
        states: States,
        robot: Robot,
        period: float,
        step: float,
        start: Start,
        figures: JointModel,
    ) -> None:
        self._engines = list(engines)
        super().__init__(states, robot, period, step, start, figures)

    def place(self) -> None:
        for engine in self._engines:
            engine.place()

    def joints(self) -> tuple[Float, Float]:
        pos, vel = zip(*(engine.joints() for engine in self._engines))
        return np.concatenate(pos, dtype=np.float64), np.concatenate(vel, dtype=np.float64)

    def base(self) -> WorldPose:
        poses = [engine.base() for engine in self._engines]
        return WorldPose(*map(np.concatenate, zip(*poses)))

    def step(self, torque: Float) -> None:
        first = 0
        for engine in self._engines:
            engine.step(torque[first : first + engine.worlds], self.timestep)
            first += engine.worlds

    def add_velocity(self, velocity: Float) -> None:
        first = 0
        for engine in self._engines:
            engine.add_velocity(velocity[first : first + engine.worlds])
            first += engine.worlds

    def close(self) -> None:
        self._engines.clear()


class _Engine:
    """A model of one world or several, its solver and its two states.

    Args:
        newton: the module.
        model: a finalized model of equal worlds.
        joints: number of Newton's joint by name, in the first world.
        robot: names the joints.
        start: where it begins.
        options: of `SolverMuJoCo`.
    """

    def __init__(
        self,
        newton: Any,
        model: Any,
        joints: dict[str, int],
        robot: Robot,
        start: Start,
        options: dict[str, Any],
    ) -> None:
        self.worlds = max(model.world_count, 1)
        self._model, self._floating = model, start.floating
        coordinates, velocities = model.joint_q_start.numpy(), model.joint_qd_start.numpy()
        numbers = [joints[name] for name in robot.joint_names]
        self._q, self._v = coordinates[numbers], velocities[numbers]
        if start.floating:
            self._centre = np.array(model.body_com.numpy()[0], np.float64)
        self._begin(start, joints)
        self._solver = newton.solvers.SolverMuJoCo(model, **options)
        self._now, self._next, self._control = model.state(), model.state(), model.control()
        self._force = np.zeros((self.worlds, model.joint_dof_count // self.worlds), np.float32)

    def _begin(self, start: Start, joints: dict[str, int]) -> None:
        """Let the model begin where the scene says: a reset goes back there."""
        q = self._rows(self._model.joint_q).copy()
        loaded, starts = start.loaded, self._model.joint_q_start.numpy()
        for name, number in joints.items():
            if name and name not in loaded.model.names.decode():
                continue
        if start.floating:
            w, x, y, z = start.quat
            q[:, :7] = *start.position, x, y, z, w
        q[:, self._q] = start.joint_pos
        self._model.joint_q.assign(q.ravel())

    def _rows(self, array: Any) -> NDArray[np.float32]:
        """Return what Newton has in one array for all worlds, one row each."""
        rows: NDArray[np.float32] = array.numpy().reshape(self.worlds, -1)
        return rows

    def place(self) -> None:
        self._control.joint_f.zero_()
        self._solver.reset(self._now)

    def joints(self) -> tuple[Any, Any]:
        """Return positions and velocities, shape (worlds, n) each, float32."""
        now = self._now
        return self._rows(now.joint_q)[:, self._q], self._rows(now.joint_qd)[:, self._v]

    def base(self) -> tuple[Float, Float, Float, Float]:
        """Return the values of a `WorldPose`, shape (worlds, 3) or (worlds, 4)."""
        pose = self._rows(self._now.joint_q)[:, :7].astype(np.float64)
        twist = self._rows(self._now.joint_qd)[:, :6].astype(np.float64)
        quat, rate = pose[:, (6, 3, 4, 5)], twist[:, 3:]
        quat /= np.linalg.norm(quat, axis=1, keepdims=True)
        centre = rotation(quat) @ self._centre  # from the origin, in the world
        return pose[:, :3], quat, twist[:, :3] - np.cross(rate, centre), rate

    def step(self, torque: Float, timestep: float) -> None:
        """Apply torques [N·m], shape (worlds, n), and step the physics."""
        self._force[:, self._v] = torque
        self._control.joint_f.assign(self._force.ravel())
        self._solver.step(self._now, self._next, self._control, None, timestep)
        self._now, self._next = self._next, self._now

    def add_velocity(self, velocity: Float) -> None:
        """Add to the bases' velocities [m/s] in the world, shape (worlds, 3)."""
        rows = self._rows(self._now.joint_qd).copy()
        rows[:, :3] += velocity
        self._now.joint_qd.assign(rows.ravel())


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    scene: Scene,
    timestep: float | None = None,
    passive: Passive = "replace",
    solver: str = "mujoco",
    device: str = "cpu",
) -> NewtonPlatform:
    """Build the platform.

    Args:
        states: with `num_robots` set, as many robots are simulated, each in a world of its own.
        robot: its joints are found in the model by name.
        period: of a tick in [s].
        scene: how it begins.
        timestep: physics step in [s], the model's unless said.
        passive: damping of the joints in the model: `keep` it beside that of the command, or
            `replace` it by that.
        solver: `mujoco`, MuJoCo's own library for each robot, or `warp`, MuJoCo Warp for all of
            them at once.
        device: of Warp: `cpu`, or `cuda:0` with `warp`.
    """
    try:
        import newton
        import warp
    except ImportError as error:
        install = "pip install 'unicon_ros[sim-newton]'"
        raise MissingDependencyError("platform 'newton'", "newton", install) from error
    warp.config.log_level = 40
    start = start_of(robot, scene)
    figures = joint_model(start, passive)
    template, joints = build_world(newton, warp, start, robot, figures)
    count = states.num_robots or 1
    step = float(start.loaded.model.opt.timestep) if timestep is None else timestep
    options = solver_options(start)
    engines = []
    with warp.ScopedDevice(device):
        if solver == "mujoco":
            for _ in range(count):
                model = template.finalize()
                engines.append(
                    _Engine(newton, model, joints, robot, start, {**options, "use_mujoco_cpu": True})
                )
        else:
            builder = newton.ModelBuilder(gravity=warp.vec3(*start.gravity))
            newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
            builder.replicate(template, count)
            engines.append(_Engine(newton, builder.finalize(), joints, robot, start, options))
    return NewtonPlatform(engines, states, robot, period, step, start, figures)
