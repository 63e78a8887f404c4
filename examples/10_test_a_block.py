"""Testing a block of one's own on the bench that unicon's blocks are tested on."""

from __future__ import annotations

import numpy as np

from unicon_core import Amends, Reads
from unicon_core.flow import Tick
from unicon_core.testing import Bench


def soften(joint_stiffness: Amends, joint_vel: Reads, *, above: float = 2.0) -> Tick:
    """Halve the stiffness of joints that are faster than `above` in [rad/s]."""

    def tick() -> None:
        joint_stiffness[np.abs(joint_vel) > above] *= 0.5

    return tick


def test_fast_joints_are_softened() -> None:
    bench = Bench("go2")
    bench.stand()
    bench.states.joint_vel[3] = -5.0
    stiffness = bench.states.joint_stiffness.copy()
    block = bench.block(soften, above=2.0)
    block.tick()
    assert block.amends == ("joint_stiffness",)
    assert bench.states.joint_stiffness[3] == 0.5 * stiffness[3]
    assert (bench.states.joint_stiffness[:3] == stiffness[:3]).all()


if __name__ == "__main__":
    test_fast_joints_are_softened()
    print("fast joints are softened")
