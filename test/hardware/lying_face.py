"""Face of an emulated robot of Unitree that lies in the midst of a walk: for `test_sensor_lies.py`.

What the lie is and when it begins stands in the environment, LIES: `{"kind": "repeat", "at": 6.0}`,
in [s] after the first command. A file, `log`, gets when it began and when the commands got limp.
"""

from __future__ import annotations

import json
import os
import random
import time
from collections import deque
from typing import Any

import numpy as np

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.unitree.face import face as unitree
from unicon_hardware.unitree_legged.platform import face as unitree_legged

MEASURED = ("joint_pos", "joint_vel", "base_quat", "base_ang_vel", "base_lin_acc")
JITTER, LOSS = 0.02, 0.01
AGEING = 0.3


class Late:
    """Holds what is sent back for a while.

    Args:
        send: really.
    """

    def __init__(self, send: Any) -> None:
        self._send, self._queue = send, list[tuple[float, Any]]()
        self.delay = 0.0
        self.jitter = self.loss = 0.0

    def __call__(self, data: Any, peer: Any = None) -> None:
        if random.random() < self.loss:
            return
        due = time.monotonic() + self.delay + random.uniform(0.0, self.jitter)
        self._queue.append((due, (bytes(data), peer)))

    def flush(self) -> None:
        """Send what is due."""
        now = time.monotonic()
        due = [each for each in self._queue if each[0] <= now]
        self._queue = [each for each in self._queue if each[0] > now]
        for _, (data, peer) in sorted(due, key=lambda each: each[0]):
            self._send(data, peer)


class Liar:
    """A face whose measurements are changed on their way."""

    def __init__(self, inner: Any, states: States, robot: Robot) -> None:
        self._inner, self._states = inner, states
        told = json.loads(os.environ["LIES"])
        self._kind, self._at, self._log = told["kind"], told["at"], told["log"]
        self._first = self._began = self._stiff = 0.0
        self._knee = next(i for i, n in enumerate(robot.joint_names) if "calf" in n or "knee" in n)
        self._past: deque[dict[str, Any]] = deque(maxlen=round(inner.rate))
        self._frozen: dict[str, Any] = {}
        self._late = self._held_back(inner)
        if self._kind == "jitter":
            self._late.jitter, self._late.loss = JITTER, LOSS

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    @property
    def now(self) -> float:
        return float(self._inner.now)

    @now.setter
    def now(self, value: float) -> None:
        self._inner.now = value

    def _held_back(self, inner: Any) -> Late:
        if hasattr(inner, "_udp"):
            udp, send = inner._udp, inner._udp.send

            def really(data: bytes, peer: Any) -> None:
                udp.peer = peer
                send(data)

            late = Late(really)
            udp.send = lambda data: late(data, udp.peer)
            return late
        (writer, encode), *rest = inner._outlets
        late = Late(lambda data, _: writer.write(data))

        class Outlet:
            write = staticmethod(late)

        inner._outlets = [(Outlet(), encode), *rest]
        return late

    def _write(self, what: str) -> None:
        with open(self._log, "a") as file:
            file.write(json.dumps({what: time.monotonic()}) + "\n")

    def tell(self) -> None:
        """Send what is measured, or a lie."""
        states, since = self._states, time.monotonic() - self._first - self._at
        true = {name: np.array(states[name]) for name in MEASURED}
        lies = bool(self._first) and since >= 0.0 and self._kind != "jitter"
        if not lies:
            self._past.append(true)
        elif not self._began:
            self._began = time.monotonic()
            self._frozen = true
            self._write("lies")
        if lies:
            self._lie(since)
        self._inner.tell()
        self._late.flush()
        for name, value in true.items():
            states[name][...] = value

    def _lie(self, since: float) -> None:
        states, kind = self._states, self._kind
        if kind == "yaw":
            states["base_ang_vel"][2] += 2.0
        elif kind == "gyro sign":
            states["base_ang_vel"] *= -1.0
        elif kind == "encoder":
            states["joint_pos"][self._knee] += 0.3
        elif kind == "velocities frozen":
            states["joint_vel"][...] = self._frozen["joint_vel"]
        elif kind == "velocities zero":
            states["joint_vel"][...] = 0.0
        elif kind == "velocity sign":
            states["joint_vel"] *= -1.0
        elif kind == "repeat":
            past = self._past.popleft()
            self._past.append(past)
            for name, value in past.items():
                states[name][...] = value
        elif kind == "ageing":
            self._late.delay = AGEING * since

    def hear(self) -> bool:
        """Hear a command, and see when it gets limp."""
        heard = bool(self._inner.hear())
        if heard:
            stiff = float(self._states["joint_stiffness"].sum())
            if not self._first and stiff > 0.0:
                self._first = time.monotonic()
            if self._began and stiff < 0.95 * self._stiff:
                self._write("limp")
            self._stiff = stiff
        return heard

    def close(self) -> None:
        self._inner.close()


def face(states: States, robot: Robot, **options: Any) -> Liar:
    """Open the robot's end."""
    legged = str(robot.transport["protocol"]).startswith("unitree_legged")
    return Liar((unitree_legged if legged else unitree)(states, robot, **options), states, robot)
