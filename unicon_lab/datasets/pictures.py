"""Pictures of a recording as pixels, PNG and JPEG; for data sets."""

from __future__ import annotations

import ctypes
import io
import os
import threading
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import UniconError, imported, one_line
from unicon_base.arrays import Int64, UInt8
from unicon_lab.recording import Record
from unicon_lab.recording.scan import Frames
from unicon_msgs_map.layout.messages import shared_messages

IMAGE, JPEG = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
RGB = "rgb8"


@dataclass(frozen=True, eq=False)
class Pictures:
    """The colour pictures of one camera of a recording.

    Attributes:
        frames: the messages.
        height: of each in pixels.
        width: of each in pixels.
        what: names the camera and its recording, for messages.
    """

    frames: Frames
    height: int
    width: int
    what: str

    def rgb(self, index: int) -> UInt8:
        """Return the pixels of a picture, shape (height, width, 3).

        Raises:
            UniconError: it is damaged, or of another size than the first one.
        """
        raw = self.frames.message(index)
        if self.frames.type == IMAGE:
            found = _read(raw, IMAGE, self.what)
            seen: UInt8 = found.data
            if len(seen) == found.height * found.width * 3:
                seen = seen.reshape(found.height, found.width, 3)
        else:
            seen = _decoded(_read(raw, JPEG, self.what).data, self.what)
        if seen.shape != (self.height, self.width, 3):
            raise UniconError(
                f"{self.what}: a picture has shape {seen.shape}, the first one ({self.height}, "
                f"{self.width}, 3); leave that camera out: --cameras"
            )
        return seen

    def encoded(self, index: int) -> bytes:
        """Return a picture as the bytes of a file: JPEG where it was recorded so, else PNG."""
        if self.frames.type == JPEG:
            return bytes(_read(self.frames.message(index), JPEG, self.what).data)
        return png(self.rgb(index))


@dataclass(frozen=True, eq=False)
class Shown:
    """The pictures of a camera, one for each frame of an episode.

    Attributes:
        pictures: of the whole recording.
        indexes: of that of each frame, shape (frames,).
    """

    pictures: Pictures
    indexes: Int64

    def __len__(self) -> int:
        return len(self.indexes)

    def rgb(self, frame: int) -> UInt8:
        """Return the pixels at a frame, shape (height, width, 3)."""
        return self.pictures.rgb(int(self.indexes[frame]))

    def encoded(self, frame: int) -> bytes:
        """Return the picture at a frame as the bytes of a file, JPEG or PNG."""
        return self.pictures.encoded(int(self.indexes[frame]))


def pictures_of(
    record: Record, wanted: Collection[str] | None = None
) -> tuple[dict[str, Pictures], dict[str, str]]:
    """Return the cameras of a recording, and of other frames why they are none.

    Args:
        record: it.
        wanted: names of frames that are looked at; None for all.

    Raises:
        UniconError: a message is damaged.
        MissingDependencyError: a JPEG is to be read, and Pillow is not installed.
    """
    found: dict[str, Pictures] = {}
    others: dict[str, str] = {}
    for name in record.frame_names:
        if wanted is not None and name not in wanted:
            continue
        frames = record.frames(name)
        if frames.type not in (IMAGE, JPEG):
            others[name] = frames.type
            continue
        if f"{name}_handle" not in record.layout.specs:
            others[name] = f"no state {name}_handle"
            continue
        raw, what = frames.message(0), f"{record.paths[0]}, camera {name!r}"
        if frames.type == JPEG:
            height, width, _ = _decoded(_read(raw, JPEG, what).data, what).shape
            found[name] = Pictures(frames, height, width, what)
        elif (first := _read(raw, IMAGE, what)).encoding == RGB:
            found[name] = Pictures(frames, first.height, first.width, what)
        else:
            others[name] = first.encoding
    return found, others


def _read(raw: memoryview, kind: str, what: str) -> Any:
    """Return a message, read from CDR."""
    try:
        return shared_messages().store.deserialize_cdr(raw, kind)
    except Exception as error:  # whatever rosbags raises for garbage
        raise UniconError(
            f"{what}: a picture is damaged: {one_line(error)}; leave that camera out: --cameras"
        ) from error


def _pillow() -> Any:
    imported("PIL", "a data set of pictures", "lerobot", "pillow")
    return import_module("PIL.Image")


def _decoded(data: UInt8, what: str) -> UInt8:
    image = _pillow()
    try:
        return np.asarray(image.open(io.BytesIO(data.tobytes())).convert("RGB"))
    except Exception as error:  # whatever Pillow raises for garbage
        raise UniconError(
            f"{what}: a picture is not a JPEG that can be read; leave that camera out: --cameras"
        ) from error


def png(pixels: UInt8) -> bytes:
    """Return a picture as PNG.

    Args:
        pixels: shape (height, width, 3).

    Raises:
        MissingDependencyError: Pillow is not installed.
    """
    stream = io.BytesIO()
    _pillow().fromarray(pixels).save(stream, "png", compress_level=1)
    return stream.getvalue()


CODEC, NAME, PIXELS = "libsvtav1", "av1", "yuv420p"
OPTIONS = {"g": "2", "crf": "30", "preset": "12"}
SMALLEST = 64
"""Shorter sides SVT-AV1 does not encode."""


def can_encode(height: int, width: int) -> bool:
    """Tell whether pictures of a size can be a video here: PyAV is installed, and both are even."""
    if height % 2 or width % 2 or min(height, width) < SMALLEST:
        return False
    try:
        import av
    except ModuleNotFoundError:
        return False
    try:
        av.Codec(CODEC, "w")
    except ValueError:  # a build without it
        return False
    return True


class Video:
    """A video that is being written.

    Args:
        path: of the file; its folder exists.
        fps: frames a second.
        height: in pixels.
        width: in pixels.
        codec: FFmpeg's name of the encoder.
        options: of the encoder.

    Attributes:
        frames: that are in it.

    Raises:
        OSError: it cannot be written.
        ValueError: this PyAV lacks the encoder.
    """

    def __init__(
        self,
        path: Path,
        fps: float,
        height: int,
        width: int,
        codec: str = CODEC,
        options: Mapping[str, str] = OPTIONS,
    ) -> None:
        import av

        os.environ.setdefault("SVT_LOG", "0")  # else the encoder tells its settings
        self._av: Any = av
        self.path, self.frames = path, 0
        with _told(av):
            endless = {"loop": "0"} if codec == "libwebp_anim" else {}
            self._container = av.open(str(path), "w", options=endless)
        rate = Fraction(fps).limit_denominator(1000)
        self._stream: Any = self._container.add_stream(codec, rate, options=dict(options))
        self._stream.pix_fmt = PIXELS
        self._stream.height, self._stream.width = height, width

    def add(self, pixels: UInt8) -> None:
        """Add a frame.

        Args:
            pixels: shape (height, width, 3).

        Raises:
            OSError: it cannot be written.
        """
        frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")
        frame.pts = self.frames
        before = _policies() if not self.frames else {}
        with _told(self._av):
            packets = self._stream.encode(frame)
            _calm(before)
            self._container.mux(packets)
        self.frames += 1

    def close(self) -> None:
        """Finish it.

        Raises:
            OSError: it cannot be written.
        """
        with _told(self._av):
            self._container.mux(self._stream.encode())
            self._container.close()


def _policies() -> dict[int, int]:
    """Return the scheduling policy of each thread of this process; none where none can be told."""
    if not hasattr(os, "SCHED_BATCH"):
        return {}
    found = {}
    with suppress(OSError):
        for name in os.listdir("/proc/self/task"):
            with suppress(OSError):  # it has ended
                found[int(name)] = os.sched_getscheduler(int(name))
    return found


def _calm(before: dict[int, int]) -> None:
    """Take back the real-time priority that SVT-AV1 gives itself, and its caller, where it is root.

    Its threads would go before the tick of a robot that runs beside an export. The caller's own is
    told to libpthread, which tells the kernel: it remembers what was set last, and Fast DDS gives
    its threads what pthread_getschedparam(3) says of the thread that makes them.
    """
    for thread, policy in _policies().items() if before else ():
        usual = before.get(thread, os.SCHED_BATCH)
        if policy == usual:
            continue
        if thread == threading.get_native_id():
            nothing = ctypes.create_string_buffer(64)  # struct sched_param, in any libc
            pthread = ctypes.c_ulong(threading.get_ident())
            ctypes.CDLL(None).pthread_setschedparam(pthread, ctypes.c_int(usual), nothing)
            continue
        with suppress(OSError):
            os.sched_setscheduler(thread, usual, os.sched_param(0))


@contextmanager
def _told(av: Any) -> Iterator[None]:
    """Tell what FFmpeg finds wrong as an OSError."""
    try:
        yield
    except av.FFmpegError as error:
        raise OSError(error.errno, error.strerror) from error
