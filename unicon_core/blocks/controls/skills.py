"""Skills: what chooses between the skills of a workflow, see `unicon_core/workflow/flow_yaml.py`.

A state machine as `modes` is one, whose modes are asked for by buttons, by a state and by whoever
calls `ask`, such as a service. Who is refused is told why.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from unicon_base.arrays import Array, Int32
from unicon_core.blocks.controls.modes import ModeEntry, Modes, Seen
from unicon_core.workflow.autowire import BuildContext

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
        self._following, self._wish = dict(following), wish
        self._wished = self._value()
        self._asked = self._next = ""
        self.reads, self.writes = tuple(reads), (SKILL,)

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
