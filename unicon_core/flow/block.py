"""Block: the unit of control, for whoever writes one; and how a factory gets the states it names.

A block is built once against the arrays that it names, then called with no argument each tick. It
returns True when it is done, False or None while it runs (the paper's r), and raises `Fault` when
something is wrong. Any plain function that returns a bool is a block.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, TypeAlias

from unicon_base.arrays import Array
from unicon_base.errors import WorkflowError
from unicon_core.flow.linear import LinearMap
from unicon_core.flow.stage import Stage

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
