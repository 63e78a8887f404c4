"""Phases of a run, for the runner and for whoever reads what a run does.

start → run → wind-down → close
"""

from __future__ import annotations

from enum import Enum

from unicon_core.workflow import Program

__all__ = ["WIND_DOWN", "Phase", "describe"]

WIND_DOWN = 5.0
"""Longest wind-down in [s]: whoever asks a run to end is not to wait for ever."""


class Phase(Enum):
    """What a run is at."""

    START = "start"
    """The platform is open and has told every state that is needed; the gates are asked."""
    RUN = "run"
    """The flow ticks. The report's distances, falls and hash count this phase alone."""
    WIND_DOWN = "wind-down"
    """The flow of `wind_down:` ticks; recv, estimate, input, safety, send and observers go on."""
    CLOSE = "close"
    """The platform damps and lets go; nothing is sent any more."""


def describe(program: Program) -> list[tuple[str, str]]:
    """Return what each phase of a program does, for tables."""
    after = "" if program.duration is None else f" or for {program.duration:g} s"
    gates = ", ".join(getattr(g, "name", "gate") for g in program.gates) or "no gates"
    wind_down = f"its flow until it is done, at most {WIND_DOWN:g} s"
    if program.wind_down is None:
        wind_down = "none: the platform damps at once"
    return [
        (Phase.START.value, f"platform {program.platform.facts.name} is open; {gates}"),
        (Phase.RUN.value, f"the flow until it is done{after}"),
        (Phase.WIND_DOWN.value, wind_down),
        (Phase.CLOSE.value, "the platform damps and lets go"),
    ]
