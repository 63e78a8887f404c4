"""The gait clock of a policy: units that cannot be right."""

from __future__ import annotations

import numpy as np

from unicon_core.check.result import PolicyResult

TURN = 2.0 * np.pi + 1e-3
"""In [rad]: phases beyond it are in degrees."""
GAIT = (0.1, 10.0)
"""Shortest and longest period of a gait in [s]; published ones have 0.4 to 1.5."""


def check_clock(policy: PolicyResult) -> None:
    """Find phases in degrees and periods in milliseconds or in [Hz]."""
    phase = policy.contract.phase
    if phase is None:
        return
    stand = phase.stand if isinstance(phase.stand, float) else 0.0
    for part, values in (("phase.offsets", phase.offsets), ("phase.stand", (stand,))):
        most = max(values, key=abs)
        if abs(most) > TURN:
            policy.find(
                "timing.clock",
                part,
                f"{most:g} rad is more than a turn",
                f"give it in [rad]: {np.radians(most):.4g} if these were degrees",
            )
    if not GAIT[0] <= phase.period <= GAIT[1]:
        policy.find(
            "timing.clock",
            "phase.period",
            f"a gait of {phase.period:g} s; plausible are {GAIT[0]:g} to {GAIT[1]:g}",
            "give the period of the gait in [s]: 0.8 for 1.25 Hz",
        )
