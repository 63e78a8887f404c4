"""The command states as one bundle, and the check that all of it is finite, for every platform."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import DTypeLike

from unicon_base.arrays import Array
from unicon_base.errors import Fault
from unicon_core.states import States
from unicon_core.states.stacked import flat, stacked
from unicon_core.states.standard import COMMAND_STATES


class FiniteCheck:
    """Raises a fault where a command is NaN or infinite; it names state and joint.

    Args:
        commands: name to array of shape (..., n).
        joint_names: of the last axis.
        who: in front of the message, for a robot that is one of several.
    """

    def __init__(
        self, commands: Mapping[str, Array], joint_names: Sequence[str], who: str = ""
    ) -> None:
        self._commands, self._names, self._said = dict(commands), joint_names, who
        self._flat = flat(list(commands.values()))

    def __call__(self) -> None:
        for values in self._flat:
            # A product with itself is finite only if every element is: 0.3 µs against 1.5 µs.
            if not values.dot(values) < math.inf:
                self._raise()

    def _raise(self) -> None:
        for state, view in self._commands.items():
            wrong = np.argwhere(~np.isfinite(view))
            if len(wrong):  # else a huge value overflowed the product
                index = tuple(int(i) for i in wrong[0])
                who = f"robot {index[0]}, " if len(index) > 1 else self._said
                raise Fault(f"{who}{state} of joint {self._names[index[-1]]} is {view[index]}")


class Command:
    """A copy of the command states, taken once a tick, all of it finite.

    Attributes:
        rows: in the order of `COMMAND_STATES`: q*, qd*, tau_ff, kp, kd in [rad], [rad/s], [N·m],
            [N·m/rad], [N·m·s/rad], shape (5, ..., n).

    Args:
        views: holds the command states by name, each of shape (..., n).
        joint_names: of the last axis.
        who: in front of a fault's message.
        dtype: of the copy.
    """

    def __init__(
        self,
        views: Mapping[str, Array] | States,
        joint_names: Sequence[str],
        who: str = "",
        dtype: DTypeLike = np.float64,
    ) -> None:
        sources = [views[name] for name in COMMAND_STATES]
        self.rows: Array = np.zeros((len(sources), *sources[0].shape), dtype)
        whole = stacked(sources)
        self._copies = list(zip(self.rows, sources)) if whole is None else [(self.rows, whole)]
        self._flat = self.rows.reshape(-1)
        self._check = FiniteCheck(dict(zip(COMMAND_STATES, self.rows)), joint_names, who)

    def take(self) -> None:
        """Copy the command states.

        Raises:
            Fault: a command is not finite.
        """
        for row, source in self._copies:
            row[...] = source
        if not self._flat.dot(self._flat) < math.inf:  # false for NaN too: one call finds both
            self._check()
