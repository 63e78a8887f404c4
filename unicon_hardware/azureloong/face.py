"""AzureLoong as it looks on the wire: its joint interface, and its remote's port; for the emulator.

It takes what the remote's keys say, as its vendor's readme.md tells: en, rc, rl, then jntSdk, in
which alone it takes commands.
"""

from __future__ import annotations

import math
import time

import numpy as np

from unicon_base.errors import PlatformError, alternatives
from unicon_core.platforms.kit.base import rpy_of_quat
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_hardware.azureloong.codec import COPIED, KEYS, LoongTransport
from unicon_hardware.facts import Port, fact, ipv4
from unicon_hardware.udp import Udp

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


class AzureEndpoint:
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
        self.rate, self.dead_man = link.rate, link.lost
        self._plan, self.where = plan, f"{address}:{link.port}"
        self.reach = {"address": address}
        self._kind, self._frame = link.command, np.zeros(1, link.state)
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
        if time.monotonic() - self._heard > self._link.lost:
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
