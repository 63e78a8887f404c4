"""Members of a robot in a workflow, and what `robot:` and `platform:` may say.

robot: go2                                  # NAME, or a path
robot: {body: g1_29dof, left_hand: dex3_left, right_hand: dex3_right}     # made of members

platform: mujoco                            # NAME, or module:function
platform: {child: mujoco}                   # in a process of its own
platform: {child: my_robot, silence: 0.05, watchdog: 0.2}     # with its times in [s]
platform: {body: unitree, hands: {child: dex3}}     # one for each member; hands: every *_hand
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

from unicon_base import RobotError, WorkflowError, alternatives
from unicon_base.resources import find_config
from unicon_base.schema.marks import Write, positive
from unicon_core.flow.block import Share
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import Robot, compose, load_robot
from unicon_core.robots.load import joints_like
from unicon_core.robots.robot import Place, Places
from unicon_core.states import StateSpec
from unicon_core.states.groups import divided, member_states, stamp_of
from unicon_core.workflow.autowire import BuildContext
from unicon_core.workflow.document import WorkflowDocument, read_part
from unicon_core.workflow.registry import known

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

    def wrong(text: str, *path: str) -> WorkflowError:
        return document.error(text, "platform", *path)

    members, value = read_members(document), document.values["platform"]
    if isinstance(value, str) or (isinstance(value, dict) and "child" in value):
        return {"": _use(document, value, ("platform",))}
    if not isinstance(value, dict) or not value:
        raise wrong(f"platform: {value!r} is not a platform's name; write platform: mujoco")
    name, options = next(iter(value.items()))
    if not members and isinstance(options, dict):
        option = next(iter(options), "OPTION")
        raise wrong(
            f"platform names {name} with options; write platform: {name}, and its options beside "
            f"it: platforms: {{{name}: {{{option}: …}}}}, or --set platforms.{name}.{option}=VALUE"
        )
    if not members:
        raise wrong(
            f"platform names {', '.join(map(str, value))}, and the robot is not made of members; "
            f"write robot: {{body: {document.values['robot']}, …}}, or platform: "
            f"{value.get('body') or 'mujoco'}"
        )
    found: dict[str, PlatformUse] = {}
    hands = [name for name in members if name.endswith(HAND)]
    for key, said in value.items():
        named = hands if key == HANDS and HANDS not in members else [key]
        if not named or named[0] not in members:
            there = alternatives(str(key), (*members, *((HANDS,) if hands else ()), "child"))
            raise wrong(f"platform: no member {key!r}; {there}", str(key))
        for member in named:
            if member in found:
                raise wrong(
                    f"platform: {member} has two platforms; {HANDS} means every member whose name "
                    f"ends with {HAND}",
                    key,
                )
            found[member] = _use(document, said, ("platform", key))
    for member in members:
        if member not in found:
            raise wrong(
                f"platform says nothing of {member!r} of the robot; add {member}: NAME, or fake"
            )
    return {member: found[member] for member in members}


def _use(document: WorkflowDocument, value: Any, path: tuple[str, ...]) -> PlatformUse:
    """Return the use that a name or `{child: NAME, …}` means."""
    if isinstance(value, str):
        return PlatformUse(value, path)
    if not isinstance(value, dict) or "child" not in value:
        text = f"{'.'.join(path)}: {value!r} is not a platform's name; write {path[-1]}: mujoco"
        raise document.error(text, *path)
    said: Child = read_part(document, Child, value, *path)
    return PlatformUse(said.child, path, said)


def load_robot_of(document: WorkflowDocument) -> Robot:
    """Load the robot that a workflow names, by name or by a path beside the workflow file.

    Raises:
        RobotError: no such robot, or its file is wrong.
        WorkflowError: `robot:` has no known form.
    """
    members, said = read_members(document), document.get("scene", {}).get("mounts")
    mounts: dict[str, Place] = {}
    if said is not None:
        mounts = read_part(document, Places, said, "scene", "mounts")
    carried = list(members)[1:]
    for member in mounts:
        if member not in carried:
            there = alternatives(member, carried) if carried else "the robot has no members"
            text = f"scene.mounts: no member {member!r}; {there}"
            raise document.error(text, "scene", "mounts", member)

    def load(text: str, *path: str) -> Robot:
        folder = document.path.parent
        try:
            file = find_config("robots", text, error=RobotError, relative_to=folder)
        except RobotError as error:
            raise RobotError(error.message, document.where(*path)) from error
        return load_robot(file)

    if not members:
        return load(document.values["robot"], "robot")
    for member in members:
        if member in known("platforms"):
            raise document.error(
                f"robot: a member called {member!r} would be mistaken for the platform; name it "
                "otherwise, such as body",
                "robot",
                member,
            )
    robots = {member: load(text, "robot", member) for member, text in members.items()}
    try:
        return compose(robots, mounts)
    except RobotError as error:
        raise document.error(error.message, "robot") from error


def stamps_of(document: WorkflowDocument) -> dict[str, StateSpec]:
    """Return the states that tell when each member's data were taken; none of one platform."""
    spec = StateSpec((), "int64", "ns", description="source time of its data")
    return {stamp_of(member): spec for member in read_platforms(document) if member}


def member_robot(robot: Robot, member: str) -> Robot:
    """Return the robot of a member, or the whole for ""."""
    return robot.members[member] if member else robot


def of_whole(spec: StateSpec, own: Robot, robot: Robot) -> StateSpec:
    """Return a state that a block of a member declares as the whole robot has it.

    One with an element for each of the member's joints has one for each joint of the whole, of
    which each member's blocks have their slice.
    """
    if own is robot or spec.names != own.joint_names or spec.shape != (own.num_joints,):
        return spec
    return replace(spec, shape=(robot.num_joints,), names=robot.joint_names)


def member_context(context: BuildContext, member: str) -> BuildContext:
    """Return what is built for one member: its robot, and its share of the states."""
    robot = context.robot
    own, base = robot.members[member], member == next(iter(robot.members))
    joints, names = robot.joints_of(member), robot.joint_names
    states = member_states(context.states, names, member, joints, own.joint_names, base=base)
    return replace(context, states=states, robot=own, carried=not base)


def share_of(context: BuildContext, member: str, words: Sequence[str] = ()) -> Share:
    """Return what a block has of the states that moves some joints alone.

    Args:
        context: of the whole robot.
        member: for which it is built, "" for the whole robot.
        words: groups or joints of that member, or of the whole; all of them if none are given.

    Raises:
        RobotError: a word means no joint.
    """
    robot = context.robot
    own, names = member_robot(robot, member), robot.joint_names
    parts = {each: names[robot.joints_of(each)] for each in robot.members}
    whole = parts.get(member, names)
    places = own.group(words) if words else range(own.num_joints)
    return Share(
        ", ".join(words) or member,
        frozenset(whole[place] for place in places),
        frozenset(names),
        {each: frozenset(joints) for each, joints in (parts | dict(robot.groups)).items()},
        divided(context.states.layout, names),
    )


def scene_of_member(scene: Scene, robot: Robot, member: str) -> Scene:
    """Return a member's part of a scene; what disturbs it is left out, since it is of the whole."""
    joints, own = robot.joints_of(member), robot.members[member]
    base = member == next(iter(robot.members))
    figures: dict[str, dict[str, float]] = {}
    for pattern, said in scene.joints.items():
        for i in joints_like(pattern, robot):
            if joints.start <= i < joints.stop:
                figures.setdefault(own.joint_names[i - joints.start], {}).update(said)
    calm = replace(scene, delay=0, noise={}, push={}, joints=figures)
    if not base:
        calm = replace(calm, model=None, initial_pose="default")
    if scene.posed_by_model:
        return calm
    pose = scene.joint_pos(robot)[joints].astype("float32")
    height = scene.initial_height if base else None
    return replace(calm, pose=pose, initial_pose="default", initial_height=height)
