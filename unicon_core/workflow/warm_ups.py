"""WarmUps: warm-ups for blocks that have none of their own, for the workflow builder.

A block whose factory is `pure` (what it does depends on its states, options and calls alone) is
built a second time on a copy of the states. Before a deadline the copy takes the present values of
what those second blocks read, and they run on it: code and constants get warm, and nothing else
changes.
A block of 1 µs costs 5 to 20 in a 50 Hz loop without it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from unicon_core.flow import Block
from unicon_core.flow.block import Tick
from unicon_core.states import States
from unicon_core.states.stacked import spans
from unicon_core.workflow.autowire import BuildContext
from unicon_core.workflow.registry import Factory

_OURS = "unicon_core.blocks."  # all of them are pure

LARGEST = 65_536
"""Bytes of states beyond which a block is not warmed up: they alone would take 5 µs and more to
copy, and it spends its time on them and not on its code."""


class WarmUps:
    """The copy of the states and the second blocks on it.

    Args:
        context: what the blocks of the workflow are built with.
    """

    def __init__(self, context: BuildContext) -> None:
        self._states = context.states
        self._context = context
        self._copy: States | None = None
        self._read: set[str] = set()

    def add(self, block: Block, factory: Factory, build: Callable[[BuildContext], Block]) -> None:
        """Give a block a warm-up, where its factory is pure and it has none.

        Args:
            block: the block.
            factory: what it was built with.
            build: builds it once more in another context.
        """
        pure = getattr(factory, "pure", getattr(factory, "__module__", "").startswith(_OURS))
        if not pure or block.warm_up is not None:
            return
        slots = self._states.layout.slots
        used = {*block.reads, *block.amends, *block.writes}
        if sum(slots[name].nbytes for name in used if name in slots) > LARGEST:
            return
        self._read |= used
        if self._copy is None:
            self._copy = States(self._states.layout)
            self._context = replace(self._context, states=self._copy)
        block.warm_up = _quiet(build(self._context).tick)

    def refresh(self, platform: Tick | None) -> Tick | None:
        """Return what brings the present values into the copy, or None where nothing is warmed up.

        Args:
            platform: what warms the platform's own way to the motors, called with it; or None.
        """
        warm_up = None if platform is None else _quiet(platform)
        if self._copy is None:
            return warm_up
        into, out_of = memoryview(self._copy.buffer.data), memoryview(self._states.buffer.data)
        parts = [(into[part], out_of[part]) for part in spans(self._states.layout, self._read)]

        def refresh() -> None:
            for there, here in parts:
                there[:] = here
            if warm_up is not None:
                warm_up()

        return refresh


def _quiet(tick: Tick) -> Tick:
    """Return its tick: a fault that it finds is told by the block itself, in its turn."""

    def warm_up() -> None:
        try:
            tick()
        except Exception:
            return

    return warm_up
