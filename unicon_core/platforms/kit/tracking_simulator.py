"""A simulator beside a robot: put where the robot was measured, then given the same commands.

beside = Beside(make, robot, period, scene)
beside.put(measured)
joint_pos = beside.step(commands)      # open loop, one tick later
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from unicon_base.arrays import Array, Float32
from unicon_base.errors import PlatformError
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.platform import Placeable, Platform
from unicon_core.robots import Robot
from unicon_core.states import States, standard_states
from unicon_core.states.standard import BASE_STATES, COMMAND_STATES

PLACE = ("joint_pos", "joint_vel", "base_quat", "base_ang_vel", "base_pos_w", "base_lin_vel")
"""States that say where a robot is; those of the base as far as they are measured."""


class Beside:
    """See the module.

    Args:
        make: factory of the simulator.
        robot: the robot.
        period: of a tick in [s].
        scene: model and joints; noise, delay, pushes and seed of it are left out.
        options: of the factory.

    Attributes:
        states: of its own.
        platform: the simulator.

    Raises:
        PlatformError: the simulator cannot be put anywhere.
        UniconError: it cannot be built.
    """

    def __init__(
        self,
        make: Callable[..., Platform],
        robot: Robot,
        period: float,
        scene: Scene,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        self.states = States(standard_states(robot.joint_names))
        calm = replace(scene, seed=0, noise={}, push={}, delay=0)
        self.platform = make(self.states, robot, period, scene=calm, **(options or {}))
        if not isinstance(self.platform, Placeable):
            name = self.platform.facts.name
            self.platform.close()
            raise PlatformError(
                f"platform {name!r} cannot be put where a robot was measured; use mujoco"
            )
        self._put = self.platform.put
        self._commands = [(name, self.states[name]) for name in COMMAND_STATES]
        self.moves = any(name in self.platform.facts.writes for name in BASE_STATES)
        """Whether it has a base that moves."""

    def put(self, measured: Mapping[str, Array]) -> None:
        """Put it where a robot was measured, as far as `measured` says; see `Placeable`."""
        self._put(measured)

    def step(self, commands: Mapping[str, Array] | States) -> Float32:
        """Simulate one tick under commands; return the joint positions at its end, shape (n,).

        Raises:
            Fault: a command is not finite, or the physics blew up.
        """
        for name, view in self._commands:
            view[...] = commands[name]
        self.platform.send()
        self.platform.recv()
        return self.states["joint_pos"]

    def close(self) -> None:
        """Let go of the simulator."""
        self.platform.close()
