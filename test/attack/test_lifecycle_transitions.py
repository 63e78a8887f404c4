"""A transition that is unknown or not allowed is answered success=False, and the node lives on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

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
