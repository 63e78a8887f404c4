"""`twin_stop` alone: a flag that stays raised trips it, in its time, by the joint's name."""

from __future__ import annotations

import numpy as np
import pytest

from unicon_base.errors import Fault, WorkflowError
from unicon_core.blocks.safety.servo_stops import TwinStop
from unicon_core.robots import load_robot
from unicon_core.workflow.autowire import read_options

ROBOT = load_robot("go2")
PERIOD = 0.02


class Flags:
    """A twin's states and the stop that reads them."""

    def __init__(self, **options: float) -> None:
        self.raised = np.zeros(ROBOT.num_joints, np.int32)
        self.gap = np.linspace(0.2, 0.3, ROBOT.num_joints, dtype=np.float32)
        self.stop = TwinStop(self.raised, self.gap, robot=ROBOT, period=PERIOD, **options)

    def ticks(self, count: int) -> None:
        """Look so often."""
        for _ in range(count):
            self.stop()


def test_it_trips_after_its_time_and_names_the_joint():
    flags = Flags()
    flags.ticks(50)
    flags.raised[7] = 1
    flags.ticks(9)
    with pytest.raises(
        Fault, match=f"joint {ROBOT.joint_names[7]} is 0.26 rad from its twin for 10"
    ):
        flags.ticks(1)


def test_a_break_and_a_reset_begin_anew():
    flags = Flags(timeout=0.1)
    flags.raised[3] = 1
    flags.ticks(4)
    flags.raised[3] = 0
    flags.ticks(1)
    flags.raised[3] = 1
    flags.ticks(4)
    flags.stop.reset()
    flags.ticks(4)
    with pytest.raises(Fault, match=ROBOT.joint_names[3]):
        flags.ticks(1)


def test_of_several_the_largest_gap_is_named():
    flags = Flags(timeout=0.1)
    flags.raised[[2, 9]] = 1
    flags.ticks(4)
    flags.raised[11] = 1  # farther away, but not for long enough
    with pytest.raises(Fault, match=ROBOT.joint_names[9]):
        flags.ticks(1)


@pytest.mark.parametrize("timeout", [float("nan"), -1.0, float("inf")])
def test_a_time_that_is_none_is_refused(timeout):
    with pytest.raises(WorkflowError, match=r"timeout is .*; write a number above 0 to 5 \[s\]"):
        read_options(TwinStop, {"timeout": timeout}, lambda text, *_: WorkflowError(text))
