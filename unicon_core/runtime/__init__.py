"""Runtime: pacing, statistics, trace and report of a running graph."""

from unicon_core.runtime.pacing import DryRun, Pacing, WallClock, prepare_process
from unicon_core.runtime.report import Monitor, Report
from unicon_core.runtime.runner import Runner, RunOptions, run
from unicon_core.runtime.statistics import TickStatistics, percentiles

__all__ = [
    "DryRun",
    "Monitor",
    "Pacing",
    "Report",
    "RunOptions",
    "Runner",
    "TickStatistics",
    "WallClock",
    "percentiles",
    "prepare_process",
    "run",
]
