"""A block of one's own: a function that names its states is built once, then called each tick."""

from __future__ import annotations

import math

from unicon_core import Amends, Loop, Program, Reads, Zip, block, elapsed, run
from unicon_core.flow import Tick


def nod(tick: Reads, joint_pos_target: Amends, *, period: float, amplitude: float = 0.1) -> Tick:
    """Add a slow wave to every target.

    Args:
        tick: number of the present tick.
        joint_pos_target: in [rad], shape (n,).
        period: of a tick in [s].
        amplitude: of the wave in [rad].
    """

    def wave() -> None:  # no arguments: all that it needs was named above
        joint_pos_target[:] += amplitude * math.sin(2.0 * float(tick) * period)

    return wave


if __name__ == "__main__":
    program = Program(
        robot="go2",
        platform="fake",  # joints that follow: no simulator is needed
        rate=100,
        flow=Loop(Zip(block("hold"), block(nod, amplitude=0.05)), until=elapsed(5)),
    )
    report = run(program, speed="max")
    print(f"{report.ticks} ticks, {report.ended}")
