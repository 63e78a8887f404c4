"""Waiting: what a robot's run waits for before anything is sent; for the runner."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from unicon_core.errors import Fault
from unicon_core.gates.gate import StartGate

PATIENCE = 30.0
"""How long gates may take to hold where no operator looks on, [s]."""

REPEAT = 5.0
"""How often what is waited for is told again, [s]."""

GRACE = 1.0
"""What is waited for in the first moments is not told, [s]: gates take half a second to measure."""

GO = "go"


class Waiting:
    """The block of the waiting phase: asks the gates, then the operator.

    Args:
        gates: asked in every tick.
        operator: somebody has to say go.
        warn: takes what is waited for, one line each.
        prepare: brings the robot to where it takes commands, behind the go; "" once it does.

    Attributes:
        reason: what is waited for, "" once nothing is.
    """

    def __init__(
        self,
        gates: Sequence[StartGate],
        operator: bool,
        warn: Callable[[str], None],
        prepare: Callable[[], str] | None = None,
    ) -> None:
        self._gates, self._operator, self._warn = gates, operator, warn
        self._prepare = prepare
        self._go = not operator
        self._began = self._told = 0.0
        self._what = ""
        self.reason = "the first data"

    def go(self) -> bool:
        """Say go; it counts where nothing else is waited for."""
        ready = self._what == GO
        self._go |= ready
        return ready

    def __call__(self) -> bool:
        now = time.monotonic()
        self._began = self._began or now
        what, reason = self._missing()
        self.reason = reason
        if not reason:
            return True
        if not self._operator and now - self._began > PATIENCE:
            raise Fault(f"not started, waited {PATIENCE:g} s for {reason}")
        heard = what == GO or now - self._began >= GRACE
        if heard and (what != self._what or now - self._told > REPEAT):
            self._what, self._told = what, now
            self._warn(f"waiting for {reason}")
        return False

    def _missing(self) -> tuple[str, str]:
        """Return the name of the first gate that does not hold, or else what comes after them."""
        for gate in self._gates:
            if reason := gate():
                name = getattr(gate, "name", "gate")  # it may be a plain function
                return name, f"{name}: {reason}"
        if self._go:
            reason = self._prepare() if self._prepare is not None else ""
            return ("robot", f"robot: {reason}") if reason else ("", "")
        return GO, "the operator's go: press Enter, call ~/start, or run with --yes"
