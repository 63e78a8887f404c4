"""Block `webxr`: head, hands and controllers of a headset that shows our page.

commands:
  - webxr                                                      # http://127.0.0.1:8443/
  - webxr: {host: 192.168.1.5, token: a-word-of-16-signs}      # https, for a headset
  - webxr: {cameras: [left_eye, right_eye]}                    # pictures in front of the operator
"""

from __future__ import annotations

import struct
import time
from collections import deque
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Annotated, Any

import numpy as np

from unicon_base import MissingDependencyError, WorkflowError, alternatives
from unicon_base.arrays import Float32
from unicon_base.schema.marks import Within
from unicon_core.flow import Block
from unicon_core.handles import FrameRing
from unicon_core.states import StateSpec
from unicon_core.workflow.autowire import BuildContext
from unicon_hardware.wire import frame_type
from unicon_ros.bridge.images import as_jpeg
from unicon_ros.peripheral import FrameSource, Peripheral, peripheral_block, peripheral_states
from unicon_ros.web_front import LOOPBACK

_FINGER = ("metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
JOINTS = (
    "wrist",
    "thumb-metacarpal",
    "thumb-phalanx-proximal",
    "thumb-phalanx-distal",
    "thumb-tip",
    *(
        f"{finger}-finger-{bone}"
        for finger in ("index", "middle", "ring", "pinky")
        for bone in _FINGER
    ),
)
"""Of a hand, in the order of XRHandJoint (W3C, WebXR Hand Input Module, section 3.2)."""

PARTS: Mapping[str, slice] = {
    "head": slice(0, 1),
    "left_hand": slice(1, 26),
    "right_hand": slice(26, 51),
    "left_controller": slice(51, 52),
    "right_controller": slice(52, 53),
    "left_aim": slice(53, 54),
    "right_aim": slice(54, 55),
}
"""Where the poses of each stand among the 55; the number of a part is its bit in `flags`."""

BUTTONS = ("trigger", "squeeze", "touchpad", "thumbstick", "a", "b", "more_1", "more_2")
"""Of a controller, as `xr-standard` has them (W3C, WebXR Gamepads Module, section 3.3); `a` and `b`
are X and Y on the left."""
AXES = ("touchpad_x", "touchpad_y", "thumbstick_x", "thumbstick_y")
"""-1 to 1, right and down positive."""

VERSION = 1
FRAME = frame_type(
    "version <u2, flags <u2, number <u4, time <f8, poses <f4 55x7, buttons <f4 2x8, axes <f4 2x4"
)
"""1652 B: `time` is the page's in [ms]; a pose is position [m] and quaternion xyzw, by WebXR."""

PING, ANSWER = struct.Struct("<q"), struct.Struct("<qd")
"""Our time in [ns], and in the answer the page's in [ms]."""

FAR = 1000.0
"""No pose is further away, in [m]."""

_PART_OF = np.repeat(np.arange(len(PARTS)), [part.stop - part.start for part in PARTS.values()])
_OURS = [2, 0, 1]
_SIGN = np.array([-1.0, -1.0, 1.0], np.float32)
_NEUTRAL = np.array([0, 0, 0, 1, 0, 0, 0], np.float32)


class Refused(Exception):
    """A message that is not taken; its text says why, the same for all alike."""


class Frame:
    """A message, taken apart.

    Args:
        data: of the message.

    Attributes:
        number: of the headset's frame.
        time: when it was, of the page's clock in [ms].
        valid: 1 where a part is tracked, shape (7,), as of `PARTS`.
        poses: position [m] and quaternion wxyz in our axes, shape (55, 7); identity where not.
        buttons: pressed how far, 0 to 1, left and right, shape (2, 8).
        axes: -1 to 1, left and right, shape (2, 4).

    Raises:
        Refused: it is none, or holds what cannot be.
    """

    def __init__(self, data: bytes) -> None:
        if len(data) != FRAME.itemsize:
            raise Refused("wrong length")
        told = np.frombuffer(data, FRAME)[0]
        if told["version"] != VERSION:
            raise Refused("wrong version")
        self.number, self.time = int(told["number"]), float(told["time"])
        flags = int(told["flags"])
        if flags >> len(PARTS):
            raise Refused("unknown parts")
        if not 0.0 <= self.time < 1e12:
            raise Refused("no time")
        self.valid = (flags >> np.arange(len(PARTS)) & 1).astype(np.int32)
        self.poses = self._turned(told["poses"])
        self.buttons, self.axes = told["buttons"], told["axes"]
        if (
            not ((self.buttons >= 0.0) & (self.buttons <= 1.0)).all()
            or not (np.abs(self.axes) <= 1.0).all()
        ):
            raise Refused("not a button")  # neither is NaN

    def _turned(self, raw: Float32) -> Float32:
        there = self.valid[_PART_OF].astype(bool)
        poses = np.tile(_NEUTRAL, (len(raw), 1))
        given = raw[there]
        if not (np.abs(given) < FAR).all():  # nor is NaN
            raise Refused("not finite")
        length = np.linalg.norm(given[:, 3:], axis=1, keepdims=True)
        if not ((length > 0.9) & (length < 1.1)).all():
            raise Refused("not a rotation")
        turned = poses[there]
        turned[:, :3] = given[:, _OURS] * _SIGN
        turned[:, 3] = given[:, 6]
        turned[:, 4:] = given[:, 3:6][:, _OURS] * _SIGN
        turned[:, 3:] /= length
        poses[there] = turned
        return poses


KEPT = 40
"""Answers of which the quickest counts."""


class Clock:
    """Tells by CLOCK_MONOTONIC what the page's clock says: the quickest answer has it best."""

    def __init__(self) -> None:
        self._asked: set[int] = set()
        self._answers: deque[tuple[int, int]] = deque(maxlen=KEPT)

    def ask(self) -> bytes:
        """Return what to ask the page."""
        now = time.monotonic_ns()
        self._asked.add(now)
        return PING.pack(now)

    def answer(self, data: bytes) -> None:
        """Take its answer.

        Raises:
            Refused: nobody has asked so.
        """
        asked, page = ANSWER.unpack(data)
        if asked not in self._asked or not 0.0 <= page < 1e12:
            raise Refused("not an answer")
        self._asked.remove(asked)
        now = time.monotonic_ns()
        self._answers.append((now - asked, (asked + now) // 2 - round(1e6 * page)))

    def at(self, page: float) -> int | None:
        """Return our time in [ns] of the page's in [ms]; None before it has answered."""
        return min(self._answers)[1] + round(1e6 * page) if self._answers else None


PICTURE = struct.Struct("<Iff")
"""What stands before a JPEG: number of its frame, its age, and how long the page waited, [ms]."""
QUALITY = 80
"""Of the JPEG of a raw picture, 1 to 100: 640 x 480 pixels take 3 ms and some 60 kB."""


class Eye:
    """The pictures of a camera, as JPEG; the newest one alone, and made where a page asks for it.

    Args:
        path: of the ring with the camera's frames.
        offset: where the data of a frame begin, [B].
        shape: of the data: (height, width, 3) of rgb8, or (bytes,) of a JPEG.

    Attributes:
        ring: the camera's frames.
    """

    def __init__(self, path: str, offset: int, shape: Sequence[int]) -> None:
        self.ring, self._offset, self._shape = FrameRing.attach(path), offset, shape
        self._made = 0, 0, b""

    def jpeg(self) -> tuple[int, int, bytes]:
        """Return the newest frame: handle, when it was true by CLOCK_MONOTONIC [ns], JPEG.

        Where a frame is overwritten meanwhile that is the one before.
        """
        handle = self.ring.latest
        frame = None if handle == self._made[0] else self.ring.frame(handle)
        if frame is not None:
            data, true_ns = bytes(frame[self._offset :]), self.ring.true_ns(handle)
            if self.ring.holds(handle):
                if len(self._shape) == 1:
                    data = data[: int.from_bytes(frame[self._offset - 4 : self._offset], "little")]
                else:
                    data = as_jpeg(data, self._shape, QUALITY)
                self._made = handle, true_ns, data
        return self._made


MODULE = "unicon_hardware.peripherals.webxr.process"
SHORTEST = 12
"""Characters of a token."""


def webxr(
    context: BuildContext,
    *,
    host: str = "127.0.0.1",
    port: Annotated[int, Within(0, 65535)] = 8443,
    token: str = "",
    tls: bool | None = None,
    stale: Annotated[float, Within(0.02, 2.0, "s")] = 0.2,
    prefix: str = "webxr",
    cameras: Sequence[str] = (),
) -> Block:
    """Write poses, buttons and axes of a headset; all neutral, and alive 0, while none is heard.

    Args:
        context: of the workflow.
        host: address of this computer where the page is served; that of the headset's network.
        port: there; 0 for any.
        token: a word that the headset has to give (`?token=…`); needed beyond this machine.
        tls: serve by https; unless said, beyond this machine: headsets show WebXR to no others.
        stale: frames that are older are not taken, and after so long without one all is neutral,
            in [s].
        prefix: stands before the names of its states.
        cameras: handles without `_handle` whose colour pictures are in front of the operator and in
            the page: one for both eyes, or the left and the right eye's.

    Raises:
        WorkflowError: an option is wrong.
        MissingDependencyError: `websockets` is not installed.
        UniconError: it cannot be served there.
    """
    beyond = host not in LOOPBACK
    if token and (len(token) < SHORTEST or not token.replace("-", "").isalnum()):
        raise WorkflowError(
            f"webxr: the token is too plain; give {SHORTEST} or more letters, digits and -"
        )
    if beyond and not token:
        raise WorkflowError(
            f"webxr: host {host} lets everybody in the network move the robot; give a token of "
            f"{SHORTEST} or more letters and digits, or leave host out"
        )
    if beyond and tls is False:
        raise WorkflowError(
            f"webxr: host {host} without TLS: headsets show WebXR to no such page; leave tls out"
        )
    if len(cameras) > 2:
        raise WorkflowError(f"webxr: {len(cameras)} cameras; give one, or the left and right eye's")
    there = [
        n.removesuffix("_handle") for n in context.states.layout.specs if n.endswith("_handle")
    ]
    for name in cameras:
        if name not in there:
            raise WorkflowError(f"webxr: no camera {name!r}; {alternatives(name, there)}")
    for package in ("websockets", *["PIL"] * bool(cameras)):
        if not context.dry and find_spec(package) is None:
            raise MissingDependencyError("webxr", package, "pip install 'unicon_ros[webxr]'")
    options = {
        "host": host,
        "port": port,
        "token": token,
        "tls": beyond if tls is None else tls,
        "stale": stale,
        "cameras": len(cameras),
    }
    block = peripheral_block(
        context, prefix, MODULE, options, values=_values(prefix), stale=stale, kind=Headset
    )
    if isinstance(block.tick, Headset):
        block.tick.cameras, block.tick.blocks = cameras, context.blocks
    return block


class Headset(Peripheral):
    """The tick of `webxr`: tells also how old the poses are in it, for records and replays.

    Attributes:
        cameras: names of handles whose pictures the page shows.
        blocks: of the workflow, one of which has those pictures; all of them once it ticks.
    """

    cameras: Sequence[str] = ()
    blocks: Sequence[Block] = ()
    _knows = 0  # the process that was told of the cameras

    def __call__(self) -> bool:
        news = super().__call__()
        if self._knows != self.process.pid:
            self._name_cameras()
        states, name = self._states, self._name
        age = 0.0
        if states[f"{name}_alive"]:
            age = 1e-9 * (time.monotonic_ns() - int(states[f"{name}_stamp_ns"]))
        states[f"{name}_age"][...] = age
        return news

    def say(self, text: str) -> None:
        """Show the operator a line below the pictures."""
        self.wish("say", text)

    def _name_cameras(self) -> None:
        sources: dict[str, FrameSource] = {}
        for block in self.blocks:
            sources |= getattr(block.tick, "sources", {})
        found = {n: s for n, s in sources.items() if s.message.dtype == "|u1"}  # colours, JPEG
        eyes = [
            (str(found[n].ring.path), found[n].message.offset, found[n].message.shape)
            if n in found
            else None
            for n in self.cameras
        ]
        if self.wish("cameras", *eyes):
            self._knows = self.process.pid
            for name in set(self.cameras) - {*found}:
                self._tell(f"{self._name}: {name} has no colour pictures here; it is not shown")


def _values(name: str) -> Mapping[str, StateSpec]:
    values = {
        f"{name}_{part}": _pose(at.stop - at.start, part.replace("_", " "))
        for part, at in PARTS.items()
    }
    for side in ("left", "right"):
        values[f"{name}_{side}_buttons"] = StateSpec((len(BUTTONS),), names=BUTTONS)
        values[f"{name}_{side}_axes"] = StateSpec((len(AXES),), names=AXES)
    return values | {
        f"{name}_valid": StateSpec(
            (len(PARTS),), "int32", names=tuple(PARTS), description="1 where it is tracked"
        ),
        f"{name}_latency": StateSpec((), unit="s", description="from the headset's frame to us"),
        f"{name}_age": StateSpec((), unit="s", description="from the headset's frame to this tick"),
        f"{name}_number": StateSpec((), "int64", description="number of the headset's frame"),
        f"{name}_missed": StateSpec((), "int64", description="frames that were not sent"),
        f"{name}_refused": StateSpec((), "int64", description="messages that were not taken"),
    }


def _pose(joints: int, what: str) -> StateSpec:
    """Return position and quaternion wxyz of one pose, or of each joint."""
    shape = (joints, 7) if joints > 1 else (7,)
    neutral = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0) * joints
    return StateSpec(
        shape,
        frame="local_floor",
        names=("x", "y", "z", "qw", "qx", "qy", "qz"),
        description=f"{what}: position [m], quaternion",
        initial=neutral,
    )


def _declares(prefix: str = "webxr", **_: Any) -> Mapping[str, StateSpec]:
    return peripheral_states(prefix, _values(prefix))


setattr(webxr, "declares", _declares)  # noqa: B010  a function has none to mypy
