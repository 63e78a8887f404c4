"""StartGate: the contract of a gate, for runner, preflight and whoever writes one of his own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from unicon_core.errors import Fault

__all__ = ["Heeding", "Passing", "StartGate"]


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
    """

    def __init__(self, name: str, about: str, stop: Callable[[], object], remedy: str) -> None:
        self.name, self.about = name, about
        self._stop, self._remedy = stop, remedy

    def __call__(self) -> str:
        """Return what the stop raised, with the remedy."""
        try:
            self._stop()
        except Fault as fault:
            return f"{fault}; {self._remedy}"
        return ""


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
