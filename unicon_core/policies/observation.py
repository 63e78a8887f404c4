"""The observation as one gather over the packed state buffer, for the policy block.

Per call: one `take` of every element of every term, the filters of terms that have some, then one
subtraction, one clip and one scaling, each skipped where it changes nothing; then, with a history,
one copy into a ring and one `take` that lays out the window. Nothing else is looped over terms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np

from unicon_base.arrays import Float32, Index
from unicon_core.policies.action_map import TermSlice, term_slices
from unicon_core.policies.contract import ObservationSpec, PolicyContract
from unicon_core.policies.controller import PackedStates
from unicon_core.policies.phase import make_filter


class Observation:
    """The observation of a policy, assembled in place.

    Args:
        contract: the policy.
        states: the packed states.
        robot_joints: the robot's joint order.
        spec: another observation than the contract's own, for networks with several inputs.

    Attributes:
        slices: the terms, resolved; `start` counts within one frame.
        frame_size: elements of one frame, d.
        size: elements of the whole observation with histories.

    Raises:
        PolicyError: as `term_slices`.
    """

    memory = ("_smoothing", "_ring", "_head", "_fresh")

    def __init__(
        self,
        contract: PolicyContract,
        states: PackedStates,
        robot_joints: Sequence[str],
        spec: ObservationSpec | None = None,
    ) -> None:
        spec = contract.observation if spec is None else spec
        self.slices = term_slices(contract, states, robot_joints, spec)
        self.frame_size = self.slices[-1].stop if self.slices else 0
        self.size = sum(part.elements.size * part.term.history for part in self.slices)
        self.num_robots = states.num_robots
        rows = self.num_robots or 1
        self.shape = (rows, self.size)
        index = np.concatenate(
            [
                states.offset(part.term.state)
                + np.arange(rows)[:, None] * states.spec(part.term.state).size
                + part.elements
                for part in self.slices
            ]
            or [np.zeros((rows, 0), np.intp)],
            axis=1,
        )
        # Only the part that is read: `take` copies its result where it lies inside what it reads,
        # and the state `observation` lies in the same buffer.
        first = int(index.min()) if index.size else 0
        last = int(index.max()) + 1 if index.size else 0
        self._buffer = states.buffer_of(np.float32)[first:last]
        self._index = index - first
        # Every operand has the flat shape of the frame: broadcasting costs 1.1 µs against 0.2 µs.
        subtract, scale, low, high = (
            (
                np.tile(np.concatenate(parts), rows)
                for parts in zip(*((p.subtract, p.scale, p.low, p.high) for p in self.slices))
            )
            if self.slices
            else [np.zeros(0, np.float32)] * 4
        )
        self._subtract = subtract if subtract.any() else None
        self._scale = scale if (scale != 1.0).any() else None
        clipped = np.flatnonzero(np.isfinite(low) | np.isfinite(high))
        self._clip: tuple[slice, Float32, Float32] | None = None
        if clipped.size:
            span = slice(int(clipped[0]), int(clipped[-1]) + 1)
            self._clip = (span, low[span], high[span])
        self._history = max((part.term.history for part in self.slices), default=1)
        self._zeros = spec.start == "zeros"
        self._fresh = True
        # Columns of a frame and the filter of them.
        self._filters = tuple(
            (slice(p.start, p.stop), make_filter(f, (rows, p.elements.size), contract.period))
            for p in self.slices
            if (f := p.term.filter) is not None
        )
        self._smoothing = [each for _, each in self._filters]
        self._ring, self._head = np.zeros((0, rows * self.frame_size), np.float32), 0
        if self._history > 1:
            self._make_ring(spec, rows)

    def _make_ring(self, spec: ObservationSpec, rows: int) -> None:
        """Lay out a ring of 2·H frames; the last H frames always stand in one piece in it."""
        h, d = self._history, self.frame_size
        self._ring = np.zeros((2 * h, rows * d), np.float32)
        sign = -1 if spec.newest == "last" else 1
        frames: list[tuple[int, int, TermSlice]] = []  # (age of the frame, order, term)
        whole = spec.layout == "term_major"  # a term's history, else frames of a group of terms
        for _, group in groupby(enumerate(self.slices), lambda each: each[1].term.history):
            block = [(age, *part) for part in group for age in range(part[1].term.history)]
            frames += sorted(block, key=lambda f: (whole and f[1], sign * f[0]))
        columns = np.arange(rows)[:, None] * d
        # Within the window frame H − 1 is the newest.
        self._window_index = np.concatenate(
            [
                (h - 1 - age) * rows * d + columns + np.arange(part.start, part.stop)
                for age, _, part in frames
            ],
            axis=1,
        )
        flat = self._ring.reshape(-1)
        size = h * rows * d
        # Frame k is written twice, at k and k + H; after that the window starts at frame k + 1.
        # Bytes are copied from memoryview to memoryview: 60 to 105 ns, arrays 110 to 240.
        self._slots = [
            (
                self._ring[k],
                memoryview(self._ring[k].view(np.uint8).data),
                memoryview(self._ring[k + h].view(np.uint8).data),
                flat[(k + 1) * rows * d :][:size].take,
            )
            for k in range(h)
        ]

    def reset(self) -> None:
        """Forget the history: the next call fills it with its own frame, or leaves zeros."""
        self._fresh = True
        for each in self._smoothing:
            each.reset()

    def bind(self, out: Float32) -> Callable[[], None]:
        """Return a function that writes the observation of a tick to `out`.

        Args:
            out: contiguous, shape (num_robots or 1, size).
        """
        write, advance = self.bind_parts(out)
        if advance is nothing:
            return write

        def both() -> None:
            write()
            advance()

        return both

    def bind_parts(self, out: Float32) -> tuple[Callable[[], None], Callable[[], None]]:
        """Return `write` and `advance`: the observation of this tick, and on to the next tick.

        `write` may be called several times before `advance`, as a warm-up does: it lays its frame
        where the history's oldest one was, which no later tick reads.

        Args:
            out: contiguous, shape (num_robots or 1, size).
        """
        flat = out.reshape(-1)
        assemble = self._assembler()
        if self._history == 1:
            return partial(assemble, flat), self._filters_on if self._filters else nothing
        index = self._window_index.reshape(-1)

        def write() -> None:
            slot, newest, again, take = self._slots[self._head]
            assemble(slot)
            if self._fresh:
                self._ring[...] = 0.0 if self._zeros else slot.copy()
                if self._zeros:
                    assemble(slot)
            again[:] = newest
            take(index, None, flat, "clip")

        def advance() -> None:
            head = self._head + 1
            self._head = head if head < self._history else 0
            self._fresh = False

        def both() -> None:
            advance()
            self._filters_on()

        return write, both if self._filters else advance

    def _filters_on(self) -> None:
        for each in self._smoothing:
            each.advance()

    def _assembler(self) -> Callable[[Float32], None]:
        """Return the straight-line function that writes one frame to a flat array."""
        # mode "clip": the indices are known to fit, and "raise" would go through a buffer.
        take: Any = self._buffer.take
        index = self._index.reshape(-1)
        minus, scale, clip = self._subtract, self._scale, self._clip
        subtract, multiply = np.subtract, np.multiply
        if self._filters:
            take = self._filtered
        elif clip is None and minus is not None and scale is not None:

            def usual(out: Float32) -> None:
                take(index, None, out, "clip")
                subtract(out, minus, out)
                multiply(out, scale, out)

            return usual

        span, low, high = clip or (slice(0), np.zeros(0, np.float32), np.zeros(0, np.float32))
        whole = low.size == index.size
        maximum, minimum = np.maximum, np.minimum

        def general(out: Float32) -> None:
            take(index, None, out, "clip")
            if minus is not None:
                subtract(out, minus, out)
            if clip is not None:
                part = out if whole else out[span]
                maximum(part, low, out=part)  # both pass NaN on
                minimum(part, high, out=part)
            if scale is not None:
                multiply(out, scale, out)

        return general

    def _filtered(self, index: Index, _: None, out: Float32, mode: Any) -> None:
        """Take a frame and filter it."""
        self._buffer.take(index, None, out, mode)
        frame = out.reshape(self.shape[0], -1)
        for columns, each in self._filters:
            each(frame[:, columns])

    def place_of(self, position: int) -> str:
        """Return what stands at a place of the observation, for messages.

        Args:
            position: from 0 to size − 1.
        """
        part, i, age = self.element_of(position)
        element = part.names[i] if part.names else f"element {i}"
        old = f", {age} frames ago" if age else ""
        return f"term {part.term.name!r} ({part.term.state}, {element}{old})"

    def element_of(self, position: int) -> tuple[TermSlice, int, int]:
        """Return the term, the element of it and its age in frames at a place from 0 on."""
        if self._history == 1:
            age, column = 0, position
        else:
            window = int(self._window_index[0, position])
            rows = self.shape[0]
            age = self._history - 1 - window // (rows * self.frame_size)
            column = window % self.frame_size
        part = next(part for part in self.slices if column < part.stop)
        return part, column - part.start, age


def nothing() -> None:
    """There is nothing to write, or without a history nothing to go on to."""
