"""Workflow files: what they say, as classes that `unicon_base.schema` reads.

Blocks and flows are read by the builder, which knows their factories.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from unicon_base import AnyDict, AnyMapping, UniconError, alternatives
from unicon_base.resources import find_config
from unicon_base.schema.marks import (
    Checked,
    Key,
    Later,
    Matches,
    NotEmpty,
    Text,
    Unit,
    Within,
    Write,
    positive,
)
from unicon_base.schema.records import meant
from unicon_base.schema.types import Here
from unicon_core.bounds import DURATION, Button, Seconds
from unicon_core.pacing import Pacing

_BLOCK = Write("a block, or {chain: [...]}")
FlowType = Annotated[Any, Later("unicon_core.workflow.autowire:FLOW"), _BLOCK]
Blocks = Annotated[list[FlowType], Write("a list of blocks")]
MOST_ROBOTS = 4096
"""Of a batch: each takes half a megabyte and 1.5 ms to begin in MuJoCo."""

_ROBOT = Annotated[str, Write("a robot's name")]
_NAMES = Write("NAME, or {MEMBER: NAME}")
Member = Annotated[
    str,
    Matches(
        r"(?!child$)[a-z][a-z0-9_]{0,30}",
        "a member's name of small letters, digits and _, such as left_hand",
    ),
]
"""Name of a member; `child` means a platform in a process of its own."""


def _no_map(name: str) -> str:
    try:
        find_config("maps", name)
    except UniconError as error:
        return f"is {name!r}: {error.message}"
    return ""


@dataclass(frozen=True, eq=False, repr=False)
class PolicyEntry:
    """A policy of a workflow.

    Attributes:
        path: folder or file of the policy: a path, a name or assets:PATH.
        given: facts that its files lack.
        child: true or options, where it runs in a process of its own.
        remote: options, where a server runs its network (`unicon serve`).
    """

    path: Text
    given: Annotated[AnyMapping | None, Write("a mapping of facts")] = None
    child: bool | Annotated[Any, Later("unicon_core.policies.chunks:ChildSpec")] | None = None
    remote: Annotated[Any, Later("unicon_core.policies.chunks:RemoteSpec")] | None = None

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note a network that shall run in two places."""
        if found.get("child") and found.get("remote") is not None:
            here.value("stands beside child; give one of them", "remote")


@dataclass(frozen=True, eq=False, repr=False)
class ShadowEntry(PolicyEntry):
    """A policy that ticks beside another one, and may replace it during a run.

    Attributes:
        path: folder or file of the policy: a path, a name or assets:PATH.
        given: facts that its files lack.
        child: refused.
        blend: time in which the command goes from one policy to the other.
        bound: largest difference of its targets from the other policy's, and step in a tick.
        limit: longest time of its tick; half of its period unless given.
    """

    blend: Annotated[float, positive(10.0, "s")] = 0.3
    bound: Annotated[float, positive(math.pi, "rad")] = 0.4
    limit: Annotated[float | None, positive(10.0, "s")] = None


@dataclass(frozen=True, eq=False, repr=False)
class Entry:
    """How a mode or a skill is entered.

    Attributes:
        button: that asks for it.
        sources: modes or skills from which it is entered; any unless given.
        after: time that the one before must have had.
        tilt: most that the base may lean.
        calm: the sticks are let go.
    """

    button: Button | None = None
    sources: Annotated[Sequence[str], Key("from")] = ()
    after: Seconds = 0.0
    tilt: Annotated[float, positive(math.pi, "rad")] = math.pi
    calm: bool = False


@dataclass(frozen=True, eq=False, repr=False)
class Skill(Entry):
    """A skill: one policy or a flow, and how it is entered.

    Attributes:
        policy: name of a policy.
        do: the graph, in place of a policy.
        enter: expression over states that has to hold.
        blend: time in which it comes in.
        next: skill that follows when its graph is done.
        button: that asks for it.
        sources: skills from which it is entered; any unless given.
        after: time that the skill before must have had.
        tilt: most that the base may lean.
        calm: the sticks are let go.
    """

    policy: str | None = None
    do: FlowType | None = None
    enter: Annotated[str | None, Write("an expression over states")] = None
    blend: Annotated[float, Within(0.0, 60.0, "s")] = 0.5
    next: str | None = None

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note a skill that is both a policy and a graph, or neither."""
        if (found.get("policy") is None) == (found.get("do") is None):
            here.note("give {policy: NAME}, or {do: FLOW}")


@dataclass(frozen=True, eq=False, repr=False)
class CheckSettings:
    """Settings of `unicon check`.

    Attributes:
        accept: codes of findings that shall be notes; `unicon explain` lists them.
        duration: simulated time of a run of the twin.
        command: velocity command of the twin, in [m/s, m/s, rad/s].
    """

    accept: str | list[Any] | None = None
    duration: Annotated[float, Unit("s"), Within(1.0)] = 5.0
    command: Annotated[tuple[float, float, float] | None, Write("[vx, vy, wz]")] = None


@dataclass(frozen=True, eq=False, repr=False)
class SafetyOnly:
    """The safety blocks of a robot, and no others.

    Attributes:
        only: the blocks.
    """

    only: Annotated[list[FlowType], NotEmpty, Write("a list of blocks")]


_SAFETY = "[finite, joint_limits], {only: [finite, joint_limits]} for no others on a robot, or none"


@dataclass(frozen=True, eq=False, repr=False)
class Workflow:
    """A workflow: a robot, a platform and what runs between them.

    Attributes:
        robot: robot file: name or path; or member to name, a body and its hands.
        platform: the one word that changes from simulation to the robot; or member to name.
        flow: the graph.
        schema: version of the format.
        name: of the workflow; the file's name unless given.
        description: one line.
        store: where else states go: local, shm, or {zmq: ADDRESS}.
        parts: name to {publishes, silent}: the workflow runs in several processes.
        scene: how a simulation begins and what disturbs it, the same on every simulator.
        platforms: platform to its options.
        rate: ticks per second; the policy's period unless given.
        duration: end of a run unless --duration says otherwise; none: until the flow is done.
        num_robots: batch dimension.
        map: message map: name or path.
        ros: true to mirror to ROS 2 without being asked.
        states: extra states: name to specification.
        policies: name to policy: a path, or {path, given, child, remote}.
        shadow: name of one of these to the policy that ticks beside it, for comparison and swap.
        skills: what `flow: skills` switches between: name to policy or to {policy or do, …}.
        estimate: blocks that compute what is not measured, right behind recv.
        commands: blocks that make commands, before ROS inputs may replace them.
        start: gates, operator, approach and fade-in before a robot moves; none on a test bench.
        wind_down: the graph after the run, before the platform damps and closes; at most 5 s.
        safety: blocks between the flow and send, {only: blocks}, or none.
        deferred: blocks after send.
        twin: a simulator beside the robot, under its commands: its name or options.
        pacing: how ticks are timed.
        check: settings of `unicon check`.
    """

    robot: Annotated[str | Annotated[Mapping[Member, _ROBOT], NotEmpty], _NAMES]
    platform: Annotated[Any, Later("unicon_core.workflow.autowire:PLATFORM_NAME"), _NAMES]
    flow: FlowType
    schema: Literal["unicon.workflow/1"] | None = None
    name: str | None = None
    description: str | None = None
    store: (
        Annotated[
            Any,
            Later("unicon_core.workflow.parts:StoreWord"),
            Write("local, shm or {zmq: ADDRESS}"),
        ]
        | None
    ) = None
    parts: Annotated[Any, Later("unicon_core.workflow.parts:PartFiles")] | None = None
    scene: Annotated[Any, Later("unicon_core.platforms.kit.scene:Scene")] | None = None
    platforms: Annotated[Any, Later("unicon_core.workflow.autowire:PLATFORMS")] | None = None
    rate: Annotated[float | None, Within(0.001, 10_000.0, "Hz")] = None
    duration: Annotated[float | None, positive(DURATION, "s")] = None
    num_robots: Annotated[int | None, Within(1, MOST_ROBOTS)] = None
    map: Annotated[str | None, Checked(_no_map)] = None
    ros: bool | None = None
    states: AnyMapping | None = None
    policies: Mapping[str, str | PolicyEntry] | None = None
    shadow: Mapping[str, str | ShadowEntry] | None = None
    skills: (
        Mapping[
            Annotated[str, Matches(r"(?a:[A-Za-z]\w{0,63})", "letters, digits and _")],
            str | Annotated[Any, Later("unicon_core.workflow.file:Skill")],
        ]
        | None
    ) = None
    estimate: Blocks | None = None
    commands: Blocks | None = None
    start: Annotated[Any, Later("unicon_core.workflow.settings:Start")] | None = None
    wind_down: FlowType | None = None
    safety: Annotated[
        Literal["none"] | Annotated[list[FlowType], NotEmpty] | SafetyOnly | None, Write(_SAFETY)
    ] = None
    deferred: Blocks | None = None
    twin: str | Annotated[Any, Later("unicon_core.workflow.live_twin:TwinSettings")] | None = None
    pacing: Pacing | None = None
    check: CheckSettings | None = None

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note skills that follow and are not there, and a policy that another one is meant by."""
        policies = here.document.get("policies")
        for name, said in policies.items() if isinstance(policies, Mapping) else ():
            others = [str(other) for other in policies if other != name]
            if isinstance(said, Mapping) and "path" not in said and meant(name, others):
                here.note(f"policies.{name}: {alternatives(str(name), others)}", "policies", name)
        skills = here.document.get("skills")
        for name, said in skills.items() if isinstance(skills, Mapping) else ():
            following = said.get("next") if isinstance(said, Mapping) else None
            if isinstance(following, str) and following not in skills:
                known = alternatives(str(following), map(str, skills))
                here.value(f"is {following!r}, which is no skill; {known}", "skills", name, "next")
