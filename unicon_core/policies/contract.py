"""PolicyContract: what a trained network leaves unsaid, for the policy block, checks and tables.

The canonical form of `policy.yaml`; every importer ends here. One observation term is
`scale · clip(filter(state[index]) − subtract)`; the command is
`joint_pos_target = offset + scale · filter(clip(action))`, or a velocity or torque likewise.

Most hints are those of `policy.yaml` (`file.py` has the others): how to write a value, its bounds.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np

from unicon_base import AnyDict
from unicon_base.arrays import Bool, Float32
from unicon_base.schema.marks import Made, Names, Text, Within, Write, positive
from unicon_base.schema.types import Here
from unicon_core.bounds import SCALE, Damping, Stiffness
from unicon_core.policies.chunks import ChildSpec, ChunkSpec, RemoteSpec
from unicon_core.policies.hints import (
    LONGEST_FILTER,
    MOST_FRAMES,
    Alpha,
    Angle,
    Clip,
    ClockRate,
    ClockShift,
    Feeds,
    MotionSpec,
    Offsets,
    Period,
    Places,
    Ranges,
    Sha256,
    Slew,
    Stand,
    Tensor,
    Threshold,
    each,
    listed,
    rounded,
    rounded_one,
)
from unicon_core.policies.perception import HeightScanSpec, Images

ActionKind: TypeAlias = Literal["position", "velocity", "torque"]
TORCHSCRIPT = (".pt", ".pth", ".jit")
_TWO_LEGS = rounded([0.0, np.pi])
_STILL = rounded_one(0.01)


@dataclass(frozen=True)
class FilterSpec:
    """A filter over the ticks of a policy; one of the first three is given.

    Attributes:
        low_pass: cut-off frequency of a first-order low pass in [Hz].
        alpha: the same by the weight of the newest sample, above 0 and at most 1.
        moving_average: number of samples whose mean is taken, at least 2.
        start: what it has seen before its first sample: the `first` one, or `zeros`.
    """

    low_pass: Annotated[float | None, positive(unit="Hz")] = None
    alpha: Alpha | None = None
    moving_average: Annotated[int | None, Within(2, LONGEST_FILTER, "samples")] = None
    start: Literal["first", "zeros"] = "first"

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note other than one filter."""
        named = [key for key, said in here.written.items() if key != "start" and said is not None]
        if len(named) != 1:
            what = f"gives {' and '.join(named)}" if named else "names no filter"
            here.value(f"{what}; give one of low_pass: Hz, alpha: SHARE, moving_average: SAMPLES")

    def __str__(self) -> str:
        if self.moving_average is not None:
            return f"mean of {self.moving_average}"
        if self.low_pass is not None:
            return f"low pass {self.low_pass:g} Hz"
        return f"low pass, alpha {self.alpha:g}"


@dataclass(frozen=True, eq=False)
class ObservationTerm:
    """A part of the network's input: `scale · clip(filter(state[index]) − subtract)`.

    Attributes:
        name: the training side's name.
        state: the state that it is taken from; joint states are taken in policy order, and
            `gait_phase` is all sines, then all cosines. Of a constant it is `constant_NAME`.
        index: elements of the state (for joint states: of the policy order), or None for all.
        subtract: what is taken off before clipping, unit of the state: `"default_joint_pos"`,
            numbers of shape (1,) or (d,), or None.
        scale: factor after clipping, shape (1,) or (d,).
        clip: lowest and highest value before scaling, shape (2, 1) or (2, d), or None.
        history: number of frames that the network sees, at least 1.
        filter: of the state's elements, before anything else; or None.
        value: of a constant, shape (d,), in place of a state; or None.
    """

    name: Text
    state: Text = ""
    index: Places | None = None
    subtract: Literal["default_joint_pos"] | Annotated[Float32, each(float)] | None = None
    scale: Annotated[Float32, each(Annotated[float, Within(-SCALE, SCALE)])] = field(
        default_factory=lambda: np.ones(1, np.float32)
    )
    clip: Clip | None = None
    history: Annotated[int, Within(1, MOST_FRAMES)] = 1
    filter: FilterSpec | None = None
    value: Annotated[Float32, each(Annotated[float, Within(-SCALE, SCALE)])] | None = None

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note a constant that is taken from a state, too."""
        if found.get("state") and found.get("value") is not None:
            here.value("is a constant and has a state; give one of state and value", "value")

    def __post_init__(self) -> None:
        if self.value is not None:
            object.__setattr__(self, "state", "constant_" + re.sub(r"\W", "_", self.name))


@dataclass(frozen=True, eq=False)
class ObservationSpec:
    """The network's input vector.

    Attributes:
        terms: in the order of the input; empty where the network takes states one by one.
        layout: `term_major` (each term's whole history together) or `frame_major` (whole frames of
            each group of neighbours that have one history; the groups follow each other).
        newest: where the newest frame stands in a history.
        start: what the older frames hold after a reset: the `first` observation, or `zeros`.
    """

    terms: tuple[ObservationTerm, ...] = ()
    layout: Literal["term_major", "frame_major"] = "term_major"
    newest: Literal["first", "last"] = "last"
    start: Literal["first", "zeros"] = "first"

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note constants of one name, whose states would be one."""
        names = [term.state for term in found.get("terms", ()) if term.value is not None]
        for name in dict.fromkeys(n for n in names if names.count(n) > 1):
            here.value(f"has several constants {name!r}; give each a name of its own", "terms")


@dataclass(frozen=True, eq=False)
class ActionSpec:
    """What the network's output means: `target = offset + scale · filter(clip(action))`.

    Attributes:
        joints: the joints that are moved, in output order; a subset of the policy's joints.
        scale: for one unit of action, shape (m,), in the unit of each joint's kind.
        offset: in the same units, shape (m,).
        clip: lowest and highest action, shape (2, m), or None.
        feedback: what the state `action`, and so the term `last_action`, holds: the network's
            `raw` output, the `clipped` one, or the `filtered` one, which was clipped before.
        kinds: what each joint is given: a `position` in [rad], a `velocity` in [rad/s] or a
            `torque` in [N·m]; empty where all are positions.
        filter: of the clipped action, or None.
        extra: state that takes the output's values beyond those of the joints, or None.
    """

    joints: tuple[str, ...]
    scale: Float32
    offset: Float32
    clip: Float32 | None = None
    feedback: Literal["raw", "clipped", "filtered"] = "raw"
    kinds: tuple[ActionKind, ...] = ()
    filter: FilterSpec | None = None
    extra: str | None = None

    def of_kind(self, kind: ActionKind) -> Bool:
        """Return which joints are given this kind of target, shape (m,)."""
        kinds = self.kinds or ("position",) * len(self.joints)
        return np.array([each == kind for each in kinds], np.bool_)


@dataclass(frozen=True)
class CommandSpec:
    """The velocity command as the policy and its gait clock see it.

    Attributes:
        slew: largest change of vx, vy, wz in [m/s², m/s², rad/s²]; infinite for any.
    """

    slew: Slew


@dataclass(frozen=True)
class Recurrent:
    """A state tensor of the network that is fed back: `output` of one call is the next `input`."""

    input: Tensor
    output: Tensor


@dataclass(frozen=True)
class NetworkPart:
    """A network that runs before the one that gives the action, such as an encoder.

    Attributes:
        name: of the part; its tensors are called `NAME.tensor`.
        model: its ONNX file.
        feeds: input of it -> what fills it, one after the other.
        sha256: of its file, or None.
    """

    name: str
    model: Path
    feeds: Feeds
    sha256: str | None = None


@dataclass(frozen=True)
class PhaseSpec:
    """The gait clock behind `gait_phase_sin`, `gait_phase_cos` and `gait_phase`.

    With k offsets the first two have k elements, and `gait_phase` has all sines, then all cosines.

    Attributes:
        period: of the gait in [s].
        offsets: start of each phase in [rad], such as (0, π) for two legs.
        stand: what the phases are while the command is zero: a value of all of them in [rad],
            `freeze` where they are, or `zero`, where sine and cosine are both 0; None: they run on.
        stand_below: the command counts as zero below this ([m/s] and [rad/s]).
        command: state with vx, vy, wz.
        resume: where they go on once the command is no longer zero: at the `offsets`, from where
            they `stand`, or where the `clock` is, which ran on meanwhile; None: the usual one of
            `stand`, which are these in turn for a value, `freeze` and `zero`.
        rate: what the clock's speed follows, or None for 1 / period.
        shift: what puts each phase ahead of the clock besides `offsets`, or None.
    """

    period: Period
    offsets: Offsets = _TWO_LEGS
    stand: Stand | Literal["freeze", "zero"] | None = None
    stand_below: Threshold = _STILL
    command: Text = "velocity_command"
    resume: Literal["offsets", "stand", "clock"] | None = None
    rate: ClockRate | None = None
    shift: ClockShift | None = None

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note phases that go on and never stand, and shifts of more or fewer phases."""
        shift, offsets = found.get("shift"), found.get("offsets", _TWO_LEGS)
        if shift is not None and len(shift.index) != len(offsets):
            text = f"has {len(shift.index)} lists for {len(offsets)} offsets; give one for each"
            here.value(text, "shift", "index")
        if found.get("resume") is not None and here.written.get("stand") is None:
            here.value(
                "says where the phases go on, and stand: does not say that they stand; add stand: "
                "a phase in [rad], freeze or zero",
                "resume",
            )


@dataclass(frozen=True, eq=False, kw_only=True)
class PolicyFacts:
    """What a `policy.yaml` and a contract both say.

    Attributes:
        period: control period in [s].
        joints: the policy's joint order, length n; every joint array below is in this order.
        default_joint_pos: pose that relative positions refer to in [rad], shape (n,).
        action: meaning of the output.
        chunk: the output has a row for each of several times, or None.
        stiffness: proportional gains in [N·m/rad], shape (n,).
        damping: derivative gains in [N·m·s/rad], shape (n,).
        observation: the input vector.
        inputs: `observation` or the name of a state -> name of the network's input.
        outputs: `action` -> name of the network's output; further states may be written.
        recurrent: state tensors that are fed back.
        command_ranges: `lin_vel_x`, … -> lowest and highest trained command.
        phase: the gait clock, or None.
        command: how fast the velocity command may change that it sees, or None.
        motion: what it follows, or None.
        height_scan: the points at which it sees the ground, or None.
        images: state to how it is made of a camera's frames.
        robot: the robot it was trained for, for information.
        sha256: of the network's file, or None.
        provider: where ONNX Runtime runs the network: `cpu`, `cuda` or `tensorrt`.
        feeds: input of the network in `model` -> what fills it, where there are `networks`.
    """

    period: Period
    joints: Annotated[Names, Write("a list of joint names")]
    default_joint_pos: Annotated[Float32, each(Angle)]
    action: Any
    stiffness: Annotated[Float32, each(Stiffness)]
    damping: Annotated[Float32, each(Damping)]
    observation: ObservationSpec = field(default_factory=ObservationSpec)
    inputs: Mapping[str, Tensor] = field(default_factory=dict)
    outputs: Mapping[str, Tensor] = field(default_factory=dict)
    recurrent: Annotated[tuple[Recurrent, ...], Made(listed, Recurrent | list[Recurrent])] = ()
    command_ranges: Ranges = field(default_factory=dict)
    phase: PhaseSpec | None = None
    command: CommandSpec | None = None
    motion: MotionSpec | None = None
    height_scan: HeightScanSpec | None = None
    images: Images = field(default_factory=dict)
    chunk: ChunkSpec | None = None
    robot: str | None = None
    sha256: Sha256 | None = None
    provider: Literal["cpu", "cuda", "tensorrt"] = "cpu"
    feeds: Feeds = field(default_factory=dict)

    @property
    def terms(self) -> tuple[ObservationTerm, ...]:
        """The observation's terms in the order of the input."""
        return self.observation.terms

    @property
    def seen(self) -> set[str]:
        """The states that the network takes as inputs or terms."""
        return {*self.inputs, *(term.state for term in self.terms)}


@dataclass(frozen=True, eq=False, kw_only=True)
class PolicyContract(PolicyFacts):
    """A network and everything that is needed to run it as it was trained.

    Attributes:
        name: of the policy.
        path: the file that the contract was read from.
        model: the network: `.onnx`, `.pt` for TorchScript, `.safetensors` in LeRobot's folder.
        networks: what runs before the network in `model`, in order.
        child: how it runs in a process of its own or at a server, or None; the workflow says it.
        source: the format that it came from.
        notes: what a user should know, such as rounding of the source.
    """

    action: ActionSpec
    name: str
    path: Path
    model: Path
    networks: tuple[NetworkPart, ...] = ()
    child: ChildSpec | RemoteSpec | None = None
    source: str = "policy.yaml"
    notes: tuple[str, ...] = ()

    @property
    def parts(self) -> tuple[NetworkPart, ...]:
        """All networks in order; the last one, which gives the action, has no name."""
        return (*self.networks, NetworkPart("", self.model, self.feeds, self.sha256))

    @property
    def threads(self) -> int:
        """How many threads the networks have: one in the process of the ticks."""
        return 1 if self.child is None else self.child.threads

    @property
    def is_torchscript(self) -> bool:
        """Whether the network is a TorchScript file."""
        return self.model.suffix in TORCHSCRIPT

    @property
    def is_lerobot(self) -> bool:
        """Whether the network is a folder of LeRobot's."""
        return self.model.suffix == ".safetensors"

    @property
    def is_onnx(self) -> bool:
        """Whether the network is an ONNX file, which says what it takes and gives."""
        return not (self.is_torchscript or self.is_lerobot)
