"""unicon_node as a process: exit statuses, lifecycle orders, parameters, services, diagnostics."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from unicon_lab.recording import open_record

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]

Start = Callable[..., Any]


def ros_args(*parameters: str) -> list[str]:
    return ["--ros-args", *(part for text in parameters for part in ("-p", text))]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_damps_closes_and_exits_0(
    nodes: Start, peers: Start, sway: Path, number: signal.Signals
) -> None:
    node = nodes(*ros_args(f"workflow:={sway}"))
    watcher = peers("robot_watcher")
    watcher.wait_for(lambda: len(watcher.of("joints")) > 5, "joint_states")
    node.process.send_signal(number)
    status, errors = node.end()
    assert status == 0, errors
    assert "Traceback" not in errors
    assert "ended after" in errors


def test_a_signal_ends_an_inactive_node_too(nodes: Start, peers: Start, react: Path) -> None:
    node = nodes(*ros_args(f"workflow:={react}", "autostart:=false"))
    caller = peers("caller", "unicon", "?")
    assert caller.end()[0] == 0
    assert caller.lines[0]["state"] == "unconfigured"
    node.process.send_signal(signal.SIGINT)
    assert node.end() == (0, node.end()[1])


BAD = [
    (ros_args("workflow:=nope"), "unknown workflow 'nope'; known: "),
    (["--ros-args", "-p", "foo"], "Couldn't parse parameter override rule: '-p foo'"),
    (ros_args("workflow:=go2_stand", "map:=nope"), "unknown map 'nope'"),
    (ros_args("workflow:=go2_stand", "overrides:=['rate=x']"), "rate is 'x'; write a number"),
    (ros_args("workflow:=go2_stand", "frame_prefix:=/r/"), "frame prefix '/r/': tf2 takes no"),
    (ros_args("max_vx:=-1.0"), "max_vx"),
]


def is_told(said: str, errors: str) -> None:
    lines = [line for line in errors.splitlines() if not line.startswith(("[INFO]", "[WARN]"))]
    assert len(lines) == 1, errors
    assert lines[0].startswith("unicon_node: error: ")
    assert said in lines[0]


@pytest.mark.parametrize(("arguments", "said"), BAD[:2])
def test_bad_input_at_start_is_one_line_and_exit_status_1(
    nodes: Start, arguments: list[str], said: str
) -> None:
    status, errors = nodes(*arguments).end()
    assert status == 1, errors
    is_told(said, errors)


IN_A_ROW = """\
import json, sys
from unicon_ros.node_main import main
for arguments in json.loads(sys.argv[1]):
    print(f"status {main(arguments)}", file=sys.stderr, flush=True)
"""


def test_all_bad_input_is_one_line_and_the_next_node_of_the_process_tells_its_own(
    processes: Start,
) -> None:
    arguments = json.dumps([each for each, _ in BAD])
    status, errors = processes(sys.executable, "-c", IN_A_ROW, arguments).end()
    assert status == 0, errors
    told = errors.split("status 1\n")
    assert told.pop() == ""
    assert len(told) == len(BAD), errors
    for (_, said), error in zip(BAD, told):
        is_told(said, error)


def test_lifecycle_is_clean_in_every_order(nodes: Start, peers: Start, react: Path) -> None:
    node = nodes(*ros_args(f"workflow:={react}", "autostart:=false"))
    words = [
        "+configure",
        "+cleanup",
        "+configure",
        "+activate",
        "+deactivate",
        "+activate",
        "wait=0.3",
        "+deactivate",
        "+cleanup",
        "start",  # configures and activates
        "wait=0.3",
        "stop",
        "until=inactive",
        "?",
        "start",
        "estop",
        "wait=0.6",  # nothing clears it before
        "until=inactive",
        "?",
        "clear_estop",
        "start",
        "+shutdown",
    ]
    caller = peers("caller", "unicon", *words)
    status, errors = caller.end(60)
    assert status == 0, errors
    states = [line["state"] for line in caller.lines if "state" in line]
    assert states == [
        "inactive",
        "unconfigured",
        "inactive",
        "active",
        "inactive",
        "active",
        "inactive",
        "unconfigured",
        "inactive",  # after stop
        "inactive",  # after estop
    ]
    assert all(line.get("success", True) for line in caller.lines), caller.lines
    status, errors = node.end()
    assert status == 0, errors
    assert "Traceback" not in errors
    assert "fault: emergency stop by the service ~/estop" in errors


def test_a_workflow_that_cannot_be_built_leaves_the_node_unconfigured(
    nodes: Start, peers: Start
) -> None:
    node = nodes(*ros_args("workflow:=nope", "autostart:=false"))
    caller = peers("caller", "unicon", "+configure", "start")
    assert caller.end()[0] == 0
    assert caller.lines[0] | {"seconds": 0} == {
        "success": False,
        "state": "unconfigured",
        "word": "+configure",
        "seconds": 0,
    }
    assert "unknown workflow 'nope'" in caller.lines[1]["message"]
    node.process.send_signal(signal.SIGINT)
    assert node.end()[0] == 0


def test_a_fault_is_exit_status_3_where_it_is_asked_for(
    nodes: Start, peers: Start, react: Path
) -> None:
    node = nodes(*ros_args(f"workflow:={react}", "exit_on_fault:=true"))
    watcher = peers("robot_watcher")
    watcher.wait_for(lambda: len(watcher.of("joints")) > 5, "joint_states")
    assert peers("caller", "unicon", "estop").end()[0] == 0
    status, errors = node.end()
    assert status == 3, errors
    said = next(line for line in errors.splitlines() if "fault record: " in line)
    record = open_record(said.split("fault record: ")[1])
    assert record.facts["reason"] == "emergency stop by the service ~/estop"
    assert record.moments == ("received", "input", "tuned", "sent")
    assert json.loads(record.files["memory.json"])["trouble"] == ""


def test_command_limits_and_gain_scales_may_be_set_while_it_runs(
    nodes: Start, peers: Start, react: Path
) -> None:
    nodes(*ros_args(f"workflow:={react}"))
    watcher = peers("robot_watcher", "--command", "0.5", "0", "0")
    names = "FL_hip_joint"

    def hip() -> float:
        line = watcher.of("joints")[-1]
        return float(line["position"][line["names"].index(names)])

    watcher.wait_for(lambda: watcher.of("joints") and abs(hip() - 0.6) < 1e-5, "0.1 + 0.5")
    caller = peers("caller", "unicon", "max_vx=0.2", "max_vx=-3.0", "stiffness_scale=0.0")
    assert caller.end()[0] == 0
    assert [line["success"] for line in caller.lines] == [True, False, True]
    # Without stiffness the fake robot's joints stay where they are: at the limited command.
    watcher.wait_for(lambda: abs(hip() - 0.3) < 1e-5, "0.1 + 0.2")


def test_two_nodes_run_in_two_namespaces(nodes: Start, peers: Start, react: Path) -> None:
    for space in ("a", "b"):
        nodes(*ros_args(f"workflow:={react}"), "-r", f"__ns:=/{space}")
    for space in ("a", "b"):
        caller = peers("caller", f"/{space}/unicon", "until=active", "?", "stop")
        status, errors = caller.end()
        assert status == 0, errors
        assert caller.lines[0]["state"] == "active"


ROBOT = """\
robot: go2
platform: fake_robot
rate: 100
start: {fade_in: 0.2}
flow: hold
wind_down: {hold: {duration: 0.2}}
pacing: {hang: 20}
"""


ASKS = "waiting for the operator's go"


@pytest.mark.alone  # a caller whose answer takes 10 s gives up
def test_a_robot_waits_for_the_operator_and_start_is_his_go(
    nodes: Start, peers: Start, tmp_path: Path
) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT)
    node = nodes(*ros_args(f"workflow:={path}"))
    node.wait_for(lambda: ASKS in node.errors, ASKS, timeout=60.0)
    words = ["?", "pause", "start", "wait=0.2", "start", "stop", "until=inactive", "?"]
    again = ["start", "wait=2", "start", "estop", "until=inactive", "start", "?"]
    callers, waits = [], []
    for each in (words, again):
        callers.append(peers("caller", "unicon", *each))
        status, errors = callers[-1].end(60)
        assert status == 0, errors
        waits.append(node.errors.count(ASKS))
    lines = [line for caller in callers for line in caller.lines]
    told = [(line["word"], line.get("message", line.get("state"))) for line in lines]
    assert told[0] == ("?", "active")
    assert "is a real robot, which has no pause" in told[1][1]
    assert told[2:5] == [
        ("start", "go"),
        ("start", "it runs already"),
        ("stop", "stopping: it winds down, then the platform damps"),
    ]
    assert told[5:8] == [("?", "inactive"), ("start", "started"), ("start", "it runs already")]
    assert "latched until ~/clear_estop" in told[8][1]
    assert "~/clear_estop" in told[9][1]
    assert told[10] == ("?", "inactive")
    node.process.send_signal(signal.SIGINT)
    status, errors = node.end()
    assert status == 0, errors
    assert waits[0] == waits[1], errors  # ~/start of an inactive node is the go of that run


def test_an_estop_in_the_wait_ends_it_and_nothing_is_sent(
    nodes: Start, peers: Start, tmp_path: Path
) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT)
    node = nodes(*ros_args(f"workflow:={path}", "exit_on_fault:=true"))
    node.wait_for(lambda: ASKS in node.errors, ASKS, timeout=60.0)
    caller = peers("caller", "unicon", "estop")
    assert caller.end(60)[0] == 0
    status, errors = node.end()
    assert status == 3, errors
    assert "ended after 0 ticks" in errors
