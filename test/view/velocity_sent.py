"""The velocity of whole ticks: within one, it is the script's first, then the driver's."""

from __future__ import annotations

from unicon_core.flow import Block, Stage
from unicon_core.workflow import HookBlocks, Program

__all__ = ["VelocitySent"]


class VelocitySent:
    """A hook that notes the velocity command as each tick leaves it, to be read from any thread."""

    def __init__(self) -> None:
        self.last = [0.0, 0.0, 0.0]

    def hook(self, program: Program) -> HookBlocks:
        command = program.states["velocity_command"]

        def note() -> None:
            self.last = [round(float(x), 3) for x in command]

        return {Stage.OBSERVE: [Block("note the velocity", note, endless=True)]}
