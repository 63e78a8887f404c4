"""What passes through Foxglove's server: topics, ticks, meshes, and clients that drive.

`Publishers` are clients that publish a velocity, one at a time.
"""

from __future__ import annotations

import json
import math
import struct
import threading
import time
import xml.etree.ElementTree as Xml
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np

from unicon_base import AnyDict, AnyMapping, UniconError
from unicon_base.packages import package_file
from unicon_base.resources import find_config
from unicon_core.models.posed import FootContacts, PosedModel
from unicon_core.models.terrain import load_on
from unicon_core.runtime.tick_ring import ENDED, HEAD
from unicon_lab.recording.recorded_topics import string_message
from unicon_lab.recording.ticks import (
    PHASE,
    TOPIC,
    field_names,
    message_text,
    tick_channel,
)
from unicon_lab.view.shown import DEAD_MAN, Shown
from unicon_lab.view.source import Remote, Snapshot
from unicon_msgs_map import Decoder, load_map
from unicon_msgs_map.layout.messages import Messages, shared_messages
from unicon_ros.bridge.bindings import robot_variables

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


SERVED = "package://unicon"


class MeshServer:
    """Gives Foxglove the files that the robot_description it got names, and no others.

    It has no file before `offered`. Foxglove asks a server for `package:` alone, and its own
    browser for `file:`, which may be on another machine. So `file:///PATH` becomes
    `package://unicon/PATH`.
    """

    def __init__(self) -> None:
        self._files: dict[str, Path] = {}

    def offered(self, message: bytes) -> bytes:
        """Return a robot_description as clients get it; from then on its meshes are given out.

        Args:
            message: std_msgs/String as CDR: 8 bytes, the text and a NUL.
        """
        root = Xml.fromstring(message[8:-1].decode())
        for mesh in root.iter("mesh"):
            uri = mesh.get("filename", "")
            path = urlsplit(uri).path
            with suppress(UniconError):  # its package has gone
                if uri.startswith("file:"):
                    file, uri = Path(unquote(path)), f"{SERVED}{path}"
                else:
                    file = package_file(uri, "mesh")
                self._files[uri] = file
            mesh.set("filename", uri)
        return string_message('<?xml version="1.0"?>\n' + Xml.tostring(root, encoding="unicode"))

    def fetch(self, uri: str) -> bytes | None:
        """Return the bytes of a file, None where it is not one of those; in threads of the server.

        Args:
            uri: as it stands in the description, letter by letter.
        """
        file = self._files.get(uri)
        try:
            return None if file is None else file.read_bytes()
        except OSError:
            return None


class Topics:
    """Takes messages in the place of a recorder."""

    def __init__(self, foxglove: Any, context: Any) -> None:
        self._foxglove, self._context = foxglove, context
        self._latched: dict[int, tuple[Any, bytes]] = {}
        self.meshes = MeshServer()

    def start(self) -> None:
        """Nothing has to begin."""

    def close(self) -> None:
        """Nothing is open."""

    def channel(
        self,
        topic: str,
        kind: str,
        messages: Messages | None = None,
        qos: object = None,
        latched: bytes = b"",
    ) -> Callable[[int, bytes], bool]:
        """Advertise a topic, and return what takes its messages."""
        known = (messages or shared_messages()).definition(kind)
        made = self.made(f"/{topic.lstrip('/')}", known.name, known.text, known.encoding)
        if latched and topic.endswith("robot_description"):
            latched = self.meshes.offered(latched)
        if latched:
            self._latched[made.id()] = made, latched

        def write(stamp_ns: int, message: bytes) -> bool:
            if made.has_sinks():
                made.log(latched or bytes(message), log_time=stamp_ns)
            return True

        return write

    def made(self, topic: str, kind: str, text: str, encoding: str = "ros2msg") -> Any:
        """Advertise a topic, and return its channel.

        Args:
            topic: its name.
            kind: its type.
            text: definition of the type.
            encoding: of the text.
        """
        return self._foxglove.Channel(
            topic,
            schema=self._foxglove.Schema(name=kind, encoding=encoding, data=text.encode()),
            message_encoding="cdr",
            context=self._context,
        )

    def again(self, channel: int) -> None:
        """Tell a latched message once more, to who has just subscribed."""
        found = self._latched.get(channel)
        if found is not None:
            found[0].log(found[1])


_STATE = struct.Struct("<4sqqI??2xddq")
_STATE_LINES = f"""\
# What a run does. Times are those of the tick before.
int64 stamp_ns
int64 tick
{PHASE}
bool paused
bool driven  # by a viewer
float64 late_us
float64 took_us
int64 overruns
unicon/Contacts contacts
string waits_for
string fault"""


class Ticks:
    """Every state by name, as `/unicon/ticks` of recordings has it; and `/unicon/state` beside it.

    Args:
        shown: the run.
        topics: they take both.

    Attributes:
        feet: whose contacts `/unicon/state` has: in simulators, and where `foot_contact` is there.
    """

    def __init__(self, shown: Shown, topics: Topics) -> None:
        specs, self.feet = shown.layout.specs, tuple(shown.robot.feet)
        self._simulated = shown.simulated
        self._touching: FootContacts | None = None
        if "foot_contact" not in specs:
            with suppress(UniconError):  # its model cannot be read
                if self.feet and shown.model and shown.simulated:
                    posed = PosedModel(load_on(shown.model, shown.robot, shown.terrain))
                    self._touching = FootContacts(posed, self.feet, shown.terrain is not None)
            self.feet = self.feet if self._touching else ()
        contacts = "\n".join(f"bool {foot}" for foot in field_names(self.feet)) or "bool unknown"
        text = message_text([_STATE_LINES], {"Contacts": contacts})
        self._state = topics.made("/unicon/state", "unicon/msg/State", text)
        channel = tick_channel(1, shown.layout, {"sent": None}, shown.names)
        self._ticks = topics.made(TOPIC, channel.type, channel.definition)

    def __call__(self, tick: Snapshot, texts: AnyMapping, again: bool = False) -> None:
        """Log a tick for clients that have subscribed, with the newest one of `faults`.

        Args:
            tick: it.
            texts: as of `Source`.
            again: the tick is logged, and the texts are new.
        """
        stamp = int(tick.states["stamp_ns"]) if self._simulated else tick.wall_ns
        head = b"\x00\x01\x00\x00", stamp, tick.tick, tick.phase
        if self._ticks.has_sinks() and not again:
            self._ticks.log(HEAD.pack(*head, ENDED) + tick.buffer.tobytes(), log_time=stamp)
        if self._state.has_sinks():
            times = tick.late_ns * 1e-3, tick.busy_ns * 1e-3, tick.overruns
            raw = _STATE.pack(*head, tick.paused, tick.driving, *times)
            raw += bytes(self._contacts(tick) or [True])
            for text in (texts["waits_for"], *(texts["faults"][-1:] or [""])):
                raw += bytes(-len(raw) % 4) + string_message(text)[4:]
            self._state.log(raw, log_time=stamp)

    def _contacts(self, tick: Snapshot) -> list[bool]:
        states, touching = tick.states, self._touching
        if touching is None:
            return [bool(sure > 0.5) for sure in states["foot_contact"]] if self.feet else []
        place = np.concatenate([states[name] for name in ("base_pos_w", "base_quat", "joint_pos")])
        if not np.isfinite(place).all() or not place[:3].any():  # its place is not known
            return [False] * len(self.feet)
        touching.posed.put(place[7:], place[:7])
        standing = touching()
        return [foot in standing for foot in self.feet]


def foxglove_layout(shown: Shown, feet: Sequence[str]) -> AnyDict:
    """Return config/foxglove/unicon.json with the frame, joints and feet of a run."""
    layout: AnyDict = json.loads(find_config("foxglove", "unicon", ".json").read_text("utf-8"))
    panels, frames = layout["configById"], robot_variables(shown.robot, shown.frame_prefix)
    panels["3D!robot"]["followTf"] = frames["base_frame"]
    panels["3D!robot"]["layers"]["grid"]["frameId"] = frames["odom_frame"]
    elements = {"JOINT": shown.layout.specs["joint_pos"].names, "FOOT": feet}
    for panel in panels.values():
        if "paths" in panel:
            panel["paths"] = [
                {**path, "value": f"{front}.{field}", "enabled": path["enabled"] or not k}
                for path in panel["paths"]
                for front, _, word in [path["value"].rpartition(".")]
                for k, field in enumerate(field_names(elements.get(word, (word,))))
            ]
    return layout
