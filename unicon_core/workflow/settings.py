"""Settings of a workflow: how ticks are timed, how a run begins, what is safe."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from unicon_core.pacing import Pacing
from unicon_core.workflow.document import WorkflowDocument, read_part

if TYPE_CHECKING:
    from unicon_core.workflow.start import StartSettings

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


def pacing_of(document: WorkflowDocument) -> Pacing:
    """Return how ticks are timed."""
    pacing: Pacing = read_part(document, Pacing, document.get("pacing", {}), "pacing")
    return pacing


def start_of(document: WorkflowDocument) -> StartSettings:
    """Return how the run begins."""
    from unicon_core.workflow import start

    said = read_part(document, start.Start, document.get("start", {}), "start")
    if said == "none":
        return start.NONE
    settings: StartSettings = said
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
