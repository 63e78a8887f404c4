"""An emergency stop holds for the processes to come, and status 3 for their autostart."""

from __future__ import annotations

import json
import os
import signal
import stat
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from estop_platform import events
from robot_host import Caller, Host, wait_for, write_workflow

from unicon_ros.cli.main import main
from unicon_ros.latches import ESTOP, FAULT, Latch, boot_id, latches

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]


@pytest.fixture
def start(domain: None) -> Iterator[Callable[..., Host]]:
    """Starts unicon_node, or `unicon run`, on a workflow."""
    hosts: list[Host] = []

    def make(path: Path, *parameters: str, kind: str = "node") -> Host:
        given = (f"workflow:={path}", *parameters)
        arguments = ["--ros-args", *(part for text in given for part in ("-p", text))]
        if kind == "run":
            arguments = ["run", str(path), "--ros", "--quiet", *parameters]
        hosts.append(Host(kind, *arguments))
        return hosts[-1]

    yield make
    for host in hosts:
        host.kill()


@pytest.fixture
def callers(domain: None) -> Iterator[Callable[[], Caller]]:
    """Makes clients that have not known the processes before."""
    made: list[Caller] = []

    def make() -> Caller:
        made.append(Caller())
        return made[-1]

    yield make
    for each in made:
        each.close()


def ticking(log: Path, count: int = 10) -> None:
    wait_for(lambda: len(events(log, "send")) > count, "commands")


def transition(caller: Caller, label: str) -> bool:
    from lifecycle_msgs.srv import ChangeState

    request = ChangeState.Request()
    request.transition.label = label
    return bool(caller.call("change_state", request).success)


def test_nothing_gets_round_an_estop_but_its_clearing(
    start: Any, callers: Any, tmp_path: Path, latch_files: Path
) -> None:
    path, log = write_workflow(tmp_path)
    host = start(path)
    ticking(log)
    assert callers().call("estop").success
    host.process.send_signal(signal.SIGKILL)
    host.end()
    sent = len(events(log, "send"))

    again = start(path, "exit_on_fault:=true")  # a respawn; it stays to be cleared
    wait_for(lambda: "not started by itself: the emergency stop was pressed" in again.said, "why")
    caller = callers()
    assert "~/clear_estop" in caller.call("start").message
    assert transition(caller, "configure")
    assert not transition(caller, "activate")
    assert again.interrupt() == 0
    assert len(events(log, "send")) == sent

    last = start(path)
    wait_for(lambda: "not started by itself" in last.said, "why")
    caller = callers()
    assert caller.call("clear_estop").success
    assert list(latch_files.iterdir()) == []
    assert caller.call("start").success
    ticking(log, sent + 10)
    assert last.interrupt() == 0


@pytest.mark.slow
def test_status_3_is_not_started_again_by_itself(start: Any, callers: Any, tmp_path: Path) -> None:
    path, log = write_workflow(tmp_path, fails="recv")
    host = start(path, "exit_on_fault:=true")
    assert host.end() == 3
    sent = len(events(log, "send"))
    path, log = write_workflow(tmp_path)
    again = start(path, "exit_on_fault:=true")
    wait_for(lambda: "the process before ended by a fault" in again.said, "why")
    time.sleep(0.3)
    assert len(events(log, "send")) == sent
    assert callers().call("start").success  # somebody has looked
    ticking(log, sent + 10)
    assert again.interrupt() == 0
    last = start(path, "exit_on_fault:=true")
    ticking(log, len(events(log, "send")) + 20)
    assert last.interrupt() == 0


ROBOT = "{robot: go2, platform: fake_robot, rate: 100, start: none, flow: hold, pacing: {hang: 20}}"


def test_a_run_on_a_robot_is_refused_while_it_is_latched(
    start: Any, callers: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT)
    host = start(path, kind="run")
    assert callers().call("estop").success
    assert host.end() == 3
    run = ["run", str(path), "--ros", "--quiet"]
    assert main(run) == 1
    said = capsys.readouterr().err
    assert "the emergency stop of /unicon is latched (pressed 2" in said
    assert "unicon latches --clear /unicon" in said
    for more in (["--dry"], ["--set", "platform=fake"]):  # nothing moves but in a simulation
        assert main([*run, *more, "--duration", "0.2"]) == 0
    assert main(["preflight", str(path), "--seconds", "1", "--ros"]) == 1
    assert "/unicon/estop: latched since 2" in capsys.readouterr().out
    node = start(path)
    wait_for(lambda: "not started by itself" in node.said, "why")
    assert node.interrupt() == 0


def test_a_latch_that_cannot_be_kept_is_told(
    start: Any, callers: Any, tmp_path: Path, latch_files: Path
) -> None:
    latch_files.rmdir()
    latch_files.write_text("no folder")
    path, _ = write_workflow(tmp_path)
    host = start(path, "autostart:=false")
    answer = callers().call("estop")
    assert answer.success
    assert answer.message.endswith("; for this process only (File exists)")
    assert host.interrupt() == 0
    assert "the latch of /unicon lasts for this process only" in host.said


def latch(kind: str = ESTOP, node: str = "/robot1/unicon", domain: int = 3) -> Latch:
    return Latch(node, domain, kind, pytest.fail)


def test_a_latch_is_of_one_node_one_domain_and_one_kind() -> None:
    one = latch()
    one.set("pressed")
    assert one.kept()
    found = one.read()
    assert found is not None
    assert (found.node, found.domain, found.kind) == ("/robot1/unicon", 3, ESTOP)
    assert (found.reason, found.boot) == ("pressed", boot_id())
    for other in (latch(FAULT), latch(node="/robot2/unicon"), latch(domain=4), latch(node="/u")):
        assert other.read() is None
    assert [each for _, each in latches()] == [found]
    assert one.release() == ""
    assert latches() == []
    one.close()


def test_the_next_boot_lets_go_and_what_cannot_be_read_does_not(tmp_path: Path) -> None:
    one = latch()
    one.set("pressed")
    assert one.kept()
    assert one.path is not None
    told = json.loads(one.path.read_text())
    for content, latched in (
        (json.dumps(told | {"boot": "another"}), False),
        (json.dumps(told | {"boot": 5}), True),
        (json.dumps(told | {"more": "keys"}), True),
        ("", True),
        ("[]", True),
        ("{}" if boot_id() else "", not boot_id()),
        ("\x00garbage", True),
    ):
        one.path.write_text(content)
        assert (one.read() is not None) is latched, content
    one.path.write_bytes(b"\xff\xfe")
    found = one.read()
    assert found is not None
    assert "cannot be read" in found.reason
    assert found.node == "/robot1/unicon"
    assert one.release() == ""


def test_a_latch_that_cannot_be_removed_stays(tmp_path: Path, latch_files: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may remove everything")
    one = latch()
    one.set("pressed")
    assert one.kept()
    latch_files.chmod(stat.S_IRUSR | stat.S_IXUSR)
    try:
        assert "remove it by hand" in one.release()
    finally:
        latch_files.chmod(stat.S_IRWXU)
    assert one.read() is not None


def test_the_command_lists_and_clears(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["latches"]) == 0
    assert "nothing is latched in " in capsys.readouterr().out
    for domain in (3, 4):
        one = latch(domain=domain)
        one.set("pressed")
        assert one.kept()
    assert main(["latches"]) == 0
    assert capsys.readouterr().out.count("/robot1/unicon") == 2
    assert main(["latches", "--clear", "/unicon"]) == 1
    assert "no latch of '/unicon' in " in capsys.readouterr().err
    assert main(["latches", "--clear", "/robot1/unicon", "--domain", "4"]) == 0
    assert "/robot1/unicon (domain 4): estop cleared" in capsys.readouterr().out
    assert [each.domain for _, each in latches()] == [3]
    assert main(["latches", "--domain", "3"]) == 1
