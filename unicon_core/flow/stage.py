"""Stage: the place of a block in a tick, for hooks, checks and whoever reads a graph.

recv → estimate → command → input → flow → tune → safety → send → observe
"""

from __future__ import annotations

from enum import Enum


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
