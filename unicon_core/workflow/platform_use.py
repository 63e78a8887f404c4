"""What `platform:` of a workflow may say: its one grammar, read here and nowhere else.

platform: mujoco                            # NAME, or module:function
platform: {child: mujoco}                   # in a process of its own: not yet
platform: {body: mujoco, hands: dex3}       # one for each part of the robot: not yet
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from unicon_core.errors import alternatives
from unicon_core.workflow.document import WorkflowDocument

__all__ = ["PARTS", "PlatformUse", "read_platform"]

PARTS = ("body", "hands")
"""Parts of a robot that may have a platform of their own."""


@dataclass(frozen=True)
class PlatformUse:
    """Which platforms a workflow uses.

    Attributes:
        parts: part of the robot, "" for all of it, to the platform's name.
        child: it runs in a process of its own.
    """

    parts: Mapping[str, str]
    child: bool = False

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
    for key, name in value.items():
        if key not in (*PARTS, "child"):
            known = alternatives(str(key), (*PARTS, "child"))
            raise document.error(f"platform has no part {key!r}; {known}", "platform", key)
        if not isinstance(name, str):
            raise document.error(
                f"platform.{key}: {name!r} is not a platform's name; write {key}: mujoco",
                "platform",
                key,
            )
    if "child" in value and len(value) > 1:
        raise document.error(
            "platform: child stands alone, as in {child: mujoco}; leave the parts out", "platform"
        )
    use = PlatformUse({"": value["child"]}, True) if "child" in value else PlatformUse(value)
    what = "a process of its own" if use.child else "platforms for parts of a robot"
    instead = value.get("child") or value.get("body") or "mujoco"
    raise document.error(
        f"platform: {what} cannot be had yet; write platform: {instead}", "platform"
    )
