"""Block `scripted`: the emulated headset of `examples/` in the tick, for runs at full speed."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from unicon_core.flow import Block, Stage
from unicon_core.workflow.autowire import BuildContext
from unicon_hardware.peripherals.webxr.webxr import PARTS, Frame, webxr

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))

from emulated_headset import Operator


def scripted(
    context: BuildContext,
    *,
    begin: float = 1.0,
    hands: bool = False,
    ahead: float = 0.0,
    radius: float = 0.08,
) -> Block:
    """Write what `webxr` would, of the operator's arithmetic."""
    states, operator = context.states, Operator(hands, radius, 0.4, 0.5, begin, ahead)
    number = 0

    def tick() -> None:
        nonlocal number
        number += 1
        frame = Frame(operator.frame(number, number * context.period, 1.0))
        for part, at in PARTS.items():
            many = at.stop - at.start > 1
            states[f"webxr_{part}"][...] = frame.poses[at if many else at.start]
        for row, side in enumerate(("left", "right")):
            states[f"webxr_{side}_buttons"][...] = frame.buttons[row]
            states[f"webxr_{side}_axes"][...] = frame.axes[row]
        states["webxr_valid"][...] = frame.valid
        states["webxr_alive"], states["webxr_age"] = 1, 0.01
        states["webxr_stamp_ns"] += round(1e9 * context.period)

    names = tuple(webxr.declares())  # type: ignore[attr-defined]
    block = Block("scripted", tick, writes=names, endless=True, stage=Stage.RECV)
    if context.dry:  # a record has what it told
        block.tick = lambda: None
    return block


def _declares(**_: Any) -> Any:
    return webxr.declares()  # type: ignore[attr-defined]


setattr(scripted, "declares", _declares)  # noqa: B010  a function has none to mypy
