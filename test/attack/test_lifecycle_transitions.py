"""Transitions: a refused one is answered success=False, one that ends a run when that has ended."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from estop_platform import events
from lifecycle_msgs.srv import ChangeState
from robot_host import Caller, Host, wait_for, write_workflow

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]

CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = 1, 2, 3, 4
UNKNOWN = [(77, ""), (255, ""), (0, "nonsense"), (10, ""), (60, "")]
"""Transitions that nobody may ask for: no such id or label, or those of rclpy's own use."""


@pytest.fixture
def caller() -> Iterator[Caller]:
    made = Caller()
    yield made
    made.close()


def change(caller: Caller, number: int, label: str = "") -> bool:
    request = ChangeState.Request()
    request.transition.id, request.transition.label = number, label
    return bool(caller.call("change_state", request).success)


def test_an_idle_node_refuses_and_lives_on(caller: Caller, tmp_path: Path) -> None:
    path, log = write_workflow(tmp_path)
    host = Host("node", "--ros-args", "-p", f"workflow:={path}", "-p", "autostart:=false")
    try:
        for number, label in [*UNKNOWN, (CLEANUP, ""), (ACTIVATE, ""), (0, "deactivate")]:
            assert not change(caller, number, label), (number, label)
            assert caller.state() == "unconfigured"
        assert change(caller, CONFIGURE)
        for number, label in [*UNKNOWN, (CONFIGURE, ""), (DEACTIVATE, "")]:
            assert not change(caller, number, label), (number, label)
            assert caller.state() == "inactive"
        assert change(caller, ACTIVATE)
        wait_for(lambda: events(log, "send"), "commands")
        assert host.interrupt() == 0
        assert "transition refused in state 'unconfigured': " in host.said
        assert "Traceback" not in host.said
    finally:
        host.kill()


def test_an_active_node_refuses_and_ticks_on(caller: Caller, tmp_path: Path) -> None:
    path, log = write_workflow(tmp_path)
    host = Host("node", "--ros-args", "-p", f"workflow:={path}")
    try:
        wait_for(lambda: events(log, "send"), "commands")
        for number, label in [*UNKNOWN, (CONFIGURE, ""), (ACTIVATE, ""), (0, "cleanup")]:
            assert not change(caller, number, label), (number, label)
            assert caller.state() == "active"
        before = len(events(log, "send"))
        wait_for(lambda: len(events(log, "send")) > before + 5, "further commands")
        assert events(log, "close") == []
        assert change(caller, DEACTIVATE)
        caller.become("inactive")
        assert host.interrupt() == 0
    finally:
        host.kill()


WIND_DOWN = "wind_down: {{chain: [{{hold: {{duration: {seconds}}}}}]}}\n"


def winding_down(folder: Path, seconds: float) -> tuple[Path, Path]:
    """Write a workflow that winds down for so long."""
    path, log = write_workflow(folder)
    path.write_text(path.read_text() + WIND_DOWN.format(seconds=seconds))
    return path, log


def asked(caller: Caller, label: str) -> Any:
    """Ask for a transition; return its future."""
    request = ChangeState.Request()
    request.transition.label = label
    return caller.send("change_state", request)[1]


def test_deactivate_is_answered_once_nothing_is_commanded_any_more(
    caller: Caller, tmp_path: Path
) -> None:
    path, log = winding_down(tmp_path, 1.5)
    host = Host("node", "--ros-args", "-p", f"workflow:={path}", "-p", "exit_on_fault:=true")
    try:
        wait_for(lambda: events(log, "send"), "commands")
        first, second = asked(caller, "deactivate"), asked(caller, "deactivate")
        # Meanwhile the node is what it says, ticks on, and lets nothing be built or closed.
        for label in ("cleanup", "configure", "activate"):
            assert not change(caller, 0, label)
        before = len(events(log, "send"))
        wait_for(lambda: len(events(log, "send")) > before + 5, "further commands")
        assert caller.state() == "active"
        assert not first.done()
        assert events(log, "close") == []
        assert caller.wait(first).success
        after = time.monotonic_ns()
        assert caller.wait(second).success
        assert len(events(log, "close")) == 1
        assert max(events(log, "send") + events(log, "close")) < after
        assert caller.state() == "inactive"
        assert change(caller, 0, "cleanup")
        assert caller.state() == "unconfigured"
        assert host.interrupt() == 0
        assert "fault" not in host.said
    finally:
        host.kill()


@pytest.mark.parametrize("times", [2, pytest.param(20, marks=pytest.mark.slow)])
def test_a_lifecycle_manager_resets_and_starts_again_and_again(
    caller: Caller, tmp_path: Path, times: int
) -> None:
    path, log = winding_down(tmp_path, 0.5)
    host = Host("node", "--ros-args", "-p", f"workflow:={path}", "-p", "exit_on_fault:=true")
    try:
        for number in range(1, times + 1):
            wait_for(
                lambda: max([0, *events(log, "send")]) > max([0, *events(log, "open")]), "commands"
            )
            assert len(events(log, "open")) == number
            for label in ("deactivate", "cleanup", "configure", "activate"):  # RESET, STARTUP
                assert change(caller, 0, label), label
        assert change(caller, 0, "shutdown")
        assert host.end() == 0
        assert "fault" not in host.said
    finally:
        host.kill()


def test_an_emergency_stop_ends_the_wind_down_that_a_transition_waits_for(
    caller: Caller, tmp_path: Path
) -> None:
    path, log = winding_down(tmp_path, 4.0)
    host = Host("node", "--ros-args", "-p", f"workflow:={path}")
    try:
        wait_for(lambda: events(log, "send"), "commands")
        pending = asked(caller, "deactivate")
        assert not change(caller, 0, "cleanup")
        assert caller.call("estop").success
        pressed = time.monotonic_ns()
        assert caller.wait(pending).success
        assert caller.state() == "inactive"
        assert all(sent < pressed for sent in events(log, "send"))
        assert not caller.call("start").success
        assert host.interrupt() == 0
    finally:
        host.kill()
