"""Datagrams of Fourier's FSA v2 actuators, port 2335, big endian; for their wire and their face.

The first byte is a code. A query is answered under its own code; a setting that is acknowledged
carries a count, and its answer that count and a result. Source: PyPI fi_fsa 0.3.17,
fi_fsa/v2/fi_fsa_v2.py. Positions are in [deg], speeds in [deg/s], currents in [A]; gains are the
actuator's own, and the robot file says what they are.
"""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import RobotError
from unicon_core.robots import Robot
from unicon_ros.hardware.facts import TransportFacts

__all__ = [
    "ACKNOWLEDGED",
    "ACKNOWLEDGED_GAINS",
    "ARM_DEAD_MAN",
    "CLEAR_DEAD_MAN",
    "COMMAND",
    "COMMAND_TYPE",
    "DISABLE",
    "ENABLE",
    "GAINS",
    "GAINS_TYPE",
    "PD_MODE",
    "STATE",
    "STATE_TYPE",
    "TEMPERATURE",
    "TEMPERATURE_TYPE",
    "TIMED_OUT",
    "Actuators",
]

DISABLE, COMMAND, GAINS = 0x02, 0x0E, 0xA1
STATE, TEMPERATURE = 0x21, 0x22
ENABLE, PD_MODE, ACKNOWLEDGED_GAINS, ARM_DEAD_MAN, CLEAR_DEAD_MAN = 0x51, 0x59, 0x61, 0x64, 0x65

COMMAND_TYPE = np.dtype([("code", "u1"), ("pos", ">f4"), ("vel", ">f4"), ("current", ">f4")])
"""Targets of PD mode: position, and feed-forward of speed and current."""
GAINS_TYPE = np.dtype([("code", "u1"), ("kp", ">f4"), ("kd", ">f4")])
STATE_TYPE = np.dtype([("code", "u1"), ("measured", ">f4", (4,)), ("errors", ">u4", (8,))])
"""Position, speed, current and torque; the main error and seven words of extended ones."""
TEMPERATURE_TYPE = np.dtype([("code", "u1"), ("celsius", ">f4", (2,))])
"""Of the transistors and of the windings."""
ACKNOWLEDGED = np.dtype([("code", "u1"), ("count", ">u4"), ("result", ">u4")])

TIMED_OUT = 7, 0x01
"""Of `errors`: the word and the bit which say that no command came in time."""

UNITS = ("stiffness_scale", "damping_scale", "timeout_mode")


@dataclass(frozen=True)
class Actuators:
    """What the robot file says of the actuators; arrays of shape (n,).

    Attributes:
        names: of the joints.
        addresses: of the actuators.
        port: for codes.
        rate: at which they may be asked, [Hz].
        degrees: of an actuator for one radian of the joint, with its sign.
        kp: of an actuator for 1 N·m/rad of the joint.
        kd: of an actuator for 1 N·m·s/rad of the joint.
        current: for 1 N·m of the joint in [A], with its sign; None where nobody knows.
        timeout_mode: which mode an actuator enters that gets no commands.
    """

    names: tuple[str, ...]
    addresses: tuple[str, ...]
    port: int
    rate: float
    degrees: NDArray[np.float64]
    kp: NDArray[np.float64]
    kd: NDArray[np.float64]
    current: NDArray[np.float64] | None
    timeout_mode: int

    @classmethod
    def of(cls, robot: Robot, network: str = "") -> Actuators:
        """Return those of a robot file.

        Args:
            robot: the file.
            network: an address in another network of 256 in which they are; the last number of
                each address stays.

        Raises:
            RobotError: a fact is missing or wrong.
        """
        facts, transport = TransportFacts(robot), robot.transport
        if transport.get("fsa") != 2:
            raise RobotError(
                f"robot {robot.name}: transport.fsa is {transport.get('fsa')}; only actuators of "
                "FSA version 2 are driven (N1)"
            )
        missing = [key for key in UNITS if transport.get(key) is None]
        if missing:
            raise RobotError(
                f"robot {robot.name}: its vendor does not say what its actuators' gains are in "
                "N·m/rad, nor what they do when commands stop; measure it, and write "
                f"{', '.join(f'transport.{key}' for key in missing)} into {robot.path.name} with "
                "its source"
            )
        addresses = facts.texts("actuators")
        if network:
            start = network.rpartition(".")[0]
            addresses = tuple(f"{start}.{a.rpartition('.')[2]}" for a in addresses)
        try:
            addresses = tuple(str(ipaddress.IPv4Address(a)) for a in addresses)
        except ValueError as error:
            raise facts.wrong("actuators", f"IPv4 addresses ({error})") from error
        if len(set(addresses)) < len(addresses):
            raise facts.wrong("actuators", "an address of its own for each")
        signs = facts.numbers("actuator_sign", -1.0, 1.0)
        if not (np.abs(signs) == 1.0).all():
            raise facts.wrong("actuator_sign", "1 or -1 for each joint")
        known = transport.get("current_scale") is not None
        return cls(
            robot.joint_names,
            addresses,
            facts.integer("port_fast", 1, 65535),
            facts.number("rate_hz", 1.0, 1000.0),
            np.rad2deg(signs),
            facts.numbers("stiffness_scale", 1e-9, 1e9),
            facts.numbers("damping_scale", 1e-9, 1e9),
            signs * facts.numbers("current_scale", 1e-9, 1e9) if known else None,
            facts.integer("timeout_mode", 0, 255),
        )
