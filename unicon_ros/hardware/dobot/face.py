"""Face of an Atom: both states, both commands, its state machine's number and the arms' switch.

Not emulated, as it is not public: what its state machine does, and what the robot does when
commands stop.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_msgs_map.layout.messages import shared_messages
from unicon_ros.hardware.dds.end import DdsEnd
from unicon_ros.hardware.dds.frames import Frames
from unicon_ros.hardware.dds.maps import subscribe
from unicon_ros.hardware.dds.participant import Participant
from unicon_ros.hardware.dobot.codec import FSM, SWITCH, DobotFacts, own_arrays
from unicon_ros.hardware.dobot.wire import EXTRA
from unicon_ros.hardware.modes import EmulatedModes
from unicon_ros.hardware.torso import IMU_STATES, turned
from unicon_ros.hardware.wire import Counts

LABEL = "emulated dobot"
TEMPERATURE = 35.0
"""What it tells where its simulator knows none, in [°C]."""


def face(
    states: States,
    robot: Robot,
    *,
    address: str | None = "127.0.0.1",
    domain: int | None = None,
    layout: str = "sdk",
    acts_in: int = 2,
) -> DobotFace:
    """Build the robot's end.

    Args:
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.
        layout: of UpperState, `sdk` or `ros2`.
        acts_in: state of its state machine in which joint commands act; it begins in 0.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """
    return DobotFace(states, robot, domain, address, layout, acts_in)


class DobotFace(DdsEnd):
    """What a driver sees of an emulated Atom.

    Attributes:
        rate: of its states in [Hz].
        dead_man: infinity: what the robot does is not public.
        obeys: its state machine is where joint commands act, and the arms are switched over.
        own: what it tells besides states: `fsm_id`, `upper_control` and `remote`.
        modes: of the motors, those of the last command that acted; 0 before.
    """

    platform = "dobot"
    dead_man = math.inf

    def __init__(
        self,
        states: States,
        robot: Robot,
        domain: int | None,
        address: str | None,
        layout: str,
        acts_in: int,
    ) -> None:
        facts, counts, n = DobotFacts.of(robot, layout), Counts(), robot.num_joints
        domain = facts.domain if domain is None else domain
        self.rate, self.own, self._acts_in = facts.rate, own_arrays(), acts_in
        self.modes = EmulatedModes(self.own["modes"])
        self._layout = layout
        self._states, self._waist, self._mode = states, facts.waist, facts.lower.mode
        self._imu = {name: np.array(states[name]) for name in IMU_STATES}
        defaults: dict[str, NDArray[Any]] = {
            "motor_temperature": np.full(n, TEMPERATURE, np.float32),
            "battery_charge": np.ones((), np.float32),
        }
        arrays = defaults | {name: states[name] for name in states} | self.own | self._imu
        self._heard: dict[str, NDArray[Any]] = {
            name: np.zeros(n, np.float32) for name in COMMAND_STATES
        }
        self._heard["modes"] = np.zeros(n, np.uint8)
        self._asked: dict[str, NDArray[Any]] = {
            "id": np.zeros((), np.uint16),
            "flag": np.zeros((), np.uint8),
        }
        self._came = (False, False)
        participant = Participant(domain, address, LABEL, EXTRA)
        super().__init__(participant, facts.lower.command_topic, counts)
        with self.closing():
            for half in (facts.lower, facts.upper):
                state, command = half.messages()
                self.speak(half.state_topic, state, half.state_out(arrays), name=half.name)
                frames = half.command_in(self._heard, counts)
                self.listen(half.command_topic, command, frames, anyone=True)
            for topic, message, field in (
                (facts.fsm_topic, FSM, "id"),
                (facts.switch_topic, SWITCH, "flag"),
            ):
                spec = subscribe(topic, message, {field: field})
                asked = Frames(spec, self._asked, Counts(), checked=False)
                self.listen(topic, shared_messages().struct(message), asked, anyone=True)

    @property
    def reach(self) -> dict[str, object]:
        """See `Face`."""
        return {**super().reach, "layout": self._layout, "fsm_id": self._acts_in}

    @property
    def obeys(self) -> bool:
        """Whether commands act."""
        return int(self.own["fsm_id"]) == self._acts_in and bool(self.own["upper_control"])

    def tell(self) -> None:
        """Send what the robot measures."""
        states, waist = self._states, self._waist
        angle, rate = (-float(states[name][waist]) for name in ("joint_pos", "joint_vel"))
        turned({name: states[name] for name in IMU_STATES}, self._imu, angle, rate)
        self.put()

    def hear(self) -> bool:
        """Answer requests, and bring the newest good commands into the command states."""
        lower, upper, fsm, switch = self._inlets
        if fsm.take():
            self.own["fsm_id"][...] = self._asked["id"]
        if switch.take():
            self.own["upper_control"][...] = self._asked["flag"]
        lower_came, upper_came = lower.take(), upper.take()
        self._came = self._came[0] or bool(lower_came), self._came[1] or bool(upper_came)
        if not lower_came + upper_came or not all(self._came):
            return False
        heard = self._heard
        if not self.obeys:
            self.counts.refuse("its own controller commands", f"state {int(self.own['fsm_id'])}")
            return False
        if (heard["modes"] != self._mode).any():
            self.counts.refuse("motor mode", f"{heard['modes'].tolist()}")
            return False
        for name in COMMAND_STATES:
            self._states[name][...] = heard[name]
        self.modes.command(heard["modes"], self._states)
        return True
