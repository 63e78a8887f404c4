"""Messages of an Atom, made of a robot file, for both ends of the wire; its emulator endpoint.

Legs ("lower") and torso, arms, head ("upper") have topics of their own. Angular velocity is in
[deg/s] on the wire. Of UpperState there are two layouts of one name: the SDK's header has no IMU,
the ROS 2 package has one (Dobot-Arm/dobot_atom_sdk idl/upper_state.h, Dobot-Arm/dobot_atom_ros2
dobot_atom/msg/UpperState.msg).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from unicon_base import AnyDict, PlatformError
from unicon_base.arrays import Array
from unicon_base.schema.marks import Key, Text
from unicon_core.platforms.kit.base import IMU_STATES
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.dds.end import DdsEndpoint
from unicon_hardware.dds.maps import (
    COMMANDS,
    IMU,
    MEASURED,
    Domain,
    Message,
    Messages,
    motors,
    zeros,
)
from unicon_hardware.dds.service import Inlet
from unicon_hardware.facts import Octet, Rate, facts_of, joint_number, wrong_fact
from unicon_hardware.wire import Counts, turned

LAYOUTS = {"sdk": "dobot_atom/msg/UpperState", "ros2": "dobot_atom/msg/UpperStateImu"}
"""Option `layout` to the type of UpperState."""
# Motors of either half.
LOWER, UPPER = 12, 17


@dataclass(frozen=True)
class Half(Messages):
    """Legs, or what is above them.

    Attributes:
        first: number of its first joint.
        count: of joints, and of motors in its messages.
        state_topic: of its state.
        command_topic: of its commands.
        state_type: of its state.
        name: in the type of its commands.
        mode: byte `mode` of its motors' commands.
    """

    first: int
    count: int
    state_topic: str
    command_topic: str
    state_type: str
    name: str
    mode: int

    @property
    def state(self) -> Message:
        """LowerState, or UpperState of either layout."""
        told = MEASURED | {"motor_temp": "motor_temperature", "mode": "modes"}
        fields: AnyDict = motors("motor_state", range(self.count), told, self.first)
        if self.first:
            fields["is_upper_control"] = "upper_control"
            name = "dobot_atom.msg.dds_.UpperState_"
            return Message(self.state_topic, self.state_type, fields, name=name)
        fields |= IMU | {"fsm_id": "fsm_id", "wireless_remote": "remote"}
        fields["imu_state.gyroscope"] = {"state": "base_ang_vel", "unit": "deg/s"}
        fields["bms_state.battery_level"] = {"state": "battery_charge", "scale": 0.01}
        return Message(self.state_topic, self.state_type, fields, orientation="base_quat")

    @property
    def command(self) -> Message:
        """LowerCmd or UpperCmd."""
        return Message(
            self.command_topic,
            f"dobot_atom/msg/{self.name}Cmd",
            motors("motor_cmd", range(self.count), COMMANDS, self.first),
            sent={f"motor_cmd[{slot}].mode": self.mode for slot in range(self.count)},
            taken=motors("motor_cmd", range(self.count), {"mode": "modes"}, self.first),
        )


@dataclass(frozen=True)
class DobotFacts:
    """`transport` of a robot file.

    Attributes:
        layout: of UpperState, one of `LAYOUTS`.
        domain: of DDS.
        rate: of the states in [Hz].
        lower_state_topic, lower_command_topic: of the legs.
        upper_state_topic, upper_command_topic: of torso, arms and head.
        modes: byte `mode` of motors' commands.
        waist: number of the joint between pelvis and the torso with the IMU.
        fsm_topic: takes the number of a state of the robot's own state machine.
        switch_topic: takes whether the arms are ours.
    """

    layout: str
    domain: Domain
    rate: Rate
    lower_state_topic: Text
    lower_command_topic: Text
    upper_state_topic: Text
    upper_command_topic: Text
    modes: Annotated[Octet, Key("motor_mode")]
    waist: Annotated[int, Key("waist_joint"), joint_number]
    fsm_topic: Text
    switch_topic: Text

    @classmethod
    def of(cls, robot: Robot, layout: str) -> DobotFacts:
        """Read them.

        Args:
            layout: of UpperState, one of `LAYOUTS`.

        Raises:
            RobotError: one lacks, or is not what it must be.
            PlatformError: there is no such layout.
        """
        if layout not in LAYOUTS:
            raise PlatformError(
                f"platform 'dobot': layout is {layout!r}; the vendor's SDK and its ROS 2 package "
                "contradict each other in UpperState, so that it must be said: sdk (without an "
                "IMU) or ros2 (with one)"
            )
        facts = facts_of(cls, robot, layout=layout)
        for half, key in zip(facts.halves, ("lower_motors", "upper_motors")):
            last = half.first + half.count - 1
            if [*(robot.transport.get(key) or ())] != [*range(half.first, last + 1)]:
                raise wrong_fact(robot, key, f"{half.first} to {last}, the only order known")
        return facts

    def own(self, joints: int) -> dict[str, Array]:
        """Return the arrays of the messages that are not states, zero."""
        return zeros(f"fsm_id u2, upper_control u1, remote u1 40, modes u1 {joints}")

    @property
    def state_topic(self) -> str:
        """Of both halves, for messages."""
        return f"{self.lower_state_topic} and {self.upper_state_topic}"

    @property
    def command_topic(self) -> str:
        """Of the legs, which stands for both in messages."""
        return self.lower_command_topic

    @property
    def halves(self) -> tuple[Half, Half]:
        """The legs; torso, arms and head."""
        lower = self.lower_state_topic, self.lower_command_topic
        upper = self.upper_state_topic, self.upper_command_topic
        return (
            Half(0, LOWER, *lower, "dobot_atom/msg/LowerState", "Lower", self.modes),
            Half(LOWER, UPPER, *upper, LAYOUTS[self.layout], "Upper", self.modes),
        )

    @property
    def fsm(self) -> Message:
        """What asks for the state `id` of the robot's own state machine."""
        return Message(self.fsm_topic, "dobot_atom/msg/SetFsmId", {"id": "id"})

    @property
    def switch(self) -> Message:
        """What asks for the arms, by `flag`."""
        return Message(self.switch_topic, "dobot_atom/msg/SwitchUpperControl", {"flag": "flag"})


class DobotEndpoint(DdsEndpoint):
    """An emulated Atom: both states, both commands, its state machine's number, the arms' switch.

    Not emulated, as it is not public: what its state machine does, and what the robot does when
    commands stop.

    Args:
        states: of the emulator.
        robot: its file.
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.
        layout: of UpperState, `sdk` or `ros2`.
        acts_in: state of its state machine in which joint commands act; it begins in 0.

    Attributes:
        obeys: its state machine is where joint commands act, and the arms are switched over.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """

    label, extra, platform = "emulated dobot", "hw-dobot", "dobot"

    def __init__(
        self,
        states: States,
        robot: Robot,
        *,
        address: str | None = "127.0.0.1",
        domain: int | None = None,
        layout: str = "sdk",
        acts_in: int = 2,
    ) -> None:
        self._acts_in, self._came = acts_in, set[Inlet]()
        self._build(states, robot, DobotFacts.of(robot, layout), address, domain)

    def _built(self) -> None:
        self._imu = {name: np.array(self._states[name]) for name in IMU_STATES}
        self.own |= self._imu
        self._asked = zeros("id u2, flag u1")

    def _open(self) -> None:
        facts = self._facts
        for half in facts.halves:
            self.speak(half.state, self._arrays)
            self.listen(half.command, self._heard, anyone=True)
        for message in (facts.fsm, facts.switch):
            self.listen(message, message.frames(self._asked, Counts()), anyone=True)

    @property
    def reach(self) -> dict[str, object]:
        """Options of the platform."""
        return {**super().reach, "layout": self._facts.layout, "fsm_id": self._acts_in}

    @property
    def obeys(self) -> bool:
        """Whether commands act."""
        return int(self.own["fsm_id"]) == self._acts_in and bool(self.own["upper_control"])

    def tell(self) -> None:
        """Send what the robot measures."""
        turned(self._states, self._imu, self._states, self._facts.waist, -1.0)
        self.put()

    def hear(self) -> bool:
        """Answer requests, and bring the newest good commands into the command states."""
        *halves, fsm, switch = self._inlets
        if fsm.take():
            self.own["fsm_id"][...] = self._asked["id"]
        if switch.take():
            self.own["upper_control"][...] = self._asked["flag"]
        came = {inlet for inlet in halves if inlet.take()}
        self._came |= came
        if not came or len(self._came) < len(halves) or not self._acts():
            return False
        self._act()
        return True

    def _acts(self) -> bool:
        if not self.obeys:
            self.counts.refuse("its own controller commands", f"state {int(self.own['fsm_id'])}")
            return False
        return self._right("motor mode", self._heard["modes"], self._facts.modes)


face = DobotEndpoint
