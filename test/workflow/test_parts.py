"""A workflow in parts: who belongs where, what crosses the border, and what silence does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from unicon_base.errors import CheckError, Fault, StateError, UniconError, WorkflowError
from unicon_core.check import check_workflow, refuse_errors
from unicon_core.flow import blocks_of
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States
from unicon_core.states.backends.shm import Segment, ShmReader, ShmWriter, segments
from unicon_core.states.groups import subset
from unicon_core.states.links import AGAIN_NS
from unicon_core.workflow import load_workflow
from unicon_core.workflow.document import load_document
from unicon_core.workflow.program import Program

NAME = f"parts-{os.getpid()}"

WORKFLOW = """\
name: {name}
robot: go2
platform: fake
rate: 100
{store}
states:
  mode: {{shape: [], dtype: int64}}
parts:
  robot: {{publishes: [joint_pos, stamp_ns, joint_pos_target], silent: {{after: 0.2}}}}
  desk: {{publishes: [velocity_command], silent: {{after: 0.3, then: hold}}}}
commands:
  - {{velocity_command: {{schedule: [[0.0, 0.7, 0.0, 0.0]]}}, on: desk}}
flow: hold
safety: [finite, joint_limits]
"""


def write(folder: Path, text: str = WORKFLOW, store: str = "store: shm", name: str = NAME) -> Path:
    path = folder / "divided.yaml"
    path.write_text(text.format(name=name, store=store))
    return path


@pytest.fixture
def workflow(tmp_path: Path) -> Iterator[Path]:
    yield write(tmp_path)
    assert not [found.name for found in segments() if found.name.startswith(NAME)]


@pytest.fixture
def build(workflow: Path) -> Iterator[Callable[..., Program]]:
    """Builds a part in this process; closes it in the end."""
    built: list[Program] = []

    def part(name: str, path: Path = workflow, tell: Callable[[str], None] = print) -> Program:
        built.append(Program(load_document(path), part=name))
        built[-1].warn = tell
        return built[-1]

    yield part
    for program in built:
        program.close()


def start(path: Path, part: str, *more: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "unicon_ros", "run", str(path), "--part", part, "--no-ros"]
    pipe = subprocess.PIPE
    return subprocess.Popen([*command, *more], stdout=pipe, stderr=pipe, text=True)


def until(condition, timeout=20.0):
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, "it did not come to that"
        time.sleep(0.005)


def tick(program, count=1):
    """Tick a program without a runner."""
    from unicon_core.flow import compile_graph

    graph = compile_graph(program.root)
    for _ in range(count):
        graph.step()
        graph.deferred()


def test_without_a_part_all_of_it_runs_in_one_process(workflow):
    program = load_workflow(workflow)
    Runner(program, RunOptions(duration=0.1, speed="max")).run()
    assert program.states.velocity_command[0] == np.float32(0.7)


def test_parts_that_no_block_is_on_are_only_named(tmp_path):
    text = WORKFLOW.replace(", on: desk", "")
    path = write(tmp_path, text, store="store: {zmq: tcp://127.0.0.1:5600}")
    assert not [f for f in check_workflow(path).findings if f.code.startswith("parts.")]
    program = Program(load_document(path), silent=True)
    tick(program)
    assert program.context.lag == 0.0
    program.close()
    moved = write(tmp_path)
    with pytest.raises(WorkflowError, match="a divided workflow cannot be run silently"):
        Program(load_document(moved), silent=True)


def test_a_part_without_the_robot_knows_that_it_is_a_tick_away(build):
    robot = build("robot")
    assert robot.context.lag == 0.0
    tick(robot)
    assert build("desk").context.lag == 0.01


def test_each_part_has_its_own_blocks_and_they_exchange_states(build):
    told: list[str] = []
    robot = build("robot", tell=told.append)
    names = [block.name for block in blocks_of(robot.root)]
    assert "velocity_command" not in names
    assert "joint_limits" in robot.safety
    tick(robot)
    assert robot.states.velocity_command[0] == 0.0
    desk = build("desk")
    names = [block.name for block in blocks_of(desk.root)]
    assert "velocity_command" in names
    assert not any("joint_limits" in name for name in names)
    tick(desk)
    time.sleep(AGAIN_NS * 1.2e-9)  # how often one that is not there is looked for
    tick(robot)
    assert robot.states.velocity_command[0] == np.float32(0.7)
    tick(desk)
    np.testing.assert_array_equal(desk.states.joint_pos_target, robot.states.joint_pos_target)
    assert desk.states.joint_pos_target.any()
    desk.close()
    time.sleep(0.25)
    tick(robot)
    assert robot.states.velocity_command[0] == 0.0
    assert told == [
        "part 'desk' is not heard yet: its states are neutral",
        "part 'desk' is heard",
        "part 'desk' has been silent for 0.2 s: its states are neutral",
    ]


def test_what_came_is_written_anew_in_each_tick(build):
    robot = build("robot")
    tick(robot)
    desk = build("desk")
    tick(desk)
    time.sleep(AGAIN_NS * 1.2e-9)  # how often one that is not there is looked for
    tick(robot)
    robot.states.velocity_command[:] *= 0.5  # somebody amends it
    tick(robot)
    assert robot.states.velocity_command[0] == np.float32(0.7)


def test_a_desk_without_a_robot_says_what_to_run(workflow, monkeypatch):
    monkeypatch.setattr("unicon_core.platforms.joined.PartPlatform.__init__.__defaults__", (0.1,))
    with pytest.raises(UniconError, match="part 'robot' is not heard; run it first"):
        Program(load_document(workflow), part="desk")


def test_silence_can_be_a_fault(tmp_path, build):
    path = write(tmp_path, WORKFLOW.replace("{{after: 0.2}}", "{{after: 0.3, then: fault}}"))
    robot = build("robot", path)
    tick(robot)
    desk = build("desk", path)
    tick(desk)
    time.sleep(AGAIN_NS * 1.2e-9)  # how often one that is not there is looked for
    tick(robot)
    time.sleep(0.4)
    with pytest.raises(Fault, match=r"part 'desk' has been silent for 0\.3 s"):
        tick(robot)


@pytest.mark.parametrize(
    "number", [signal.SIGKILL, pytest.param(signal.SIGSTOP, marks=pytest.mark.slow)]
)
def test_processes_come_and_go(workflow, number):
    robot = start(workflow, "robot")
    until(lambda: any(f.name == f"{NAME}-robot" for f in segments()))
    seen = States(Segment.attach(f"{NAME}-robot", read_only=True).groups["measured"])
    reader = ShmReader(f"{NAME}-robot", "measured", seen)
    until(reader.take)
    desk = start(workflow, "desk")
    until(lambda: any(f.name == f"{NAME}-desk" for f in segments()))
    there = Segment.attach(f"{NAME}-desk", read_only=True)
    until(lambda: there.latest("measured")[0] > 30)  # it has been heard
    desk.send_signal(number)
    time.sleep(0.5)
    assert robot.poll() is None
    desk.kill()
    desk.wait()
    again = start(workflow, "desk", "--duration", "1")  # takes over what the dead one left
    _, error = again.communicate(timeout=30)
    assert again.returncode == 0, error
    robot.send_signal(signal.SIGINT)
    _, error = robot.communicate(timeout=30)
    assert "part 'desk' has been silent for 0.2 s: its states are neutral" in error
    assert error.count("part 'desk' is heard") == 2
    assert "fault" not in error
    reader.close()


def test_another_layout_is_refused_by_name(tmp_path, workflow):
    robot = start(workflow, "robot")
    until(lambda: any(f.name == f"{NAME}-robot" for f in segments()))
    other = tmp_path / "other"
    other.mkdir()
    text = WORKFLOW.replace("robot: go2", "robot: g1_29dof")
    desk = start(write(other, text), "desk")
    _, error = desk.communicate(timeout=30)
    assert desk.returncode == 1
    assert "state 'joint_pos': shape is [29] here and [12] there" in error
    robot.send_signal(signal.SIGINT)
    robot.communicate(timeout=30)


def test_two_runs_of_one_part_are_one_too_many(workflow):
    robot = start(workflow, "robot")
    until(lambda: any(f.name == f"{NAME}-robot" for f in segments()))
    second = start(workflow, "robot")
    _, error = second.communicate(timeout=30)
    assert second.returncode == 1
    assert f"is written by process {robot.pid}" in error
    robot.send_signal(signal.SIGINT)
    robot.communicate(timeout=30)


def test_store_publishes_a_workflow_that_is_not_divided(tmp_path):
    path = tmp_path / "whole.yaml"
    path.write_text(f"name: {NAME}\nrobot: go2\nplatform: fake\nrate: 50\nstore: shm\nflow: hold\n")
    program = load_workflow(path)
    assert {f.name: f.alive for f in segments()}[NAME]
    seen = States(program.states.layout)
    readers = [ShmReader(NAME, group, seen) for group in ("measured", "command")]
    tick(program, 3)
    assert all(reader.take() for reader in readers)
    np.testing.assert_array_equal(seen.joint_pos_target, program.states.joint_pos_target)
    with pytest.raises(StateError, match="is written by process"):
        load_workflow(path)
    program.close()
    assert NAME not in [f.name for f in segments()]
    for reader in readers:
        reader.close()


def test_commands_leave_behind_send(tmp_path):
    path = tmp_path / "whole.yaml"
    path.write_text(f"name: {NAME}\nrobot: go2\nplatform: fake\nrate: 50\nstore: shm\nflow: hold\n")
    program = load_workflow(path)
    names = [block.name for block in blocks_of(program.root)]
    assert names.index("publish command") == names.index("send") + 1
    program.close()


WRONG = {
    "store: sham": r"store is 'sham'; write local, shm or \{zmq: ADDRESS\}",
    "store: ros": r"store is 'ros'; write local, .*; ROS is ros: true",
    "store: {zmq: here}": r"store\.zmq is 'here', which is not an address; write tcp://HOST:PORT",
    "store: {shm: {folder: x}}": r"store\.shm: unknown key 'folder'; known: name",
    "store: {shm: a, zmq: 'ipc://a'}": r"store: give either shm or zmq",
    "store: {shm: a/b}": r"a segment cannot be named 'a/b'",
    'store: {zmq: "tcp://127.0.0.1:²"}': r"is not an address",
    'store: {zmq: "tcp://:5600"}': r"is not an address",
    "store: {zmq: {address: 'tcp://h:5600', keys: '~nobody_at_all/x'}}": r"is not a folder",
}


@pytest.mark.parametrize("store", WRONG)
def test_wrong_stores(tmp_path, store):
    with pytest.raises(WorkflowError, match=WRONG[store]):
        load_workflow(write(tmp_path, store=store))


CHANGES = {
    ("on: desk", "on: disk"): r"no part 'disk'; did you mean 'desk'",
    ("publishes: [velocity_command]", "publishes: [velocity]"): r"no state 'velocity'",
    ("publishes: [velocity_command]", "publishes: [joint_pos]"): r"both publish 'joint_pos'",
    ("then: hold", "then: halt"): r"silent\.then 'halt' is not known; did you mean 'fault'",
    ("publishes: [velocity_command]", "publishes: [tick]"): r"each part counts its own ticks",
    ("after: 0.2", "after: .nan"): r"silent\.after is nan",
    ("after: 0.2", "after: 1e300"): r"silent\.after is 1e\+300; write a number above 0 to 3600",
    ("after: 0.2", "after: 0.2, set: {{velocity_command: 1e300}}"): r"does not fit shape \(3,\)",
    (
        "[finite, joint_limits]",
        "[finite, {{joint_limits: {{}}, on: desk}}]",
    ): r"safety: .* leave out",
    ("flow: hold", "flow: hold\nwind_down: {{damp: {{}}, on: desk}}"): r"wind_down: .* leave out",
    ("after: 0.2", "after: 0.2, set: {{velocity_command: [1, 2]}}"): r"does not fit shape \(3,\)",
    ("after: 0.2", "after: 0.2, set: {{joint_pos: 0}}"): r"'joint_pos' does not come from another",
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("part", ["robot", ""])
def test_wrong_parts(tmp_path, change, part):
    path = write(tmp_path, WORKFLOW.replace(*change))
    with pytest.raises(WorkflowError, match=CHANGES[change]):
        Program(load_document(path), part=part)


def test_what_is_in_order_is_not_divided(tmp_path):
    chain = "flow: {{chain: [hold, {{damp: {{}}, on: desk}}]}}"
    path = write(tmp_path, WORKFLOW.replace("flow: hold", chain))
    with pytest.raises(WorkflowError, match="divide at a zip"):
        Program(load_document(path), part="robot")


def test_a_block_on_a_part_where_there_are_none(tmp_path):
    path = tmp_path / "whole.yaml"
    path.write_text("robot: go2\nplatform: fake\nrate: 50\nflow: {hold: {}, on: desk}\n")
    with pytest.raises(WorkflowError, match="on: desk: the workflow has no parts"):
        load_workflow(path)


def test_a_hook_knows_what_comes_from_other_parts(workflow):
    """A bridge amends such states, as it does those of blocks."""
    written: list[str] = []

    def hook(program: Program) -> dict:
        written.extend(state for block in program.blocks for state in block.writes)
        return {}

    Program(load_document(workflow), part="robot", hooks=[hook]).close()
    assert "velocity_command" in written


def test_a_part_that_publishes_nothing_leaves_nothing(tmp_path, build):
    path = write(tmp_path, WORKFLOW.replace("publishes: [velocity_command]", "publishes: []"))
    tick(build("robot", path))
    tick(build("desk", path))
    assert f"{NAME}-desk" not in [found.name for found in segments()]


def test_nothing_of_a_new_writer_is_taken_before_its_first_value(tmp_path):
    """Else a state that is held would turn to zero while the other part starts anew."""
    states = load_workflow("go2_stand", ["platform=fake"]).states
    group = {"measured": subset(states.layout, ["joint_pos"])}
    first = Segment.create(NAME, group)
    states.joint_pos[:] = 0.5
    reader = ShmReader(NAME, "measured", states)
    reader.restore()
    assert (states.joint_pos == 0.5).all()
    ShmWriter(first, "measured", states).publish()
    assert reader.take()
    first.close()
    second = Segment.create(NAME, group)
    assert reader.alive()
    assert not reader.take()
    reader.restore()
    assert (states.joint_pos == 0.5).all()
    reader.close()
    second.close()


def findings(folder: Path, *change: str) -> list[str]:
    sway = 'flow: {{sway: {{duration: 9.0, gains: {{"*_thigh_joint": [0.4, 0.0, 0.0]}}}}}}'
    path = write(folder, WORKFLOW.replace("flow: hold", sway).replace(*(change or ("", ""))))
    return [str(found) for found in check_workflow(path).findings]


def test_check_finds_what_does_not_cross_the_border(tmp_path):
    assert findings(tmp_path) == []
    found = findings(tmp_path, "publishes: [velocity_command]", "publishes: []")
    assert "add to parts.desk.publishes: [velocity_command]" in " ".join(found)
    found = findings(
        tmp_path, "publishes: [velocity_command]", "publishes: [velocity_command, mode]"
    )
    assert "it publishes 'mode', which nothing writes" in " ".join(found)
    assert "[parts.published" in found[0]
    found = findings(tmp_path, "publishes: [velocity_command]", "publishes: [base_quat]")
    assert "publishes 'base_quat', which part 'robot' writes" in " ".join(found)


def test_check_knows_that_over_zmq_parts_talk_with_the_first_alone(tmp_path):
    pytest.importorskip("zmq")
    over = WORKFLOW.replace("{store}", "store: {{zmq: tcp://127.0.0.1:23456}}")
    sway = 'sway: {{duration: 9.0, gains: {{"*_thigh_joint": [0.4, 0.0, 0.0]}}}}'
    third = over.replace("commands:", "  arm: {{publishes: []}}\ncommands:", 1)
    told = "of part 'arm': it reads 'velocity_command' of part 'desk'; over zmq parts talk with"
    for states in ("velocity_command", ""):
        text = third.replace("flow: hold", f"flow: {{{{{sway}, on: arm}}}}")
        text = text.replace("[velocity_command]", f"[{states}]")
        found = [str(each) for each in check_workflow(write(tmp_path, text)).findings]
        assert any(told in each for each in found)
    text = over.replace("flow: hold", "flow: {{hold: {{}}, on: desk}}").replace("[joint_pos, ", "[")
    found = " ".join(str(each) for each in check_workflow(write(tmp_path, text)).findings)
    assert "it reads joint_pos, which part 'robot' writes and does not publish" in found
    assert "over zmq" not in found  # the first part is the one that it may ask


def test_check_wants_to_know_what_is_commanded_in_silence(tmp_path):
    text = WORKFLOW.replace("flow: hold", "flow: {{hold: {{}}, on: desk}}").replace(
        "[joint_pos, stamp_ns, joint_pos_target]", "[joint_pos, stamp_ns]"
    )
    commands = "joint_pos_target, joint_vel_target, joint_effort_ff, joint_stiffness, joint_damping"
    text = text.replace("[velocity_command]", f"[velocity_command, {commands}]")
    path = write(tmp_path, text)
    found = {f.code: str(f) for f in check_workflow(path).findings}
    assert list(found) == ["parts.silent"]
    assert "then: fault" in found["parts.silent"]
    robot = Program(load_document(path), part="robot")
    with pytest.raises(CheckError, match=r"is not run"):  # nor is the part, which asks for itself
        refuse_errors(robot)
    robot.close()
    path.write_text(path.read_text().replace("after: 0.2", "after: 0.2, then: fault"))
    assert not check_workflow(path).findings


def test_show_draws_the_border(workflow, capsys):
    from unicon_ros.cli.main import main

    assert main(["show", str(workflow)]) == 0
    text = capsys.readouterr().out
    assert "velocity_command (on desk)" in text
    assert f"shm {NAME}-desk" in text


STORE = 'store: {{zmq: {{address: "tcp://{host}:5600"{keys}}}}}'
TOGETHER = 'start: {{together: {{robots: {{a: "tcp://{host}:1", b: "ipc:///b"}}, me: a{keys}}}}}'


@pytest.mark.parametrize(("where", "text"), [("store", STORE), ("start.together", TOGETHER)])
@pytest.mark.parametrize(
    ("host", "keys", "exposed"),
    [
        ("10.0.0.1", "", True),
        ("robot", "", True),
        ("127.0.0.1", "", False),
        ("10.0.0.1", ", keys: folder", False),
    ],
)
def test_what_other_machines_reach_without_keys_is_an_error(
    tmp_path: Path, where: str, text: str, host: str, keys: str, exposed: bool
) -> None:
    path = write(tmp_path, store=text.format(host=host, keys=keys))
    found = [each for each in check_workflow(path).findings if each.code == "zmq.keys"]
    assert [each.culprit for each in found] == exposed * [where]
    if exposed:
        assert "can be reached from other machines, without keys: anybody who" in found[0].evidence


def test_a_part_that_listens_without_keys_is_refused_unless_forced(tmp_path: Path) -> None:
    path = write(tmp_path, store=STORE.format(host="0.0.0.0", keys=""))
    with closing(Program(load_document(path), part="robot")) as program:
        with pytest.raises(CheckError, match=r"--force zmq\.keys"):
            refuse_errors(program)
        assert any("forced: store: " in line for line in refuse_errors(program, ["zmq.keys"]))
    with closing(load_workflow(path)) as program:  # all of it in one process: nothing listens
        refuse_errors(program)
