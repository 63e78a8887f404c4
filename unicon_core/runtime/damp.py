"""The last phase with commands: damping ticks, whatever went wrong before; for the runner."""

from __future__ import annotations

import time

from unicon_core.errors import Fault
from unicon_core.flow import Tick, Zip, compile_graph
from unicon_core.pacing import WallClock
from unicon_core.platforms.kit.damping import DAMPING_TIME, Damping
from unicon_core.signals import Interrupted
from unicon_core.workflow import Program


class Damp:
    """Ticks the damping command: damps, sends, lets observers look, hears.

    What hears or looks and fails is left alone from then on. Safety blocks do not run: they are
    what may have tripped, and the damping command keeps the limits by itself.

    Args:
        program: what ran.

    Attributes:
        next_due_ns: when the next tick is due, on the clock of `time.perf_counter_ns`.
    """

    def __init__(self, program: Program) -> None:
        self._program = program
        self.next_due_ns = 0
        # Compiled now: in a fault a robot would wait for it.
        self._hear: Tick | None = compile_graph(Zip(*program.hearing)).step
        self._look: Tick | None = None
        if program.looking:
            self._look = compile_graph(Zip(*program.looking)).step

    def run(self, *, hear: bool) -> None:
        """Damp, at the program's rate; a simulator as fast as it goes.

        Args:
            hear: receive besides; what hung once is not asked again.

        Raises:
            Exception: what `send` raised; the platform is left to its own `close`.
        """
        program, now = self._program, time.perf_counter_ns
        states, platform, gate = program.states, program.platform, program.gate
        damping = Damping(states, program.robot, gate.sent, program.period)
        paced = not platform.facts.simulated
        clock, period = WallClock(0), round(program.period * 1e9)
        due, hears, look = now(), self._hear if hear else None, self._look
        for _ in range(max(1, round(DAMPING_TIME / program.period))):
            damping()
            if gate.closed:
                raise Fault("closed while it damped")
            program.sending()
            gate.sent.note()
            states["tick"][...] += 1
            due += period
            self.next_due_ns = due if paced else 0
            look = _tried(look)  # at what was sent, before anything new is heard
            hears = _tried(hears)
            if paced:
                clock.until(due)
                due = max(due, now() - period)  # after a stall, not all at once


def _tried(step: Tick | None) -> Tick | None:
    """Call it, and return it where it can be called again."""
    if step is not None:
        try:
            step()
        except Interrupted:  # a second signal has damped already
            raise
        except BaseException:  # a vendor's code may raise anything
            return None
    return step
