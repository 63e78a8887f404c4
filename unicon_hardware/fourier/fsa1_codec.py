"""Datagrams of Fourier's FSA v1 actuators (GR-1), and what their gains are; for wire and face.

Port 2335 takes codes as of v2: a position with feed-forward, and questions for what is measured
and for errors. Modes, enabling, gains and temperatures are JSON on port 2333, whose answers say
`"status": "OK"` and have no number. Sources: PyPI fi_fsa 0.3.17, fi_fsa/v1/fi_fsa_v1.py; absolute
encoders: FFTAI/Wiki-FSE, and CreeperLin/unicon unicon/systems/fftai.py.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from unicon_base import AnyDict, RobotError
from unicon_base.arrays import Float64
from unicon_base.schema.marks import Key, Size, Within, Write
from unicon_core.robots import Robot
from unicon_hardware.facts import Port, each, fact
from unicon_hardware.fourier.actuator_wire import (
    Addressed,
    addressed,
    addresses,
    complete,
    of_actuators,
)
from unicon_hardware.wire import frame_type

ENABLE, POSITION, STATE, ERROR = 0x01, 0x0A, 0x1A, 0x1B
STATE_TYPE = frame_type("code u1, measured >f4 3")
"""Position, speed and current."""
ERROR_TYPE = frame_type("code u1, error >u4")
SERVO_OFF, SERVO_ON = 0x06, 0x0F
"""Control words."""
POSITION_MODE = 1
LARGEST_ANSWER = 1024
"""Bytes of JSON: the vendor's own buffer."""

UNITS = ("reduction_ratio", "pole_pairs", "torque_constant")
WHY = "what its actuators' gains are in N·m/rad, nor where the zero of its encoders is"


def _json(method: str, target: str, **values: object) -> bytes:
    """Return what the vendor's package writes, to the byte."""
    return json.dumps({"method": method, "reqTarget": target, **values}).encode()


MEASURED = _json("GET", "/measured", property="")
"""Asks an encoder for its `angle` in [deg]."""
TEMPERATURE = _json("GET", "/get_ntc_temperature")
"""Asks an actuator for its `mos_temperature` and `armature_temperature` in [°C]."""


def control_word(word: int) -> bytes:
    """Return the setting of a control word."""
    return _json("SET", "/control_word", property="", control_word=word)


def mode_of_operation(mode: int) -> bytes:
    """Return the setting of a mode."""
    return _json("SET", "/mode_of_operation", mode_of_operation=mode)


def loop_gains(position: float, speed: float) -> bytes:
    """Return the setting of gains, which act at once and are forgotten without power.

    Args:
        position: of the position loop.
        speed: of the speed loop, whose integral stays 0.
    """
    return _json(
        "SET",
        "/pid_param_imm",
        property="",
        control_position_kp_imm=position,
        control_velocity_kp_imm=speed,
        control_velocity_ki_imm=0.0,
    )


def understood(data: bytes) -> AnyDict | None:
    """Return a JSON object; None where it is none, whatever it is."""
    if len(data) > LARGEST_ANSWER:
        return None
    try:
        found = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def number(value: object) -> float | None:
    """Return a finite number; None where it is none."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    try:
        found = float(value)
    except OverflowError:
        return None
    return found if math.isfinite(found) else None


@dataclass(frozen=True)
class Servos(Addressed):
    """What the robot file says of actuators and encoders; arrays of shape (n,), (m,) of encoders.

    In position mode an actuator turns the difference e of its position in [deg] into a current
    (FFTAI/Wiki-FSA doc/EN/Control_System_Introduction_EN.md, i the reduction, p the pole pairs):

        I = k_v (k_p e i - v i p / 360)

    With the torque i k_t I of the joint, and radians for degrees, its gains are those of `gains`.

    Attributes:
        encoders: addresses of the absolute encoders, which the first m joints have.
        encoder_degrees: of the actuator for one of the encoder, with its sign.
        encoder_zero: what an encoder tells where its joint is at zero, [deg].
        control_port: for JSON.
        reduction: of the gear.
        pole_pairs: of the motor.
        torque_constant: of the motor in [N·m/A].
    """

    encoders: tuple[str, ...]
    encoder_degrees: Float64
    encoder_zero: Float64
    control_port: Annotated[Port, Key("port_control")]
    reduction: Annotated[Float64, Key("reduction_ratio"), each(1.0, 1e3)]
    pole_pairs: Annotated[Float64, each(1.0, 1e3)]
    torque_constant: Annotated[Float64, each(1e-6, 1e3)]

    @classmethod
    def of(cls, robot: Robot, network: str = "") -> Servos:
        """Return those of a robot file.

        Args:
            robot: the file.
            network: see `addresses`; of the encoders too.

        Raises:
            RobotError: a fact is missing or wrong.
        """
        listed = robot.transport.get("encoders") or []
        complete(robot, 1, (*UNITS, "encoder_zero") if listed else UNITS, WHY)
        if not isinstance(listed, list | tuple) or len(listed) > robot.num_joints:
            raise RobotError(
                f"robot {robot.name}: transport.encoders is not a list of addresses of the first "
                "joints' encoders"
            )
        encoders = addresses(robot, "encoders", tuple(map(str, listed)), network)
        if set(encoders) & set(of_actuators(robot, network)):
            raise RobotError(
                f"robot {robot.name}: transport.encoders names an address of transport.actuators"
            )
        signs = _each(robot, "encoder_sign", len(encoders), 1.0)
        if not (np.abs(signs) == 1.0).all():
            raise RobotError(f"robot {robot.name}: transport.encoder_sign is not 1 or -1 for each")
        return addressed(
            cls,
            robot,
            network,
            encoders=encoders,
            encoder_degrees=signs * _each(robot, "encoder_ratio", len(encoders), 1e3),
            encoder_zero=_each(robot, "encoder_zero", len(encoders), 360.0),
        )

    @cached_property
    def speed(self) -> Float64:
        """What the inner loop counts for 1 deg/s of the actuator: i p / 360."""
        return self.reduction * self.pole_pairs / 360.0

    @cached_property
    def torque(self) -> Float64:
        """Of the joint for 1 A, with its sign, [N·m/A]."""
        return self.signs * self.torque_constant * self.reduction

    def gains(
        self, stiffness: NDArray[np.floating[Any]], damping: NDArray[np.floating[Any]]
    ) -> tuple[Float64, Float64]:
        """Return the gains of the position loop and of the speed loop, shape (n,) each.

        Args:
            stiffness: of the joints in [N·m/rad], shape (n,); 0 where the damping is.
            damping: of the joints in [N·m·s/rad], shape (n,).
        """
        held = damping > 0.0
        position = np.zeros(len(held))
        np.divide(stiffness * self.speed, damping * self.reduction, out=position, where=held)
        return position, np.deg2rad(damping / (np.abs(self.torque) * self.speed))

    def joint_gains(self, joint: int, position: float, speed: float) -> tuple[float, float]:
        """Return stiffness and damping of a joint with these gains; what `gains` undoes."""
        torque = math.degrees(speed * abs(self.torque[joint]))  # for one count of the inner loop
        return float(torque * position * self.reduction[joint]), float(torque * self.speed[joint])


def _each(robot: Robot, key: str, count: int, most: float) -> Float64:
    """Return a number for each encoder, within ±`most`."""
    wanted = f"{count} numbers from {-most:g} to {most:g}, one for each of transport.encoders,"
    hint = Annotated[list[Annotated[float, Within(-most, most)]], Size(count, count), Write(wanted)]
    return np.array(fact(robot, key, hint) if count else (), np.float64)
