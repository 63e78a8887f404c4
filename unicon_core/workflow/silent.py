"""A silent run: all is computed and nothing is sent, for `unicon run --dry` and preflight."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from unicon_core.platforms.platform import Platform
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES

if TYPE_CHECKING:
    from unicon_core.workflow.document import WorkflowDocument
    from unicon_core.workflow.parts import Parts


def withheld(platform: Platform, states: States) -> Callable[[], bool | None]:
    """Return what a silent run does in place of `send`.

    A robot gets nothing. A simulator gets limp joints, since its time goes on with `send` alone;
    the command states hold again afterwards what would have been sent.

    Args:
        platform: of the program.
        states: of the program.
    """
    if not platform.facts.simulated:
        return _nothing
    views = [(states[name], np.zeros_like(states[name])) for name in COMMAND_STATES]
    target, measured = states["joint_pos_target"], states["joint_pos"]

    def limp() -> bool | None:
        for view, kept in views:
            kept[...] = view
            view[...] = 0.0
        target[...] = measured
        try:
            return platform.send()
        finally:
            for view, kept in views:
                view[...] = kept

    return limp


def refuse_parts(parts: Parts | None, document: WorkflowDocument) -> None:
    """Refuse a divided workflow, whose parts command each other.

    Raises:
        WorkflowError: it is one.
    """
    if parts is not None:
        raise document.error(
            "parts: a divided workflow cannot be run silently (--dry, preflight): what one part "
            "publishes moves another; run it undivided",
            "parts",
        )


def _nothing() -> None:
    """Send nothing."""
