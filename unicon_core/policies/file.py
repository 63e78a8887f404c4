"""What a `policy.yaml` says, as classes; what a contract has in the same shape has one class."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from unicon_core.bounds import EFFORT
from unicon_core.policies.contract import ActionKind, FilterSpec, PolicyFacts
from unicon_core.policies.feeds import Feeds
from unicon_core.policies.file_rules import (
    note_filters,
    note_joints,
    note_networks,
    note_unread_command,
)
from unicon_core.policies.hints import Clip, Floats, Sha256, each
from unicon_core.schema.marks import Matches, Names, NotEmpty, Within, Write
from unicon_core.schema.types import Here

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

    scale: Annotated[Floats, each(_Figure)]
    offset: Annotated[Floats, each(_Figure)] | None = None
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
