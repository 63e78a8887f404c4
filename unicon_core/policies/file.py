"""What a `policy.yaml` says, as classes; what a contract has in the same shape has one class.

Rules say what lies between its facts: what fits no joint, no network or no period. Each takes
`found`, the facts that are right by themselves, and notes what is wrong `here`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Annotated, Any, Literal, cast

from unicon_base.arrays import Float32
from unicon_base.errors import alternatives
from unicon_base.located_yaml import Where
from unicon_base.schema.marks import Matches, Names, NotEmpty, Within, Write
from unicon_base.schema.types import Here
from unicon_core.bounds import ACTION_SCALE, EFFORT, POSITION, VELOCITY
from unicon_core.policies.contract import ActionKind, FilterSpec, PolicyFacts
from unicon_core.policies.hints import Clip, Feeds, Sha256, each

_BOUNDS: dict[ActionKind, tuple[dict[str, float], str]] = {
    "position": ({"scale": ACTION_SCALE, "offset": POSITION}, "rad"),
    "velocity": ({"scale": VELOCITY, "offset": VELOCITY}, "rad/s"),
    "torque": ({"scale": EFFORT, "offset": EFFORT}, "N·m"),
}


def kinds_of(said: Any, moved: Sequence[str]) -> list[ActionKind]:
    """Return what each joint is given.

    Args:
        said: `action.kind`: one word, one for each joint, or pattern to word, the last one first.
        moved: the joints that are moved.
    """
    if isinstance(said, Mapping):
        patterns = [*said.items()][::-1]
        found = ((word for like, word in patterns if fnmatchcase(name, like)) for name in moved)
        return [next(words, "position") for words in found]
    return cast(list[ActionKind], [said] * len(moved) if isinstance(said, str) else said)


def note_networks(found: dict[str, Any], here: Here) -> None:
    """Note what goes with other networks than those that are named."""
    networks, feeds = (here.document.get(key) for key in ("networks", "feeds"))
    if here.document.get("torchscript") is not None:
        if networks:
            here.note("networks needs ONNX; export the network of the action so", "networks")
        if found.get("provider", "cpu") != "cpu":
            text = "TorchScript runs on the cpu; export the network as ONNX"
            here.value(f"is {found['provider']!r}; {text}", "provider")
    if feeds and not networks:
        here.note("feeds goes with 'networks'; name them, or leave it out", "feeds")
    if networks and not feeds:
        here.note(
            "feeds needs {INPUT: [observation, NAME.output]} where there are networks", "networks"
        )


def note_joints(found: dict[str, Any], here: Here) -> None:
    """Note lists that are longer or shorter than that of the joints, and what one cannot have."""
    joints, action = found.get("joints"), found.get("action")
    if joints is None:
        return
    for key in ("default_joint_pos", "stiffness", "damping"):
        _note_count(found.get(key), joints, here, key)
    if action is None:
        return
    moved = action.joints or joints
    for name in moved:
        if name not in joints:
            known = alternatives(name, joints)
            here.value(f"names {name!r}, which is not in joints; {known}", "action", "joints")
            return
    for key in ("scale", "offset", "clip"):
        _note_count(getattr(action, key), moved, here, "action", key)
    if action.feedback == "filtered" and action.filter is None:
        text = "is 'filtered'; there is no action.filter; add it, or give raw"
        here.value(text, "action", "feedback")
    for pattern in action.kind if isinstance(action.kind, Mapping) else ():
        if not any(fnmatchcase(name, pattern) for name in moved):
            here.value(
                f"names {pattern!r}, which is none of the joints that are moved; "
                f"{alternatives(pattern, moved)}",
                "action", "kind",
            )  # fmt: skip
            return
    kinds = kinds_of(action.kind, moved)
    if len(kinds) != len(moved):
        here.value(
            f"has {len(kinds)} words for {len(moved)} joints; give one word, one for each joint, "
            "or a mapping {'*_wheel_joint': velocity}",
            "action", "kind",
        )  # fmt: skip
        return
    _note_sizes(action, kinds, here)
    for name, kind in zip(moved, kinds):
        if kind == "velocity":
            _note_gains(joints.index(name), name, found, here)


def _note_count(array: Any, joints: Sequence[str], here: Here, *where: str) -> None:
    size = 1 if array is None else array.shape[-1]
    if size not in (1, len(joints)):
        here.value(
            f"has {size} values for {len(joints)} joints; give one for each joint in policy order",
            *where,
        )


def is_single(value: Any) -> bool:
    """Return whether a value of the facts is one number for all joints."""
    return not hasattr(value, "__len__")


def _at(array: Any, place: int) -> float:
    """The number of a joint, NaN where there is none."""
    listed = [] if array is None else array.tolist()
    place = 0 if len(listed) == 1 else place
    return float(listed[place]) if place < len(listed) else math.nan


def _note_sizes(action: Any, kinds: Sequence[ActionKind], here: Here) -> None:
    for key in ("scale", "offset"):
        array = getattr(action, key)
        for i, kind in enumerate(kinds):
            bounds, unit = _BOUNDS[kind]
            number = _at(array, i)
            if abs(number) > bounds[key]:
                below = [i] if array.size > 1 else []
                text = f"is {number:g}; a {kind} has at most {bounds[key]:g} {unit}"
                here.value(text, "action", key, *below)
                if not below:
                    break


def _note_gains(place: int, name: str, found: dict[str, Any], here: Here) -> None:
    """Note gains of a joint that is given velocities; a single stiffness is that of the others."""
    stiffness, damping = (_at(found.get(key), place) for key in ("stiffness", "damping"))
    if stiffness > 0.0 and not is_single(here.document["stiffness"]):
        here.value(
            f"is {stiffness:g} at {name}, which is given velocities: it would be held where it "
            "stands; give 0 there",
            "stiffness",
        )
    if damping == 0.0:
        here.value(
            f"is 0 at {name}, which is given velocities: nothing would turn it; give the damping "
            "that it was trained with",
            "damping",
        )


def note_filters(found: dict[str, Any], here: Here) -> None:
    """Note low passes that let everything pass."""
    terms = enumerate(getattr(found.get("observation"), "terms", ()))
    places: list[tuple[Where, Any]] = [(("action",), found.get("action"))]
    places += [(("observation", "terms", i), term) for i, term in terms]
    highest = 0.5 / found.get("period", math.inf)
    for where, place in places:
        cutoff = getattr(getattr(place, "filter", None), "low_pass", None)
        if cutoff is not None and cutoff > highest > 0.0:
            here.value(
                f"is {cutoff:g}; give the cut-off frequency in [Hz], above 0 and at most "
                f"{highest:g}, half the policy's rate",
                *where, "filter", "low_pass",
            )  # fmt: skip


def note_unread_command(found: dict[str, Any], here: Here) -> None:
    """Note a limit of the command where nothing sees the command."""
    terms, inputs = getattr(found.get("observation"), "terms", ()), found.get("inputs", {})
    phase = found.get("phase")
    reads = {*inputs, *(term.state for term in terms)}
    reads |= {phase.command} if phase is not None and phase.stand is not None else set()
    known = terms or "observation" not in inputs
    if found.get("command") is not None and known and "velocity_command" not in reads:
        here.value("limits velocity_command, and no term reads that; leave it out", "command")


_KIND = Write(
    "position, velocity or torque, a list with one for each joint, or {'*_wheel_joint': velocity}"
)
_Figure = Annotated[float, Within(-EFFORT, EFFORT)]


@dataclass(frozen=True)
class ActionFilter(FilterSpec):
    """A filter of the action, which begins with zeros unless it says otherwise."""

    start: Literal["first", "zeros"] = "zeros"


@dataclass(frozen=True, eq=False, repr=False)
class ActionFile:
    """What the network's output means.

    Attributes:
        scale: for one unit of action: one number or one for each joint, in the unit of its kind.
        offset: likewise; the default pose unless given, and 0 of velocities and torques.
        kind: position, velocity or torque: one word, one for each joint, or pattern to word.
        clip: lowest and highest action, each one number or one for each joint.
        joints: the joints that are moved, in output order; all unless given.
        filter: of the clipped action.
        feedback: what the state `action` holds: the network's output raw, clipped or filtered.
    """

    scale: Annotated[Float32, each(_Figure)]
    offset: Annotated[Float32, each(_Figure)] | None = None
    kind: Annotated[ActionKind | list[ActionKind] | Mapping[str, ActionKind], _KIND] = "position"
    clip: Clip | None = None
    joints: Names | None = None
    filter: ActionFilter | None = None
    feedback: Literal["raw", "clipped", "filtered"] = "raw"


@dataclass(frozen=True, eq=False, repr=False)
class NetworkFile:
    """A network that runs before the one that gives the action.

    Attributes:
        onnx: its file, in the folder of the policy.
        feeds: input of it to what fills it.
        sha256: of its file.
    """

    onnx: str
    feeds: Annotated[Feeds, NotEmpty]
    sha256: Sha256 | None = None


NetworkName = Annotated[
    str, Matches(r"(?!observation$)[A-Za-z]\w{0,63}", "a name of letters, digits and _")
]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PolicyFile(PolicyFacts):
    """A policy: a network and what it was trained with.

    Attributes:
        schema: version of the format.
        name: of the policy; the folder's unless given.
        description: one line.
        onnx: the network, in the folder of the file.
        torchscript: the network, in place of onnx.
        networks: what runs before the network, by name and in order.
        sources: where the facts were taken from.
    """

    schema: Literal["unicon.policy/1"] = "unicon.policy/1"
    name: str | None = None
    description: Any = None
    onnx: str | None = None
    torchscript: str | None = None
    action: ActionFile
    networks: Mapping[NetworkName, NetworkFile] = field(default_factory=dict)
    sources: Any = None

    @staticmethod
    def between(found: dict[str, Any], here: Here) -> None:
        """Note what fits no joint, no network or no period."""
        note_networks(found, here)
        note_joints(found, here)
        note_filters(found, here)
        note_unread_command(found, here)
