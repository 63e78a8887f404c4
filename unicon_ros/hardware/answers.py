"""Answers: which of several motors have answered since all did last; for wires that ask each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

NAMED = 3
"""How many a message names."""


class Answers:
    """See the module; as text it is those that have not, for `Wire.where`.

    Args:
        labels: of the motors, each with its address.

    Attributes:
        heard: who has, shape (n,).
    """

    def __init__(self, labels: Sequence[str]) -> None:
        self._labels = labels
        self.heard = np.zeros(len(labels), bool)

    def complete(self) -> bool:
        """Return whether all have, and begin anew if so."""
        if not self.heard.all():
            return False
        self.heard[...] = False
        return True

    def __str__(self) -> str:
        missing = [self._labels[i] for i in np.flatnonzero(~self.heard).tolist()]
        if len(missing) in (0, len(self._labels)):
            return f"all {len(self._labels)} motors ({self._labels[0]}, …)"
        more = f" and {len(missing) - NAMED} more" if len(missing) > NAMED else ""
        return f"{', '.join(missing[:NAMED])}{more}"
