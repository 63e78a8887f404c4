"""Runner and Program are guarded against other threads and against use after their end."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from unicon_base.errors import Fault, UniconError
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import Program, load_workflow

WORKFLOW = """\
robot: go2
platform: fake
rate: 200
flow: {hold: {}}
"""


@pytest.fixture
def workflow(tmp_path: Path) -> Callable[..., Program]:
    def load(**hooks: Any) -> Program:
        path = tmp_path / "threads.yaml"
        path.write_text(WORKFLOW)
        return load_workflow(path, **hooks)

    return load


class Counted:
    """A workflow whose sends are counted, and a runner that ticks it in a thread of its own."""

    def __init__(self, load: Callable[..., Program], between: Any = None) -> None:
        self.sends = 0
        self.after_close = 0
        self.closed = False

        def hook(workflow: Program) -> dict[Any, Any]:
            platform: Any = workflow.platform
            send, close = platform.send, platform.close

            def counted() -> Any:
                self.sends += 1
                self.after_close += self.closed
                return send()

            def closing() -> None:
                self.closed = True
                close()

            platform.send, platform.close = counted, closing
            return {}

        self.program = load(hooks=[hook])
        self.runner = Runner(self.program, RunOptions())
        self.reports: list[Any] = []
        self.thread = threading.Thread(target=lambda: self.reports.append(self.runner.run()))

    def start(self) -> Counted:
        self.thread.start()
        while self.sends < 20:
            time.sleep(0.005)
        return self


def test_close_of_another_thread_ends_the_run_and_waits(workflow: Callable[..., Program]) -> None:
    counted = Counted(workflow).start()
    counted.runner.close()
    assert counted.closed
    counted.thread.join(5.0)
    assert counted.after_close == 0
    assert counted.reports[0].faults == []
    assert counted.reports[0].ended == "stopped"


def test_workflow_close_of_another_thread_lets_nothing_more_out(
    workflow: Callable[..., Program],
) -> None:
    counted = Counted(workflow).start()
    counted.program.close()
    counted.thread.join(5.0)
    assert counted.after_close <= 1  # one that had passed the gate
    assert "the workflow is closed" in counted.reports[0].faults[0]


def test_reset_of_another_thread_is_refused(workflow: Callable[..., Program]) -> None:
    counted = Counted(workflow).start()
    try:
        with pytest.raises(
            UniconError, match=r"another thread ticks .* call_soon\(runner\.reset\)"
        ):
            counted.runner.reset()
        with pytest.raises(UniconError, match="another thread ticks"):
            counted.runner.tick(0)
        with pytest.raises(UniconError, match="is running"):
            counted.runner.run()
    finally:
        counted.runner.close()
        counted.thread.join(5.0)
    assert counted.reports[0].faults == []


def test_an_action_that_raises_is_a_fault(workflow: Callable[..., Program]) -> None:
    counted = Counted(workflow).start()

    def action() -> None:
        raise ZeroDivisionError("between two ticks")

    counted.runner.call_soon(action)
    counted.thread.join(5.0)
    assert counted.reports[0].faults[0].startswith("ZeroDivisionError: between two ticks")
    assert counted.closed
    assert counted.after_close == 0


def test_a_closed_workflow_is_not_run_again(workflow: Callable[..., Program]) -> None:
    loaded = workflow()
    runner = Runner(loaded, RunOptions(speed="max", duration=0.1))
    runner.run()
    with pytest.raises(UniconError, match="is closed; build it anew"):
        Runner(loaded)
    with pytest.raises(UniconError, match="this run has ended"):
        runner.run()
    with pytest.raises(Fault, match="the workflow is closed"):
        runner.tick(0)


def test_a_second_runner_of_an_open_workflow_sends_nothing_after_the_first(
    workflow: Callable[..., Program],
) -> None:
    loaded = workflow()
    first = Runner(loaded, RunOptions(speed="max", duration=0.1))
    second = Runner(loaded, RunOptions(speed="max", duration=0.1))
    assert first.run().ticks == 20
    report = second.run()
    assert report.ticks == 0
    assert "the workflow is closed" in report.faults[0]


def test_a_tick_that_hangs_does_not_hold_its_closer_for_ever(
    workflow: Callable[..., Program], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("unicon_core.runtime.runner.CLOSING", 0.2)
    counted = Counted(workflow).start()
    released = threading.Event()
    counted.runner.call_soon(lambda: released.wait(20.0))
    time.sleep(0.1)
    with pytest.raises(UniconError, match="did not end within"):
        counted.runner.close()
    sends = counted.sends
    released.set()
    counted.thread.join(5.0)
    assert counted.sends == sends
    assert counted.closed
