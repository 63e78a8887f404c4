"""Platform `pnd`: Adam over CycloneDDS, for workflows.

    platform: pnd
    platforms:
      pnd: {address: eth0}        # of this machine, towards the robot

Topics, domain and motor slots stand in the robot file. It needs the extra `hw-pnd`.
"""

from __future__ import annotations

from unicon_core.platforms.platform import Facts
from unicon_core.states.standard import CONTROL_STATES, JOINT_STATES
from unicon_ros.hardware.dds.end import factory_of
from unicon_ros.hardware.pnd.wire import PndWire
from unicon_ros.hardware.wired_robot import WiredRobot


class Pnd(WiredRobot):
    """An Adam; build it with `make`."""

    facts = Facts(
        "pnd",
        writes=(
            *JOINT_STATES,
            "base_quat",
            "base_ang_vel",
            "base_lin_acc",
            "projected_gravity",
            "stamp_ns",
            "motor_error",
            *CONTROL_STATES,
        ),
        protocols=("pnd_adam",),
    )


make = factory_of(Pnd, PndWire)
