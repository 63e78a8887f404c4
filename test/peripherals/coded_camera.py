"""A camera for tests, in a process of its own: each picture has the time of the day in its pixels.

Sixteen bars are the lowest 16 bits of the time in [ms], black and white, the highest bit first.
Below them all is black, and white where the camera's name is `rear`.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from unicon_core.flow import Block
from unicon_core.robots import Robot
from unicon_core.states import StateSpec
from unicon_core.workflow.autowire import BuildContext
from unicon_ros.bridge.images import frame_message
from unicon_ros.peripheral import peripheral_block, peripheral_states
from unicon_ros.peripheral_process import Feed, end, serve

WIDTH, HEIGHT, BITS = 640, 480, 16
BAND = slice(160, 320)
"""Rows of the bars; those above move, so that a JPEG has something to do."""


class Coded:
    """Draws and stamps pictures at a rate."""

    def __init__(self, feed: Feed) -> None:
        self._feed, options = feed, feed.options
        self._period, self._due = 1.0 / options["rate"], time.monotonic()
        self._message = frame_message("color", WIDTH, HEIGHT, "coded")
        rows, columns = np.mgrid[:HEIGHT, :WIDTH]
        self._scene = ((rows // 3 + columns // 2) % 256).astype(np.uint8)

    def poll(self) -> None:
        """Take a picture when it is due."""
        time.sleep(max(0.0, self._due - time.monotonic()))
        self._due = max(self._due + self._period, time.monotonic() - self._period)
        ring = self._feed.rings[""]
        slot, now = ring.fill(), time.time_ns()
        picture = self._message.data(slot)
        picture[...] = np.roll(self._scene, ring.latest * 3, axis=1)[..., None]
        bits = now // 1_000_000 >> np.arange(BITS)[::-1] & 1
        picture[BAND] = np.repeat(bits * 255, WIDTH // BITS).astype(np.uint8)[:, None]
        picture[BAND.stop :] = 255 * (self._feed.name == "rear")
        self._message.stamp(slot, now)
        ring.commit(now)
        self._feed.publish()

    def close(self) -> None:
        """Let go."""


def coded(*, context: BuildContext, prefix: str = "front", rate: float = 30.0) -> Block:
    """Take pictures with a time code.

    Args:
        context: of the workflow.
        prefix: stands before its states.
        rate: pictures a second.
    """
    message = frame_message("color", WIDTH, HEIGHT, "coded")
    options = {"context": context, "name": prefix, "module": "coded_camera", "stale": 1.0}
    return peripheral_block(**options, options={"rate": rate}, values=(), frames={"": message})


def _declares(robot: Robot | None = None, prefix: str = "front", **_: Any) -> dict[str, StateSpec]:
    return peripheral_states(prefix, {}, [""])


coded.declares = _declares  # type: ignore[attr-defined]

if __name__ == "__main__":
    end(serve(Coded))
