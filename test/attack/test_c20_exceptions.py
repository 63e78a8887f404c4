"""Whatever is raised in a tick is a fault: damped, status 3, with reason, report and trace."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from runs import Run

REASONS = {
    "value": "ValueError: a value (recording_robot.py:",
    "memory": "MemoryError (recording_robot.py:",
    "os": "OSError: [Errno 5] Input/output error",
    "recursion": "RecursionError: maximum recursion depth exceeded",
    "exit": "SystemExit: 7",
    "interrupt": "KeyboardInterrupt",
    "shape": "ValueError: operands could not be broadcast",
    "fault": "the robot says so",
}


# What derives from Exception goes one way: of those, one is quick.
QUICK = {"value", "recursion", "exit", "interrupt", "fault"}
FAULTS = [
    fault if fault in QUICK else pytest.param(fault, marks=pytest.mark.slow) for fault in REASONS
]


@pytest.mark.parametrize("where", ["recv", pytest.param("send", marks=pytest.mark.slow)])
@pytest.mark.parametrize("fault", FAULTS)
def test_an_exception_is_a_fault_with_its_reason(tmp_path: Path, fault: str, where: str) -> None:
    trace = tmp_path / "trace.json"
    arguments = ["--quiet", "--trace", str(trace)]
    run = Run(tmp_path, f"fault: {fault}, where: {where}", arguments=arguments).start()
    status, out, err = run.wait()
    assert status == 3
    assert run.sent() == 5
    assert run.closed
    assert run.report["ended"] == "fault"
    assert run.report["faults"][0].startswith(REASONS[fault])
    assert REASONS[fault] in out
    assert "Traceback" not in err  # it is in the report
    assert ("recording_robot.py" in run.report["traceback"]) is (fault != "fault")
    spans = json.loads(trace.read_text())["traceEvents"]
    assert sum(span["name"] == "tick" for span in spans) == 5


def test_a_mistake_in_closing_does_not_hide_the_fault(tmp_path: Path) -> None:
    flow = "zip: [hold, {call: {function: 'tripping:trip'}}]"
    (tmp_path / "tripping.py").write_text(
        "from unicon_base.errors import Fault\n"
        "from unicon_core.flow import Reads, Tick\n"
        "def trip(tick: Reads) -> Tick:\n"
        "    def step() -> bool:\n"
        "        if tick == 5:\n"
        "            raise Fault('tripped on purpose')\n"
        "        return False\n"
        "    return step\n"
    )
    run = Run(tmp_path, "fault: value, where: close", flow=flow).start()
    status, _, _ = run.wait()
    assert status == 3
    assert run.report["faults"][0] == "tripped on purpose"
    assert run.report["faults"][1].startswith("closing: ValueError: a value")


def test_without_a_report_the_traceback_is_told(tmp_path: Path) -> None:
    run = Run(tmp_path, "fault: value")
    run.start(report=False)
    status, out, err = run.wait()
    assert status == 3
    assert "ValueError: a value" in out
    assert "Traceback" in err
    assert "recording_robot.py" in err


def test_an_error_that_nobody_foresaw_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "wrong.py").write_text(
        "from unicon_core.flow import Reads, Tick\n"
        "def wrong(tick: Reads) -> Tick:\n"
        "    raise RuntimeError('while building')\n"
    )
    run = Run(tmp_path, flow="zip: [hold, {call: {function: 'wrong:wrong'}}]").start()
    status, _, err = run.wait()
    assert status == 1
    assert err.count("\n") == 1
    assert "RuntimeError: while building (wrong.py:3)" in err
    assert run.closed
