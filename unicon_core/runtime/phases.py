"""Phases of a run, for the runner and for whoever reads what a run does.

wait → approach → run → soft → damp → off

A fault, or a second signal, leaves every phase for damp.
"""

from __future__ import annotations

from enum import Enum

from unicon_core.platforms.kit.damping import BLEND, DAMPING_TIME
from unicon_core.workflow import Program

WIND_DOWN = 5.0
"""Longest wind-down in [s]: whoever asks a run to end is not to wait for ever."""


class Phase(Enum):
    """What a run is at."""

    WAIT = "wait"
    """The platform is open, and nothing is sent. A robot's gates are asked in every tick until all
    hold; then the operator says go."""
    APPROACH = "approach"
    """A robot's joints go to where the flow begins, slowly and with stiffness that grows."""
    RUN = "run"
    """The flow ticks. The report's distances, falls and hash count this phase alone."""
    SOFT = "soft"
    """The flow of `wind_down:` ticks; recv, estimate, input, safety, send and observers go on."""
    DAMP = "damp"
    """The damping command is sent: stiffness falls to zero, targets stay, damping stays."""
    OFF = "off"
    """The platform has let go; nothing is sent any more."""


def describe(program: Program) -> list[tuple[str, str]]:
    """Return what each phase of a program does, for tables."""
    start, simulated = program.start, program.platform.facts.simulated
    gates = ", ".join(getattr(gate, "name", "gate") for gate in program.gates) or "none"
    if simulated:
        wait, approach = f"nothing: a simulator passes its gates ({gates})", "nothing"
    else:
        go = "; then for the operator's go" if start.operator else ""
        wait = f"gates: {gates}{go}"
        approach = (
            f"joints go to where the flow begins at {start.approach:g} rad/s, stiffness grows in "
            f"{start.fade_in:g} s"
        )
    if start.at is not None or start.together is not None:
        others = (
            f"; then {start.at.words} is waited for"
            if start.at
            else "; then the others are waited for"
        )
        if simulated or not start.fade_in:
            wait += others
        else:
            approach += others
    after = "" if program.duration is None else f" or for {program.duration:g} s"
    soft = f"wind_down: until it is done, at most {WIND_DOWN:g} s"
    return [
        (Phase.WAIT.value, wait),
        (Phase.APPROACH.value, approach),
        (Phase.RUN.value, f"the flow until it is done{after}"),
        (Phase.SOFT.value, "nothing: no wind_down" if program.wind_down is None else soft),
        (Phase.DAMP.value, f"stiffness to 0 within {BLEND:g} s, damping for {DAMPING_TIME:g} s"),
        (Phase.OFF.value, f"platform {program.platform.facts.name} is closed"),
    ]
