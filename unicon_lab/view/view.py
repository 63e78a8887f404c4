"""What a process of its own is given beside a run: a viewer, `--view`, and figures, `--metrics`."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from unicon_core.flow import Block, Stage
from unicon_core.states import States
from unicon_core.workflow import Program, WorkflowDocument
from unicon_lab.view.driver import Driver
from unicon_lab.view.feed import Fed
from unicon_lab.view.shown import DEAD_MAN, NAME, PAGE
from unicon_ros.bridge.bindings import told_states
from unicon_ros.bridge.services import Controls
from unicon_ros.parameters import Tuning
from unicon_ros.peripheral import Peripheral, peripheral_states, short

if TYPE_CHECKING:
    from unicon_core.runtime import Runner
    from unicon_ros.bridge import RosSession

TOLD = 0.2
"""How often the viewer is told texts that have changed, in [s]."""

LAST_WORDS = 0.2
"""For so long a viewer may show the last ones before it is closed, in [s]."""

LINES = 20
"""Of what the run has told, that a viewer is told."""

LONGEST = 3500
"""Bytes of the texts: they go through a pipe whole or not at all."""


class View(Fed):
    """A viewer of one run; whoever made it closes it.

    Args:
        options: of the sink: `sink`, `host`, `port`, `token`, `fps`.
        session: of ROS, whose services act on the same run; None without ROS.
        map: name of the message map.
        frame_prefix: of ROS frames.
        warn: takes lines for the operator.

    Attributes:
        address: where it is seen, once it is attached.
    """

    drives, label = True, "view"

    def __init__(
        self,
        options: Mapping[str, Any],
        session: RosSession | None = None,
        map: str | None = None,
        frame_prefix: str = "",
        warn: Callable[[str], None] = print,
    ) -> None:
        super().__init__(warn)
        self._options, self._session, self._map = dict(options), session, map or "default"
        self._prefix = frame_prefix
        self.controls = session.controls if session is not None else Controls(time.sleep)
        self._tuning = Tuning()
        self._told = States(PAGE)
        self._lines: list[str] = []
        self._texts: dict[str, Any] = {}
        self._reader: object = None
        self._driver: Driver | None = None

    def declare(self, document: WorkflowDocument) -> None:
        """Let the workflow have the states that a viewer's parameters change."""
        self._tuning.declare(document)

    def hook(self, program: Program) -> dict[Stage, list[Block]]:
        """Return the blocks of the viewer. Place it after the hook that receives commands."""
        press: Callable[[], object] = bool
        if self._session is not None and self._session.estop is not None:
            press = self._session.estop.press
        self._driver = Driver(program, self._told, self.controls, self._tuning, press)
        stages = {stage: list(blocks) for stage, blocks in self._tuning.hook(program).items()}
        for stage, blocks in self._driver.blocks().items():
            stages[stage] = blocks + stages.get(stage, [])
        stages[Stage.OBSERVE] = [Block(NAME, self._show, endless=True), *stages[Stage.OBSERVE]]
        return stages

    def attach(self, runner: Runner) -> None:
        """Start the viewer's process, before the first tick.

        Raises:
            UniconError: it cannot begin.
        """
        driver, program = self._driver, runner.program
        assert driver is not None
        if self.controls.runner is None:
            self.controls.runner = runner
        peripheral = self._start(
            *(runner, NAME, self._told, self._options, driver, self.controls),
            stale=DEAD_MAN,
            period=driver.interval,
            map=self._map,
            frame_prefix=self._prefix,
        )
        driver.attach(peripheral, runner)
        self.controls.others += [driver.look, self._show]
        tell = runner.options.warn

        def heard(line: str) -> None:
            self._lines = [*self._lines, line][-LINES:]
            tell(line)

        program.warn = heard

    def _show(self) -> None:
        self._fill()
        now = time.perf_counter_ns()
        if now >= self._due_ns and self._runner is not None:
            self._due_ns = now + round(TOLD * 1e9)
            self._tell(self._runner)

    def _tell(self, runner: Runner) -> bool:
        if self._peripheral is None:
            return False
        texts = {
            "waits_for": runner.waits_for,
            "faults": runner.faults,
            "notes": self._lines,
            "parameters": self._tuning.values(),
        }
        process = self._peripheral.process  # one that was started again knows nothing
        if process is self._reader and texts == self._texts:
            return False
        if self._peripheral.wish("texts", {name: _cut(each) for name, each in texts.items()}):
            self._texts, self._reader = {**texts, "faults": list(runner.faults)}, process
        return True

    def close(self) -> None:
        """Tell the last words, and end the viewer's process; once the run has ended.

        Safe to call twice.
        """
        if self._runner is not None and self._tell(self._runner):
            time.sleep(LAST_WORDS)
        super().close()


def _cut(value: Any) -> Any:
    if isinstance(value, dict):
        return value
    if isinstance(value, str):
        return short(value, LONGEST // 4)
    lines: list[str] = []
    for line in reversed(value):
        if len(json.dumps([line, *lines])) > LONGEST // 4:
            break
        lines.insert(0, line)
    return lines


METRICS, SINK = "metrics", "unicon_lab.view.metrics:Metrics"

FIGURES_TOLD = 1.0
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

    label = METRICS

    def __init__(
        self, port: int, session: RosSession | None = None, warn: Callable[[str], None] = print
    ) -> None:
        super().__init__(warn)
        self._port, self._session = port, session

    def hook(self, program: Program) -> dict[Stage, list[Block]]:
        """Return the block that copies each tick."""
        return {Stage.OBSERVE: [Block(METRICS, self._tick, endless=True)]}

    def attach(self, runner: Runner) -> None:
        """Start the process, before the first tick.

        Raises:
            UniconError: the port cannot be had.
        """
        written = sorted(told_states(runner.program))
        options: dict[str, Any] = {"port": self._port, "written": written, "sink": SINK}
        nobody: Any = SimpleNamespace(driving=0, paused=0)
        told = States(peripheral_states(METRICS, {}))
        often = FIGURES_TOLD
        self._start(runner, METRICS, told, options, nobody, nobody, stale=often, period=often)

    def _tick(self) -> None:
        self._fill()
        now = time.perf_counter_ns()
        if now >= self._due_ns and self._peripheral is not None:
            self._due_ns = now + round(FIGURES_TOLD * 1e9)
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
