"""View: a viewer beside a run, for `--view`: its hook, its process and what comes back."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from unicon_core.flow import Block, Stage
from unicon_core.states import States
from unicon_core.workflow import Program, WorkflowDocument
from unicon_ros.bridge.tuning import Tuning
from unicon_ros.controls import Controls
from unicon_ros.peripherals.peripheral import short
from unicon_ros.view.driver import Driver
from unicon_ros.view.feed import Fed
from unicon_ros.view.shown import DEAD_MAN, NAME, PAGE

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
