"""Settings of a workflow: how ticks are timed, how a run begins, what is safe.

    start: {operator: false, approach: 0.3, fade_in: 2.0}
    start: none                    # a test bench: commands at once, as told at every start
    start: {at: "2026-11-22T21:00:00", late: go}     # with others: unicon_core/synchronised_start
    start: {together: {robots: [left, right], me: left}}

In a simulator gates are shown and pass by themselves, and there is neither approach nor fade-in.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

from unicon_base import AnyDict
from unicon_base.schema.marks import Made, Within, positive
from unicon_base.schema.types import Here
from unicon_core.bounds import POSE_SPEED
from unicon_core.pacing import Pacing
from unicon_core.synchronised_start.meeting import Party
from unicon_core.synchronised_start.rendezvous import Moment, moment_of
from unicon_core.workflow.document import WorkflowDocument, read_part

DEFAULT_SAFETY: tuple[Any, ...] = ("finite", "joint_limits")
"""What stands between the flow and `send` of a simulator where a workflow does not say."""

NO_SAFETY = "none"
ONLY = "only"


@dataclass(frozen=True)
class Safety:
    """What a workflow says of its safety blocks.

    Attributes:
        blocks: as they are written.
        path: where they stand in the document.
        exact: `none` or `only`: a robot gets no others.
    """

    blocks: list[Any]
    path: tuple[str, ...] = ("safety",)
    exact: bool = False

    @property
    def words(self) -> str:
        """How it is written, for messages."""
        return f"safety: {NO_SAFETY if not self.blocks else ONLY}" if self.exact else "safety"


MOMENTS = ("at", "together")
"""Keys that say at which moment the flow begins."""

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
    approach: Annotated[float, positive(POSE_SPEED, "rad/s")] = 0.5
    fade_in: Annotated[float, Within(0.0, LONGEST_FADE, "s")] = 1.0
    at: Annotated[Moment | None, Made(moment_of)] = None
    together: Party | None = None
    late: Literal["fault", "go"] = "fault"

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note two moments."""
        if found.get("at") is not None and found.get("together") is not None:
            here.note("at and together both say when; leave one out", "at")

    @property
    def alone(self) -> bool:
        """Whether who is late begins alone."""
        return self.late == "go"


Start = Literal["none"] | StartSettings
"""Of `start:`."""

NONE = StartSettings(gates=False, operator=False, fade_in=0.0)
"""Of `start: none`."""


def pacing_of(document: WorkflowDocument) -> Pacing:
    """Return how ticks are timed."""
    pacing: Pacing = read_part(document, Pacing, document.get("pacing", {}), "pacing")
    if pacing.every is not None and pacing.trigger == "deadline":
        text = "pacing.every counts the platform's data; set pacing.trigger: state, or leave it out"
        raise document.error(text, "pacing", "every")
    return pacing


def start_of(document: WorkflowDocument) -> StartSettings:
    """Return how the run begins."""
    said = read_part(document, Start, document.get("start", {}), "start")
    settings: StartSettings = NONE if said == "none" else said
    if settings.together is not None:
        settings = replace(settings, together=settings.together.within(document.path.parent))
    return settings


def safety_of(document: WorkflowDocument) -> Safety:
    """Return what is said under `safety:`; `safety: none` has no blocks."""
    value = document.values.get("safety")
    if value is None:
        return Safety(list(DEFAULT_SAFETY))
    if value == NO_SAFETY:
        return Safety([], exact=True)
    if isinstance(value, dict):
        return Safety(value[ONLY], ("safety", ONLY), exact=True)
    return Safety(value)
