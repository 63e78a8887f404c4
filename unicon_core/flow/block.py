"""Block: the unit of control, for authors of blocks; and how a factory gets the states it names.

A block is built once against the arrays that it names, then called with no argument each tick. It
returns True when it is done, False or None while it runs (the paper's r), and raises `Fault` when
something is wrong. Any plain function that returns a bool is a block.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from unicon_base.arrays import Array
from unicon_base.errors import StateError, WorkflowError


class Stage(Enum):
    """The stages of a tick, in their order."""

    RECV = "recv"
    """The platform writes what was measured."""
    ESTIMATE = "estimate"
    """What is not measured is computed: contacts, velocities, poses of frames."""
    COMMAND = "command"
    """Commands are made by the workflow's own blocks."""
    INPUT = "input"
    """Others may replace them: topics, devices."""
    FLOW = "flow"
    """Postures and policies write the command states."""
    TUNE = "tune"
    """The host changes gains at somebody's wish."""
    SAFETY = "safety"
    """Limits and stops, the last that changes a command."""
    SEND = "send"
    """The platform sends the command states."""
    OBSERVE = "observe"
    """Bridge, recorder and viewers look, in the slack of the tick."""


FIXED = frozenset({Stage.RECV, Stage.TUNE, Stage.SAFETY, Stage.SEND})
"""Stages whose blocks stay where they are: neither put off nor fused with others. A safety block
that says that it is `patient`, since it compares many ticks, is put off by the program."""


@dataclass(eq=False)
class LinearMap:
    """target = source[…, index] · scale + offset, along the last axis, in the target's type.

    Everything is read before anything is written. A block whose tick it is, or carries one as its
    attribute `linear`, is a copy or a linear index map and nothing else: it is never done.

    Attributes:
        source: view that is read, shape (…, m).
        target: view that is written, shape (…, n).
        index: places in the last axis of the source, integers of shape (n,); None: all, n = m.
        scale: factor, one number or shape (n,); None for none.
        offset: summand in the target's unit, one number or shape (n,); None for none.
        source_name: the source's state, "" where it is none.
        target_name: the target's state, "" where it is none.

    Raises:
        StateError: shapes or an index that do not fit.
    """

    memory = ()

    source: Array
    target: Array
    index: Any = None
    scale: ArrayLike | None = None
    offset: ArrayLike | None = None
    source_name: str = ""
    target_name: str = ""
    _taken: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        label = f"{self.target_name or 'target'} from {self.source_name or 'source'}"
        source, target = self.source, self.target
        shape = source.shape
        if self.index is not None:
            index = np.asarray(self.index)
            last = source.shape[-1] if source.ndim else 0
            if index.ndim != 1 or index.dtype.kind not in "iu":
                raise StateError(f"{label}: the index must be a list of whole numbers")
            wrong = index[(index < 0) | (index >= last)]
            if wrong.size:
                raise StateError(f"{label}: no element {wrong[0]}; there are 0 to {last - 1}")
            shape = (*source.shape[:-1], index.size)
            whole = index.size == last and (index == np.arange(last)).all()
            self.index = None if whole else index.astype(np.intp)
        if shape != target.shape:
            raise StateError(
                f"{label}: shape {shape} into {target.shape}; give an index of as many elements"
            )
        width = target.shape[-1:]
        count = width[0] if width else 1
        dtype = target.dtype if target.dtype.kind == "f" else np.float64
        for name in ("scale", "offset"):
            if getattr(self, name) is not None:
                values = np.ravel(getattr(self, name))
                if values.size not in (1, count):
                    raise StateError(
                        f"{label}: {name} has {values.size} values for {count} elements; give "
                        "one, or one for each"
                    )
                # As wide as the target: broadcasting costs 1.1 µs against 0.2 µs.
                full = np.broadcast_to(values, (count,)).astype(dtype).reshape(width)
                setattr(self, name, full)
        self._taken = np.empty(target.shape, source.dtype)

    @property
    def is_copy(self) -> bool:
        """True where the values arrive as they are, whatever their places."""
        return self.scale is None and self.offset is None

    @property
    def reads(self) -> tuple[str, ...]:
        """The source's state, for the graph check."""
        return (self.source_name,) if self.source_name else ()

    @property
    def writes(self) -> tuple[str, ...]:
        """The target's state, for the graph check."""
        return (self.target_name,) if self.target_name else ()

    def __call__(self) -> None:
        source, target = self.source, self.target
        if self.index is not None:
            # mode "clip" (the index was checked at build) saves NumPy's own buffer, 2x.
            source.take(self.index, -1, self._taken, "clip")
            source = self._taken
        np.copyto(target, source, casting="unsafe")  # NumPy sees an overlap and minds it
        if self.scale is not None:
            np.multiply(target, self.scale, out=target, casting="unsafe")
        if self.offset is not None:
            np.add(target, self.offset, out=target, casting="unsafe")


Tick: TypeAlias = Callable[[], object]
"""A parameter-less function; a true result means done."""


@dataclass(frozen=True)
class Access:
    """How a factory's parameter uses the state of its name."""

    mode: Literal["reads", "writes", "amends"]


Reads: TypeAlias = Annotated[Array, Access("reads")]
"""A state that the block reads: it gets a read-only view."""
Writes: TypeAlias = Annotated[Array, Access("writes")]
"""A state that the block writes in every tick before anybody reads it."""
Amends: TypeAlias = Annotated[Array, Access("amends")]
"""A state that another block writes and this one changes in place (limits, safety)."""


class Bundle:
    """Base of dataclasses that hand a factory several states as one parameter.

    Its fields are named and annotated as the factory's own parameters would be.
    """


@dataclass(frozen=True)
class Share:
    """What a block has of the states that moves some joints of a robot alone.

    Attributes:
        of: whose joints: a member of the robot, or groups.
        joints: their names in the whole robot.
        whole: all joints of the robot.
        parts: name to joints of members and groups, for messages.
        states: those that have an element for each joint; of them it has its own joints'.
    """

    of: str
    joints: frozenset[str]
    whole: frozenset[str]
    parts: Mapping[str, frozenset[str]]
    states: frozenset[str]


@dataclass(eq=False)
class Block:
    """One built block.

    Attributes:
        name: label for traces, tables and errors.
        tick: the parameter-less function.
        reads: states that it reads.
        writes: states that it writes; a state has one writer in a tick.
        amends: states that it reads and changes after their writer.
        reset: called when the flow enters the block anew after it has run, or None.
        warm_up: the same arithmetic on scratch memory, called shortly before the deadline to warm
            the caches; changes nothing observable, but may raise `Fault`; or None.
        close: called once at the end, in reverse order of building, or None.
        stage: its place in the tick; the program sets it where the block does not say.
        where: `file:line` of its declaration, for messages.
        part: of a divided workflow, to which it belongs; "" for the first one.
        endless: True where the block can never be done; what it returns is not even looked at.
        expects: what it needs states to be: name to `shape`, `dtype`, `unit` or `frame`.
        share: of a block that moves some of the joints alone, such as those of a member, or None.
        linear: what it does where that is a copy or a linear index map, or None; neighbours are
            then fused into one operation.
        parts: the blocks that were fused into this one.
        inline: Python expression of numbers and of names in `inline_names`, without texts and
            attributes, which the compiler puts in the place of the call, or ""; of an endless
            block also statements, one a line.
    """

    name: str
    tick: Tick
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    amends: tuple[str, ...] = ()
    reset: Tick | None = None
    close: Tick | None = None
    warm_up: Tick | None = None
    stage: Stage | None = None
    where: str = ""
    part: str = ""
    endless: bool = False
    expects: dict[str, dict[str, Any]] = field(default_factory=dict)
    share: Share | None = None
    linear: LinearMap | None = None
    parts: tuple[Block, ...] = ()
    inline: str = ""
    inline_names: dict[str, Any] = field(default_factory=dict)

    def __call__(self) -> object:
        return self.tick()

    def claim(self, state: str) -> str:
        """Return a state as this block has it: `joint_pos of left_hand`, or all of it."""
        share = self.share
        return f"{state} of {share.of}" if share and state in share.states else state


def as_block(candidate: Any, *, name: str = "", where: str = "") -> Block:
    """Wrap what a factory returned, or any callable, as a Block.

    Attributes `reads`, `writes`, `amends`, `reset`, `close`, `warm_up`, `stage`, `endless`,
    `expects`, `linear` and `name` of the callable are taken over where it has them. A callable
    annotated to return None is endless.

    Raises:
        WorkflowError: it cannot be called without arguments.
    """
    if isinstance(candidate, Block):
        candidate.name, candidate.where = candidate.name or name, candidate.where or where
        return candidate
    if not callable(candidate):
        raise WorkflowError(
            f"block {name or candidate!r} is a {type(candidate).__name__}; "
            "a block is a function without parameters that returns a bool",
            where,
        )

    def listed(attribute: str) -> tuple[str, ...]:
        value: Sequence[str] | Iterable[str] = getattr(candidate, attribute, ())
        return (value,) if isinstance(value, str) else tuple(value)

    linear = getattr(candidate, "linear", candidate)
    linear = linear if isinstance(linear, LinearMap) else None
    label = name or getattr(candidate, "name", "") or getattr(candidate, "__name__", "")
    return Block(
        name=label or type(candidate).__name__,
        tick=candidate,
        reads=listed("reads"),
        writes=listed("writes"),
        amends=listed("amends"),
        reset=getattr(candidate, "reset", None),
        close=getattr(candidate, "close", None),
        warm_up=getattr(candidate, "warm_up", None),
        stage=getattr(candidate, "stage", None),
        where=where,
        endless=bool(getattr(candidate, "endless", linear is not None or _never_done(candidate))),
        expects=dict(getattr(candidate, "expects", None) or {}),
        linear=linear,
    )


def _never_done(candidate: Any) -> bool:
    """Return True where a callable is annotated to return None."""
    missing = object()
    for function in (candidate, type(candidate).__call__):
        told = getattr(function, "__annotations__", {}).get("return", missing)
        if told is not missing:
            return told is None or told == "None"
    return False
