"""Runtime: pacing, statistics, trace and report of a running graph."""

from unicon_core.runtime.options import RunOptions
from unicon_core.runtime.pacing import Pacing, WallClock, WarmUp, prepare_process
from unicon_core.runtime.report import Monitor, Report
from unicon_core.runtime.runner import Runner
from unicon_core.runtime.statistics import TickStatistics, percentiles

__all__ = [
    "Monitor",
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
