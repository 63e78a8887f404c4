"""Block `external`: motor commands of another process, and a fault where they are not fresh."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from unicon_base.errors import Fault, WorkflowError
from unicon_core.flow import compile_graph
from unicon_core.states import States
from unicon_core.states.backends.shm import Segment, ShmReader, ShmWriter
from unicon_core.states.groups import groups_of
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow import Program, load_document

NAME = f"test-external-{os.getpid()}"
WORKFLOW = """\
name: host
robot: go2
platform: fake
store: {shm: NAME-host}
states: {unreported: {shape: [2], initial: 0.5}}   # no block writes it
rate: 100
flow: {external: {segment: NAME, timeout: 0.2}}
safety: [finite, joint_limits]
"""


@pytest.fixture
def host(tmp_path: Path) -> Iterator[Program]:
    path = tmp_path / "host.yaml"
    path.write_text(WORKFLOW.replace("NAME", NAME))
    program = Program(load_document(path))
    yield program
    program.close()


class Other:
    """The process that commands."""

    def __init__(self, states: States) -> None:
        groups = groups_of(states.layout)
        self.states = States(groups["command"])
        self._segment = Segment.create(NAME, {"command": groups["command"]})
        self.publish = ShmWriter(self._segment, "command", self.states).publish
        self.close = self._segment.close


def test_it_passes_commands_on_and_safety_sees_them(host: Program) -> None:
    other, step = Other(host.states), compile_graph(host.root).step
    for value in (0.5, 0.25):
        for name in COMMAND_STATES:
            other.states[name][...] = value
        other.publish()
        for _ in range(2):  # a command stays for its time
            step()
            for name in COMMAND_STATES[1:]:
                assert (host.states[name] == value).all()
            assert host.states["joint_pos_target"][0] == value
            assert host.states["joint_pos_target"][2] < -0.8  # the limit of a calf
    shared = States(groups_of(host.states.layout)["measured"])
    assert ShmReader(f"{NAME}-host", "measured", shared).take()
    assert shared["unreported"].tolist() == [0.5, 0.5]
    other.states["joint_stiffness"][3] = float("nan")
    other.publish()
    with pytest.raises(Fault, match="joint_stiffness"):
        step()
    other.close()


def test_an_old_command_is_a_fault(host: Program) -> None:
    other, step = Other(host.states), compile_graph(host.root).step
    other.publish()
    step()
    time.sleep(0.25)
    with pytest.raises(Fault, match=f"'{NAME}' has been silent for 0.2 s"):
        step()
    other.close()


@pytest.mark.parametrize("there", ["nothing", "no command", "other states"])
def test_without_a_command_it_is_a_fault(
    there: str, host: Program, capsys: pytest.CaptureFixture[str]
) -> None:
    segment = None
    if there == "no command":
        segment = Segment.create(NAME, {"command": groups_of(host.states.layout)["command"]})
    if there == "other states":
        segment = Segment.create(NAME, {"command": groups_of(host.states.layout)["measured"]})
    step = compile_graph(host.root).step
    with pytest.raises(Fault, match="has been silent"):
        step()
    if segment is not None:
        segment.close()
    assert ("is not heard: " in capsys.readouterr().out) == (there == "other states")


def test_a_name_that_no_segment_can_have(tmp_path: Path) -> None:
    path = tmp_path / "host.yaml"
    path.write_text(WORKFLOW.replace("segment: NAME", "segment: a/b").replace("NAME", NAME))
    with pytest.raises(WorkflowError, match="'external': a segment cannot be named 'a/b'; use"):
        Program(load_document(path))
