"""Both: the one command of both DFX hands, shared by the wires of this process.

Who drives one hand alone must say something of the other: it is told to stay where it was found.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_open: dict[tuple[int, str], Both] = {}


class Both:
    """Targets of both hands on one topic; get it with `Both.of`.

    Attributes:
        targets: as they are sent, shape (count,).
        users: wires that send them.
    """

    def __init__(self, count: int) -> None:
        self.targets = np.zeros(count, np.float32)
        self.users = 0
        self._known = np.zeros(count, bool)

    @classmethod
    def of(cls, domain: int, topic: str, count: int) -> Both:
        """Return that of a topic, and use it until `leave`."""
        made = _open.setdefault((domain, topic), cls(count))
        made.users += 1
        return made

    def found(self, told: NDArray[np.float32]) -> None:
        """Note where the hands are: who is not commanded stays there."""
        np.copyto(self.targets, told, where=~self._known)
        self._known[...] = True

    def leave(self, domain: int, topic: str) -> None:
        """Use it no longer."""
        self.users -= 1
        if not self.users:
            _open.pop((domain, topic), None)
