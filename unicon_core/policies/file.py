"""What a `policy.yaml` says, as classes, and the checked contract that is built of any source.

Classes that a contract has in the same shape are those of `contract.py`. Rules say what lies
between facts: what fits no joint, no network or no period. Each takes `found`, the facts that are
right by themselves, and notes what is wrong `here`. Every mistake is named at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from fnmatch import fnmatchcase
from typing import Annotated, Any, Literal, cast

import numpy as np

from unicon_base import AnyDict, PolicyError, alternatives
from unicon_base.arrays import Float32
from unicon_base.located_yaml import Where
from unicon_base.resources import file_beside
from unicon_base.schema.marks import Matches, Names, NotEmpty, Text, Within, Write
from unicon_base.schema.read import refuse
from unicon_base.schema.records import record_of
from unicon_base.schema.types import Here, Mistakes
from unicon_core.bounds import ACTION_SCALE, EFFORT, POSITION, VELOCITY
from unicon_core.policies.chunks import note_chunk
from unicon_core.policies.contract import (
    ActionKind,
    ActionSpec,
    FilterSpec,
    NetworkPart,
    PolicyContract,
    PolicyFacts,
)
from unicon_core.policies.facts import GAINS, Facts, dig, is_open, missing_facts
from unicon_core.policies.hints import Clip, Feeds, Sha256, each
from unicon_core.robots import joint_index

# Largest scale and offset of an action, and their unit.
_BOUNDS: dict[ActionKind, tuple[float, float, str]] = {
    "position": (ACTION_SCALE, POSITION, "rad"),
    "velocity": (VELOCITY, VELOCITY, "rad/s"),
    "torque": (EFFORT, EFFORT, "N·m"),
}
# Kinds of joints that a single gain is not of.
_WITHOUT = {"stiffness": ("velocity", "torque"), "damping": ("torque",)}


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


def note_networks(found: AnyDict, here: Here) -> None:
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
        text = "feeds needs {INPUT: [observation, NAME.output]} where there are networks"
        here.note(text, "networks")


def _spread(array: Any, count: int) -> Float32:
    """Return one number for each of `count`; NaN where there are others or none."""
    fits = array is not None and array.shape[-1] in (1, count)
    return np.array(np.broadcast_to(array if fits else np.float32(np.nan), count))


def is_single(value: Any) -> bool:
    """Return whether a value of the facts is one number for all joints."""
    return not hasattr(value, "__len__")


def note_joints(found: AnyDict, here: Here) -> None:
    """Note lists that are longer or shorter than that of the joints, and what one cannot have."""
    joints, action = found.get("joints"), found.get("action")
    if joints is None:
        return
    lists: list[tuple[Where, Any, Sequence[str]]] = [
        ((key,), found.get(key), joints) for key in ("default_joint_pos", *GAINS)
    ]
    moved = action.joints or joints if action is not None else ()
    unknown = next((name for name in moved if name not in joints), None)
    if action is not None and unknown is None:
        keys = ("scale", "offset", "clip")
        lists += [(("action", key), getattr(action, key), moved) for key in keys]
    for where, array, of in lists:
        size = 1 if array is None else array.shape[-1]
        if size not in (1, len(of)):
            text = f"has {size} values for {len(of)} joints; give one for each in policy order"
            here.value(text, *where)
    if unknown is not None:
        known = alternatives(unknown, joints)
        here.value(f"names {unknown!r}, which is not in joints; {known}", "action", "joints")
    elif action is not None:
        _note_action(action, moved, joints, found, here)


def _note_action(
    action: ActionFile, moved: Sequence[str], joints: Sequence[str], found: Any, here: Here
) -> None:
    if action.feedback == "filtered" and action.filter is None:
        text = "is 'filtered'; there is no action.filter; add it, or give raw"
        here.value(text, "action", "feedback")
    for pattern in action.kind if isinstance(action.kind, Mapping) else ():
        if not any(fnmatchcase(name, pattern) for name in moved):
            text = f"names {pattern!r}, which is none of the joints that are moved"
            here.value(f"{text}; {alternatives(pattern, moved)}", "action", "kind")
            return
    kinds = kinds_of(action.kind, moved)
    if len(kinds) != len(moved):
        text = f"has {len(kinds)} words for {len(moved)} joints; give one word, one for each"
        here.value(f"{text}, or a mapping {{'*_wheel_joint': velocity}}", "action", "kind")
        return
    for column, key in enumerate(("scale", "offset")):
        array = getattr(action, key)
        single = array is None or array.size == 1
        for i, (kind, number) in enumerate(zip(kinds, _spread(array, len(kinds)))):
            highest, unit = _BOUNDS[kind][column], _BOUNDS[kind][2]
            if abs(number) > highest:
                text = f"is {number:g}; a {kind} has at most {highest:g} {unit}"
                here.value(text, "action", key, *(() if single else (i,)))
                if single:
                    break
    stiffness, damping = (_spread(found.get(key), len(joints)) for key in GAINS)
    for name in (name for name, kind in zip(moved, kinds) if kind == "velocity"):
        place = joints.index(name)
        given = f"at {name}, which is given velocities"
        if stiffness[place] > 0.0 and not is_single(here.document["stiffness"]):
            text = f"is {stiffness[place]:g} {given}: it would be held where it stands; give 0"
            here.value(text, "stiffness")
        if damping[place] == 0.0:
            text = f"is 0 {given}: nothing would turn it; give the damping of its training"
            here.value(text, "damping")


def note_filters(found: AnyDict, here: Here) -> None:
    """Note low passes that let everything pass."""
    terms = enumerate(getattr(found.get("observation"), "terms", ()))
    places: list[tuple[Where, Any]] = [(("action",), found.get("action"))]
    places += [(("observation", "terms", i), term) for i, term in terms]
    highest = 0.5 / found.get("period", math.inf)
    for where, place in places:
        cutoff = getattr(getattr(place, "filter", None), "low_pass", None)
        if cutoff is not None and cutoff > highest > 0.0:
            text = f"is {cutoff:g}; give the cut-off frequency in [Hz], above 0 and at most"
            here.value(f"{text} {highest:g}, half the policy's rate", *where, "filter", "low_pass")


def note_unread_command(found: AnyDict, here: Here) -> None:
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
        extra: state that takes the output's values beyond those of the joints.
    """

    scale: Annotated[Float32, each(_Figure)]
    offset: Annotated[Float32, each(_Figure)] | None = None
    kind: Annotated[ActionKind | list[ActionKind] | Mapping[str, ActionKind], _KIND] = "position"
    clip: Clip | None = None
    joints: Names | None = None
    filter: ActionFilter | None = None
    feedback: Literal["raw", "clipped", "filtered"] = "raw"
    extra: Text | None = None


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
    def between(found: AnyDict, here: Here) -> None:
        """Note what fits no joint, no network or no period."""
        for note in (note_networks, note_joints, note_filters, note_chunk, note_unread_command):
            note(found, here)


class IncompletePolicyError(PolicyError):
    """A policy lacks facts.

    Args:
        message: which, and how to give them.
        facts: what it says.
    """

    def __init__(self, message: str, facts: Facts) -> None:
        super().__init__(message)
        self.facts = facts


class _Mistakes(Mistakes):
    """The mistakes of facts, but for facts that are missing, which `missing_facts` asks for."""

    def missing(self, where: Where, key: str, wanted: str) -> None:
        if not where or key == "scale":
            self.found.append((where, ""))
        else:
            super().missing(where, key, wanted)


def read_facts(facts: Facts, missing: Mapping[str, str]) -> PolicyFile:
    """Return what facts say, which is of no use where some are missing.

    Args:
        facts: of a source.
        missing: those that are asked for elsewhere: a place that is still open is no mistake then.

    Raises:
        PolicyError: facts are wrong: file, line and remedy of each mistake.
    """
    mistakes = _Mistakes(facts.values)
    said: PolicyFile = record_of(PolicyFile).read(facts.values, (), mistakes)
    mistakes.found = [
        (where, text)
        for where, text in mistakes.found
        if text and not (missing and is_open(dig(facts.values, *where)))
    ]
    refuse(mistakes, facts.error, f"policy {facts.path}")
    return said


def build_contract(facts: Facts) -> PolicyContract:
    """Check facts and build the contract.

    Raises:
        PolicyError: facts are wrong or missing; all are named, missing ones with how to give them.
    """
    missing = missing_facts(facts)
    said = read_facts(facts, missing)
    if missing:
        names = "; ".join(f"{name} ({what})" if what else name for name, what in missing.items())
        remedy = "give it under 'given' in the workflow, with the keys of policy.yaml"
        if facts.source == "policy.yaml":
            remedy = f"add it to {facts.path.name}"
        raise IncompletePolicyError(
            f"{facts.path}: the {facts.source} does not say {names}; {remedy}{facts.offer}", facts
        )
    count = len(said.joints)
    default = _spread(said.default_joint_pos, count)
    action = _action(said.action, said.joints, default)
    shared = {each.name: getattr(said, each.name) for each in fields(PolicyFacts)}
    shared |= {"default_joint_pos": default, "action": action}
    for key, kinds in _WITHOUT.items():
        shared[key] = gains = _spread(getattr(said, key), count)
        for name, kind in zip(action.joints, action.kinds):
            if kind in kinds and is_single(facts.values[key]):
                gains[said.joints.index(name)] = 0.0
    shared["motion"] = said.motion and facts.with_clip(said.motion)
    return PolicyContract(
        **shared,
        name=said.name or facts.path.parent.name or facts.path.stem,
        path=facts.path,
        model=facts.model(),
        networks=tuple(
            NetworkPart(
                name,
                file_beside(facts.path, part.onnx, "onnx", error=PolicyError),
                part.feeds,
                part.sha256,
            )
            for name, part in said.networks.items()
        ),
        source=facts.source,
        notes=tuple(facts.notes),
    )


def _action(said: ActionFile, joints: tuple[str, ...], default: Float32) -> ActionSpec:
    moved = said.joints or joints
    count, kinds = len(moved), kinds_of(said.kind, moved)
    positions = np.array([kind == "position" for kind in kinds])
    pose = np.where(positions, default[joint_index(moved, joints)], np.float32(0.0))
    return ActionSpec(
        moved,
        _spread(said.scale, count),
        pose if said.offset is None else _spread(said.offset, count),
        None if said.clip is None else np.array(np.broadcast_to(said.clip, (2, count))),
        said.feedback,
        () if {*kinds} == {"position"} else tuple(kinds),
        said.filter and FilterSpec(**asdict(said.filter)),
        said.extra,
    )
