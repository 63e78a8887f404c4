"""Platform `booster`: T1 over DDS, for workflows.

    platform: {child: booster}
    platforms:
      booster: {address: eth0}        # of this machine, towards the robot

Topics, domain and motor slots stand in the robot file. It needs the extra `hw-booster`, and nothing
of the vendor's.
"""

from __future__ import annotations

from unicon_core.platforms.platform import Facts
from unicon_core.states.standard import CONTROL_STATES, JOINT_STATES
from unicon_ros.hardware.booster.wire import BoosterWire
from unicon_ros.hardware.dds.end import factory_of
from unicon_ros.hardware.torso import IMU_STATES
from unicon_ros.hardware.wired_robot import WiredRobot


class Booster(WiredRobot):
    """A T1; build it with `make`."""

    facts = Facts(
        "booster",
        writes=(
            *JOINT_STATES,
            *IMU_STATES,
            "projected_gravity",
            "stamp_ns",
            "motor_temperature",
            "motor_error",
            "battery_charge",
            "battery_voltage",
            *CONTROL_STATES,
        ),
        protocols=("booster",),
    )


make = factory_of(Booster, BoosterWire)
