"""Settings of a workflow that are used late: checked when the document is read, for run and check.

The runner takes `pacing` and `duration`, the bridge `map` and `ros`, long after hardware may have
been opened; what is wrong in them has to be told before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from unicon_core.bounds import DURATION
from unicon_core.errors import UniconError, WorkflowError
from unicon_core.resources import find_config
from unicon_core.workflow.start import StartSettings

if TYPE_CHECKING:
    from unicon_core.runtime.pacing import Pacing
    from unicon_core.workflow.document import WorkflowDocument

__all__ = ["DEFAULT_SAFETY", "check_settings", "pacing_of", "safety_of", "start_of"]

DEFAULT_SAFETY: tuple[Any, ...] = ("finite", "joint_limits")
"""What stands between the flow and `send` where a workflow does not say."""

NO_SAFETY = "none"


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
    pacing_of(document)
    start_of(document)
    safety_of(document)


def pacing_of(document: WorkflowDocument) -> Pacing:
    """Return how ticks are timed.

    Raises:
        WorkflowError: `pacing` is wrong; with file and line.
    """
    # Imported here: the runner's package imports this one.
    from unicon_core.runtime.pacing import Pacing

    try:
        return Pacing.from_dict(document.get("pacing", dict, {}))
    except UniconError as error:
        raise document.error(str(error), "pacing") from error


def start_of(document: WorkflowDocument) -> StartSettings:
    """Return how the run begins.

    Raises:
        WorkflowError: `start` is wrong; with file and line.
    """
    try:
        return StartSettings.from_value(document.values.get("start"))
    except UniconError as error:
        raise document.error(str(error), "start") from error


def safety_of(document: WorkflowDocument) -> list[Any]:
    """Return the blocks of `safety:` as they are written; `safety: none` has none.

    Raises:
        WorkflowError: it is neither a list nor `none`, or an empty list.
    """
    value = document.values.get("safety")
    if value is None:
        return list(DEFAULT_SAFETY)
    if value == NO_SAFETY:
        return []
    if not isinstance(value, list) or not value:
        default = ", ".join(map(str, DEFAULT_SAFETY))
        error: WorkflowError = document.error(
            f"safety: {value!r} is not a list of blocks; write [{default}], or `none` to send "
            "every command as it is",
            "safety",
        )
        raise error
    return value
