"""The command states as one bundle, and the check that all of it is finite, for every platform."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from unicon_core.errors import Fault
from unicon_core.states.standard import COMMAND_STATES

__all__ = ["Command", "FiniteCheck"]

Array = NDArray[Any]


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
        self._flat = _joined(list(commands.values()))

    def __call__(self) -> None:
        for flat in self._flat:
            # A product with itself is finite only if every element is: 0.3 µs against 1.5 µs.
            if not flat.dot(flat) < math.inf:
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
        views: the command states by name, each of shape (..., n).
        joint_names: of the last axis.
        who: in front of a fault's message.
        dtype: of the copy.
    """

    def __init__(
        self,
        views: Mapping[str, Array],
        joint_names: Sequence[str],
        who: str = "",
        dtype: DTypeLike = np.float64,
    ) -> None:
        sources = [views[name] for name in COMMAND_STATES]
        self.rows: Array = np.zeros((len(sources), *sources[0].shape), dtype)
        self._copies = _pairs(self.rows, sources)
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


def _joined(views: list[Array]) -> list[Array]:
    """Return the views flat, as one where they stand back to back in one buffer.

    The standard command states do: one product of 60 numbers takes 0.5 µs and five take 1.9.
    """
    starts = [view.__array_interface__["data"][0] for view in views]
    ends = [start + view.nbytes for start, view in zip(starts, views)]
    one_type = len({view.dtype for view in views}) == 1
    if one_type and ends[:-1] == starts[1:] and all(v.flags.c_contiguous for v in views):
        size = sum(view.size for view in views)
        strides = (views[0].itemsize,)
        return [np.lib.stride_tricks.as_strided(views[0], (size,), strides, writeable=False)]
    return [view.reshape(-1) for view in views]


def _pairs(rows: Array, sources: list[Array]) -> list[tuple[Array, Array]]:
    """Return (row, state) pairs to copy; one pair of the whole where the states are equally spaced.

    The standard states stand back to back in the buffer: one strided copy of (5, n) then takes
    0.4 µs and five take 1.5 µs.
    """
    starts = [source.__array_interface__["data"][0] for source in sources]
    step = starts[1] - starts[0]
    together = [starts[0] + i * step for i in range(len(sources))] == starts
    if together and step > 0 and len({(s.dtype, s.strides) for s in sources}) == 1:
        strides = (step, *sources[0].strides)
        packed = np.lib.stride_tricks.as_strided(sources[0], rows.shape, strides, writeable=False)
        return [(rows, packed)]
    return list(zip(rows, sources))
