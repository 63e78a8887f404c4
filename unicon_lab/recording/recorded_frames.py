"""RecordedFrames: pictures and clouds on their way from the rings of cameras into a recording.

    unicon run g1_teleop --record run.mcap --record-frames all --record-jpeg 90

A thread looks at the rings a hundred times a second and copies what is new; the tick pays nothing
for it. A frame of `front_handle` is a message of `/unicon/frames/front`, whose sequence number is
the handle: with the states of a tick goes the handle of the frame that it could see.
"""

from __future__ import annotations

import os
import struct
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from unicon_base.arrays import UInt8
from unicon_base.errors import UniconError, alternatives, imported, one_line
from unicon_lab.recording.background import calm
from unicon_lab.recording.ticks import FRAMES
from unicon_ros.bridge.images import JPEG, STAMP, FrameMessage, jpeg_message

if TYPE_CHECKING:
    from unicon_core.workflow import Program
    from unicon_lab.recording.background import Large
    from unicon_lab.recording.recorder import Recorder
    from unicon_ros.peripheral import FrameSource

ALL = "all"
"""The word for every ring that a workflow has."""

INTERVAL = 0.01
"""How often the rings are looked at, in [s]: a third of the time of a picture at 30 Hz, of which a
ring keeps three."""


def chosen_sources(program: Program, names: Sequence[str]) -> dict[str, FrameSource]:
    """Return the rings whose frames are to be recorded, by the names of their handles.

    Args:
        program: whose blocks have them.
        names: of handles without `_handle`, or `all`.

    Raises:
        UniconError: there is none of such a name.
    """
    there: dict[str, FrameSource] = {}
    for block in program.blocks:
        there |= getattr(block.tick, "sources", {})
    if not there:
        raise UniconError(
            "--record-frames: no block of the workflow has pictures or clouds; add one, such as "
            "camera or webcam, or leave it out"
        )
    for name in names:
        if name not in (*there, ALL):
            raise UniconError(
                f"--record-frames: no frames {name!r}; {alternatives(name, [*there, ALL])}"
            )
    return {name: there[name] for name in there if ALL in names or name in names}


class RecordedFrames:
    """Copies frames into a recording from a thread of its own.

    Args:
        recorder: not started yet; it gets a topic for each ring.
        sources: name of a handle without `_handle` to its ring.
        now: tells the time of the recording's messages, [ns].
        jpeg: quality from 1 to 100 of pictures that are raw, 0 to leave them as they are.
        warn: takes a warning, from the thread.

    Raises:
        UniconError: the file cannot be written.
        MissingDependencyError: a picture is to be a JPEG, and Pillow is not installed.
    """

    def __init__(
        self,
        recorder: Recorder,
        sources: Mapping[str, FrameSource],
        now: Callable[[], int],
        jpeg: int = 0,
        warn: Callable[[str], None] = print,
    ) -> None:
        self._streams = {
            name: _Stream(recorder, name, source, jpeg) for name, source in sources.items()
        }
        self._now, self._warn = now, warn
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._work, name="recorder frames", daemon=True)

    def counts(self) -> dict[str, dict[str, int]]:
        """Return for each ring the frames that are in the file, and those that are not."""
        found = {}
        for name, stream in self._streams.items():
            large = stream.large
            missed = stream.missed + large.crowded + large.lost
            found[name] = {"frames": large.written, "missed": missed}
        return found

    def start(self) -> None:
        """Start the thread; safe to call twice."""
        if self._thread.ident is None:
            self._thread.start()

    def close(self) -> None:
        """Take what is there, and end; safe to call twice. The recorder is closed behind it."""
        self._ended.set()
        if self._thread.ident is not None:
            self._thread.join(1.0)

    def _work(self) -> None:
        calm()
        streams = tuple(self._streams.values())
        ending = False
        while not ending:
            ending = self._ended.wait(INTERVAL)
            try:
                for stream in streams:
                    if stream.ring.latest != stream.seen:
                        stream.take(self._now())
            except Exception as error:  # whatever it is, the run goes on
                self._warn(f"frames are recorded no longer: {one_line(error)}")
                return


class _Stream:
    """One ring and its topic."""

    def __init__(self, recorder: Recorder, name: str, source: FrameSource, jpeg: int) -> None:
        self.ring, message = source.ring, source.message
        colour = message.dtype == "|u1" and len(message.shape) == 3  # 8 bits for each of three
        self._jpeg = _Jpeg(message, jpeg) if jpeg and colour else None
        self._cut = message.offset if message.type == JPEG else 0
        kind = message.type if self._jpeg is None else JPEG
        self.large: Large = recorder.large_channel(FRAMES + name, kind, self.ring.nbytes)
        self.seen = self.ring.latest  # of frames before the run, the newest
        self.seen -= self.seen > 0
        self.missed = 0

    def take(self, now: int) -> None:
        """Take the frames that are new."""
        ring, latest = self.ring, self.ring.latest
        for handle in range(self.seen + 1, latest + 1):
            frame, stamp_ns = ring.frame(handle), ring.stamp_ns(handle)
            room = None if frame is None else self.large.room()
            if frame is None:
                self.missed += 1
            if frame is None or room is None:
                continue
            np.copyto(room, frame)
            if not ring.holds(handle):  # overwritten meanwhile
                self.missed += 1
                continue
            length = len(room)
            if self._cut:
                length = self._cut + struct.unpack_from("<I", room.data, self._cut - 4)[0]
            elif self._jpeg is not None:
                length = self._jpeg(room)
            if not 0 < length <= len(room):
                self.missed += 1
                continue
            self.large.put(length, handle, now, stamp_ns)
        self.seen = latest


class _Jpeg:
    """Makes a JPEG of a picture, in its place. Pillow does so without Python's lock into a file."""

    def __init__(self, message: FrameMessage, quality: int) -> None:
        self._image = imported("PIL.Image", "--record-jpeg", "lerobot", "pillow")
        self._from, self._quality = message, quality
        self._to = jpeg_message(0, message.frame_id)
        self._file: BinaryIO = os.fdopen(os.memfd_create("jpeg"), "r+b")

    def __call__(self, room: UInt8) -> int:
        """Replace the picture of a message by its JPEG; return the new length, 0 if it is longer.

        Args:
            room: a whole message, shape (bytes,).
        """
        height, width, _ = self._from.shape
        pixels = self._from.data(room.data)
        picture = self._image.frombuffer("RGB", (width, height), pixels, "raw", "RGB", 0, 1)
        self._file.seek(0)
        picture.save(self._file, "JPEG", quality=self._quality)
        self._file.flush()
        head, length = bytearray(self._to.template), self._file.tell()
        if len(head) + length > len(room):
            return 0
        head[STAMP] = room[STAMP].tobytes()
        room[: len(head)] = np.frombuffer(head, np.uint8)
        return self._to.put(room.data, memoryview(os.pread(self._file.fileno(), length, 0)))
