"""Emulator: a robot that is not there, behind its own protocol, in real time; `unicon emulate`.

    emulator = emulated(load_robot("go2"), face, {"address": "127.0.0.1"}, posture="rest")
    emulator.run(60.0)

A tick is a frame of the robot: sensors, `face.tell`, `face.hear`, motors. What the vendor's robot
does by itself happens here: until it has obeyed a command its own controller holds the posture in
which it began; commands do not act while the face does not obey; and without any for
`face.dead_man` it damps, until the next one. Torques are limited by the servo.
"""

from __future__ import annotations

import json
import os
import shlex
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from unicon_base import AnyMapping, Fault, PlatformError, RobotError, TextSink, UniconError
from unicon_base.resources import find_config
from unicon_core.pacing import Pacing, WallClock, prepare_process
from unicon_core.platforms.kit.command import FiniteCheck, LastSent
from unicon_core.robots import Robot, robot_names
from unicon_core.states import States, standard_states
from unicon_core.states.standard import COMMAND_STATES, hardware_states
from unicon_core.workflow.autowire import read_options
from unicon_core.workflow.hardware import refuse_incomplete
from unicon_hardware.emulate.body import Body, CommandLog, Defects, Say, body_of, say
from unicon_hardware.endpoint import Endpoint

SILENCE = 0.5
"""After so long without a command, or its dead man's time, the next one is a first one, [s]."""
LATE = 0.1
"""Share of a second's frames that a busy machine may miss untold."""
CATCH_UP = 0.05
"""A busy machine may be late by so much and the robot makes up for it, [s]: bodies never stop."""
FASTEST = 5000.0
"""Of faces in [Hz]: a tick of Python takes 0.1 ms."""
ROOM_TEMPERATURE = 25.0
"""Of motors in [°C]."""

WORKFLOW = "h1_stand"
"""What `reaching` runs: it goes to the default pose; any robot does."""


class Emulator:
    """One robot.

    Args:
        states: of the emulated robot: standard ones, and those of its hardware.
        robot: its file.
        face: its end of the protocol, over these states.
        body: its physics, over these states.
        defects: what is wrong with it.
        let_go: so long after the first command its gantry lets go, [s].
        say: takes what it saw, see `CommandLog`.
        each: say every command.

    Attributes:
        ticks: so many have been.
        missed: so many have been left out, since the machine was too busy.
    """

    def __init__(
        self,
        states: States,
        robot: Robot,
        face: Endpoint,
        body: Body,
        *,
        defects: Defects | None = None,
        let_go: float = float("inf"),
        say: Say = say,
        each: bool = False,
    ) -> None:
        self._states, self._face, self._body = states, face, body
        self._let_go, self._goes_at = let_go, float("inf")
        self._leaves_at = float("inf")
        self._say = say
        self._defects = defects or Defects()
        self._names = robot.joint_names
        self._share = (self._defects.rate or face.rate) / face.rate
        self._owed = 1.0 - self._share
        self._pos = np.zeros_like(states["joint_pos"])
        self._own = {
            "joint_stiffness": np.nan_to_num(robot.joint_stiffness, nan=1.0),
            "joint_damping": np.nan_to_num(robot.joint_damping),
        }
        self._own_loop = robot.position_controlled
        commands = {name: states[name] for name in COMMAND_STATES}
        self._commands = commands
        self._finite = FiniteCheck(commands, robot.joint_names)
        self._acting = LastSent(states)
        self._telling = CommandLog(states, robot.joint_names, say, each=each)
        self._heard, self._obeyed, self._damped = 0.0, False, False
        self._stop = self._closed = False
        self.ticks = self.missed = 0
        states["motor_temperature"][...] = ROOM_TEMPERATURE
        body.platform.recv()
        self._began = states["base_pos_w"].copy()
        self._hold()
        posture = dict(zip(robot.joint_names, states["joint_pos"].astype(float).round(4).tolist()))
        say(
            "ready",
            robot=robot.name,
            protocol=robot.transport.get("protocol"),
            where=getattr(face, "where", ""),
            **reaching(robot, face),
            rate=face.rate,
            model=body.model and str(body.model),
            posture=posture,
        )

    def tick(self, now: float) -> None:
        """Be a robot for one frame.

        Args:
            now: time in [s] that only grows, of `time.monotonic`.

        Raises:
            Fault: the physics blew up.
        """
        states, face = self._states, self._face
        face.now = now
        self._body.platform.recv()
        self._pos[...] = states["joint_pos"]
        self._defects.sensed(states)
        self._owed += self._share
        if self._owed >= 1.0 - 1e-9:
            self._owed -= 1.0
            face.tell()
        if now >= self._leaves_at:
            self._leave(now)
        if face.hear():
            self._take(now)
        elif self._obeyed:
            self._mind(now)
        self._defects.acted(states)
        if now >= self._goes_at and self._body.let_go is not None:
            self._goes_at = float("inf")
            self._body.let_go()
            self._say("let go", after=now)
        self._body.platform.send()
        self.ticks += 1

    def _leave(self, now: float) -> None:
        """Let the motor leave its mode that is to."""
        assert self._defects.leaves is not None
        joint, _ = self._defects.leaves
        self._face.modes.leave(joint)  # type: ignore[attr-defined]  # `emulated` has looked
        self._leaves_at = float("inf")
        self._say("left its mode", joint=self._names[joint], after=now)

    def _hold(self) -> None:
        """Let the robot's own controller hold where it is."""
        states = self._states
        states["joint_pos_target"][...] = states["joint_pos"]
        for name, gain in self._own.items():
            states[name][...] = gain
        self._acting.note()

    def _take(self, now: float) -> None:
        """Let the command act that has come, or leave it."""
        kind = "" if self._face.obeys else "ignored"
        try:
            self._finite()
        except Fault:
            kind = "refused"
        if kind:
            self._telling.left(kind)
            for name, view in self._commands.items():
                view[...] = self._acting.states[name]
            if self._obeyed:
                self._mind(now)
            return
        if self._own_loop:
            for name, gain in self._own.items():
                self._states[name][...] = gain
        if not self._obeyed:
            self._goes_at = now + self._let_go
            if self._defects.leaves is not None:
                self._leaves_at = now + self._defects.leaves[1]
        self._heard, self._obeyed, self._damped = now, True, False
        self._acting.note()
        self._telling.command(now, self._pos)

    def _mind(self, now: float) -> None:
        """Look how long no command has come."""
        silent, dead_man = now - self._heard, self._face.dead_man
        if silent > min(SILENCE, dead_man):
            self._telling.silence(now, silent)
        if silent <= dead_man or self._damped:
            return
        self._damped = True
        for name, view in self._commands.items():
            view[...] = self._own[name] if name == "joint_damping" else 0.0
        self._states["joint_pos_target"][...] = self._pos
        self._acting.note()
        self._telling.dead_man(now, silent)

    def stop(self) -> None:
        """Let `run` end after its tick."""
        self._stop = True

    def run(self, duration: float = float("inf")) -> None:
        """Tick in real time until stopped, at most so many seconds.

        A tick that is late counts as one of the moment when it was due, and those behind it follow
        at once. Where the machine is late by more than `CATCH_UP`, ticks are left out and counted:
        meanwhile the robot's time stands still, and a driver sees a pause. A second with more than
        `LATE` of them left out is told.

        Raises:
            Fault: the physics blew up.
        """
        period, wait, now = round(1e9 / self._face.rate), WallClock(0).until, time.perf_counter_ns
        restore = prepare_process(Pacing(), lambda _: None)
        due = begun = now()
        zero = time.monotonic() - begun * 1e-9
        second, before = begun + 1_000_000_000, 0
        try:
            while not self._stop and due - begun < duration * 1e9:
                if due >= second:
                    missed = self.missed - before
                    if missed > LATE * self._face.rate:
                        self._say("late", missed=missed, of=round(self._face.rate))
                    second, before = due + 1_000_000_000, self.missed
                self.tick(zero + due * 1e-9)
                due += period
                late = now() - due
                if late > CATCH_UP * 1e9:
                    self.missed += late // period
                    due += late // period * period
                elif late < 0:
                    wait(due)
        finally:
            restore()
            self._telling.total()
            moved = (self._states["base_pos_w"] - self._began).astype(float).round(3).tolist()
            self._say("ended", ticks=self.ticks, missed=self.missed, moved=moved)

    def close(self) -> None:
        """Let go of face and physics; safe to call twice."""
        if not self._closed:
            self._closed = True
            try:
                self._face.close()
            finally:
                self._body.platform.close()


def emulated(
    robot: Robot,
    factory: Callable[..., Endpoint],
    options: AnyMapping | None = None,
    *,
    name: str = "",
    defects: Defects | None = None,
    let_go: float | None = None,
    say: Say = say,
    each: bool = False,
    warn: TextSink = print,
    **body: Any,
) -> Emulator:
    """Build an emulated robot.

    Args:
        robot: its file; what its transport says is what the face tells.
        factory: of the face: `face(states, robot, **options)`.
        options: of the face.
        name: of the face, for messages; the robot's protocol if left out.
        defects: what is wrong with it.
        let_go: it is held upright where it stands, until so long after the first command, [s].
        say: takes what it saw.
        each: say every command.
        warn: takes what is told to the user.
        body: further arguments of `body_of`.

    Raises:
        UniconError: an option is wrong, an address is taken, or the physics cannot be built.
    """
    name = f"face {name or robot.transport.get('protocol')!r}"
    options = read_options(factory, options or {}, lambda text, *_: PlatformError(f"{name}{text}"))
    states = States({**standard_states(robot.joint_names), **hardware_states(robot.joint_names)})
    try:
        face = factory(states, robot, **options)
    except (TypeError, ValueError) as error:
        raise PlatformError(f"{name}: {error}; correct its options (--set)") from error
    except OSError as error:
        raise PlatformError(
            f"{name} cannot be served: {error.strerror}; end the program that is there, or give "
            "another --address"
        ) from error
    try:
        rate = face.rate
        if not 0.0 < rate <= FASTEST:
            raise PlatformError(f"{name} says a rate of {rate} Hz; give more than 0, at most 5000")
        slower = defects.rate if defects else None
        if slower is not None and not 0.0 < slower <= rate:
            raise UniconError(f"--rate {slower:g}: the robot tells at {rate:g} Hz; give less")
        if defects and defects.leaves and not hasattr(face, "modes"):
            raise UniconError(
                f"--leave: {name} reports no mode of a motor; leave it out, or take another robot"
            )
        if let_go is not None:
            body |= {"hang": True, "lift": 0.0}
        physics = body_of(states, robot, 1.0 / rate, warn=warn, **body)
        goes = float("inf") if let_go is None else let_go
        return Emulator(
            states, robot, face, physics, defects=defects, let_go=goes, say=say, each=each
        )
    except BaseException:
        face.close()
        raise


def reaching(robot: Robot, face: Endpoint) -> dict[str, str]:
    """Return `command`, which drives an emulated robot to its default pose in a shell.

    A robot whose file lacks what driving it needs has none, and `refused` says what is lacking.

    Args:
        robot: its file.
        face: its end of the protocol; without attributes `platform` and `reach` no command is
            known, and the text is empty.
    """
    platform, reach = getattr(face, "platform", ""), getattr(face, "reach", {})
    if not platform:
        return {"command": ""}
    try:
        refuse_incomplete(robot, platform)
    except RobotError as error:
        return {"command": "", "refused": str(error)}
    settings = {"robot": _named(robot), "platform": platform}
    settings |= {f"platforms.{platform}.{option}": value for option, value in reach.items()}
    words = ["unicon", "run", WORKFLOW]
    for path, value in settings.items():
        shown = value if isinstance(value, str) else json.dumps(value)
        words += ["--set", f"{path}={shown}"]
    domain = os.environ.get("ROS_DOMAIN_ID") if platform == "ros" else None
    domains = [f"ROS_DOMAIN_ID={domain}"] if domain else []
    return {"command": shlex.join([*domains, *words, "--yes"])}


def _named(robot: Robot) -> str:
    """Return what finds the robot's file from anywhere: its name, else its path."""
    if robot.name in robot_names():
        found = find_config("robots", robot.name, ".yaml", error=RobotError)
        if found.samefile(robot.path):
            return robot.name
    return str(robot.path.resolve())
