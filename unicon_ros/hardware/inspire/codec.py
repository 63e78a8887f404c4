"""What the registers of an Inspire RH56 mean, by its robot file."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import numpy as np

from unicon_core.robots import Robot
from unicon_core.schema.marks import Within
from unicon_ros.hardware.facts import Octet, Word, fact
from unicon_ros.hardware.modbus.registers import HandRegisters, Told

RAW = Annotated[float, Within(-32768.0, 32767.0)]


def registers_of(robot: Robot) -> HandRegisters:
    """Return the registers of a hand: angles from `raw_lower` (open) to `raw_upper` (closed).

    Raises:
        RobotError: the robot file does not say them.
    """
    register = partial(fact, robot, hint=Word)
    open_, closed = (fact(robot, key, RAW) for key in ("raw_lower", "raw_upper"))
    lower, upper = robot.lower.astype(np.float64), robot.upper.astype(np.float64)
    per_rad = (closed - open_) / (upper - lower)
    ends = np.array([[min(open_, closed)], [max(open_, closed)]]).astype(np.int64)
    lowest, highest = np.repeat(ends, robot.num_joints, axis=1)
    return HandRegisters(
        unit=fact(robot, "device_id", Octet),
        target=register("register_angle_set"),
        angle=register("register_angle_actual"),
        at_zero=open_ - per_rad * lower,
        per_rad=per_rad,
        lowest=lowest,
        highest=highest,
        slow={
            "motor_error": Told(register("register_error"), bytes=True),
            "motor_status": Told(register("register_status"), bytes=True),
            "motor_temperature": Told(register("register_temperature"), bytes=True),
        },
        clear=(register("register_clear_error"), 1),
    )
