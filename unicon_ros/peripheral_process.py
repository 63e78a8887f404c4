"""The process of a peripheral: opens a device, tells what it has, opens it again when it is back.

    class _Scanner:
        def __init__(self, feed: Feed) -> None: ...  # raises Gone where it is not plugged in
        def poll(self) -> None: ...                  # waits up to `SLICE`, then feed.publish
        def close(self) -> None: ...

    if __name__ == "__main__":
        end(serve(_Scanner))

It ends with its parent.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NoReturn, Protocol

from unicon_base import AnyDict, UniconError
from unicon_core.handles import FrameRing
from unicon_core.platforms.child.pipe import ALARM, LONGEST, Parent, text_of
from unicon_core.states import Layout, States
from unicon_core.states.backends.shm import Segment, ShmWriter

GROUP = "told"
"""The group of a peripheral's segment."""

SLICE = 0.05
"""Longest wait of `poll` in [s]: meanwhile nobody sees that the parent has gone."""

AGAIN = 0.5
"""How often a device that is not there is looked for, in [s]."""

START = 60.0
"""Longest start in [s]."""


def handle_state(name: str, ring: str) -> str:
    """Return the state of a ring's handle: NAME_RING_handle, or NAME_handle of an only one, ""."""
    return "_".join(filter(None, (name, ring, "handle")))


class Gone(Exception):
    """The device is not there at present; its text says why."""


class Feed:
    """What a device is given, and where it tells what it has.

    Args:
        parent: of this process.

    Attributes:
        name: of the peripheral, which stands before the names of its states.
        options: as the workflow says them.
        rings: of its frames, by name; the parent has made them.
        wishes: what the parent has wished since the last look, each `[what, *given]`.
        data: whatever else the parent has given.
    """

    def __init__(self, parent: Parent) -> None:
        given, self._parent = parent.given, parent
        self.name: str = given["name"]
        self.options: AnyDict = given["options"]
        self.data: AnyDict = given["data"]
        self.rings = {name: FrameRing.attach(path) for name, path in given["rings"].items()}
        self.wishes: list[list[Any]] = []
        self._early: list[str] | None = []
        states = self._states = States(Layout.from_json(given["layout"]))
        self._segment = Segment.create(given["segment"], {GROUP: states.layout})
        self._writer = ShmWriter(self._segment, GROUP, states)
        self._alive, self._stamp = states[f"{self.name}_alive"], states[f"{self.name}_stamp_ns"]
        self._handles = [(states[handle_state(self.name, n)], r) for n, r in self.rings.items()]

    def publish(self, stamp_ns: int | None = None, /, **values: Any) -> None:
        """Tell values by the names of their states, and the newest handles; both at once.

        Args:
            stamp_ns: when they were true, [ns] of CLOCK_MONOTONIC; None for now.
            values: state to value; what is not named stays as it was told last.
        """
        for name, value in values.items():
            self._states[name][...] = value
        for handle, ring in self._handles:
            handle[...] = ring.latest
        self._alive[...] = 1
        self._stamp[...] = time.monotonic_ns() if stamp_ns is None else stamp_ns
        self._writer.publish()

    def neutral(self) -> None:
        """Tell that the device is not there: every value is what it was before the first one."""
        self._states.reset()
        self._writer.publish()

    def tell(self, line: str) -> None:
        """Tell the operator a line; not in every tick."""
        if self._early is None:
            self._parent.tell(note=line[:LONGEST])
        else:
            self._early.append(line)

    def ready(self, **words: Any) -> None:
        """Tell the parent that it may go on, and the operator what was to be told before."""
        self._parent.tell(ready=True, **words)
        early, self._early = self._early or (), None
        for line in early:
            self.tell(line)

    def words(self, **words: Any) -> None:
        """Tell the parent something else that can be pickled."""
        self._parent.tell(**words)

    def look(self) -> bool:
        """Take the parent's wishes; False when it has gone."""
        signal.alarm(ALARM)
        found = self._parent.wishes()
        self.wishes += found or ()
        return found is not None

    def close(self) -> None:
        """Let go of the segment."""
        self._segment.close()


class Device(Protocol):
    """What `serve` opens. It may have a method `first`, which returns words for the parent."""

    def poll(self) -> None:
        """Wait for data, at most for `SLICE`, and publish what has come.

        Raises:
            Gone: it was unplugged.
        """
        ...

    def close(self) -> None:
        """Let go of the device."""
        ...


def serve(device: Callable[[Feed], Device]) -> int:
    """Run until the parent has gone; returns the exit status.

    Args:
        device: opens it. A `UniconError` of the first opening is the parent's error.
    """
    parent = Parent(START)
    ends: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: ends.append(1))
    opened: Device | None = None
    feed: Feed | None = None
    why = ""
    try:
        feed = Feed(parent)
        try:
            opened = device(feed)
        except Gone as gone:
            why = str(gone)
        first = getattr(opened, "first", dict)
        feed.ready(**first())
        if why:
            feed.tell(f"{feed.name}: {why}; it is used once it is there")
        while not ends and feed.look():
            if opened is not None:
                try:
                    opened.poll()
                    continue
                except Gone as gone:
                    why = str(gone)
                    feed.neutral()
                    feed.tell(f"{feed.name}: {why}; its values are neutral until it is back")
                    _close(opened)
                    opened = None
            select.select([0], [], [], AGAIN)
            with suppress(Gone):
                opened = device(feed)
                feed.tell(f"{feed.name}: it is there")
    except UniconError as error:
        parent.tell(error=str(error)[:LONGEST], kind=type(error).__name__)
        return 1
    except Exception as error:
        name = parent.given["name"]
        parent.tell(error=f"{name} raised {text_of(error)}", kind="UniconError")
        return 3
    finally:
        if feed is not None:
            feed.neutral()
        if opened is not None:
            _close(opened)
        if feed is not None:
            feed.close()
    return 0


def _close(device: Device) -> None:
    with suppress(Exception):  # it is gone already
        device.close()


def end(status: int) -> NoReturn:
    """End this process without destructors: vendors' libraries hang or print tracebacks in them."""
    sys.stderr.flush()
    os._exit(status)
