"""Platform `unitree_dex3`: a Dex3-1 hand over CycloneDDS, for workflows.

    platform: {hand: unitree_dex3}
    platforms:
      hand: {address: eth0}        # of this machine, towards the robot

It needs the extra `hw-unitree`.
"""

from __future__ import annotations

from unicon_core.platforms.platform import Facts
from unicon_core.states.standard import JOINT_STATES
from unicon_ros.hardware.dds.end import factory_of
from unicon_ros.hardware.unitree_dex3.wire import Dex3Wire
from unicon_ros.hardware.wired_robot import WiredRobot

SILENCE = 0.1
"""In [s]: ten frames at the 100 Hz at which the vendor's example commands it."""


class Dex3(WiredRobot):
    """One hand; build it with `make`."""

    facts = Facts(
        "unitree_dex3",
        writes=(*JOINT_STATES, "motor_temperature", "motor_error", "stamp_ns"),
        protocols=("unitree_dex3",),
    )


make = factory_of(Dex3, Dex3Wire, SILENCE)
