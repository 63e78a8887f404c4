"""Codec: the datagrams of unitree_legged_sdk, for the driver and for the robot's end of it.

Two layouts, told apart by their lengths: 610 and 771 bytes (A1, Aliengo) and 614 and 807 (Go1).
What is on the wire is not the public C struct: the SDK packs it and compresses the motors' gains
and torques to 16 bits. Facts: unitreerobotics/unitree_legged_sdk include/unitree_legged_sdk/comm.h
(fields, modes), v3.3.1 and v3.8.6, and what its libraries put on the wire (golden frames).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from unicon_base import AnyMapping, PlatformError, RobotError, alternatives
from unicon_base.arrays import Array, Float32
from unicon_base.schema.marks import Key, Text, Within
from unicon_core.robots import Robot
from unicon_hardware.facts import (
    Octet,
    Port,
    Rate,
    fact,
    facts_of,
    ipv4,
    port_number,
    slots,
    wrong_fact,
)
from unicon_hardware.wire import frame_type
from unicon_msgs_map.codec.binding import words_crc

SLOTS = 20
"""Motors of a datagram; a robot of 12 leaves the rest idle."""
TORQUE, STIFFNESS, DAMPING = 256.0, 32.0, 16.0
"""Of the wire for 1 N·m (int16), 1 N·m/rad and 1 N·m·s/rad (uint16); truncated toward zero."""
# Smallest and largest number of the wire, and its scale: of torque, stiffness, damping.
_COMPRESSED = ((-32768, 32767, TORQUE), (0, 65535, STIFFNESS), (0, 65535, DAMPING))
CELL_VOLT = 0.032
"""Of a cell's byte in [V]."""

_MOTOR_COMMAND = frame_type("mode u1, q <f4, dq <f4, tau <i2, kp <u2, kd <u2, reserve <u4 3")
_MOTOR_STATE = frame_type(
    "mode u1, q <f4, dq <f4, ddq <i2, tau <i2, q_raw <f4, dq_raw <f4, ddq_raw <i2, temperature i1, "
    "reserve <u4 2"
)
_BMS_STATE = frame_type(
    "version u1 2, status u1, soc u1, current <i4, cycle <u2, bq_ntc i1 2, mcu_ntc i1 2, "
    "cells u1 10"
)
_A1 = "level u1, version <u2, robot <u2, sn <u4, band u1, "
_GO1 = "head u1 2, level u1, frame u1, sn <u4 2, version <u4 2, band <u2, "
_IMU = "quat <f4 4, gyro <f4 3, acc <f4 3, rpy <f4 3, imu_temperature i1, "  # wxyz
_FEET = "foot_force <i2 4, foot_force_est <i2 4, tick <u4, "
_END = "remote u1 40, reserve <u4, crc <u4"


def _command(head: str, more: str) -> np.dtype[Any]:
    return frame_type(f"{head}motors motor {SLOTS}, {more}, {_END}", motor=_MOTOR_COMMAND)


def _state(head: str, more: str = "") -> np.dtype[Any]:
    table = f"{head}{_IMU}motors motor {SLOTS}, {more}{_FEET}{_END}"
    return frame_type(table, motor=_MOTOR_STATE, bms=_BMS_STATE)


@dataclass(frozen=True)
class Layout:
    """The two datagrams of one protocol.

    Attributes:
        command: fields of what goes to the robot.
        state: fields of what comes from it.
        head: first bytes of both.
    """

    command: np.dtype[Any]
    state: np.dtype[Any]
    head: bytes = b""


LAYOUTS = {
    (layout.command.itemsize, layout.state.itemsize): layout
    for layout in (
        Layout(_command(_A1, "led u1 4x3"), _state(_A1)),
        Layout(_command(_GO1, "bms u1 4"), _state(_GO1, "bms bms, "), b"\xfe\xef"),
    )
}
"""By the lengths of command and state in bytes."""

_BAND_ENCRYPTED = 0xC03A


def encrypted_crc(crc: int) -> int:
    """Return the checksum that a Go1 which is not an EDU wants in place of the plain one.

    Bin4ry/free-dog-sdk ucl/common.py: encryptCrc.
    """
    mixed = crc ^ 0xEDCAB9DE
    return mixed >> 8 | (mixed & 0xFF) << 24


class Frame:
    """A datagram, and its fields as views.

    Attributes:
        buffer: its bytes.
    """

    def __init__(self, fields: np.dtype[Any]) -> None:
        self.buffer = bytearray(fields.itemsize)
        self._whole = np.frombuffer(self.buffer, fields)
        # The words do not end where the checksum stands: 2 or 3 bytes before it are not covered.
        self._crc = words_crc(self.buffer, (fields.itemsize >> 2) - 1)
        self._stored = self["crc"]

    def __getitem__(self, field: str) -> Array:
        """Return the view of a field; of a number one of shape ()."""
        view: Array = self._whole[field][0, ...]
        return view

    def __contains__(self, field: str) -> bool:
        """Return whether there is such a field."""
        return field in (self._whole.dtype.names or ())

    def fill(self, datagram: bytes) -> None:
        """Take the bytes of a datagram of this length."""
        self.buffer[:] = datagram

    def seal(self, encrypted: bool = False) -> None:
        """Write the checksum."""
        crc = self._crc()
        self._stored[...] = encrypted_crc(crc) if encrypted else crc

    def sound(self, encrypted: bool = False) -> bool:
        """Return whether the checksum is right.

        Args:
            encrypted: the other one is right too.
        """
        crc, stored = self._crc(), int(self._stored)
        return stored == crc or (encrypted and stored == encrypted_crc(crc))


class CommandFrame(Frame):
    """The datagram that commands the motors; it begins idle, as the vendor's own does.

    Args:
        link: layout, slots, modes and stops of the robot.
        encrypted: with the other checksum.

    Attributes:
        clamped: commands so far with a figure that the wire could not hold.
    """

    def __init__(self, link: LeggedTransport, encrypted: bool = False) -> None:
        layout, stops = link.layout, (link.pos_stop, link.vel_stop)
        super().__init__(layout.command)
        self.buffer[: len(layout.head)] = layout.head
        self["level"][...] = link.level_flag
        if encrypted:
            self["band"][...] = _BAND_ENCRYPTED
        every = self["motors"]
        every["mode"], (every["q"], every["dq"]) = link.servo, stops
        self.clamped = 0
        self._encrypted = encrypted
        self._stops = np.array(stops, np.float32)
        self._views = [every[name][link.motors] for name in ("q", "dq", "tau", "kp", "kd")]
        count = len(self._views[0])
        least, most, scale = np.array(_COMPRESSED, np.float32).T[..., None]
        self._scale, self._least, self._most = scale, least / scale, most / scale
        self._asked, self._held = np.zeros((2, 3, count), np.float32)
        self._whole_numbers = np.zeros((3, count), np.int32)
        self._moves = np.zeros((2, count), np.float32)
        self.seal(encrypted)

    def write(
        self, pos: Float32, vel: Float32, effort: Float32, stiffness: Float32, damping: Float32
    ) -> bytes:
        """Return the datagram of a command, all of it finite, each of shape (n,).

        Without stiffness a motor is sent no position, and without damping no velocity: the vendor's
        stops stand there, so that nothing but the gains' zeros has to be right.

        Args:
            pos: in [rad].
            vel: in [rad/s].
            effort: in [N·m], within ±128.
            stiffness: in [N·m/rad], below 2048.
            damping: in [N·m·s/rad], below 4096.
        """
        asked, held, numbers, moves = self._asked, self._held, self._whole_numbers, self._moves
        asked[0], asked[1], asked[2] = effort, stiffness, damping
        np.maximum(asked, self._least, out=held)
        np.minimum(held, self._most, out=held)
        self.clamped += bool((held != asked).any())
        held *= self._scale  # by powers of two: exact
        numbers[...] = held
        moves[0], moves[1] = pos, vel
        np.copyto(moves[0], self._stops[0], where=numbers[1] == 0)
        np.copyto(moves[1], self._stops[1], where=numbers[2] == 0)
        for view, values in zip(self._views, (*moves, *numbers)):
            view[...] = values
        self.seal(self._encrypted)
        return bytes(self.buffer)


NAME = "unitree_legged"


@dataclass(frozen=True)
class LeggedTransport:
    """Addresses, layout and modes.

    Attributes:
        generation: name of the protocol's.
        layout: its datagrams.
        address: of the robot.
        port: where it takes commands.
        local_port: where it is answered to.
        motors: slots of the joints.
        level_flag: of low-level datagrams.
        servo: mode of a motor that takes commands.
        damping: mode of one that brakes.
        pos_stop: position that says: no position loop.
        vel_stop: velocity that says: no velocity loop.
        rate: of datagrams in [Hz].
        preparation: what a person does so that the robot takes commands.
    """

    generation: str
    layout: Layout
    address: str
    port: int
    local_port: int
    motors: slice
    level_flag: Octet
    servo: Annotated[Octet, Key("motor_mode")]
    damping: Annotated[Octet, Key("damping_mode")]
    pos_stop: Annotated[float, Within(1.0, 1e10)]
    vel_stop: Annotated[float, Within(1.0, 1e10)]
    rate: Rate
    preparation: Text = "bring it into its low-level mode as its maker says"


def link_of(
    robot: Robot,
    *,
    generation: str | None = None,
    address: str | None = None,
    port: int | None = None,
    local_port: int | None = None,
) -> LeggedTransport:
    """Return what the robot file says, with the options in place of it where they are given.

    Args:
        robot: whose `transport` is read.
        generation: a word of its `generations`; None where it has one alone.
        address: IPv4 address.
        port: of the robot.
        local_port: of this machine.

    Raises:
        PlatformError: an option is wrong, or the generation has to be said.
        RobotError: the file lacks a fact, or it is wrong.
    """
    chosen, spoken = _generation(robot, generation)
    lengths = [spoken.get(key) for key in ("command_bytes", "state_bytes")]
    layout = next((layout for known, layout in LAYOUTS.items() if lengths == [*known]), None)
    if layout is None:
        known = ", ".join(f"{command} and {state}" for command, state in LAYOUTS)
        raise RobotError(
            f"robot {robot.name}: transport.generations.{chosen} has {lengths[0]} and "
            f"{lengths[1]} bytes; known: {known} ({robot.path})"
        )
    motors = fact(robot, "motors", Annotated[list[int], slots(SLOTS)])
    if [*motors] != [*range(motors[0], motors[0] + len(motors))]:
        raise wrong_fact(robot, "motors", f"{len(motors)} slots in sequence, all below {SLOTS},")
    address = fact(robot, "address", Text) if address is None else address
    port = fact(robot, "port", Port) if port is None else port
    local_port = spoken.get("local_port") if local_port is None else local_port
    return facts_of(
        LeggedTransport,
        robot,
        generation=chosen,
        layout=layout,
        address=ipv4(address, NAME),
        port=port_number(port, NAME),
        local_port=port_number(local_port, NAME, "local_port"),
        motors=slice(motors[0], motors[-1] + 1),
    )


def _generation(robot: Robot, chosen: str | None) -> tuple[str, AnyMapping]:
    known = robot.transport.get("generations")
    mapping = isinstance(known, Mapping) and all(
        isinstance(said, Mapping) for said in known.values()
    )
    if not known or not mapping:
        raise wrong_fact(robot, "generations", "{NAME: {…}, …}")
    spoken = [name for name, said in known.items() if "command_bytes" in said]
    if chosen is None and len(known) == 1:
        chosen = next(iter(known))
    if chosen is None:
        example = spoken[0] if spoken else "…"
        raise PlatformError(
            f"platform {NAME!r}: robot {robot.name} speaks one of {len(known)} protocols, and "
            "nothing tells which; say the generation by the vendor's SDK that drives yours: "
            f"platforms: {{{NAME}: {{generation: {example}}}}}, in `unicon emulate` "
            f"--set generation={example}; known: {', '.join(known)}"
        )
    if not isinstance(chosen, str) or chosen not in known:
        raise PlatformError(
            f"platform {NAME!r}: robot {robot.name} has no generation {chosen!r}; "
            f"{alternatives(str(chosen), known)}"
        )
    if chosen not in spoken:
        raise PlatformError(
            f"platform {NAME!r}: generation {chosen} cannot be spoken: "
            f"{known[chosen].get('refused', 'its layout is not known')}; "
            f"spoken are {', '.join(spoken)}"
        )
    return chosen, known[chosen]
