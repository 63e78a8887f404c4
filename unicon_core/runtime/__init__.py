"""Runtime: pacing, statistics, trace and report of a running graph."""

from unicon_core.pacing import Pacing, WallClock, WarmUp, prepare_process
from unicon_core.runtime.phases import RunOptions
from unicon_core.runtime.report import Report
from unicon_core.runtime.runner import Runner
from unicon_core.runtime.statistics import TickStatistics, percentiles

__all__ = [
    "Pacing",
    "Report",
    "RunOptions",
    "Runner",
    "TickStatistics",
    "WallClock",
    "WarmUp",
    "percentiles",
    "prepare_process",
]
