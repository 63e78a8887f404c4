"""What `platform:` of a workflow may say: its one grammar, read here and nowhere else.

platform: mujoco                            # NAME, or module:function
platform: {child: mujoco}                   # in a process of its own
platform: {child: my_robot, silence: 0.05, watchdog: 0.2}     # with its times in [s]
platform: {body: mujoco, hands: dex3}       # one for each part of the robot: not yet
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypedDict, cast

from unicon_core.errors import alternatives
from unicon_core.workflow.document import WorkflowDocument

__all__ = ["PARTS", "PlatformUse", "read_platform"]

PARTS = ("body", "hands")
"""Parts of a robot that may have a platform of their own."""


class ChildTimes(TypedDict, total=False):
    """What may be said of a child beside its platform, in [s]; see `ChildPlatform`."""

    silence: float
    watchdog: float


@dataclass(frozen=True)
class PlatformUse:
    """Which platforms a workflow uses.

    Attributes:
        parts: part of the robot, "" for all of it, to the platform's name.
        child: it runs in a process of its own; `silence` and `watchdog` of `ChildPlatform` as far
            as they are said. None: it runs in this one.
    """

    parts: Mapping[str, str]
    child: ChildTimes | None = None

    @property
    def name(self) -> str:
        """The one platform of the whole robot."""
        return self.parts[""]


def read_platform(document: WorkflowDocument) -> PlatformUse:
    """Return what `platform:` says.

    Raises:
        WorkflowError: another form, an unknown part, or a form that is not there yet.
    """
    value = document.values["platform"]
    if isinstance(value, str):
        return PlatformUse({"": value})
    if not isinstance(value, dict) or not value:
        raise document.error(
            f"platform: {value!r} is not a platform's name; write platform: mujoco", "platform"
        )
    if "child" in value:
        return _read_child(document, value)
    for key, name in value.items():
        if key not in PARTS:
            known = alternatives(str(key), (*PARTS, "child"))
            raise document.error(f"platform has no part {key!r}; {known}", "platform", key)
        if not isinstance(name, str):
            raise document.error(
                f"platform.{key}: {name!r} is not a platform's name; write {key}: mujoco",
                "platform",
                key,
            )
    raise document.error(
        "platform: platforms for parts of a robot cannot be had yet; write platform: "
        f"{value.get('body') or 'mujoco'}",
        "platform",
    )


def _read_child(document: WorkflowDocument, value: Mapping[str, Any]) -> PlatformUse:
    times = {}
    for key, said in value.items():
        if key == "child":
            if not isinstance(said, str):
                raise document.error(
                    f"platform.child: {said!r} is not a platform's name; write child: mujoco",
                    "platform",
                    key,
                )
        elif key not in ChildTimes.__annotations__:
            known = alternatives(str(key), ("child", *ChildTimes.__annotations__))
            raise document.error(f"platform: child has no {key!r}; {known}", "platform", key)
        elif isinstance(said, bool) or not isinstance(said, (int, float)) or not 0 < said <= 60:
            raise document.error(
                f"platform.{key} is {said!r}; give seconds, more than 0 and at most 60",
                "platform",
                key,
            )
        else:
            times[key] = float(said)
    return PlatformUse({"": value["child"]}, cast(ChildTimes, times))
