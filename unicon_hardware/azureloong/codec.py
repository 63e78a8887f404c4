"""Frames of AzureLoong's joint interface, packed and little endian; for its wire and its face.

With 31 joints and 6 + 6 fingers a command has 684 bytes and a state 1,114. Layouts:
loongOpen's loong_sim_sdk_release, sdk/loong_jnt_sdk/loong_jnt_sdk_datas.py.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from unicon_base import PlatformError, alternatives
from unicon_base.arrays import Float32, Float64
from unicon_base.schema.marks import Key, Within
from unicon_core.platforms.kit.base import rpy_of_quat
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_hardware.endpoint import Endpoint
from unicon_hardware.facts import AskingRate, Port, Transport, each, fact, ipv4, named
from unicon_hardware.wire import Udp, frame_type

KEYS = ("enable", "reset", "idle", "walk", "damp", "disable", "commands")
"""Of `transport.keys`: what the remote is told, and what the robot then does."""
COPIED = {
    "joint_pos": "pos",
    "joint_vel": "vel",
    "joint_effort": "effort",
    "motor_temperature": "temperature",
    "motor_error": "error",
}
"""State to the field of a state's frame that it is."""


def command_type(joints: int, left: int, right: int) -> np.dtype[Any]:
    """Return the layout of a command: targets [rad], [rad/s], [N·m], gains, fingers.

    Args:
        joints: of the body.
        left: fingers of the left hand.
        right: fingers of the right hand.
    """
    rows = ", ".join(f"{name} <f4 {joints}" for name in COMMAND_STATES)
    return frame_type(
        f"checker <i2, size <i2, state <i4, torque_limit_rate <f4, filter_rate <f4, {rows}, "
        f"finger_left <f4 {left}, finger_right <f4 {right}"
    )


def state_type(joints: int, left: int, right: int) -> np.dtype[Any]:
    """Return the layout of a state; see `command_type`.

    `key` is the remote's key and that of the plan that runs, `state` that of the run and the task.
    """
    n = joints
    return frame_type(
        "size <i4, timestamp <f8, key <i2 2, plan S16, state <i2 2, joy <f4 4, rpy <f4 3, "
        f"gyro <f4 3, acc <f4 3, pos <f4 {n}, vel <f4 {n}, effort <f4 {n}, temperature <i2 {n}, "
        f"status <i2 {n}, error <i2 {n}, pos_target <f4 {n}, vel_target <f4 {n}, "
        f"effort_target <f4 {n}, finger_left <f4 {left}, finger_right <f4 {right}, "
        f"finger_target_left <f4 {left}, finger_target_right <f4 {right}"
    )


def part(kind: np.dtype[Any], first: str, behind: str) -> slice:
    """Return where the bytes of a frame are from one field up to another, that one left out."""
    fields: Any = kind.fields
    return slice(fields[first][1], fields[behind][1])


@dataclass(frozen=True)
class LoongTransport(Transport):
    """What both ends of the protocol know of it, from the robot file.

    Attributes:
        port: where the robot takes commands, UDP.
        rate: of frames at most, [Hz].
        checker: in front of each command.
        commanding: `state` of a command that is to be carried out; 0 asks for states alone.
        lost_ms: without a command for so long the robot takes the client for lost, [ms].
        keys: of the remote, by the names of `KEYS`.
        left: fingers of the left hand.
        right: fingers of the right hand.
        torque, stiffness, damping: limits to which the robot's driver clamps, shape (n,).
    """

    port: Port
    rate: AskingRate
    checker: Annotated[int, Within(-32768, 32767)]
    commanding: Annotated[int, Key("state"), Within(1, 127)]
    lost_ms: Annotated[int, Within(1, 10_000)]
    keys: Annotated[dict[str, int], named(KEYS, 1, 255)]
    left: Annotated[int, Key("fingers_left"), Within(0, 32)]
    right: Annotated[int, Key("fingers_right"), Within(0, 32)]
    torque: Annotated[Float64, Key("torque_limit"), each(0.0, 1000.0)]
    stiffness: Annotated[Float64, Key("stiffness_limit"), each(0.0, 2000.0)]
    damping: Annotated[Float64, Key("damping_limit"), each(0.0, 2000.0)]

    @property
    def layouts(self) -> tuple[np.dtype[Any], np.dtype[Any]]:
        """Layouts of a command and of a state."""
        sizes = len(self.torque), self.left, self.right
        return command_type(*sizes), state_type(*sizes)

    @property
    def limits(self) -> tuple[Float32, Float32]:
        """Smallest and largest commands, rows as of `COMMAND_STATES`, shape (5, n)."""
        none = np.zeros_like(self.torque)
        free = none + np.inf
        return (
            np.array((-free, -free, -self.torque, none, none), np.float32),
            np.array((free, free, self.torque, self.stiffness, self.damping), np.float32),
        )


KEY_FRAME, KEY_AT = 96, 84
"""Bytes of the remote's frame, and which of them is the key: tools/py_ui.py of the vendor."""
FOLLOWS = {
    "enable": ("disable", "idle"),
    "reset": ("idle", "idle"),
    "walk": ("idle", "walk"),
    "commands": ("walk", "commands"),
}
"""Key of the remote to the plan in which it counts and the one that follows; `damp`, `disable` and
`idle` count in any."""


class AzureEndpoint(Endpoint):
    """The robot's end of its protocol; see `Face`.

    Args:
        states: of the emulator.
        robot: its file.
        address: where it listens.
        plan: in which it begins, of `KEYS`.

    Raises:
        PlatformError: an option is wrong, or a port is taken.
        RobotError: the robot file lacks a fact.
    """

    platform = "azureloong"

    def __init__(
        self, states: States, robot: Robot, *, address: str = "127.0.0.1", plan: str = "walk"
    ) -> None:
        if plan not in KEYS:
            raise PlatformError(
                f"emulated azureloong: plan {plan!r} is not known; {alternatives(plan, KEYS)}"
            )
        address, link = ipv4(address, "azureloong"), LoongTransport.of(robot)
        self._states, self._link, self._limits = states, link, link.limits
        self.rate, self.dead_man = link.rate, 1e-3 * link.lost_ms
        self._plan, self.where = plan, f"{address}:{link.port}"
        self.reach = {"address": address}
        self._kind, state = link.layouts
        self._frame = np.zeros(1, state)
        self._frame["size"] = self._frame.nbytes
        self._views = [states[name] for name in COMMAND_STATES]
        self._heard = -math.inf
        port = fact(robot, "port_keys", Port)
        self._udp = Udp((address, link.port), ("", 0), "emulated azureloong")
        try:
            self._remote = Udp((address, port), ("", 0), "emulated azureloong, remote")
        except BaseException:
            self._udp.close()
            raise

    @property
    def obeys(self) -> bool:
        """Whether it is in the plan in which it takes commands."""
        return self._plan == "commands"

    def hear(self) -> bool:
        """See `Face`."""
        for data, _ in self._remote.datagrams():
            if len(data) == KEY_FRAME:
                self._press(data[KEY_AT])
        newest = None
        for data, sender in self._udp.datagrams():
            if len(data) != self._kind.itemsize:
                continue
            frame = np.frombuffer(data, self._kind)[0]
            if frame["checker"] != self._link.checker or frame["size"] != len(data):
                continue
            self._udp.peer, self._heard = sender, time.monotonic()
            if frame["state"] == self._link.commanding:  # else it only asks
                newest = frame
        if newest is None or not self.obeys:
            return False
        for view, name, *limits in zip(self._views, COMMAND_STATES, *self._limits):
            view[...] = np.clip(newest[name], *limits)
        return True

    def _press(self, key: int) -> None:
        name = next((name for name, value in self._link.keys.items() if value == key), "")
        wanted, then = FOLLOWS.get(name, (self._plan, name or self._plan))
        if self._plan == wanted:
            self._plan = then

    def tell(self) -> None:
        """See `Face`."""
        if time.monotonic() - self._heard > self.dead_man:
            return
        frame, states = self._frame, self._states
        frame["timestamp"] = time.time()
        frame["key"] = (0, self._link.keys[self._plan])
        frame["plan"] = self._plan.encode()
        frame["rpy"] = rpy_of_quat(states["base_quat"])
        frame["gyro"], frame["acc"] = states["base_ang_vel"], states["base_lin_acc"]
        for state, field in COPIED.items():
            frame[field] = states[state]
        frame["pos_target"] = states["joint_pos_target"]
        self._udp.send(frame.view(np.uint8).data)

    def close(self) -> None:
        """See `Face`."""
        self._udp.close()
        self._remote.close()


face = AzureEndpoint
