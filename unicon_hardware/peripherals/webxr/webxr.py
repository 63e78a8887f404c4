"""Block `webxr`: head, hands and controllers of a headset that shows our page.

commands:
  - webxr                                                      # http://127.0.0.1:8443/
  - webxr: {host: 192.168.1.5, token: a-word-of-16-signs}      # https, for a headset
"""

from __future__ import annotations

import struct
import time
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Annotated, Any

import numpy as np

from unicon_base import MissingDependencyError, WorkflowError
from unicon_base.arrays import Float32
from unicon_base.schema.marks import Within
from unicon_core.flow import Block
from unicon_core.states import StateSpec
from unicon_core.workflow.autowire import BuildContext
from unicon_hardware.wire import frame_type
from unicon_ros.peripheral import Peripheral, peripheral_block, peripheral_states
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
    if not context.dry and find_spec("websockets") is None:
        raise MissingDependencyError("webxr", "websockets", "pip install 'unicon_ros[webxr]'")
    options = {
        "host": host,
        "port": port,
        "token": token,
        "tls": beyond if tls is None else tls,
        "stale": stale,
    }
    return peripheral_block(
        context, prefix, MODULE, options, values=_values(prefix), stale=stale, kind=Headset
    )


class Headset(Peripheral):
    """The tick of `webxr`: tells also how old the poses are in it, for records and replays."""

    def __call__(self) -> bool:
        news = super().__call__()
        states, name = self._states, self._name
        age = 0.0
        if states[f"{name}_alive"]:
            age = 1e-9 * (time.monotonic_ns() - int(states[f"{name}_stamp_ns"]))
        states[f"{name}_age"][...] = age
        return news


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
