"""Body: the physics of an emulated robot: MuJoCo where its model is there, else joints alone.

CommandLog: what an emulated robot saw of its commands, as JSON lines, for tests and users.

| kind | says |
|---|---|
| `ready` | it is there: robot, rate [Hz], model, posture, `command` that reaches it or `refused` |
| `first` | how far the first command, and each after a silence, was from where joints were, [rad] |
| `command` | every command, where that was asked for, with its largest stiffness, [N·m/rad] |
| `commands` | after every 50 of them: how many, the largest distance and step between two, [rad] |
| `ignored` | the first command of some that came while the robot does not obey |
| `refused` | the same of commands that are not finite |
| `silence` | no command has come for a while |
| `late` | frames of the last second that a busy machine missed; the robot's time stood still then |
| `let go` | the gantry holds it no longer |
| `damping` | no joint has stiffness any more, `by` a command or the robot's own dead man |
| `ended` | frames that were, those that a busy machine missed, and how far the base moved, [m] |

`after` is the time of Python's `time.monotonic`, `silent` how long no command has come, in [s].
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import MissingDependencyError, ModelError, PlatformError, TextSink
from unicon_base.arrays import Float32
from unicon_core.platforms.fake import FakePlatform
from unicon_core.platforms.kit.disturbances import disturb
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.kit.start import let_go, start_of
from unicon_core.platforms.platform import Platform
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import JOINT_STATES
from unicon_core.workflow.registry import find_factory

JOINTS_ALONE = "fake"
"""In place of a model: joints follow their targets, the base stands still."""
POSTURES = ("rest", "default", "random")
NOISE = {
    "joint_pos": 1e-4,
    "joint_vel": 1e-3,
    "base_quat": 1e-4,
    "base_ang_vel": 2e-3,
    "base_lin_acc": 0.02,
}
"""Standard deviation of what sensors tell, in the states' units: of a good encoder and a MEMS."""
STEP = 0.002
"""Longest physics step in [s]."""
TIME_CONSTANT = 0.03
"""Of joints without a model, in [s]."""
SINKING = 20.0
"""Time constant with which they sink where they are limp, in [s]."""
LIFT = 0.3
"""How far above the floor a robot hangs that would stand on it, in [m]."""
SPARE = 0.05
"""Share of a joint's range that a posture drawn at random keeps from either limit."""


@dataclass(frozen=True)
class Body:
    """The physics of one robot.

    Attributes:
        platform: a simulator, whose states are those of the face.
        model: the file that it was read from; None of joints alone.
        let_go: takes the gantry from its base; None where nothing holds it.
    """

    platform: Platform
    model: Path | None
    let_go: Callable[[], None] | None


def body_of(
    states: States,
    robot: Robot,
    period: float,
    *,
    model: str | None = None,
    posture: str = "rest",
    hang: bool = False,
    lift: float = LIFT,
    seed: int = 0,
    still: bool = False,
    warn: TextSink,
) -> Body:
    """Build the physics.

    Args:
        period: of a tick in [s].
        model: as of a scene, or `fake` for joints alone; None for the robot's own, if it is there.
        posture: one of `POSTURES`, in which it begins.
        hang: its base is held.
        lift: how far above where it would stand, in [m].
        seed: of posture and noise.
        still: no noise.
        warn: takes why there is no model, where there is none.

    Raises:
        ModelError: the model that was given is wrong.
        MissingDependencyError: mujoco is not installed, and a model was given.
        PlatformError: no such posture or seed, or it cannot hang.
    """
    if posture not in POSTURES:
        raise PlatformError(f"posture {posture!r}; known: {', '.join(POSTURES)}")
    file = None if model == JOINTS_ALONE else model
    scene = Scene(file, posture if posture != "random" else "default", seed=seed, folder=Path.cwd())
    if posture == "random":
        scene = replace(scene, pose=random_posture(robot, np.random.default_rng(seed)))
    platform: Any = None
    path: Path | None = None
    free: Callable[[], None] | None = None
    if model != JOINTS_ALONE:
        try:
            platform, base = _simulated(states, robot, period, scene, lift if hang else None)
            path = platform.model_path
            if base is not None:
                free = partial(let_go, platform.model, base)
        except (MissingDependencyError, ModelError) as error:
            if model is not None:
                raise
            warn(f"without a model, joints alone are emulated (--model FILE gives one): {error}")
    if platform is None:
        platform = JointsAlone(states, robot, period, scene)
    if not still:
        noise = {name: std for name, std in NOISE.items() if name in platform.facts.writes}
        platform = disturb(platform, replace(scene, noise=noise), states, robot, period)
    return Body(platform, path, free)


def random_posture(robot: Robot, random: np.random.Generator) -> Float32:
    """Return joint positions within the limits in [rad], shape (n,); default where unknown."""
    spare = SPARE * (robot.upper - robot.lower)
    known = np.isfinite(spare)
    lower = np.where(known, robot.lower + spare, robot.default_joint_pos)
    upper = np.where(known, robot.upper - spare, robot.default_joint_pos)
    return np.nan_to_num(random.uniform(lower, upper)).astype(np.float32)


class JointsAlone(FakePlatform):
    """Joints without a model, no faster than the robot's.

    Limp ones sink towards the middle of their range, as on a gantry.
    """

    def __init__(self, states: States, robot: Robot, period: float, scene: Scene) -> None:
        super().__init__(states, robot, period, replace(scene, model=None), TIME_CONSTANT)
        ends = np.stack((robot.lower, robot.upper))
        known = np.isfinite(ends).all(axis=0)
        self._middle = np.where(known, 0.5 * ends.sum(axis=0, where=known), self._pos)
        self._sunk = np.float32(-math.expm1(-period / SINKING))
        self._step_most = np.nan_to_num(robot.velocity_limit * np.float32(period), nan=np.inf)
        self._before = self._pos.copy()

    def send(self) -> bool | None:
        """Move the joints for one tick.

        Raises:
            Fault: a command is not finite.
        """
        self._before[...] = self._pos
        super().send()
        limp = self._command.rows[3] <= 0.0
        self._pos += limp * self._sunk * (self._middle - self._pos)
        step = np.clip(self._pos - self._before, -self._step_most, self._step_most)
        self._pos[...] = self._before + step
        self._vel[...] = step / np.float32(self._period)
        return None


def _simulated(
    states: States, robot: Robot, period: float, scene: Scene, lift: float | None
) -> tuple[Any, int | None]:
    make = find_factory("platforms", "mujoco", PlatformError)
    base: int | None = None
    if lift is not None:
        start = start_of(robot, scene)
        base = start.loaded.base
        if base is None:
            raise PlatformError(
                f"the base of robot {robot.name} does not move in {start.loaded.path}; it need not "
                "hang"
            )
        scene = replace(scene, gantry=True, initial_height=float(start.position[2]) + lift)
    # A whole number of steps in a tick.
    timestep = period / math.ceil(period / STEP - 1e-9)
    return make(states, robot, period, scene=scene, timestep=timestep), base


@dataclass(frozen=True)
class Defects:
    """What is wrong with a robot; joints by their numbers.

    Attributes:
        swapped: two joints whose encoders are exchanged, or none.
        dead: joints whose motors do nothing.
        imu_upside_down: the IMU is mounted on its head: turned by half a turn about its x axis.
        rate: of the frames in [Hz], less than the face's; None for that.
        leaves: a joint whose motor leaves the commanded mode, and how long after the first command
            that acts, [s]; None for none.
    """

    swapped: tuple[int, ...] = ()
    dead: tuple[int, ...] = ()
    imu_upside_down: bool = False
    rate: float | None = None
    leaves: tuple[int, float] | None = None

    def sensed(self, states: States) -> None:
        """Change what was measured."""
        if self.swapped:
            there, back = list(self.swapped), list(reversed(self.swapped))
            for name in JOINT_STATES:
                states[name][there] = states[name][back]
        if self.imu_upside_down:
            for name in ("base_ang_vel", "base_lin_acc", "projected_gravity"):
                states[name][1:] *= -1.0
            w, x, y, z = states["base_quat"].tolist()
            states["base_quat"][...] = (-x, w, z, -y)  # q (0, 1, 0, 0)

    def acted(self, states: States) -> None:
        """Change what the motors do."""
        if self.dead:
            dead = list(self.dead)
            for name in ("joint_stiffness", "joint_damping", "joint_effort_ff"):
                states[name][dead] = 0.0


Say = Callable[..., None]

TOLD_EVERY = 50


def say(kind: str, **facts: Any) -> None:
    """Say a JSON line on standard output."""
    print(json.dumps({"kind": kind, **facts}), flush=True)


class CommandLog:
    """Follows the commands of one robot.

    Args:
        states: whose command states are those that act.
        names: of the joints.
        say: takes kind and facts of a line.
        each: say every command.

    Attributes:
        count: commands that acted.
    """

    def __init__(
        self, states: States, names: Sequence[str], say: Say, *, each: bool = False
    ) -> None:
        self._target, self._stiffness = states["joint_pos_target"], states["joint_stiffness"]
        self._names, self._say, self._each = tuple(names), say, each
        self._before = np.zeros_like(self._target)
        self.count, self._worst, self._step = 0, 0.0, 0.0
        self._watched = self._stiff = False
        self._left: set[str] = set()

    def command(self, now: float, pos: Float32) -> None:
        """Take note of a command that acts; the joints are at `pos` in [rad], shape (n,)."""
        away = np.abs(self._target - pos)
        worst = float(away.max())
        self.count += 1
        self._worst = max(self._worst, worst)
        self._left.clear()
        if self._each:
            stiffness = float(self._stiffness.max())
            target = self._target.tolist()
            self._say("command", stamp=now, distance=worst, stiffness=stiffness, target=target)
        if not self._watched:
            self._say("first", distance=worst, joint=self._names[int(away.argmax())])
        else:
            self._step = max(self._step, float(np.abs(self._target - self._before).max()))
        self._watched = True
        self._before[...] = self._target
        stiff = bool(self._stiffness.any())
        if self._stiff and not stiff:
            self._say("damping", by="command", after=now, silent=0.0, moved=worst)
        self._stiff = stiff
        if self.count % TOLD_EVERY == 0:
            self.total()
            self._step = 0.0

    def left(self, kind: str) -> None:
        """Take note of a command that does not act: `ignored` or `refused`; the first is told."""
        if kind not in self._left:
            self._left.add(kind)
            self._say(kind, count=self.count)

    def silence(self, now: float, silent: float) -> None:
        """Take note that no command comes, once."""
        if self._watched:
            self._watched = False
            self._say("silence", after=now, silent=silent)

    def dead_man(self, now: float, silent: float) -> None:
        """Take note that the robot damps by itself."""
        self._stiff = False
        self._say("damping", by="dead man", after=now, silent=silent, moved=0.0)

    def total(self) -> None:
        """Say how many commands there were."""
        self._say("commands", count=self.count, worst=self._worst, step=self._step)
