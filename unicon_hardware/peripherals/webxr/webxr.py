"""Block `webxr`: head, hands and controllers of a headset that shows our page.

commands:
  - webxr                                                      # http://127.0.0.1:8443/
  - webxr: {host: 192.168.1.5, token: a-word-of-16-signs}      # https, for a headset
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Annotated, Any

from unicon_base.errors import MissingDependencyError, WorkflowError
from unicon_base.schema.marks import Within
from unicon_core.flow import Block
from unicon_core.states import StateSpec
from unicon_core.workflow.autowire import BuildContext
from unicon_hardware.peripherals.webxr.frames import AXES, BUTTONS, PARTS
from unicon_ros.peripheral import Peripheral, peripheral_block, peripheral_states
from unicon_ros.web_front import LOOPBACK

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
        context,
        prefix,
        MODULE,
        options,
        values=_values(prefix),
        stale=stale,
        kind=Headset,
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
