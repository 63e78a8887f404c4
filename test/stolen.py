"""Stolen: how much of its time a virtual machine did not get, for tests that measure time."""

from __future__ import annotations

from pathlib import Path

__all__ = ["Stolen"]

STAT = Path("/proc/stat")
"""Its first line: ticks of all cores, user, nice, system, idle, iowait, irq, softirq, steal."""


class Stolen:
    """Tells whether the machine was taken away since `begin`.

    Args:
        share: of its time from which that counts.
    """

    def __init__(self, share: float = 0.02) -> None:
        self._share = share
        self._stolen = self._all = 0

    def begin(self) -> None:
        """Count from now on."""
        self._stolen, self._all = _ticks()

    def __call__(self) -> bool:
        """Tell."""
        stolen, every = _ticks()
        return stolen - self._stolen > self._share * max(every - self._all, 1)


def _ticks() -> tuple[int, int]:
    """Return how many ticks were stolen, and all; zeros where nobody tells."""
    try:
        ticks = [int(word) for word in STAT.read_text(encoding="ascii").split("\n")[0].split()[1:9]]
        return ticks[7], sum(ticks)
    except (OSError, ValueError, IndexError):
        return 0, 0
