"""What a policy sees of its surroundings: the keys `height_scan` and `images` of a contract.

The layout of a scan is that of Isaac Lab (isaac-sim/IsaacLab,
`sensors/ray_caster/patterns/patterns.py`, `grid_pattern`, and `envs/mdp/observations.py`,
`height_scan`, before its offset of 0.5 m): with ordering `xy` x varies fastest, both ends are
points, and a value is the height of the base above the ground. mujocolab/mjlab
(`sensor/raycast_sensor.py`, `GridPatternCfg`) has the same order. Both turn the grid by the yaw of
the base in their velocity tasks (`ray_alignment="yaw"`).
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from unicon_base import AnyDict, UniconError, alternatives
from unicon_base.arrays import Array, Float32, Float64, Index
from unicon_base.schema.marks import Matches, Metres, Within, Write, positive
from unicon_base.schema.types import Here
from unicon_core.policies.controller import PackedStates
from unicon_core.policies.hints import Offsets, Range
from unicon_core.states import StateSpec
from unicon_core.terrain.height_map import Heights

if TYPE_CHECKING:
    from unicon_core.workflow.autowire import BuildContext

HEIGHT_SCAN = "height_scan"
MOST_POINTS = 10_000
_WHOLE = 1e-4  # of a step: what float32 and decimals leave


@dataclass(frozen=True)
class HeightScanSpec:
    """The grid of points around the base at which a policy sees the ground.

    Attributes:
        size: from the first to the last point along x and y.
        resolution: between two points.
        offset: of the grid's middle from the base's origin.
        frame: the grid turns with the base's `yaw`.
        order: `xy`: x varies fastest, as in Isaac Lab; `yx`: y does.
    """

    size: tuple[Annotated[float, Within(0.0, 10.0, "m")], Annotated[float, Within(0.0, 10.0, "m")]]
    resolution: Annotated[float, positive(10.0, "m")]
    offset: tuple[Metres, Metres] = (0.0, 0.0)
    frame: Literal["yaw"] = "yaw"
    order: Literal["xy", "yx"] = "xy"

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note a size that is no multiple of the resolution, and too many points."""
        size, step = found.get("size"), found.get("resolution")
        if size is None or step is None:
            return
        steps = [edge / step for edge in size]
        for edge, count in zip(size, steps):
            if abs(count - round(count)) > _WHOLE * max(count, 1.0):
                here.value(
                    f"has {edge:g} m, which is no multiple of the resolution of {step:g} m; the "
                    f"nearest is {round(count) * step:g} m",
                    "size",
                )
        total = math.prod(round(count) + 1 for count in steps)
        if total > MOST_POINTS:
            here.value(
                f"makes {total} points, at most {MOST_POINTS}; give a larger one", "resolution"
            )

    @property
    def counts(self) -> tuple[int, int]:
        """Number of points along x and along y."""
        x, y = (round(edge / self.resolution) + 1 for edge in self.size)
        return x, y

    def points(self) -> Float64:
        """Return x and y from the base's origin in the base's heading in [m], shape (2, n)."""
        x, y = (
            middle + np.linspace(-edge / 2, edge / 2, count)
            for middle, edge, count in zip(self.offset, self.size, self.counts)
        )
        grid = np.meshgrid(x, y, indexing="xy" if self.order == "xy" else "ij")
        return np.stack(grid).reshape(2, -1)

    def state(self) -> StateSpec:
        """Return the specification of the state `height_scan`, shape (n,)."""
        x, y = self.counts
        text = f"base's height above the ground at {x} x {y} points, {self.order} order"
        return StateSpec((x * y,), "float32", "m", "yaw", (), text)

    def __str__(self) -> str:
        x, y = self.counts
        middle = f"middle at {list(self.offset)} m of the base's {self.frame}"
        return f"{x} x {y} points, {self.resolution:g} m apart, {middle}, order {self.order}"


class HeightScan:
    """Writes `height_scan` each tick of a policy, before its observation.

    Each value is the height of the base's origin above the ground below a point of the grid in
    [m]. A pose that is not finite makes all of it NaN, which the policy refuses as a fault. The yaw
    of a base that lies on its back or stands on its nose is that of its x axis on the ground, as
    `yaw_quat` of Isaac Lab has it.

    Args:
        spec: of the contract.
        states: with `height_scan`, `base_pos_w` and `base_quat`.
        ground: heights of the ground under the base.
    """

    memory = ()

    writes = (HEIGHT_SCAN,)

    def __init__(self, spec: HeightScanSpec, states: PackedStates, ground: Heights) -> None:
        rows = states.num_robots or 1
        self._pos, self._quat = (
            states[name].reshape(rows, size) for name, size in (("base_pos_w", 3), ("base_quat", 4))
        )
        self._scan = states[HEIGHT_SCAN].reshape(rows, -1)
        self._x, self._y = spec.points()
        self._points = np.empty((2, self._x.size))
        self._ground = ground
        self.reads = ("base_pos_w", "base_quat", *getattr(ground, "reads", ()))

    def __call__(self) -> None:
        """Write the scan of each robot."""
        for pos, quat, scan in zip(self._pos, self._quat, self._scan):
            x, y, z = pos.tolist()
            w, i, j, k = quat.tolist()
            cosine, sine = 1.0 - 2.0 * (j * j + k * k), 2.0 * (w * k + i * j)
            length = math.hypot(cosine, sine)
            if not math.isfinite(x + y + z + length):
                scan[...] = math.nan
                continue
            cosine, sine = (cosine / length, sine / length) if length else (1.0, 0.0)
            # Sums of products, not a matrix product: the same bits on every machine.
            self._points[0] = cosine * self._x - sine * self._y + x
            self._points[1] = sine * self._x + cosine * self._y + y
            np.subtract(z, self._ground(self._points), out=scan, casting="same_kind")


Edge = Annotated[int, Within(1, 2048, "pixels")]
Cut = Annotated[int, Within(0, 10_000, "pixels")]
_CROP = Write("the pixels cut off at [top, bottom, left, right]")


@dataclass(frozen=True)
class ImageSpec:
    """A camera's picture as a policy sees it: `offset + scale · resize(crop(pixels))`.

    Pixels are colours from 0 to 1, red first, or depths in [m].

    Attributes:
        size: height and width.
        handle: state with the number of the camera's newest frame.
        range: nearest and farthest depth: others are held to it, and what was not measured is the
            farthest. None: colours.
        crop: what is cut off at top, bottom, left and right.
        resize: `area` takes the mean of the pixels that a pixel covers, `bilinear` that of the
            nearest four, `nearest` one; centres of pixels lie at halves.
        scale, offset: one number, or one for each colour.
        layout: `chw`: colour by colour; `hwc`: pixel by pixel.
        rate: of frames that are taken, at most; None: of the camera.
        delay: so old is a frame at least before the policy sees it.
        max_age: so old may a frame be.
        on_stale: then the policy raises a `fault`, or sees the `last` one on.
    """

    size: tuple[Edge, Edge]
    handle: str = "camera_handle"
    range: Range | None = None
    crop: Annotated[tuple[Cut, Cut, Cut, Cut], _CROP] = (0, 0, 0, 0)
    resize: Literal["area", "bilinear", "nearest"] = "area"
    scale: Offsets = (1.0,)
    offset: Offsets = (0.0,)
    layout: Literal["chw", "hwc"] = "chw"
    rate: Annotated[float | None, positive(1000.0, "Hz")] = None
    delay: Annotated[float, Within(0.0, 10.0, "s")] = 0.0
    max_age: Annotated[float, positive(60.0, "s")] = 0.5
    on_stale: Literal["fault", "last"] = "fault"

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note factors that are not one for each colour, and ages that no frame has."""
        colours = 3 if found.get("range") is None else 1
        for key in ("scale", "offset"):
            if len(found.get(key, (1.0,))) not in (1, colours):
                here.value("has other than one value, or one for each colour", key)
        if found.get("delay", 0.0) >= found.get("max_age", ImageSpec.max_age):
            here.value("is not more than delay; give more", "max_age")

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the state: (colours, height, width) or (height, width, colours), of depths 1."""
        return (self.colours, *self.size) if self.layout == "chw" else (*self.size, self.colours)

    @property
    def colours(self) -> int:
        """Values of a pixel."""
        return 3 if self.range is None else 1

    def states(self, name: str) -> dict[str, StateSpec]:
        """Return the specifications of the picture's state and of its age."""
        seen, age = f"picture of {self.handle}", "of the frame that it shows, inf before the first"
        return {
            name: StateSpec(self.shape, description=seen, initial=math.nan),
            f"{name}_age": StateSpec((), "float32", "s", description=age, initial=math.inf),
        }

    def __str__(self) -> str:
        height, width = self.size
        return f"{height} x {width} of {self.handle}, {self.layout}, at most {self.max_age:g} s old"


Images = Mapping[Annotated[str, Matches(r"[a-z]\w{0,50}_image", "NAME_image")], ImageSpec]


def taps(length: int, size: int, resize: str) -> list[tuple[Index, Float32]]:
    """Return pixels of `length`, and what each counts for its one of `size`; none of as many.

    Shapes (size,) and (size, 1, 1). A matrix product of a few times as much costs 27 ms a picture
    of 640 x 480 pixels, and threads.
    """
    if length == size:
        return []
    step, pixels, places = length / size, np.arange(length), np.arange(size)[:, None]
    if resize == "area":
        counts = np.minimum((places + 1) * step, pixels + 1) - np.maximum(places * step, pixels)
    elif resize == "bilinear":
        middles = np.clip((places + 0.5) * step - 0.5, 0.0, length - 1.0)
        counts = 1.0 - np.abs(middles - pixels)
    else:
        counts = 1.0 * (pixels == (2 * places + 1) * length // (2 * size))
    counts = np.pad(np.maximum(counts, 0.0), ((0, 0), (0, 1)))
    counts /= counts.sum(axis=1, keepdims=True)
    first = (counts > 0.0).argmax(axis=1)
    indices = (np.minimum(first + k, length) for k in range((counts > 0.0).sum(axis=1).max()))
    rows = np.arange(size)
    return [
        (np.minimum(i, length - 1), counts[rows, i].astype(np.float32)[:, None, None])
        for i in indices
    ]


_DATE = 10**18  # what is more is no CLOCK_MONOTONIC but the time since 1970, [ns]


class Frames:
    """The frames behind a handle, each taken once.

    Args:
        context: says states and the blocks before.
        handle: state with the number of the newest frame.
        what: that takes them, for messages.

    Attributes:
        message: layout of a frame, see `unicon_ros.bridge.images`; None in a dry run.

    Raises:
        UniconError: no block before fills the handle.
    """

    def __init__(self, context: BuildContext, handle: str, what: str) -> None:
        written = {name: block for block in context.blocks for name in block.writes}
        if handle not in written:
            others = [name for name in written if name.endswith("_handle")]
            known = alternatives(handle, others) if others else "list a camera under deferred"
            raise UniconError(f"{what}: no block before it fills {handle!r}; {known}")
        block, states = written[handle], context.states
        self._handle, self._last = states[handle], 0
        sources = {} if context.dry else getattr(block.tick, "sources", {})
        self._source: Any = sources.get(handle.removesuffix("_handle"))
        self.message: Any = getattr(self._source, "message", None)
        # Frames of a model are stamped with the time of its states, others by the machine's clocks.
        self._clock = states["stamp_ns"] if "stamp_ns" in block.reads else None

    def now(self) -> int:
        """Return the time that `newest` counts in, [ns]."""
        return time.monotonic_ns() if self._clock is None else int(self._clock)

    def newest(self) -> tuple[Array, int] | None:
        """Return a frame that was not taken yet, in place, and its stamp in [ns]; or None."""
        handle = int(self._handle)
        if handle in (0, self._last):
            return None
        self._last, ring = handle, self._source.ring
        frame, stamp = ring.frame(handle), ring.stamp_ns(handle)
        if self._clock is None and stamp > _DATE:
            stamp -= time.time_ns() - time.monotonic_ns()
        return None if frame is None else (self.message.data(frame), stamp)

    def whole(self) -> bool:
        """Tell whether the frame taken last was not overwritten meanwhile."""
        held: bool = self._source.ring.holds(self._last)
        return held


class ImageTerm:
    """Fills the state of a picture behind `send`, where a record has it and replays feed it.

    Args:
        context: says states and the blocks before.
        name: of the state.
        spec: of the contract.

    Raises:
        UniconError: no block fills the handle, or with frames of another kind; or several robots.
    """

    endless = outside = True

    def __init__(self, context: BuildContext, name: str, spec: ImageSpec) -> None:
        if context.states.num_robots is not None:
            raise UniconError(f"{name}: a camera is of one robot; leave num_robots out")
        self.name, self.writes, self.reads = name, (name, f"{name}_age"), (spec.handle,)
        self._out, self._age = (context.states[each] for each in self.writes)
        self._spec, self._frames = spec, Frames(context, spec.handle, name)
        self._waiting: deque[tuple[int, Float32]] = deque()
        self._taken = self._shown = -math.inf
        message, depth = self._frames.message, spec.range is not None
        self._dry = context.dry
        if context.dry:
            return
        if message is None or (len(message.shape), message.dtype) != (
            (2, "<f4") if depth else (3, "|u1")
        ):
            kind, remedy = ("depths", "leave range out") if depth else ("raw colours", "give range")
            text = f"{spec.handle!r} has no {kind}; take another camera's handle, or {remedy}"
            raise UniconError(f"{name}: {text}")
        (height, width), (top, bottom, left, right) = message.shape[:2], spec.crop
        rows, columns = height - top - bottom, width - left - right
        if min(rows, columns) < 1:
            text = f"crop {[*spec.crop]} leaves nothing of {height} x {width} pixels; give less"
            raise UniconError(f"{name}: {text}")
        self._part = slice(top, top + rows), slice(left, left + columns)
        self._taps = [taps(*edges, spec.resize) for edges in zip((rows, columns), spec.size)]
        self._scale = (np.array(spec.scale) / (1.0 if depth else 255.0)).astype(np.float32)
        self._offset = np.array(spec.offset, np.float32)

    def __call__(self) -> None:
        """Take a new frame, show the newest that is old enough, and write how old it is."""
        if self._dry:
            return
        spec, now, waiting = self._spec, self._frames.now(), self._waiting
        if waiting and waiting[-1][0] > now:  # the simulation began anew
            waiting.clear()
        self._taken, self._shown = min(self._taken, now), min(self._shown, now)
        if (newest := self._frames.newest()) is not None:
            stamp = min(newest[1], now)
            # A camera's stamps are not quite even.
            if spec.rate is None or stamp - self._taken > 0.95e9 / spec.rate:
                picture = self._picture(newest[0])
                if self._frames.whole():
                    waiting.append((stamp, picture))
                    self._taken = stamp
        while waiting and now - waiting[0][0] >= spec.delay * 1e9:
            self._shown, self._out[...] = waiting.popleft()
        age = self._age[...] = (now - self._shown) * 1e-9
        if age > spec.max_age and spec.on_stale == "fault":
            self._out[...] = math.nan  # which a policy that runs refuses

    def _picture(self, pixels: Array) -> Float32:
        """Return what the policy sees of a frame, shape of the state."""
        seen, spec = pixels[self._part], self._spec
        if spec.range is not None:
            seen = np.clip(np.where(np.isnan(seen), spec.range[1], seen), *spec.range)
        seen = seen.reshape(*seen.shape[:2], -1)
        for edge in self._taps:
            parts: Any = (seen[index] * share for index, share in edge)
            seen = (sum(parts) if edge else seen).swapaxes(0, 1)
        seen = seen * self._scale + self._offset
        return seen.transpose(2, 0, 1) if spec.layout == "chw" else seen
