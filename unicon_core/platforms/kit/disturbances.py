"""Around a simulator: noise, delay and pushes of `scene:`, and `Beside`, which tracks a robot.

beside = Beside(make, robot, period, scene)
beside.put(measured)
joint_pos = beside.step(commands)      # open loop, one tick later
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from unicon_base import AnyMapping, PlatformError, alternatives
from unicon_base.arrays import Array, Float32
from unicon_core.memory import load, save
from unicon_core.platforms.kit.command import Command
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.platform import Placeable, Platform, Pushable
from unicon_core.robots import Robot
from unicon_core.states import States, standard_states
from unicon_core.states.standard import BASE_STATES, COMMAND_STATES

_METHODS = ("reset", "change", "save", "load")


def disturb(
    platform: Platform, scene: Scene, states: States, robot: Robot, period: float
) -> Platform:
    """Put a scene's disturbances around a platform's recv, send and reset; return the platform.

    Raises:
        PlatformError: it does not write what noise is asked for, or cannot be pushed.
    """
    if not scene.disturbed:
        return platform
    around = Disturbances(platform, scene, states, robot, period)
    # In place: what else it can do, it still can.
    for method in ("recv", "send", "reset", *around.own):
        setattr(platform, method, getattr(around, method))
    return platform


def _refuse(platform: Platform, scene: Scene) -> None:
    """Refuse what a platform cannot be disturbed with."""
    name = platform.facts.name
    writes = set(platform.facts.writes) - {"stamp_ns"}
    for state in scene.noise:
        if state not in writes:
            raise PlatformError(
                f"scene.noise: platform {name!r} measures no {state!r}; "
                f"{alternatives(state, writes)}"
            )
    if scene.push and not ("base_lin_vel" in writes and isinstance(platform, Pushable)):
        raise PlatformError(f"scene.push: platform {name!r} cannot push a base; leave push out")


class Disturbances:
    """What stands in place of the platform's own recv, send and reset; see `disturb`.

    Attributes:
        own: methods of the platform itself that it has and others may not, by their names.
    """

    memory = ("_rngs", "_ticks", "_queue")

    def __init__(
        self, platform: Platform, scene: Scene, states: States, robot: Robot, period: float
    ) -> None:
        self._recv = platform.recv
        self._send = platform.send
        self.own: dict[str, Callable[..., Any]] = {
            name: getattr(platform, name) for name in _METHODS if hasattr(platform, name)
        }
        self._push = platform.push if isinstance(platform, Pushable) else None
        self._platform = platform
        self._states = states
        self._period = period
        self._batch = states.num_robots
        self._views = [states[name] for name in platform.facts.reads]
        self._command = Command(states, robot.joint_names, dtype=np.float32)
        self._take(scene)

    def _take(self, scene: Scene) -> None:
        """Take what a scene says, and begin."""
        _refuse(self._platform, scene)
        states = self._states
        self._seed = scene.seed
        self._noise = [(states[name], np.float32(std)) for name, std in scene.noise.items()]
        self._quat = states["base_quat"] if "base_quat" in scene.noise else None
        every = float(scene.push.get("every", 0.0)) / self._period
        self._push_ticks = max(round(every), 1) if scene.push else 0
        self._largest = float(scene.push.get("velocity", 0.0))
        self._delay = scene.delay
        self._begin()

    def _begin(self) -> None:
        count = self._batch or 1
        self._rngs = [np.random.default_rng((self._seed, k)) for k in range(count)]
        self._ticks = 0
        self._queue: deque[list[Array]] = deque(maxlen=self._delay + 1)

    def recv(self) -> bool | None:
        """Add noise to what was measured."""
        gone = self._recv()
        for view, std in self._noise:
            for k, rng in enumerate(self._rngs):
                one = view if self._batch is None else view[k]
                one += std * rng.standard_normal(one.shape, dtype=np.float32)
        if self._quat is not None:
            self._quat /= np.linalg.norm(self._quat, axis=-1, keepdims=True)
        return gone

    def send(self) -> bool | None:
        """Push where it is time, then send what was commanded some ticks before.

        Raises:
            Fault: a command is not finite.
        """
        if self._push_ticks and self._ticks and self._ticks % self._push_ticks == 0 and self._push:
            pushes = [rng.uniform(-self._largest, self._largest, 2) for rng in self._rngs]
            self._push(np.array(pushes[0] if self._batch is None else pushes))
        self._ticks += 1
        if not self._delay:
            return self._send()
        self._command.take()  # what is wrong is told now, not when it would arrive
        now = [view.copy() for view in self._views]
        # Before the first command arrives the motors hold what it says.
        self._queue.extend([now] * (1 if self._queue else self._delay + 1))
        try:
            self._write(self._queue[0])
            return self._send()
        finally:
            self._write(now)  # others see what was commanded

    def _write(self, values: list[Array]) -> None:
        for view, value in zip(self._views, values):
            view[...] = value

    def save(self) -> list[Any]:
        """Return what the physics and the disturbances go on from."""
        return [self.own["save"](), save(self)]

    def load(self, saved: list[Any]) -> None:
        """Go on as another platform would that was built alike."""
        self.own["load"](saved[0])
        load(self, saved[1])

    def change(self, scene: Scene) -> None:
        """Begin anew in another scene; see `Changeable`."""
        self.own["change"](scene)
        self._take(scene)

    def reset(self) -> None:
        """Begin anew, the same draws to come."""
        self.own.get("reset", bool)()
        self._begin()


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
        options: AnyMapping | None = None,
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
        # Whether it has a base that moves.
        self.moves = any(name in self.platform.facts.writes for name in BASE_STATES)

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
