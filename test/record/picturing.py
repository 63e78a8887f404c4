"""A camera for tests, each picture of which can be computed, and runs that record it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from test_recorded_runs import written

from unicon_core.flow import Tick
from unicon_core.handles import FrameRing
from unicon_core.robots import Robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import StateSpec
from unicon_core.workflow import Program, load_document
from unicon_core.workflow.autowire import BuildContext
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording import Record, open_record
from unicon_lab.recording.run_recording import Recording
from unicon_ros.bridge.images import frame_message, jpeg_message
from unicon_ros.peripheral import FrameSource, peripheral_states

__all__ = ["Camera", "camera", "clock", "picture", "run"]


def picture(handle: int, height: int, width: int) -> NDArray[np.uint8]:
    """Return the picture of a handle, shape (height, width, 3): smooth, so that JPEG keeps it."""
    rows, columns = np.mgrid[:height, :width]
    bands = (rows * 2 + handle, columns + 2 * handle, rows + columns)
    return np.stack([band % 200 for band in bands], axis=-1).astype(np.uint8)


SLOTS = 64
"""So many that none is overwritten in a run at full speed."""


class Camera:
    """The tick: a picture in every n-th tick, stamped with the time of the tick."""

    memory = ("_tick",)  # of a run from its beginning, the ring's count follows
    endless = True

    def __init__(self, handle: Any, context: BuildContext, name: str, options: dict[str, Any]):
        self.size = (options["height"], options["width"])
        jpeg = options["kind"] == "jpeg"
        self.message = (
            jpeg_message(1 << 16, f"{name}_optical_frame")
            if jpeg
            else frame_message(options["kind"], *reversed(self.size), f"{name}_optical_frame")
        )
        self.ring = FrameRing.create(len(self.message.template), options["slots"])
        self.ring.touch(self.message.template)
        self.sources = {name: FrameSource(self.ring, self.message)}
        self._handle, self._every, self._tick = handle, options["every"], 0
        self._first, self._jpeg = options["first"], jpeg
        self._stamp = context.states["stamp_ns"]

    def __call__(self) -> None:
        tick, self._tick = self._tick, self._tick + 1
        if tick < self._first or (tick - self._first) % self._every:
            return
        slot, stamp = self.ring.fill(), int(self._stamp.flat[0]) or time.time_ns()
        number = self.ring.latest + 1
        if self._jpeg:
            self.message.put(slot, memoryview(b"\xff\xd8" + bytes([number % 256]) * number))
        elif self.message.dtype == "|u1":
            self.message.data(slot)[...] = picture(number, *self.size)
        self.message.stamp(slot, stamp)
        self._handle[...] = self.ring.commit(stamp)

    def close(self) -> None:
        self.ring.close()


def camera(
    *,
    context: BuildContext,
    prefix: str = "front",
    every: int = 2,
    first: int = 0,
    kind: str = "color",
    height: int = 48,
    width: int = 64,
    slots: int = SLOTS,
) -> Tick:
    """Take pictures.

    Args:
        context: of the workflow.
        prefix: stands before its states.
        every: that many ticks there is one.
        first: tick that has one.
        kind: `color`, `depth`, or `jpeg`, which is none.
        height: in pixels.
        width: in pixels.
        slots: of the ring.
    """
    options = {
        "slots": slots,
        "every": every,
        "first": first,
        "kind": kind,
        "height": height,
        "width": width,
    }
    made = Camera(context.states[f"{prefix}_handle"], context, prefix, options)
    made.writes = (f"{prefix}_handle",)  # type: ignore[attr-defined]
    return made


def _declares(robot: Robot, prefix: str = "front", **_: Any) -> dict[str, StateSpec]:
    return {f"{prefix}_handle": peripheral_states(prefix, {}, [""])[f"{prefix}_handle"]}


camera.declares = _declares  # type: ignore[attr-defined]


def clock(*, context: BuildContext) -> Tick:
    """Write what no replay can compute."""
    handle, frames = context.states["front_handle"], np.zeros(100_000)

    def tick() -> None:
        frames[0] = handle[...] = time.monotonic_ns()

    tick.outside = True  # type: ignore[attr-defined]
    tick.writes = ("front_handle",)  # type: ignore[attr-defined]
    return tick


clock.declares = _declares  # type: ignore[attr-defined]


def run(
    folder: Path,
    *cameras: dict[str, Any],
    name: str = "run.mcap",
    hooks: tuple[Callable[[Program], Any], ...] = (),
    workflow: dict[str, Any] | None = None,
    **options: Any,
) -> tuple[Record, dict[str, Any]]:
    """Record half a second of a robot with cameras at 100 Hz, as fast as it can.

    Args:
        folder: where the workflow and the recording go.
        cameras: options of each.
        name: of the recording.
        hooks: of the program, before the recording's.
        workflow: other keys.
        options: of the recording.

    Returns:
        The recording, and what its report says of it.
    """
    calls = [{"call": {"function": "picturing:camera", **each}} for each in cameras]
    values = {"rate": 100, "duration": 0.5, "flow": "hold", "start": "none", "commands": calls}
    path = written(folder, **values | (workflow or {}))
    warnings: list[str] = []
    recording = Recording(folder / name, warn=warnings.append, **options)
    record = FaultRecord("off", warnings.append, recording)
    program = Program(load_document(path), hooks=[*hooks, recording.hook, record.hook])
    runner = Runner(program, RunOptions(speed="max", warn=str))
    record.attach(runner)
    runner.run()
    assert warnings == []
    return open_record(folder / name), recording.counts()
