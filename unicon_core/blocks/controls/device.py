"""Device: the states that a gamepad, keyboard or remote writes, and letting go of everything."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from unicon_base.arrays import Float32, Int32
from unicon_core.flow import Block, Stage
from unicon_core.states import States, StateSpec
from unicon_core.states.standard import CONTROL_STATES, control_states
from unicon_core.workflow.autowire import BuildContext


class Controls:
    """The views of the control states.

    Args:
        states: of the workflow.

    Attributes:
        sticks: lx, ly, rx, ry, shape (4,).
        buttons: as of `BUTTONS`, shape (16,).
        alive: 1 while the device is heard, shape ().
    """

    def __init__(self, states: States) -> None:
        self.sticks: Float32 = states["sticks"]
        self.buttons: Int32 = states["buttons"]
        self.alive: Int32 = states["controls_alive"]

    def let_go(self) -> None:
        """Release all that is pressed: the device is not heard."""
        self.sticks[...] = 0.0
        self.buttons[...] = 0
        self.alive[...] = 0


def declares_controls(**_: Any) -> Mapping[str, StateSpec]:
    """Return the states of a block that writes, or reads, what an operator holds."""
    return control_states()


def device_block(name: str, tick: Callable[[], None], context: BuildContext) -> Block:
    """Return the block of a device; it is received, so that every record has what it told.

    A robot that tells its own remote has no need of it: the block then does nothing.
    """
    told = () if context.platform is None else context.platform.facts.writes
    if "sticks" in told:
        return Block(name, _nothing, endless=True, stage=Stage.RECV)
    closing = {end: getattr(tick, end) for end in ("reset", "close")}
    return Block("device", tick, writes=CONTROL_STATES, endless=True, stage=Stage.RECV, **closing)


def _nothing() -> None:
    """Do nothing: the robot's own remote is heard."""
