"""InspireDdsWire: a hand behind one of the two DDS interfaces of an RH56; what both carry.

FTP (protocol `inspire_ftp`): a message for each hand, six angles of 0 (closed) to 1000 (open), and
`mode`, whose bit 0 says that angles count (NaCl-1374/inspire_hand_ws inspire_hand_sdk/hand_idl,
inspire_sdkpy/inspire_sdk.py). DFX (`inspire_dfx`): Unitree's MotorCmds and MotorStates with both
hands, `q` of 0 (closed) to 1 (open) (unitreerobotics/xr_teleoperate
teleop/robot_control/robot_hand_inspire.py).
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from unicon_base.arrays import Array, Float32, Float64, Index
from unicon_base.schema.marks import Key, Within
from unicon_core.robots import Robot
from unicon_hardware.dds.end import DdsEndpoint, DdsWire
from unicon_hardware.dds.maps import Arrays, DdsFacts, Frames, Message, zeros
from unicon_hardware.facts import fact, facts_of, one_of, slots
from unicon_hardware.wire import Counts, Speed

ANGLES = 1
"""Bit of `mode` of the FTP: `angle_set` counts."""
FTP, DFX = "inspire_ftp", "inspire_dfx"
COUNTS = {FTP: 6, DFX: 12}
"""Protocol to angles in a message."""
Raw = Annotated[float, Within(-32767.0, 32767.0)]


@dataclass(frozen=True)
class HandFacts(DdsFacts):
    """`transport` of a robot file.

    Attributes:
        protocol: `inspire_ftp` or `inspire_dfx`.
        open: what stands for each joint's lower limit.
        closed: what stands for each joint's upper limit.
        slots: place of each joint in the message, shape (6,).
        lower: limit in [rad], shape (6,).
        upper: limit in [rad], shape (6,).
    """

    protocol: Annotated[str, one_of(FTP, DFX)]
    open: Annotated[Raw, Key("raw_lower")]
    closed: Annotated[Raw, Key("raw_upper")]
    slots: Index
    lower: Float64
    upper: Float64

    @classmethod
    def of(cls, robot: Robot) -> HandFacts:
        """Read them.

        Raises:
            RobotError: one lacks, or is not what it must be.
        """
        both = robot.transport["protocol"] == DFX
        places = fact(robot, "motors", Annotated[list[int], slots(COUNTS[DFX])]) if both else None
        return facts_of(
            cls,
            robot,
            slots=np.array(places or range(COUNTS[FTP]), np.intp),
            lower=robot.lower.astype(np.float64),
            upper=robot.upper.astype(np.float64),
        )

    @property
    def both(self) -> bool:
        """Whether it is the DFX, whose messages have both hands."""
        return self.protocol == DFX

    @property
    def per_rad(self) -> Float64:
        """Change of what is sent with the angle, shape (6,)."""
        return (self.closed - self.open) / (self.upper - self.lower)

    @property
    def ends(self) -> tuple[float, float]:
        """Smallest and largest number that may be sent."""
        return min(self.open, self.closed), max(self.open, self.closed)

    @property
    def dtype(self) -> str:
        """Of the angles in a message, as they are sent."""
        return f"{'f4' if self.both else 'i2'} {COUNTS[self.protocol]}"

    def own(self, joints: int) -> dict[str, Array]:
        """Return the arrays of the messages that are not states, zero."""
        return zeros(f"told {self.dtype}, targets {self.dtype}, mode i1")

    def zeros(self) -> Array:
        """Return an array of the angles in a message, as they are sent."""
        return self.own(0)["told"]

    def to_wire(self, angles: Array) -> tuple[Float64, bool]:
        """Return what is sent for angles in [rad], and whether one was beyond the ends."""
        exact = self.open + (angles - self.lower) * self.per_rad
        sent = np.clip(exact, *self.ends)
        span = self.ends[1] - self.ends[0]
        beyond = bool(np.abs(exact - sent).max() > 1e-4 * span)  # a limit in float32 is not
        return (sent if self.both else np.rint(sent)), beyond

    def to_angles(self, told: Array) -> Float64:
        """Return the angles in [rad] of what was told."""
        return self.lower + (told - self.open) / self.per_rad

    @property
    def state(self) -> Message:
        """The state; `told` has its angles."""
        if self.both:
            count = COUNTS[DFX]
            fields = {f"states[0:{count}].q": "told"}
            kind = "unitree_go/msg/MotorStates"
            return Message(self.state_topic, kind, fields, lengths={"states": count})
        return Message(
            self.state_topic,
            "inspire/msg/HandState",
            {
                "angle_act[0:6]": "told",
                "err[0:6]": "motor_error",
                "temperature[0:6]": "motor_temperature",
            },
            sent={f"{name}[5]": 0 for name in ("pos_act", "force_act", "current", "status")},
            name="inspire.inspire_hand_state",
            lengths={"pos_act": 6},
        )

    @property
    def command(self) -> Message:
        """The command, of `targets`."""
        if self.both:
            count = COUNTS[DFX]
            fields = {f"cmds[0:{count}].q": "targets"}
            kind = "unitree_go/msg/MotorCmds"
            return Message(self.command_topic, kind, fields, lengths={"cmds": count})
        unused = {f"{name}[5]": 0 for name in ("pos_set", "force_set", "speed_set")}
        return Message(
            self.command_topic,
            "inspire/msg/HandCtrl",
            {"angle_set[0:6]": "targets"},
            sent=unused | {"mode": ANGLES},
            taken={"mode": "mode"},
            name="inspire.inspire_hand_ctrl",
            lengths={"pos_set": 6},
        )

    def state_in(self, arrays: Arrays, counts: Counts) -> Frames:
        """Return what reads the state into those arrays that are there."""
        told = {"told": self.zeros()}
        own = told | {name: np.zeros(6, np.int32) for name in ("motor_error", "motor_temperature")}
        return self.state.frames(arrays, counts, size=self.state.encoder(own).size)

    def command_in(self, arrays: Arrays, counts: Counts) -> Frames:
        """Return what reads the command, as the hand does."""
        size = self.command.encoder({"targets": self.zeros()}).size
        return self.command.frames(arrays, counts, size=size)


_open: dict[tuple[int, str], Both] = {}


class Both:
    """Targets of both hands on one topic; get it with `Both.of`.

    Attributes:
        targets: as they are sent, shape (count,).
        users: wires that send them.
    """

    def __init__(self, count: int) -> None:
        self.targets = np.zeros(count, np.float32)
        self.users = 0
        self._known = np.zeros(count, bool)

    @classmethod
    def of(cls, domain: int, topic: str, count: int) -> Both:
        """Return that of a topic, and use it until `leave`."""
        made = _open.setdefault((domain, topic), cls(count))
        made.users += 1
        return made

    def found(self, told: Float32) -> None:
        """Note where the hands are: who is not commanded stays there."""
        np.copyto(self.targets, told, where=~self._known)
        self._known[...] = True

    def leave(self, domain: int, topic: str) -> None:
        """Use it no longer."""
        self.users -= 1
        if not self.users:
            _open.pop((domain, topic), None)


OVER = 0.05
"""Over which the speed is taken, [s]: a step of 1/1000 within 10 ms would be up to 0.17 rad/s."""


class InspireDdsWire(DdsWire):
    """The connection to one hand.

    Neither interface has a number in its state: a hand that repeats itself is not distinguished
    from one that does not move.
    """

    label, extra, table = "platform 'inspire'", "hw-inspire", HandFacts
    _both: Both | None = None

    def _built(self) -> None:
        self._told, self._targets = self._own["told"], self._own["targets"]
        self._speed = Speed(OVER)

    def _open(self) -> None:
        facts = self._facts
        self._key = self.participant.domain, facts.command_topic
        if facts.both and not self._silent:
            self._both = Both.of(*self._key, len(self._told))
            self._targets = self._arrays["targets"] = self._both.targets
        super()._open()

    def _measured(self) -> None:
        angles = self._facts.to_angles(self._told[self._facts.slots])
        self._states["joint_vel"][...] = self._speed(time.monotonic_ns(), angles)
        self._states["joint_pos"][...] = angles
        if self._both is not None:
            self._both.found(self._told)

    def put(self) -> None:
        """Send the target positions; what is beyond open or closed is clamped.

        Raises:
            Fault: CycloneDDS refuses it.
        """
        sent, beyond = self._facts.to_wire(self._states["joint_pos_target"])
        self.counts.clamped += beyond
        self._targets[self._facts.slots] = sent
        super().put()

    def commanders(self) -> dict[str, int]:
        """Return the topic of commands, with the number of others that write there."""
        ours = 0 if self._both is None else self._both.users - 1  # the other hand's wire
        return {topic: max(number - ours, 0) for topic, number in super().commanders().items()}

    def close(self) -> None:
        """Leave the domain."""
        if self._both is not None:
            self._both.leave(*self._key)
            self._both = None
        super().close()


AS_IT_IS = -1
"""In an angle of the FTP: leave the finger as it is."""


class InspireDdsEndpoint(DdsEndpoint):
    """An emulated hand: its state, and commands by position.

    Of a DFX both hands are sent, the other one as `told` has it. Not emulated: forces, currents,
    status, touch sensors, and what the hand does when commands stop.

    Attributes:
        told: all that it sends, those of a DFX's other hand among them.
        asked: all that it was commanded last.
    """

    label, extra, table = "emulated inspire", "hw-inspire", HandFacts
    platform = "inspire"

    def _built(self) -> None:
        self.told, self.asked = self.own["told"], self._heard["targets"]
        self.told[...] = self._facts.open
        self._heard["mode"][...] = ANGLES

    def tell(self) -> None:
        """Send what the hand measures."""
        facts = self._facts
        self.told[facts.slots] = facts.to_wire(self._states["joint_pos"])[0]
        self.put()

    def _acts(self) -> bool:
        mode = int(self._heard["mode"])
        if not mode & ANGLES:
            self.counts.refuse("mode", f"{mode}, which sets no angle")
        return bool(mode & ANGLES)

    def _act(self) -> None:
        facts = self._facts
        asked = self.asked[facts.slots]
        kept = (asked == AS_IT_IS) & (not facts.both)
        targets = facts.to_angles(np.clip(asked, *facts.ends))
        np.copyto(self._states["joint_pos_target"], targets, where=~kept, casting="same_kind")


face = InspireDdsEndpoint
