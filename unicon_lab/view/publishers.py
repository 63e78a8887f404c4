"""Publishers: clients of Foxglove that drive by publishing a velocity, one at a time."""

from __future__ import annotations

import json
import math
import struct
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from unicon_base.resources import find_config
from unicon_lab.view.shown import DEAD_MAN, Shown
from unicon_lab.view.source import Remote
from unicon_msgs_map import Decoder, load_map

COMMAND = "velocity_command"
TWIST = "geometry_msgs/msg/Twist"


class Publishers:
    """Who drives by publishing a velocity: one client at a time.

    Once one that drove was not heard for `DEAD_MAN` seconds, it has to let go (publish zeros)
    before its velocities count again: what a stalled page had queued moves nothing.
    """

    def __init__(self, shown: Shown, remote: Remote, say: Callable[[str], object]) -> None:
        self._remote, self._say, self._lock = remote, say, threading.Lock()
        self._velocity = np.zeros(3, np.float32)
        arrays = {COMMAND: self._velocity}
        specs = load_map(find_config("maps", shown.map)).subscribe if shown.drives else ()
        self._decoders = {
            spec.topic.strip("/"): Decoder.build(spec, arrays)
            for spec in specs
            if spec.states == (COMMAND,)
        }
        self._client, self._at = -1, -math.inf
        self._stalled: set[int] = set()

    def heard(self, client: int, channel: Any, data: bytes) -> None:
        """Take a message; in a thread of the server."""
        decoder = self._decoders.get(channel.topic.strip("/"))
        if decoder is None:
            known = ", ".join(self._decoders) or "none"
            self._say(f"topic {channel.topic} is not taken; those that are: {known}")
            return
        kind = channel.schema_name.replace("/msg/", "/")
        wanted = decoder.spec.type.replace("/msg/", "/")
        if kind != wanted:
            self._say(f"topic {channel.topic} is {wanted}, not {channel.schema_name}")
            return
        with self._lock:
            if client != self._client and self._client >= 0:  # whose velocity stays as it is
                self._say("another client drives")
                return
            raw = data if channel.encoding == "cdr" else _from_json(data, decoder.spec.type)
            if raw is None or not decoder.decode(raw):
                self._say(f"topic {channel.topic}: {decoder.last_error or 'not a message'}")
                return
            self._drive(client)

    def _drive(self, client: int) -> None:
        now, moving = time.monotonic(), bool(self._velocity.any())
        if client in self._stalled:
            if moving:
                self._say("the driver was not heard for a while; publish zeros first")
                return
            self._stalled.discard(client)
        if client != self._client:
            self._client = client
            self._remote.touch()
        self._at = now
        self._remote.drive(self._velocity)
        if not moving:  # others may drive now
            self._client = -1

    def look(self) -> None:
        """Let go of a driver who is not heard any more."""
        with self._lock:
            if self._client >= 0 and time.monotonic() - self._at > DEAD_MAN:
                if self._velocity.any():
                    self._stalled.add(self._client)
                self._client = -1


def _from_json(data: bytes, kind: str) -> bytes | None:
    """Return a Twist that came as JSON, as CDR; None for what is none."""
    if kind != TWIST:
        return None
    try:
        said = json.loads(data)
        values = [float(said[a][b]) for a in ("linear", "angular") for b in ("x", "y", "z")]
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return b"\x00\x01\x00\x00" + struct.pack("<6d", *values)
