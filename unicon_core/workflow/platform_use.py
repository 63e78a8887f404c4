"""What `robot:` and `platform:` of a workflow may say: their one grammar, read here alone.

robot: go2                                  # NAME, or a path
robot: {body: g1_29dof, left_hand: dex3_left, right_hand: dex3_right}     # made of members

platform: mujoco                            # NAME, or module:function
platform: {child: mujoco}                   # in a process of its own
platform: {child: my_robot, silence: 0.05, watchdog: 0.2}     # with its times in [s]
platform: {body: unitree, hands: {child: dex3}}     # one for each member; hands: every *_hand
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from unicon_base.errors import alternatives
from unicon_base.schema.marks import Write, positive
from unicon_core.workflow.document import WorkflowDocument, read_part

HANDS, HAND = "hands", "_hand"
"""Under `platform:` this word stands for all members whose names end so."""


Time = Annotated[float | None, positive(60.0, "s")]


@dataclass(frozen=True)
class Child:
    """A platform in a process of its own.

    Attributes:
        child: its name.
        silence: as of `ChildPlatform`.
        watchdog: likewise.
    """

    child: Annotated[str, Write("a platform's name, such as mujoco")]
    silence: Time = None
    watchdog: Time = None


@dataclass(frozen=True)
class PlatformUse:
    """A platform that a workflow uses.

    Attributes:
        name: of the platform.
        path: where the workflow says it.
        child: it runs in a process of its own. None: it runs in this one.
    """

    name: str
    path: tuple[str, ...] = ("platform",)
    child: Child | None = None


def read_members(document: WorkflowDocument) -> dict[str, str]:
    """Return the members of the robot, name to robot file; nothing of a robot that has none."""
    value = document.values["robot"]
    return {} if isinstance(value, str) else dict(value)


def read_platforms(document: WorkflowDocument) -> dict[str, PlatformUse]:
    """Return what `platform:` says: member to its platform, or "" to the platform of the whole.

    Raises:
        WorkflowError: another form, an unknown member, or one without a platform.
    """
    members = read_members(document)
    value = document.values["platform"]
    if isinstance(value, str) or (isinstance(value, dict) and "child" in value):
        return {"": _use(document, value, ("platform",))}
    if not isinstance(value, dict) or not value:
        raise document.error(
            f"platform: {value!r} is not a platform's name; write platform: mujoco", "platform"
        )
    name, options = next(iter(value.items()))
    if not members and isinstance(options, dict):
        option = next(iter(options), "OPTION")
        raise document.error(
            f"platform names {name} with options; write platform: {name}, and its options beside "
            f"it: platforms: {{{name}: {{{option}: …}}}}, or --set platforms.{name}.{option}=VALUE",
            "platform",
        )
    if not members:
        whole = value.get("body") or "mujoco"
        raise document.error(
            f"platform names {', '.join(map(str, value))}, and the robot is not made of members; "
            f"write robot: {{body: {document.values['robot']}, …}}, or platform: {whole}",
            "platform",
        )
    found: dict[str, PlatformUse] = {}
    for key, said in value.items():
        hands = [name for name in members if name.endswith(HAND)]
        named = hands if key == HANDS and HANDS not in members else [key]
        if not named or named[0] not in members:
            known = alternatives(str(key), (*members, *((HANDS,) if hands else ()), "child"))
            raise document.error(f"platform: no member {key!r}; {known}", "platform", str(key))
        for member in named:
            if member in found:
                raise document.error(
                    f"platform: {member} has two platforms; {HANDS} means every member whose name "
                    f"ends with {HAND}",
                    "platform",
                    key,
                )
            found[member] = _use(document, said, ("platform", key))
    for member in members:
        if member not in found:
            raise document.error(
                f"platform says nothing of {member!r} of the robot; add {member}: NAME, or fake",
                "platform",
            )
    return {member: found[member] for member in members}


def _use(document: WorkflowDocument, value: Any, path: tuple[str, ...]) -> PlatformUse:
    """Return the use that a name or `{child: NAME, …}` means."""
    what = ".".join(path)
    if isinstance(value, str):
        return PlatformUse(value, path)
    if not isinstance(value, dict) or "child" not in value:
        raise document.error(
            f"{what}: {value!r} is not a platform's name; write {path[-1]}: mujoco", *path
        )
    said: Child = read_part(document, Child, value, *path)
    return PlatformUse(said.child, path, said)
