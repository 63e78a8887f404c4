"""Face of robots behind Unitree's DDS: LowState at 500 Hz, LowCmd, and the motion switcher.

Not emulated, as it is not public: what the robot does when LowCmd stops, how long its controller
takes to let go, and rpy, raw motor readings, voltages of cells and the like, which stay zero.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import PlatformError
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_msgs_map import Encoder
from unicon_ros.hardware.dds.frames import Frames
from unicon_ros.hardware.dds.participant import Participant
from unicon_ros.hardware.torso import IMU_STATES, turned
from unicon_ros.hardware.unitree.facts import UnitreeFacts
from unicon_ros.hardware.unitree.maps import command_in, state_out
from unicon_ros.hardware.unitree.release import CHECK_MODE, RELEASE_MODE, SWITCHER
from unicon_ros.hardware.unitree.service import Server
from unicon_ros.hardware.unitree.wire import REMOTE, own_arrays
from unicon_ros.hardware.wire import Counts

__all__ = ["UnitreeFace", "face"]

LABEL = "emulated unitree"
MODE = "normal"
"""Of its own controller, until it lets go."""
TICK_MS = 2
NOT_IMPLEMENTED = 3203
TEMPERATURE, VOLTAGE = 35.0, 29.0
"""What it tells where its simulator knows none, in [°C] and [V]."""


def face(
    states: States,
    robot: Robot,
    *,
    address: str | None = "127.0.0.1",
    domain: int | None = None,
    mode: str = MODE,
    variant: int | None = None,
) -> UnitreeFace:
    """Build the robot's end.

    Args:
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.
        mode: of its own controller at the start, "" where it has let go.
        variant: `mode_machine` that it tells, instead of the robot file's.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """
    facts = UnitreeFacts.of(robot)
    if variant is not None and not 0 <= variant <= 255:
        raise PlatformError(f"{LABEL}: variant is {variant}; give 0 to 255")
    return UnitreeFace(
        states, robot, facts, facts.domain if domain is None else domain, address, mode, variant
    )


class UnitreeFace:
    """What driver and vendor's SDK see of an emulated robot.

    Attributes:
        rate: of LowState in [Hz].
        dead_man: infinity: what the robots do is not public.
        obeys: its own controller has let go.
        mode: of that controller, "" where it has let go.
        counts: of commands.
        remote: the wireless remote's bytes, to be pressed.
        asked: numbers of the requests that its services got, by service.
    """

    dead_man = math.inf

    def __init__(
        self,
        states: States,
        robot: Robot,
        facts: UnitreeFacts,
        domain: int,
        address: str | None,
        mode: str,
        variant: int | None,
    ) -> None:
        self.rate, self.mode, self.counts = facts.rate, mode, Counts()
        self.remote = bytearray(REMOTE)
        self.asked: dict[str, list[int]] = {}
        self._facts, self._states = facts, states
        n = robot.num_joints
        defaults: dict[str, NDArray[Any]] = {
            "motor_temperature": np.full(n, TEMPERATURE, np.float32),
            "motor_error": np.zeros(n, np.int32),
            "battery_charge": np.ones((), np.float32),
            "battery_voltage": np.full((), VOLTAGE, np.float32),
            "foot_force": np.zeros(4, np.float32),
        }
        own = own_arrays(robot) | {"remote": np.frombuffer(self.remote, np.uint8)}
        arrays = defaults | {name: states[name] for name in states} | own
        self._imu = {name: np.array(states[name]) for name in IMU_STATES}
        if facts.waist is not None:
            arrays |= self._imu
        self._tick, self._pairs = own["tick"], own["temperatures"].reshape(-1, 2)
        self._heat, self._error = arrays["motor_temperature"], arrays["motor_error"]
        self._errors = own["errors"]
        own["mode_machine"][...] = (facts.mode_machine or 0) if variant is None else variant
        self._encode = Encoder.build(state_out(facts, arrays), arrays).encode
        heard = {name: np.zeros(n, np.float32) for name in COMMAND_STATES} | own_arrays(robot)
        self._heard: Mapping[str, NDArray[Any]] = heard
        self._variant = own["mode_machine"]
        self._modes = np.zeros(n, np.uint8)
        for run in facts.driven:
            self._modes[slice(*run.joints)] = run.mode
        self._frames = Frames(command_in(facts), heard, self.counts)
        self._participant = Participant(domain, address, LABEL)
        try:
            make = self._participant
            self._writer = make.writer(facts.state_topic, facts.message("LowState"))
            self._reader = make.reader(facts.command_topic, facts.message("LowCmd"))
            services = [SWITCHER, *([facts.release[0][0]] if facts.release[0] else [])]
            self._servers = {name: Server(make, name) for name in services}
        except BaseException:
            self._participant.close()
            raise

    @property
    def obeys(self) -> bool:
        """Whether commands act."""
        return not self.mode

    def tell(self) -> None:
        """Send what the robot measures."""
        states, waist = self._states, self._facts.waist
        self._tick += TICK_MS
        if waist is not None:
            angle, rate = (-float(states[name][waist]) for name in ("joint_pos", "joint_vel"))
            turned({name: states[name] for name in IMU_STATES}, self._imu, angle, rate)
        self._pairs[...] = self._heat[:, None]
        self._errors[...] = self._error
        self._writer.write(self._encode())

    def hear(self) -> bool:
        """Answer requests, and bring the newest good command into the command states."""
        for service, server in self._servers.items():
            for asked in server.asked():
                self._answer(service, server, asked)
        came = False
        for raw, info in self._reader.take():
            if info.valid_data and self._frames.good(raw) and self._frames.read(raw):
                came |= self._accepted()
        return came

    def _accepted(self) -> bool:
        heard = self._heard
        if not np.array_equal(heard["modes"], self._modes):
            self.counts.refuse("motor mode", f"{heard['modes'].tolist()}")
            return False
        if heard["mode_machine"] != self._variant:
            self.counts.refuse("mode_machine", f"{heard['mode_machine']}, not {self._variant}")
            return False
        if not self.obeys:
            self.counts.refuse("its own controller commands", f"mode {self.mode}")
            return False
        self.counts.good += 1
        for name in COMMAND_STATES:
            self._states[name][...] = heard[name]
        return True

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

    def wait(self, timeout: float) -> bool:
        """Return True once a command is there, False after `timeout` in [s]."""
        return self._reader.wait(timeout)

    def close(self) -> None:
        """Leave the domain."""
        self._participant.close()
