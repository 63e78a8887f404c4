"""Metered: a run that tells its figures to Prometheus, for `--metrics PORT`."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from unicon_core.flow import Block, Stage
from unicon_core.states import States
from unicon_core.workflow import Program
from unicon_ros.bridge.bindings import told_states
from unicon_ros.peripherals.peripheral import Peripheral, peripheral_states
from unicon_ros.view.feed import Fed

if TYPE_CHECKING:
    from unicon_core.runtime import Runner
    from unicon_ros.bridge import RosSession

NAME, SINK = "metrics", "unicon_ros.view.metrics:Metrics"

TOLD = 1.0
"""How often the process is told what is not in the states, in [s]."""

MOST = 40
"""Topics whose counts it is told."""


class Metered(Fed):
    """Lets a process of its own count the ticks and answer; whoever made it closes it.

    Args:
        port: on loopback; 0 for any that is free.
        session: of ROS, whose messages are counted, or None.
        warn: takes lines for the operator.

    Attributes:
        address: where the figures are, once it is attached.
    """

    def __init__(
        self, port: int, session: RosSession | None = None, warn: Callable[[str], None] = print
    ) -> None:
        super().__init__(warn)
        self._port, self._session = port, session

    def hook(self, program: Program) -> dict[Stage, list[Block]]:
        """Return the block that copies each tick."""
        return {Stage.OBSERVE: [Block(NAME, self._tick, endless=True)]}

    def attach(self, runner: Runner) -> None:
        """Start the process, before the first tick.

        Raises:
            UniconError: the port cannot be had.
        """
        written = sorted(told_states(runner.program))
        options: dict[str, Any] = {"port": self._port, "written": written, "sink": SINK}
        nobody: Any = SimpleNamespace(driving=0, paused=0)
        told = States(peripheral_states(NAME, {}))
        self._start(runner, NAME, told, options, nobody, nobody, stale=TOLD, period=TOLD)

    def _tick(self) -> None:
        self._fill()
        now = time.perf_counter_ns()
        if now >= self._due_ns and self._peripheral is not None:
            self._due_ns = now + round(TOLD * 1e9)
            self._tell(self._peripheral)
            self._peripheral()  # started again where it has died

    def _tell(self, peripheral: Peripheral) -> None:
        runner = self._runner
        if runner is not None:
            texts: dict[str, Any] = {"faults": [fault[:80] for fault in runner.faults[:9]]}
            if self._session is not None:
                texts["counts"] = _counts(self._session)
            peripheral.wish("texts", texts)


def _counts(session: RosSession) -> dict[str, list[tuple[str, int]]]:
    """Return what passed in each direction, by topic."""
    published: dict[str, int] = {}
    for out in session.outgoing:  # several of ours may share a topic, such as /tf
        published[out.topic] = published.get(out.topic, 0) + out.published
    received = {topic.topic: topic.received for topic in session.incoming}
    return {
        "published": list(published.items())[: MOST // 2],
        "received": list(received.items())[: MOST // 2],
    }
