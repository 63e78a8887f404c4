"""Replay: recorded ticks run again, compared bit-exact, fed to other workflows, or shown."""

from unicon_lab.replay.verify import Difference, Verdict, verify
from unicon_lab.replay.workflow import workflow_of

__all__ = ["Difference", "Verdict", "verify", "workflow_of"]
