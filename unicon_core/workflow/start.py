"""What a workflow says of its start: gates, the operator's go, approach and fade-in.

    start: {operator: false, approach: 0.3, fade_in: 2.0}
    start: none                    # a test bench: commands at once, as told at every start
    start: {at: "2026-11-22T21:00:00", late: go}     # with others: unicon_core/together
    start: {together: {robots: [left, right], me: left}}

In a simulator gates are shown and pass by themselves, and there is neither approach nor fade-in.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any, Literal

from unicon_core.bounds import POSE_SPEED, within
from unicon_core.errors import WorkflowError, alternatives
from unicon_core.together.meeting import Party, party_of
from unicon_core.together.moment import Moment, moment_of

MOMENTS = ("at", "together")
"""Keys that say at which moment the flow begins."""

LATE = ("fault", "go")
"""What becomes of a run that is late, or whose others never come."""

LONGEST_FADE = 10.0
"""Of `fade_in` in [s]."""


@dataclass(frozen=True)
class StartSettings:
    """How a robot begins to move.

    Attributes:
        gates: ask the gates before anything is sent; without them every start tells so.
        operator: wait for the operator's go.
        approach: how fast joints go to where the flow begins in [rad/s].
        fade_in: how long stiffness grows from zero, and then how long the flow's commands take to
            come in, in [s]; 0 for commands at once, without approach.
        at: the flow's first tick is at that moment of the wall clock, behind all of these.
        together: it is at a moment that robots agree on.
        late: `fault` where this one or another is late or never comes, `go` to begin without.
    """

    gates: bool = True
    operator: bool = True
    approach: float = 0.5
    fade_in: float = 1.0
    at: Moment | None = None
    together: Party | None = None
    late: Literal["fault", "go"] = "fault"

    @property
    def alone(self) -> bool:
        """Whether who is late begins alone."""
        return self.late == "go"

    @classmethod
    def from_value(cls, values: Any, folder: Path = Path()) -> StartSettings:
        """Return the settings of a workflow's `start`, of None the usual ones.

        Args:
            values: of the workflow.
            folder: from which its paths are reckoned.

        Raises:
            WorkflowError: a key or a value is wrong.
        """
        if values is None:
            return cls()
        if values == "none":
            return cls(gates=False, operator=False, fade_in=0.0)
        if not isinstance(values, dict):
            raise WorkflowError(f"start: {values!r} is neither a mapping nor none")
        known = [field.name for field in fields(cls)]
        for key, value in values.items():
            if key not in known:
                raise WorkflowError(f"start: unknown key {key!r}; {alternatives(key, known)}")
            if key in ("gates", "operator") and not isinstance(value, bool):
                raise WorkflowError(f"start: {key} is {value!r}; give true or false")
        if values.get("late", "fault") not in LATE:
            raise WorkflowError(f"start: late is {values['late']!r:.60}; give fault or go")
        given = dict(values)
        for key, read in (("at", moment_of), ("together", partial(party_of, folder=folder))):
            if given.get(key) is not None:
                given[key] = read(given[key])
        settings = cls(**given)
        if settings.at is not None and settings.together is not None:
            raise WorkflowError("start: at and together both say when; leave one out")
        within(settings.approach, "start: approach", "rad/s", POSE_SPEED)
        within(settings.fade_in, "start: fade_in", "s", LONGEST_FADE, above=False)
        return settings
