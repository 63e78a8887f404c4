"""Selector `modes`: a state machine of buttons, for the `on:` of a switch.

    switch:
      on:
        modes:
          begin: passive
          to:
            passive: {button: B}
            stand: {button: A, from: [passive, walk], tilt: 0.5}
            walk: {button: start, from: [stand], after: 2.5, calm: true}
      blend: 0.3
      cases: {passive: damp, stand: …, walk: {policy: walk}}

A button that is not for the present mode is refused, and says why.

Skills are a state machine of the same kind, see `unicon_core/workflow/skills.py`: modes that
buttons, a state and callers of `Skills.ask` (a service) ask for; a refusal says why.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

import numpy as np

from unicon_base.arrays import Array, Bool, Float32, Int32
from unicon_base.errors import WorkflowError, alternatives
from unicon_base.schema.marks import Like, NotEmpty, Write
from unicon_core.blocks.controls.device import declares_controls
from unicon_core.blocks.postures import ticks_of
from unicon_core.bounds import BUTTONS, Button
from unicon_core.flow.block import Reads, Writes
from unicon_core.states import StateSpec
from unicon_core.workflow.autowire import BuildContext
from unicon_core.workflow.file import Entry

CENTRED = 0.2
"""A stick that is no further away is let go."""


@dataclass(frozen=True)
class Mode(Entry):
    """How a mode is entered, as of `Entry`; by its button in any case."""

    button: Button


@dataclass(frozen=True)
class ModeEntry:
    """How a mode is entered.

    Attributes:
        mode: its name.
        button: its name, or "".
        sources: modes from which it is entered; empty for any.
        after: ticks that the mode before must have had.
        tilt: how far the base may lean in [rad].
        calm: no stick may be pushed.
        enter: returns why what has to hold besides does not, "" where it does; or None.
    """

    mode: str
    button: str
    sources: tuple[str, ...]
    after: int
    tilt: float
    calm: bool
    enter: Callable[[], str] | None = None


Seen: TypeAlias = tuple[Float32, Int32, Float32]
"""Sticks, buttons and projected gravity."""


def modes(
    sticks: Reads,
    buttons: Reads,
    projected_gravity: Reads,
    mode: Writes,
    *,
    context: BuildContext,
    begin: str,
    to: Annotated[
        Mapping[str, Annotated[Mapping[str, Any], Like(Mode), Write("{button: NAME}")]],
        NotEmpty,
        Write("{stand: {button: A}}"),
    ],
) -> Modes:
    """Return the name of the present mode.

    Args:
        begin: the mode in which it begins; state `mode` is 0 then, else 1, 2, … as in `to`.
        to: mode to `button` and, where they are said, `from` (modes), `after` (time that the mode
            before must have had, in [s]), `tilt` (most that the base may lean, in [rad]) and `calm`
            (the sticks are let go).

    Raises:
        WorkflowError: an unknown mode, or a button of two modes from one.
    """
    names = list(dict.fromkeys([begin, *to]))
    ways = [way_of(name, said, names, context.period, "to.") for name, said in to.items()]
    check_buttons(ways)
    return Modes((sticks, buttons, projected_gravity), mode, names, ways, context)


def check_buttons(ways: Sequence[ModeEntry]) -> None:
    """Refuse a button that leads to two modes from one.

    Raises:
        WorkflowError: it does.
    """
    for number, way in enumerate(ways):
        for other in ways[:number]:
            both = not (way.sources and other.sources) or {*way.sources} & {*other.sources}
            if way.button and way.button == other.button and both:
                raise WorkflowError(
                    f"button {way.button} leads to {other.mode} and to {way.mode}; give one of "
                    "them another, or other modes under from"
                )


def _declares(**_: Any) -> Mapping[str, StateSpec]:
    number = StateSpec((), "int32", description="number of the present mode of `modes`")
    return {**declares_controls(), "mode": number}


setattr(modes, "declares", _declares)  # noqa: B010  a function has none to mypy


def way_of(
    name: str, said: Mapping[str, Any], names: Sequence[str], period: float, place: str
) -> ModeEntry:
    """Return how a mode is entered.

    Args:
        name: of the mode.
        said: what the workflow says of it, as of `Entry`.
        names: of all modes.
        period: of a tick in [s].
        place: stands before the name in messages.

    Raises:
        WorkflowError: it is entered from a mode that there is not.
    """
    sources, button, after = (said.get(key) for key in ("from", "button", "after"))
    for source in sources or ():
        if source not in names:
            raise WorkflowError(
                f"{place}{name}.from: no mode {source!r}; {alternatives(str(source), names)}"
            )
    return ModeEntry(
        name,
        button or "",
        tuple(sources or ()),
        ticks_of(after, period) if after else 0,
        said.get("tilt", math.pi),
        said.get("calm", False),
    )


class Modes:
    """The tick of `modes`."""

    memory = ("_before", "_now", "_ticks")

    endless = True
    word = "mode"

    def __init__(
        self,
        seen: Seen,
        mode: Int32,
        names: Sequence[str],
        ways: Sequence[ModeEntry],
        context: BuildContext,
    ) -> None:
        self._sticks, self._buttons, self._gravity = seen
        self._mode = mode
        self._names = tuple(names)
        self._ways = tuple(ways)
        self.buttons_used = tuple(way.button for way in ways if way.button)
        self._period = context.period
        self._tell = context.tell
        self._before = np.empty_like(self._buttons)
        Modes.reset(self)

    def __call__(self) -> str:
        pressed = self._buttons > self._before
        self._before[...] = self._buttons
        self._ticks += 1
        if pressed.any():
            self._press(pressed)
        self._mode[...] = self._names.index(self._now)
        return self._now

    def _press(self, pressed: Bool) -> None:
        names = {BUTTONS[place] for place in np.flatnonzero(pressed)}
        wished = [way for way in self._ways if way.button in names]
        here = [way for way in wished if not way.sources or self._now in way.sources]
        for way in here or wished[:1]:
            if way.mode == self._now:
                return
            reason = self._refused(way)
            if not reason:
                self._enter(way.mode)
                return
            self._tell(f"{way.button} is refused: {reason}")

    def _enter(self, mode: str) -> None:
        self._now = mode
        self._ticks = 0
        self._tell(f"{self.word}: {mode}")

    def _refused(self, way: ModeEntry) -> str:
        if way.sources and self._now not in way.sources:
            return f"{way.mode} is entered from {', '.join(way.sources)}, and this is {self._now}"
        if way.after and self._ticks <= way.after:
            left = (way.after - self._ticks + 1) * self._period
            return f"{self._now} is not at its end, press it again in {left:.1f} s"
        upright = min(max(-float(self._gravity[..., 2].max()), -1.0), 1.0)
        lean = math.acos(upright) if math.isfinite(upright) else math.pi
        if way.tilt < math.pi and not lean <= way.tilt:
            return f"the base leans {lean:.2f} rad, at most {way.tilt:g} are allowed"
        if way.calm and not float(np.abs(self._sticks).max()) <= CENTRED:
            return "a stick is pushed; let go of it first"
        return "" if way.enter is None else way.enter()

    def reset(self) -> None:
        """Begin anew; what is held down counts once it is pressed again."""
        self._now = self._names[0]
        self._ticks = 0
        self._before[...] = 1


SKILL = "skill"
"""State: number of the present skill, in the order of the workflow."""

NOTHING = -1
"""Value of the asking state that asks for nothing."""


class Skills(Modes):
    """The selector of the skills.

    Args:
        seen: as of `Modes`; of size 0 what no skill looks at.
        number: state `skill`.
        ways: how each skill is entered, in the order of the workflow.
        following: skill to the one that comes when it is done.
        wish: state that asks for a skill by its number whenever it changes, or None.
        context: of the build.
        reads: states that are read.

    Attributes:
        names: of the skills, in the order of the workflow; the first is the one to begin with.
    """

    memory = ("_wished", "_asked", "_next")

    word = "skill"

    def __init__(
        self,
        seen: Seen,
        number: Int32,
        ways: Sequence[ModeEntry],
        following: Mapping[str, str],
        wish: Array | None,
        context: BuildContext,
        reads: Sequence[str],
    ) -> None:
        self.names = tuple(way.mode for way in ways)
        super().__init__(seen, number, self.names, ways, context)
        self._by_name = {way.mode: way for way in ways}
        self._following = dict(following)
        self._wish = wish
        self._wished = self._value()
        self._asked = self._next = ""
        self.reads = tuple(reads)
        self.writes = (SKILL,)

    @property
    def now(self) -> str:
        """The present skill."""
        return self._now

    def ask(self, name: str) -> str:
        """Ask for a skill, which is entered in the next tick; return why it is refused, or "".

        Call it in the thread of the ticks.

        Raises:
            KeyError: no such skill.
        """
        way = self._by_name[name]
        reason = "" if name == self._now else self._refused(way)
        if not reason:
            self._asked = name
        return reason

    def end(self) -> None:
        """Note that the present skill is done: the one that follows comes in the next tick."""
        self._next = self._following[self._now]

    def __call__(self) -> str:
        if self._next:
            self._enter(self._next)
            self._next = ""
        if self._wish is not None and (wished := self._value()) != self._wished:
            self._wished = wished
            self._wish_for(wished)
        if self._asked:
            self._go_to(self._asked, "it was asked for")
            self._asked = ""
        return super().__call__()

    def _value(self) -> int:
        return NOTHING if self._wish is None else int(self._wish)

    def _wish_for(self, number: int) -> None:
        if number == NOTHING:
            return
        if 0 <= number < len(self.names):
            self._go_to(self.names[number], f"number {number}")
        else:
            last = len(self.names) - 1
            self._tell(f"skill number {number} is refused: there are 0 to {last}")

    def _go_to(self, name: str, why: str) -> None:
        if name == self._now:
            return
        reason = self._refused(self._by_name[name])
        if reason:
            self._tell(f"skill {name} ({why}) is refused: {reason}")
        else:
            self._enter(name)

    def reset(self) -> None:
        """Begin anew."""
        super().reset()
        self._asked = self._next = ""
        self._wished = self._value()


class Ended:
    """What stands behind a skill that another one follows: it says that the skill is done.

    Args:
        skills: gives the selector, which is built by the time of the first tick.
    """

    memory = ()

    endless = True

    def __init__(self, skills: Callable[[], Skills]) -> None:
        self._skills = skills

    def __call__(self) -> None:
        self._skills().end()
