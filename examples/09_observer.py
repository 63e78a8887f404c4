"""A hook gives a program further blocks, each for its stage: here one that looks after `send`."""

from __future__ import annotations

import numpy as np

from unicon_core import Block, Loop, Program, Stage, elapsed, pose, run


class Peak:
    """Keeps the largest joint velocity in [rad/s]."""

    def __init__(self) -> None:
        self.velocity = 0.0

    def hook(self, program: Program) -> dict[Stage, list[Block]]:
        """Return the block that looks."""
        joint_vel = program.states["joint_vel"]

        def look() -> None:
            self.velocity = max(self.velocity, float(np.abs(joint_vel).max()))

        return {Stage.OBSERVE: [Block("peak", look, reads=("joint_vel",))]}


if __name__ == "__main__":
    peak = Peak()
    flow = Loop(pose("stand", duration=1.0), until=elapsed(2))
    program = Program(robot="go2", platform="mujoco", rate=250, flow=flow, hooks=[peak.hook])
    run(program, speed="max")
    print(f"largest joint velocity {peak.velocity:.1f} rad/s")
