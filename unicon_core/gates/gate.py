"""StartGate: the contract of a gate, for runner, preflight and whoever writes one of his own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from unicon_core.errors import Fault


class StartGate(Protocol):
    """Asked once a tick before anything is sent, behind recv and estimate.

    Attributes:
        name: one word, for tables.
    """

    name: str

    def __call__(self) -> str:
        """Return "" where it holds, else one line: what is missing, and how to go on.

        Raises:
            Fault: waiting does not help; the run is refused.
        """
        ...


class Heeding:
    """A gate that asks a stop of the safety stage: what would trip it then must not start.

    Args:
        name: of the gate.
        about: what it looks at, in a few words.
        stop: raises a Fault.
        remedy: ends the line.
        reset: makes the stop fresh once it has tripped, or None.
        lasting: so many ticks the reason stays: a stop that was made fresh counts anew before it
            trips again.
    """

    def __init__(
        self,
        name: str,
        about: str,
        stop: Callable[[], object],
        remedy: str,
        reset: Callable[[], object] | None = None,
        lasting: int = 0,
    ) -> None:
        self.name, self.about = name, about
        self._stop, self._remedy, self._reset = stop, remedy, reset
        self._lasting, self._left, self._reason = lasting, 0, ""

    def __call__(self) -> str:
        """Return what the stop raised, with the remedy."""
        try:
            self._stop()
        except Fault as fault:
            if self._reset is not None:
                self._reset()
            self._reason, self._left = f"{fault}; {self._remedy}", self._lasting
            return self._reason
        self._left = max(self._left - 1, 0)
        return self._reason if self._left else ""


class Passing:
    """A gate of a simulator: it is shown and holds.

    Attributes:
        gate: what a robot would be asked.
    """

    def __init__(self, gate: StartGate) -> None:
        self.gate, self.name = gate, gate.name
        self.about = f"{getattr(gate, 'about', '')} (passes by itself in a simulator)"

    def __call__(self) -> str:
        """Hold."""
        return ""
