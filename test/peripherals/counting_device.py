"""A device for tests: counts at 100 Hz while the file that is its plug exists."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base.errors import UniconError
from unicon_ros.peripheral_process import Feed, Gone, end, serve


class Counting:
    """Tells `count` and a frame of that number."""

    def __init__(self, feed: Feed) -> None:
        options = feed.options
        if options.get("wrong"):
            raise UniconError("counting: wrong is given; leave it out")
        self._plug = Path(options["plug"])
        if not self._plug.exists():
            raise Gone("not plugged in")
        self._feed, self._count = feed, 0
        if self._plug.read_text() == "garbage":
            os.write(feed._parent._told, b"\x05" + bytes(7) + b"12345")

    def first(self) -> dict[str, Any]:
        """Return what the parent is told first."""
        return {"pid": os.getpid()}

    def poll(self) -> None:
        """Count one up."""
        time.sleep(0.01)
        if not self._plug.exists():
            raise Gone("unplugged")
        if self._plug.read_text() == "broken":
            raise RuntimeError("broken")
        self._count += 1
        ring = self._feed.rings["picture"]
        ring.fill()[:] = np.uint8(self._count % 256)
        ring.commit(time.monotonic_ns())
        self._feed.publish(count=self._count, wished=len(self._feed.wishes))

    def close(self) -> None:
        """Let go."""


if __name__ == "__main__":
    end(serve(Counting))
