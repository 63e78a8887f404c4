"""Metrics of a run, `--metrics`, from a process of their own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from unicon_base import AnyDict, TextSink
from unicon_lab.view.view import Fed
from unicon_ros.bridge.bindings import told_states
from unicon_ros.peripheral import Peripheral

if TYPE_CHECKING:
    from unicon_core.runtime import Runner
    from unicon_ros.bridge import RosSession

METRICS, SINK = "metrics", "unicon_lab.view.metrics:Metrics"

MOST = 40
"""Topics whose counts are sent."""


class Metered(Fed):
    """Lets a process of its own count the ticks and answer; who made it closes it.

    Args:
        port: on loopback; 0 for any that is free.
        session: of ROS, whose messages are counted, or None.
        warn: takes lines for the operator.

    Attributes:
        address: where the metrics are, once it is attached.
    """

    label, interval = METRICS, 1.0

    def __init__(
        self, port: int, session: RosSession | None = None, warn: TextSink = print
    ) -> None:
        super().__init__(warn, session)
        self._port = port

    def attach(self, runner: Runner) -> None:
        """Start the process, before the first tick.

        Raises:
            UniconError: the port cannot be had.
        """
        written = sorted(told_states(runner.program))
        self._start(runner, {"port": self._port, "written": written, "sink": SINK})

    def _tell(self, peripheral: Peripheral) -> bool:
        texts: AnyDict = {"faults": [fault[:80] for fault in self._runner.faults[:9]]}
        if self._session is not None:
            texts["counts"] = _counts(self._session)
        peripheral.wish("texts", texts)
        return super()._tell(peripheral)


def _counts(session: RosSession) -> dict[str, list[tuple[str, int]]]:
    """Return what passed in each direction, by topic."""
    published: dict[str, int] = {}
    for out in session.outgoing:  # several of ours may share a topic, such as /tf
        published[out.topic] = published.get(out.topic, 0) + out.published
    received = {topic.topic: topic.received for topic in session.incoming}
    both = {"published": published, "received": received}
    return {name: list(counts.items())[: MOST // 2] for name, counts in both.items()}
