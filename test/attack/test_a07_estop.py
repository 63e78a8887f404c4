"""~/estop acts within a tick however long ticks are, latches, and is never lost."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

pytest.importorskip("rclpy")

from estop_platform import events
from robot_host import Caller, Host, wait_for, write_workflow

from unicon_base.errors import Fault
from unicon_core.latches import ESTOP, Latch
from unicon_ros.bridge.estop import PRESSED, EmergencyStop

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]

MS = 1_000_000
TICKS = {"idle": 0.0, "most of the period": 0.017, "longer than the period": 0.025}
FAULT = "emergency stop by the service ~/estop"
Start = Callable[..., Host]


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts `run` or `node` on a workflow."""
    hosts: list[Host] = []

    def make(kind: str, path: Path, *parameters: str) -> Host:
        if kind == "run":
            arguments = [str(path), "--ros", "--quiet"]
        else:
            given = (f"workflow:={path}", *parameters)
            arguments = ["--ros-args", *(part for text in given for part in ("-p", text))]
        hosts.append(Host(kind, *(["run"] if kind == "run" else []), *arguments))
        return hosts[-1]

    yield make
    for host in hosts:
        host.kill()


@pytest.fixture
def caller() -> Iterator[Caller]:
    made = Caller()
    yield made
    made.close()


def ticking(log: Path, count: int = 10) -> None:
    wait_for(lambda: len(events(log, "send")) > count, "commands")


@pytest.mark.parametrize("recv_s", TICKS.values(), ids=TICKS)
@pytest.mark.parametrize("kind", ["run", pytest.param("node", marks=pytest.mark.slow)])
def test_no_command_leaves_once_the_tick_of_the_press_is_over(
    start: Start,
    caller: Caller,
    tmp_path: Path,
    kind: str,
    recv_s: float,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tick = max(20.0, 1e3 * recv_s)
    seen = []
    for attempt in range(3):  # a machine that is busy otherwise may deliver a request late
        folder = tmp_path / str(attempt)
        folder.mkdir()
        monkeypatch.setenv("UNICON_LATCHES", str(folder))  # or the next one would not start
        path, log = write_workflow(folder, recv_s=recv_s)
        host = start(kind, path)
        caller.find("estop")
        ticking(log)
        pressed, future = caller.send("estop")
        answer = caller.wait(future)
        assert answer is not None
        assert answer.success
        if kind == "run":
            assert host.end() == 3
        else:
            caller.become("inactive")
            assert host.interrupt() == 0
        assert FAULT in host.said
        # One command may be on its way, and 20 ms are for two processes that talk.
        after = sum(stamp > pressed for stamp in events(log, "send"))
        damped = (events(log, "damp") + events(log, "close"))[0]
        seen.append((after, (damped - pressed) / MS))
        if after <= 1 and seen[-1][1] < 2 * tick + 20:
            break
    else:
        pytest.fail(f"commands after the press, and ms until the damping: {seen}")
    assert "latched until ~/clear_estop" in answer.message


def test_a_paused_simulator_hears_it_too(start: Start, caller: Caller, tmp_path: Path) -> None:
    path, log = write_workflow(tmp_path)
    host = start("run", path)
    ticking(log)
    assert caller.call("pause").success
    sent = len(events(log, "send"))
    pressed, future = caller.send("estop")
    assert caller.wait(future).success
    assert host.end() == 3
    assert FAULT in host.said
    assert len(events(log, "send")) == sent
    assert (events(log, "close")[0] - pressed) / MS < 1000


def test_a_press_is_answered_once_each_by_a_run_that_ends(
    start: Start, caller: Caller, tmp_path: Path
) -> None:
    path, log = write_workflow(tmp_path, recv_s=0.025)
    host = start("run", path)
    caller.find("estop")
    ticking(log)
    futures = [caller.send("estop")[1] for _ in range(5)]
    answers = [caller.wait(future) for future in futures]
    assert [answer is not None and answer.success for answer in answers] == [True] * 5
    assert host.end() == 3
    assert host.said.count(FAULT) == 1


def test_it_latches_until_it_is_cleared(start: Start, caller: Caller, tmp_path: Path) -> None:
    path, log = write_workflow(tmp_path)
    host = start("node", path)
    ticking(log)
    assert caller.call("estop").success
    caller.become("inactive")
    sent = len(events(log, "send"))
    answer = caller.call("start")
    assert not answer.success
    assert "call ~/clear_estop when it is safe" in answer.message
    assert not transition(caller, "activate")
    assert caller.state() == "inactive"
    time.sleep(0.6)
    assert caller.call("clear_estop").success
    assert len(events(log, "send")) == sent
    assert caller.call("start").success
    ticking(log, sent + 10)
    assert host.interrupt() == 0


@pytest.mark.parametrize("state", ["unconfigured", "inactive"])
def test_a_press_while_nothing_runs_is_not_lost(
    start: Start, caller: Caller, tmp_path: Path, state: str
) -> None:
    path, log = write_workflow(tmp_path)
    host = start("node", path, "autostart:=false")
    if state == "inactive":
        assert transition(caller, "configure")
    answer = caller.call("estop")
    assert answer.success
    assert answer.message == "nothing runs; latched until ~/clear_estop"
    answer = caller.call("start")
    assert not answer.success
    assert "~/clear_estop" in answer.message
    assert not transition(caller, "activate")
    assert events(log, "send") == []
    time.sleep(0.6)
    assert caller.call("clear_estop").success
    assert caller.call("start").success
    ticking(log)
    assert host.interrupt() == 0


@pytest.mark.parametrize("kind", ["node", pytest.param("run", marks=pytest.mark.slow)])
def test_a_press_while_it_builds_holds_the_start_off(
    start: Start, caller: Caller, tmp_path: Path, kind: str
) -> None:
    path, log = write_workflow(tmp_path, build_s=3.0)
    host = start(kind, path)
    caller.assume_seen("estop")
    _, future = caller.send("estop")
    wait_for(lambda: events(log, "open"), "the build")
    answer = caller.wait(future)
    assert answer is not None
    assert answer.success
    if kind == "run":
        assert host.end() == 3
        assert FAULT in host.said
    else:
        caller.become("inactive")
        assert not caller.call("start").success
        assert host.interrupt() == 0
    assert events(log, "send") == []


def test_nothing_clears_it_right_after_the_press_or_without_one(
    start: Start, caller: Caller, tmp_path: Path
) -> None:
    path, _ = write_workflow(tmp_path)
    host = start("node", path, "autostart:=false")
    assert caller.call("clear_estop").message == "the emergency stop was not latched"
    caller.find("clear_estop")
    for _ in range(5):  # a machine that is busy otherwise may deliver the second one late
        _, pressed = caller.send("estop")
        _, cleared = caller.send("clear_estop")
        assert caller.wait(pressed).success
        answer = caller.wait(cleared)
        if not answer.success:
            break
    assert not answer.success
    assert "call ~/clear_estop again" in answer.message
    assert not caller.call("start").success
    assert host.interrupt() == 0


class NoNode:
    """A node whose services nobody can call, and whose queue holds what `takes` says."""

    def __init__(self, *takes: Any) -> None:
        self.takes = list(takes)
        self.sent: list[Any] = []

    def create_service(self, kind: Any, name: str, callback: Any) -> Any:
        def take(request: Any) -> tuple[Any, Any]:
            taken = self.takes.pop(0) if self.takes else None
            if isinstance(taken, Exception):
                raise taken
            return None, taken

        handle = MagicMock()
        handle.service_take_request = take
        service = SimpleNamespace(handle=handle, srv_type=kind)
        service.send_response = lambda response, header: self.sent.append(header)
        return service


def test_a_request_that_cannot_be_read_does_not_make_it_deaf() -> None:
    told: list[str] = []
    node = NoNode(RuntimeError("garbage"), RuntimeError("garbage"), "a press")
    estop = EmergencyStop(node, lambda: True, told.append)
    estop.look()
    estop.look()
    assert not estop.latched
    with pytest.raises(Fault, match=FAULT):
        estop.look()
    assert len(told) == 1
    assert "RuntimeError: garbage" in told[0]


def test_a_press_between_two_ticks_does_not_wait_for_the_next_one_to_end() -> None:
    estop = EmergencyStop(NoNode("a press"), lambda: True)
    between = estop.before_send().warm_up
    assert between is not None
    with pytest.raises(Fault, match=FAULT):
        between()


def test_a_press_is_answered_after_the_damping_and_only_once() -> None:
    node = NoNode("first", None, "second")
    estop = EmergencyStop(node, lambda: True)
    with pytest.raises(Fault):
        estop.look()
    assert node.sent == []
    close = estop.before_send().close
    assert close is not None
    close()
    close()
    assert node.sent == ["first", "second"]


def latched_node() -> Any:
    node: Any = NoNode()
    node.get_fully_qualified_name = lambda: "/unicon"
    node.context = SimpleNamespace(get_domain_id=lambda: 0)
    return node


def test_a_press_in_the_slack_has_left_its_latches_when_it_is_answered(
    latch_files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    estop = EmergencyStop(latched_node(), lambda: True)
    estop.keep([Latch("", 0, ESTOP, print, "fake/go2")])
    monkeypatch.setattr("unicon_core.latches.boot_id", lambda: time.sleep(0.01) or "")
    monkeypatch.setattr("unicon_ros.bridge.estop.SLACK_S", 10.0)  # a busy machine takes longer
    assert estop.press() == (True, PRESSED)
    assert len(list(latch_files.glob("*.json"))) == 2


def test_a_press_in_the_slack_waits_for_no_medium_that_hangs(
    latch_files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    estop, goes_on = EmergencyStop(latched_node(), lambda: True), threading.Event()
    estop.keep()
    monkeypatch.setattr("unicon_core.latches.boot_id", lambda: goes_on.wait(60) and "")
    pressed, said = estop.press()
    assert pressed
    assert estop.latched
    assert said.endswith("; for this process only (the medium took nothing for 0.05 s)")
    assert list(latch_files.glob("*.json")) == []
    goes_on.set()


def test_diagnostics_tell_the_latch(start: Start, caller: Caller, tmp_path: Path) -> None:
    from diagnostic_msgs.msg import DiagnosticArray

    path, _ = write_workflow(tmp_path)
    host = start("node", path, "autostart:=false")
    heard: list[Any] = []
    caller.node.create_subscription(DiagnosticArray, "/diagnostics", heard.append, 10)
    assert caller.call("estop").success

    def told() -> bool:
        caller.state()
        values = {v.key: v.value for array in heard for s in array.status for v in s.values}
        return values.get("estop") == "latched"

    wait_for(told, "the latch in /diagnostics")
    assert heard[-1].status[0].level == b"\x02"
    assert heard[-1].status[0].message.endswith("latched until ~/clear_estop")
    assert host.interrupt() == 0


def transition(caller: Caller, label: str) -> bool:
    from lifecycle_msgs.srv import ChangeState

    request = ChangeState.Request()
    request.transition.label = label
    return bool(caller.call("change_state", request).success)
