"""Videos of a data set, encoded by PyAV as LeRobot does it: AV1, a key frame in every second one.

https://github.com/huggingface/lerobot, src/lerobot/datasets/video_utils.py
"""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base.arrays import UInt8

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

    Attributes:
        frames: that are in it.

    Raises:
        OSError: it cannot be written.
    """

    def __init__(self, path: Path, fps: int, height: int, width: int) -> None:
        import av

        os.environ.setdefault("SVT_LOG", "0")  # else the encoder tells its settings
        self._av: Any = av
        self.path, self.frames = path, 0
        with _told(av):
            self._container = av.open(str(path), "w")
        self._stream: Any = self._container.add_stream(CODEC, fps, options=OPTIONS)
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
