"""What the two DDS interfaces of an RH56 carry, made of a robot file; for both ends of the wire.

FTP (protocol `inspire_ftp`): a message for each hand, six angles of 0 (closed) to 1000 (open), and
`mode`, whose bit 0 says that angles count (NaCl-1374/inspire_hand_ws inspire_hand_sdk/hand_idl,
inspire_sdkpy/inspire_sdk.py). DFX (`inspire_dfx`): Unitree's MotorCmds and MotorStates with both
hands, `q` of 0 (closed) to 1 (open) (unitreerobotics/xr_teleoperate
teleop/robot_control/robot_hand_inspire.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.robots import Robot
from unicon_msgs_map import Encoder
from unicon_msgs_map.layout.messages import Struct, shared_messages
from unicon_ros.hardware.dds.frames import Frames
from unicon_ros.hardware.dds.maps import publish, subscribe
from unicon_ros.hardware.dds.participant import LARGEST_DOMAIN
from unicon_ros.hardware.facts import TransportFacts
from unicon_ros.hardware.wire import Counts

Arrays = Mapping[str, NDArray[Any]]
ANGLES = 1
"""Bit of `mode` of the FTP: `angle_set` counts."""


@dataclass(frozen=True)
class Kind:
    """One of the interfaces.

    Attributes:
        command: type of the command.
        state: type of the state.
        names: of both in DDS, "" where they follow from the type.
        dtype: of what is sent for an angle.
        count: angles in a message.
        command_fields: of the command to arrays, `targets` and `mode` among them.
        state_fields: of the state to arrays, `told` and states of the hand.
        constants: what else stands in a state.
        lengths: of sequences in front of which nothing varies, of command and state.
    """

    command: str
    state: str
    names: tuple[str, str]
    dtype: type
    count: int
    command_fields: Mapping[str, Any]
    state_fields: Mapping[str, str]
    constants: Mapping[str, Any]
    lengths: tuple[Mapping[str, int], Mapping[str, int]]


FTP = Kind(
    "inspire/msg/HandCtrl",
    "inspire/msg/HandState",
    ("inspire.inspire_hand_ctrl", "inspire.inspire_hand_state"),
    np.int16,
    6,
    {"angle_set[0:6]": "targets", "mode": "mode"},
    {
        "angle_act[0:6]": "told",
        "err[0:6]": "motor_error",
        "temperature[0:6]": "motor_temperature",
    },
    {f"{name}[5]": 0 for name in ("pos_act", "force_act", "current", "status")},
    ({"pos_set": 6}, {"pos_act": 6}),
)
DFX = Kind(
    "unitree_go/msg/MotorCmds",
    "unitree_go/msg/MotorStates",
    ("", ""),
    np.float32,
    12,
    {"cmds[0:12].q": "targets"},
    {"states[0:12].q": "told"},
    {},
    ({"cmds": 12}, {"states": 12}),
)
KINDS = {"inspire_ftp": FTP, "inspire_dfx": DFX}
"""By `transport.protocol`."""


@dataclass(frozen=True)
class HandFacts:
    """`transport` of a robot file.

    Attributes:
        kind: of interface.
        domain: of DDS.
        state_topic: of the state.
        command_topic: of the command.
        rate: of the state in [Hz].
        slots: place of each joint in the message, shape (6,).
        open: what stands for each joint's lower limit.
        per_rad: change with the angle, shape (6,).
        lower: limit in [rad], shape (6,).
        ends: smallest and largest number that may be sent.
    """

    kind: Kind
    domain: int
    state_topic: str
    command_topic: str
    rate: float
    slots: NDArray[np.intp]
    open: float
    per_rad: NDArray[np.float64]
    lower: NDArray[np.float64]
    ends: tuple[float, float]

    @classmethod
    def of(cls, robot: Robot) -> HandFacts:
        """Read them.

        Raises:
            RobotError: one lacks, or is not what it must be.
        """
        facts = TransportFacts(robot)
        kind = KINDS[facts.one_of("protocol", tuple(KINDS))]
        limit = 32767.0
        open_ = facts.number("raw_lower", -limit, limit)
        closed = facts.number("raw_upper", -limit, limit)
        lower = robot.lower.astype(np.float64)
        slots = facts.slots("motors", kind.count) if kind is DFX else range(kind.count)
        return cls(
            kind,
            facts.integer("domain", 0, LARGEST_DOMAIN),
            facts.text("state_topic"),
            facts.text("command_topic"),
            facts.number("rate_hz", 1.0, 10_000.0),
            np.array(slots, np.intp),
            open_,
            (closed - open_) / (robot.upper.astype(np.float64) - lower),
            lower,
            (min(open_, closed), max(open_, closed)),
        )

    def to_wire(self, angles: NDArray[Any]) -> tuple[NDArray[np.float64], bool]:
        """Return what is sent for angles in [rad], and whether one was beyond the ends."""
        exact = self.open + (angles - self.lower) * self.per_rad
        sent = np.clip(exact, *self.ends)
        span = self.ends[1] - self.ends[0]
        beyond = bool(np.abs(exact - sent).max() > 1e-4 * span)  # a limit in float32 is not
        return (np.rint(sent) if self.kind.dtype is np.int16 else sent), beyond

    def to_angles(self, told: NDArray[Any]) -> NDArray[np.float64]:
        """Return the angles in [rad] of what was told."""
        angles: NDArray[np.float64] = self.lower + (told - self.open) / self.per_rad
        return angles

    def messages(self) -> tuple[Struct, Struct]:
        """Return the layouts of command and state."""
        known = shared_messages()
        return known.struct(self.kind.command), known.struct(self.kind.state)

    def command_out(self, arrays: Arrays) -> Encoder:
        """Return what makes the command, of `targets`."""
        fields = dict(self.kind.command_fields)
        if "mode" in fields:
            fields |= {"mode": ANGLES}
            fields |= {f"{name}[5]": 0 for name in ("pos_set", "force_set", "speed_set")}
        return Encoder.build(publish(self.command_topic, self.kind.command, fields), arrays)

    def command_in(self, arrays: Arrays, counts: Counts) -> Frames:
        """Return what reads the command, as the hand does."""
        spec = subscribe(self.command_topic, self.kind.command, self.kind.command_fields)
        lengths, size = self.kind.lengths[0], self.command_out(arrays).size
        return Frames(spec, arrays, counts, checked=False, lengths=lengths, size=size)

    def state_out(self, arrays: Arrays) -> Encoder:
        """Return what makes the state."""
        fields = {**self.kind.constants, **self.kind.state_fields}
        return Encoder.build(publish(self.state_topic, self.kind.state, fields), arrays)

    def state_in(self, arrays: Arrays, counts: Counts) -> Frames:
        """Return what reads the state into those arrays that are there."""
        told = {path: name for path, name in self.kind.state_fields.items() if name in arrays}
        spec = subscribe(self.state_topic, self.kind.state, told)
        own = {"told": arrays["told"]} | {
            name: np.zeros(6, np.int32)
            for name in self.kind.state_fields.values()
            if name != "told"
        }
        lengths, size = self.kind.lengths[1], self.state_out(own).size
        return Frames(spec, arrays, counts, checked=False, lengths=lengths, size=size)
