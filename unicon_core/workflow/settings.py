"""Settings of a workflow that are used late: checked when the document is read, for run and check.

The runner takes `pacing` and `duration`, the bridge `map` and `ros`, long after hardware may have
been opened; what is wrong in them has to be told before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from unicon_core.bounds import DURATION
from unicon_core.errors import UniconError, WorkflowError
from unicon_core.pacing import Pacing
from unicon_core.resources import find_config
from unicon_core.workflow.document import WorkflowDocument

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


def check_settings(document: WorkflowDocument) -> None:
    """Check `duration`, `ros`, `map`, `pacing`, `start` and the form of `safety`.

    Raises:
        WorkflowError: one of them is wrong; with file and line.
    """
    duration = document.get("duration", (int, float))
    if duration is not None and not 0.0 < duration <= DURATION:
        raise document.error(
            f"duration: {duration!r} is not a time above 0 up to {DURATION:g} s; leave it out to "
            "run until the flow is done",
            "duration",
        )
    document.get("ros", bool)
    name = document.get("map", str)
    if name is not None:
        try:
            find_config("maps", name)
        except UniconError as error:
            raise document.error(f"map: {error}", "map") from error
    for key, check in (("pacing", pacing_of), ("start", start_of)):
        if document.values.get(key) is not None:  # else nothing is wrong, and nothing is imported
            check(document)
    safety_of(document)


def pacing_of(document: WorkflowDocument) -> Pacing:
    """Return how ticks are timed.

    Raises:
        WorkflowError: `pacing` is wrong; with file and line.
    """
    try:
        return Pacing.from_dict(document.get("pacing", dict, {}))
    except UniconError as error:
        raise document.error(str(error), "pacing") from error


def start_of(document: WorkflowDocument) -> StartSettings:
    """Return how the run begins.

    Raises:
        WorkflowError: `start` is wrong; with file and line.
    """
    from unicon_core.workflow.start import StartSettings

    try:
        return StartSettings.from_value(document.values.get("start"), document.path.parent)
    except UniconError as error:
        raise document.error(str(error), "start") from error


def safety_of(document: WorkflowDocument) -> Safety:
    """Return what is said under `safety:`; `safety: none` has no blocks.

    Raises:
        WorkflowError: it is neither a list, nor `{only: [...]}`, nor `none`, or an empty list.
    """
    value = document.values.get("safety")
    if value is None:
        return Safety(list(DEFAULT_SAFETY))
    if value == NO_SAFETY:
        return Safety([], exact=True)
    if isinstance(value, dict) and list(value) == [ONLY]:
        if isinstance(value[ONLY], list) and value[ONLY]:
            return Safety(value[ONLY], ("safety", ONLY), exact=True)
        value = value[ONLY]
    if not isinstance(value, list) or not value:
        default = ", ".join(map(str, DEFAULT_SAFETY))
        error: WorkflowError = document.error(
            f"safety: {value!r} is not a list of blocks; write [{default}], {{only: [{default}]}} "
            "for no others on a robot, or `none` to send every command as it is",
            "safety",
        )
        raise error
    return Safety(value)
