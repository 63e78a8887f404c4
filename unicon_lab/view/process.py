"""Process of a viewer: gives the ring of a run to a sink; started by `View`."""

from __future__ import annotations

import os
import time
from pkgutil import resolve_name
from typing import Any

from unicon_base import AnyDict
from unicon_core.handles import FrameRing
from unicon_lab.view import SINKS
from unicon_lab.view.shown import NAME, Shown
from unicon_lab.view.source import LiveSource, Remote, Sink
from unicon_ros.peripheral_process import Feed, end, serve

INTERVAL = 1.0 / 60.0
"""How often a sink looks, in [s]."""

BEAT = 0.25
"""How often the run is told that this process lives, in [s]; each time costs a tick 20 µs."""

NICE = 19
"""A viewer comes after the tick: at 10 it still raised the p99 of a tick several times."""


def sink_class(word: str) -> Any:
    """Return the class of a sink: of a word, or `module:class`."""
    return resolve_name(SINKS.get(word, word))


class Viewer:
    """The device of `serve`: a sink, and the two ends between which it stands."""

    def __init__(self, feed: Feed) -> None:
        os.setpriority(os.PRIO_PGRP, 0, NICE)  # libraries may have threads already
        shown: Shown = feed.data["shown"]
        drives = feed.name == NAME
        self._shown, self._feed, self._remote = shown, feed, Remote(feed if drives else None)
        self._source = LiveSource(shown.layout, FrameRing.attach(feed.data["ring"]))
        options = feed.options | {"feed": feed}  # of a sink that says more than a driver
        self._sink: Sink = sink_class(options["sink"])(shown, self._source, self._remote, options)
        self._due = self._beat = time.monotonic()

    def first(self) -> AnyDict:
        """Return the address, for the run to print."""
        return {"address": self._sink.address}

    def poll(self) -> None:
        """Show what is new."""
        if self._source.hear(self._feed):
            self._shown.tell(self._source.texts.get("parameters", {}))
        self._sink.poll()
        if time.monotonic() >= self._beat:
            self._beat = time.monotonic() + BEAT
            self._remote.beat()
        self._due = max(self._due + INTERVAL, time.monotonic())
        time.sleep(max(self._due - time.monotonic(), 0.002))

    def close(self) -> None:
        """Close the sink."""
        self._sink.close()


if __name__ == "__main__":
    end(serve(Viewer))
