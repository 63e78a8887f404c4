"""Genesis behind the platform contract, for workflows that say `platform: genesis`."""

from __future__ import annotations

from typing import Any

import numpy as np

from unicon_core.errors import Fault, ModelError
from unicon_core.platforms.kit.base import Float, WorldPose, rotation
from unicon_core.platforms.kit.joint_model import Passive
from unicon_core.platforms.kit.patience import patience
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.kit.stepped import Setup, SteppedSimulator, setup_of
from unicon_core.platforms.platform import SIMULATED, Facts
from unicon_core.platforms.sim.genesis.engine import begun, built
from unicon_core.platforms.sim.genesis.model import adapted, otherwise
from unicon_core.robots import Robot
from unicon_core.states import States


class GenesisPlatform(SteppedSimulator):
    """Robots in the surroundings of their model, each in a world of its own; built by `make`."""

    facts = Facts(
        "genesis",
        simulated=True,
        batch=True,
        writes=SIMULATED,
        physics=("strength", "friction", "armature", "delay"),
    )
    represents = frozenset(
        {
            *("armature", "damping", "friction", "limits"),
            *("self-collision", "meshes", "contact friction", "constraints", "terrain"),
        }
    )

    def __init__(self, genesis: Any, setup: Setup) -> None:
        count, start = setup.num_robots, setup.start
        loaded = start.loaded
        self._begin = np.tile(start.qpos, (count, 1))
        self._broken = genesis.GenesisException
        try:
            model = adapted(start, setup.figures)
            self._scene, self._robots = built(genesis, model, setup.timestep, self._begin)
        except self._broken as error:
            raise ModelError(f"model {loaded.path}: Genesis says: {_line(error)}") from error
        # Its coordinates are MuJoCo's: the same joints in the same order.
        model = loaded.model
        self._at, self._rates = loaded.addresses, model.jnt_dofadr[loaded.joints]
        at, rate = (
            (0, 0)
            if loaded.base is None
            else (int(array[loaded.base]) for array in (model.jnt_qposadr, model.jnt_dofadr))
        )
        self._place, self._turn = slice(at, at + 3), slice(at + 3, at + 7)
        self._linear, self._angular = slice(rate, rate + 3), slice(rate + 3, rate + 6)
        self._forces = np.zeros((count, model.nv))
        super().__init__(setup, otherwise(start))

    def place(self) -> None:
        self._scene.reset()
        self._robots.set_qpos(self._begin, zero_velocity=True)

    def joints(self) -> tuple[Float, Float]:
        return self._positions()[:, self._at], self._velocities()[:, self._rates]

    def base(self) -> WorldPose:
        pos, vel = self._positions(), self._velocities()
        quat, own = pos[:, self._turn], vel[:, self._angular, None]
        # As MuJoCo: velocity of the origin in the world, rates about the base's own axes.
        rates = (rotation(quat) @ own)[..., 0]
        return WorldPose(pos[:, self._place], quat, vel[:, self._linear], rates)

    def step(self, torque: Float) -> None:
        self._forces[:, self._rates] = torque
        self._robots.control_dofs_force(self._forces)
        try:
            self._scene.step(update_visualizer=False)
        except self._broken as error:  # it looks every tenth step
            raise Fault(f"the physics blew up: Genesis says: {_line(error)}") from error

    def add_velocity(self, velocity: Float) -> None:
        vel = self._velocities()
        vel[:, self._linear] += velocity
        self._robots.set_dofs_velocity(vel)

    def close(self) -> None:
        self._scene.destroy()

    def _positions(self) -> Float:
        """Return MuJoCo's `qpos` of all worlds, shape (N, nq), float64."""
        return np.asarray(self._robots.get_qpos().cpu().numpy(), np.float64)

    def _velocities(self) -> Float:
        """Return the velocities of all degrees of freedom, shape (N, nv), float64."""
        return np.asarray(self._robots.get_dofs_velocity().cpu().numpy(), np.float64)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    scene: Scene,
    timestep: float | None = None,
    passive: Passive = "keep",
) -> GenesisPlatform:
    """Build the platform.

    Args:
        states: with `num_robots` set, as many robots are simulated, each in a world of its own.
        robot: its joints are found in the model by name.
        period: of a tick in [s].
        scene: how it begins.
        timestep: physics step in [s], None for the model's.
        passive: damping of the joints in the model: `keep` it beside that of the command, or
            `replace` it by that.

    Raises:
        MissingDependencyError: Genesis is not installed.
        ModelError: Genesis does not take the model.
    """
    with patience("genesis: compiling its kernels, some 90 s the first time, 20 s from then on"):
        genesis = begun()
        setup = setup_of(states, robot, period, scene, timestep, passive)
        return GenesisPlatform(genesis, setup)
