"""Face of robots behind Unitree's DDS: LowState at 500 Hz, LowCmd, and the motion switcher.

What the robot does when LowCmd stops is not public: it goes on with its last command, unless option
`dead_man` says otherwise, which is an assumption. Not emulated, for the same reason: how long its
controller takes to let go, and rpy, raw motor readings, voltages of cells and the like, which stay
zero.
"""

from __future__ import annotations

import json
import math
import sys
from typing import Annotated, Any

import numpy as np

from unicon_base.schema.marks import Within
from unicon_core.blocks.controls.device import Controls, unitree_pressed
from unicon_core.blocks.controls.gamepad import gamepad
from unicon_core.bounds import within
from unicon_core.platforms.kit.base import IMU_STATES
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import control_states
from unicon_core.workflow.autowire import BuildContext
from unicon_hardware.dds.end import DdsEndpoint
from unicon_hardware.endpoint import Milliseconds
from unicon_hardware.unitree.facts import CHECK_MODE, RELEASE_MODE, SWITCHER, Server, UnitreeFacts
from unicon_hardware.wire import turned

MODE = "normal"
"""Of its own controller, until it lets go."""
TICK_MS = 2
NOT_IMPLEMENTED = 3203
LONGEST = 10.0
"""Of `dead_man` in [s]."""


class Remote:
    """Brings what is held into the bytes that the robot tells.

    Args:
        device: as of block `gamepad`.
        robot: whose remote it is.
        raw: those bytes, shape (40,).

    Raises:
        WorkflowError: the device is a file that is neither device nor pipe.
    """

    def __init__(self, device: str, robot: Robot, raw: Any) -> None:
        states = States(control_states())
        context = BuildContext(states, robot, 1.0, tell=_say)
        self._pad = gamepad(context=context, device=device)
        self._controls, self._raw = Controls(states), raw

    def __call__(self) -> None:
        """Look at what is held now; it never waits."""
        self._pad()
        unitree_pressed(self._controls, self._raw)

    def close(self) -> None:
        """Let go of the device."""
        if self._pad.close is not None:
            self._pad.close()


def _say(line: str) -> None:
    print(f"unicon: {line}", file=sys.stderr)  # standard output has the robot's own lines


class UnitreeEndpoint(DdsEndpoint):
    """What driver and vendor's SDK see of an emulated robot.

    Args:
        states: of the emulator.
        robot: its file.
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.
        mode: of its own controller at the start, "" where it has let go.
        variant: `mode_machine` that it tells, instead of the robot file's.
        dead_man: it damps without a LowCmd for so long, in [s]. An assumption: what a real one
            does is not public, and without this the last command goes on for ever.
        remote: a game pad that is held as its wireless remote, such as /dev/input/event5, or a
            pipe, or auto; see block `gamepad`.

    Attributes:
        where: topic and domain.
        dead_man: infinity unless given: what the robots do is not public.
        mode: of that controller, "" where it has let go.
        counts: of commands.
        modes: of the motors; 0 only where its own controller has let go before the first command.
        remote: the wireless remote's bytes, to be pressed.
        held: what presses them, or None.
        asked: numbers of the requests that its services got, by service.

    Raises:
        UniconError: the robot file lacks a fact, an option is out of range, or the network cannot
            be used.
    """

    label, table, platform = "emulated unitree", UnitreeFacts, "unitree"

    def __init__(
        self,
        states: States,
        robot: Robot,
        *,
        address: str | None = "127.0.0.1",
        domain: int | None = None,
        mode: str = MODE,
        variant: Annotated[int | None, Within(0, 255)] = None,
        dead_man: float | None = None,
        remote: str | None = None,
    ) -> None:
        facts = UnitreeFacts.of(robot)
        if dead_man is not None:
            label = f"{self.label}: dead_man"
            dead_man = within(dead_man, label, "s", LONGEST, 1.0 / facts.rate)
        self.mode = mode
        self._variant = (facts.mode_machine or 0) if variant is None else variant
        self.dead_man = math.inf if dead_man is None else dead_man
        self.held: Remote | None = None
        self.asked: dict[str, list[int]] = {}
        self.clock = Milliseconds(TICK_MS)
        self._device, self._robot = remote, robot
        self._build(states, robot, facts, address, domain)

    def _open(self) -> None:
        super()._open()
        before, _ = self._facts.release
        services = [SWITCHER, *([before[0]] if before else [])]
        self._servers = {name: Server(self.participant, name) for name in services}
        if self._device is not None:
            self.held = Remote(self._device, self._robot, self.remote)

    def _built(self) -> None:
        own, facts, states = self.own, self._facts, self._states
        self.remote = memoryview(own["remote"].data)
        own["mode_machine"][...] = self._variant
        self._variant = own["mode_machine"]
        own["modes"][...] = facts.modes if self.mode else 0
        if "foot_force" not in states:
            own["foot_force"] = np.zeros(4, np.float32)
        self._imu = {name: np.array(states[name]) for name in IMU_STATES}
        if facts.waist is not None:
            own |= self._imu

    @property
    def obeys(self) -> bool:
        """Whether commands act."""
        return not self.mode

    def tell(self) -> None:
        """Send what the robot measures."""
        states, waist = self._states, self._facts.waist
        self.own["tick"][...] = self.clock(self.now)
        if self.held is not None:
            self.held()
        if waist is not None:
            turned(states, self._imu, states, waist, -1.0)
        self.own["temperatures"][...] = np.repeat(self._arrays["motor_temperature"], 2)
        self.put()

    def hear(self) -> bool:
        """Answer requests, and bring the newest good command into the command states."""
        for service, server in self._servers.items():
            for asked in server.heard():
                self._answer(service, server, asked)
        return super().hear()

    def _acts(self) -> bool:
        heard = self._heard
        if not self._right("motor mode", heard["modes"], self._facts.modes):
            return False
        if not self._right("mode_machine", heard["mode_machine"], self._variant):
            return False
        if not self.obeys:
            self.counts.refuse("its own controller commands", f"mode {self.mode}")
        return self.obeys

    def _answer(self, service: str, server: Server, asked: Any) -> None:
        number = asked.header.identity.api_id
        self.asked.setdefault(service, []).append(number)
        if service != SWITCHER:
            server.reply(asked, 0)
        elif number == CHECK_MODE:
            server.reply(asked, 0, json.dumps({"form": "0", "name": self.mode}))
        elif number == RELEASE_MODE:
            self.mode = ""
            server.reply(asked, 0)
        else:
            server.reply(asked, NOT_IMPLEMENTED)

    def close(self) -> None:
        """Let go of the remote, and leave the domain."""
        if self.held is not None:
            self.held.close()
        super().close()


face = UnitreeEndpoint
