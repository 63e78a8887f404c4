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

from unicon_base.errors import EmergencyStopPressed, Fault, PlatformError
from unicon_core import Program
from unicon_core.flow import Block, Zip
from unicon_core.latches import ESTOP, FAULT, Latch, boot_id, latches, of_robot, robot_key
from unicon_core.robots import load_robot
from unicon_core.run_program import run
from unicon_core.runtime import Report
from unicon_core.workflow.uses import block
from unicon_ros.cli.main import main

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
    again.says("not started by itself: the emergency stop was pressed")
    caller = callers()
    assert "~/clear_estop" in caller.call("start").message
    assert transition(caller, "configure")
    assert not transition(caller, "activate")
    assert again.interrupt() == 0
    assert len(events(log, "send")) == sent

    last = start(path)
    last.says("not started by itself")
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
    again.says("the process before ended by a fault")
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
    run = ["run", str(path), "--quiet", "--duration", "0.2", "--yes"]
    for way in (["--ros"], ["--no-ros"], ["--ros", "--namespace", "elsewhere"]):
        assert main([*run, *way]) == 1
        said = capsys.readouterr().err
        assert "the emergency stop of robot fake_robot/go2 is latched (since 2" in said
        assert "unicon latches --clear fake_robot/go2" in said
    for more in (["--dry"], ["--set", "platform=fake"], ["--set", "robot=go1"]):
        assert main([*run, *more]) == 0  # in a simulation, or another robot
    for way in ("--ros", "--no-ros"):
        assert main(["preflight", str(path), "--seconds", "1", way]) == 1
        said = capsys.readouterr().out
        assert "robot fake_robot/go2: latched: emergency stop by the service ~/estop (2" in said
        assert ("/unicon/estop: latched since 2" in said) == (way == "--ros")
    node = start(path)
    node.says("not started by itself")
    assert node.interrupt() == 0
    assert main(["latches", "--clear", "fake_robot/go2"]) == 0  # the node's, too
    assert latches() == []
    assert main([*run, "--ros"]) == 0


@pytest.mark.slow
def test_clear_estop_lets_go_of_the_robot_that_an_earlier_process_drove(
    start: Any, callers: Any, tmp_path: Path
) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT)
    host = start(path)
    host.says("running")
    assert callers().call("estop").success
    host.kill()
    assert {e.owner for _, e in latches()} == {"/unicon", "fake_robot/go2"}
    again = start(path)
    again.says("not started by itself")
    assert callers().call("clear_estop").success
    assert latches() == []
    assert again.interrupt() == 0


class Pressed:
    """A button of whatever kind, pressed in the tenth tick."""

    def __init__(self, kind: type[Fault]) -> None:
        self._kind, self._ticks = kind, 0

    def __call__(self) -> None:
        self._ticks += 1
        if self._ticks == 10:
            raise self._kind("the red button was pressed")


def driven(platform: str = "fake_robot", kind: type[Fault] = EmergencyStopPressed) -> Report:
    program = Program(
        robot="go2",
        platform=platform,
        rate=100,
        flow=Zip(block("hold"), Block("button", Pressed(kind), endless=True)),
        start="none",
        duration=0.5,
        pacing={"hang": 20},
    )
    return run(program, warn=lambda _: None)


def test_a_press_without_ros_latches_the_robot(capsys: pytest.CaptureFixture[str]) -> None:
    for simulated, kind in (("fake", EmergencyStopPressed), ("fake_robot", Fault)):
        assert driven(simulated, kind).faults == ["the red button was pressed"]
        assert latches() == []  # a simulator, and the operator's normal stop
    assert driven().faults == ["the red button was pressed"]
    ((path, found),) = latches()
    assert (found.node, found.robot, found.kind) == ("", "fake_robot/go2", ESTOP)
    assert found.reason == "the red button was pressed"
    with pytest.raises(PlatformError, match="unicon latches --clear fake_robot/go2"):
        driven()
    path.write_text("garbage")
    with pytest.raises(PlatformError, match="cannot be read"):
        driven()
    assert main(["latches"]) == 0
    assert "fake_robot/go2" in capsys.readouterr().out
    assert main(["latches", "--clear", "fake_robot/go2"]) == 0


@pytest.mark.parametrize(
    ("name", "platform", "protocols", "options", "key"),
    [
        ("go1", "unitree_legged", ["unitree_legged"], {}, "unitree_legged/192.168.123.10/8007"),
        (
            "go1",
            "my.module:make",
            ["unitree_legged"],
            {"address": "localhost", "port": 5000},
            "unitree_legged/127.0.0.1/5000",
        ),
        ("go2", "unitree", ["unitree_go"], {}, "unitree_go/domain0/any"),
        ("go2", "unitree", ["unitree_go"], {"address": "lo"}, "unitree_go/domain0/127.0.0.1"),
        ("go2", "unitree", ["unitree_go"], {"domain": 7}, "unitree_go/domain7/any"),
        ("go2", "fake_robot", [], {}, "fake_robot/go2"),
        ("arx_x5", "arx", ["arx"], {"channel": "vcan0"}, "arx/vcan0"),
        ("rohand", "rohand", ["rohand"], {"device": "/dev/ttyUSB0"}, "rohand/dev-ttyUSB0"),
    ],
)
def test_a_robot_is_named_by_what_reaches_it(
    name: str, platform: str, protocols: list[str], options: dict[str, Any], key: str
) -> None:
    assert robot_key(platform, protocols, options, load_robot(name)) == key


def test_no_name_clears_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    """As of a variable that is not set."""
    kept = latch()  # of a node that drove no robot
    kept.set("pressed")
    assert kept.kept()
    assert main(["latches", "--clear", ""]) == 1
    assert "no latch of ''" in capsys.readouterr().err
    assert len(latches()) == 1


def test_an_interface_that_is_chosen_may_be_any() -> None:
    kept = Latch("", 0, ESTOP, pytest.fail, "unitree_go/domain0/any")
    kept.set("pressed")
    assert kept.kept()
    assert of_robot("unitree_go/domain0/10.0.0.2") == of_robot("unitree_go/domain0/any")
    assert of_robot("unitree_go/domain0/any") is not None
    assert of_robot("unitree_go/domain1/any") is None
    assert of_robot("unitree_hg/domain0/any") is None
    assert of_robot("unitree_go/domain0") is None


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
