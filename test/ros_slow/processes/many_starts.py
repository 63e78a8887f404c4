"""unicon_node, started and stopped many times, with long runs measured before and after.

Usage: many_starts.py WORKFLOW OUT.npz TIMES.
"""

from __future__ import annotations

import ctypes
import gc
import sys
from typing import Any

import numpy as np
import psutil
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from unicon_core.runtime.statistics import TickStatistics
from unicon_ros.node import UniconNode

ROUNDS, LONG, SHORT = 5, 2.0, 0.1  # s of a run


def main() -> None:
    times = int(sys.argv[3])
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    overrides = [Parameter("workflow", value=sys.argv[1]), Parameter("autostart", value=False)]
    node = UniconNode("many", parameter_overrides=overrides)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    process = psutil.Process()
    plan = [LONG] * ROUNDS + [SHORT] * times + [LONG] * ROUNDS
    kept: list[np.ndarray] = []
    windows: list[tuple[int, int]] = []
    facts: list[tuple[int, int, int]] = []
    active = 0.0
    starts = 0

    def keep(statistics: TickStatistics) -> None:
        rows = statistics.kept()
        ends = [4 + i for i in range(len(statistics.names)) if i not in statistics.deferred]
        rows = np.column_stack([rows[:, 0], rows[:, 2], rows[:, ends].max(axis=1)])
        kept.append(rows)
        # The first ticks of a run find cold caches.
        windows.append((int(rows[0, 1]) + 500_000_000, int(rows[-1, 1])))

    def act() -> None:
        nonlocal active, starts
        if node.session is not None and node._running:
            active += SHORT
            if active >= plan[starts - 1]:
                assert node.runner is not None
                if plan[starts - 1] == LONG:
                    keep(node.runner.statistics)
                gc.collect()  # what nobody uses counts neither as garbage nor as the allocator's
                ctypes.CDLL(None).malloc_trim(0)
                memory = process.memory_info().rss
                facts.append((process.num_threads(), process.num_fds(), memory))
                node.session.controls.stop()
        elif starts == len(plan):
            node.trigger_shutdown()
        else:
            starts, active = starts + 1, 0.0
            ok, message = node._start()
            assert ok, message

    timer: Any = node.create_timer(SHORT, act)
    status = node.spin(executor)
    assert status == 0
    del timer
    before, after = facts[ROUNDS - 1], facts[-1]
    rows = np.concatenate(kept)
    np.savez(
        sys.argv[2],
        starts=starts,
        windows=windows,
        due=rows[:, 0],
        start=rows[:, 1],
        sent=rows[:, 2],
        threads_before=before[0],
        threads_after=after[0],
        files_before=before[1],
        files_after=after[1],
        rss_before=before[2],
        rss_after=after[2],
    )
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


main()
