"""A viewer beside a run: what it sees, what it may do, and that it holds nothing up."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from velocity_sent import VelocitySent

from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.workflow import Program, load_document
from unicon_core.workflow.document import WorkflowDocument
from unicon_lab.view.driver import FAULT
from unicon_lab.view.view import View

FLOW = {"chain": [{"hold": {"duration": 0.1}}, "hold"]}


class Rig:
    """A run of the fake platform in a thread, with a viewer that tells what it sees."""

    def __init__(
        self, folder: Path, workflow: str | Path, rate: float = 100.0, duration: float = 30.0
    ) -> None:
        self.folder, self.lines = folder, list[str]()
        document: WorkflowDocument = load_document(workflow, [f"rate={rate}"])
        self.view = View(
            {"sink": "telling_sink:Telling", "folder": str(folder)}, warn=self.lines.append
        )
        self.view.declare(document)
        self.sent = VelocitySent()
        self.program = Program(document, hooks=[self.view.hook, self.sent.hook])
        self.runner = Runner(self.program, RunOptions(duration=duration, warn=self.lines.append))
        self.view.attach(self.runner)
        self.report: Report | None = None
        self.thread = threading.Thread(target=self._run)
        self.thread.start()

    def _run(self) -> None:
        self.report = self.runner.run()
        self.view.close()

    def say(self, what: str, *given: Any) -> None:
        with (self.folder / "say").open("a") as file:
            file.write(json.dumps([what, *given]) + "\n")

    def seen(self) -> dict[str, Any]:
        path = self.folder / "seen"
        return json.loads(path.read_text()) if path.exists() else {"tick": -1}

    def until(self, holds: Callable[[dict[str, Any]], bool], patience: float = 5.0) -> float:
        begin = time.monotonic()
        while not holds(self.seen()):
            assert time.monotonic() - begin < patience, (self.seen(), self.lines)
            time.sleep(0.005)
        return time.monotonic() - begin

    @property
    def process(self) -> int:
        assert self.view._peripheral is not None
        return self.view._peripheral.process.pid

    def command(self) -> list[float]:
        return self.sent.last

    def end(self) -> Report:
        self.runner.stop()
        self.thread.join(10.0)
        assert self.report is not None
        return self.report


def written(folder: Path) -> Path:
    import yaml

    path = folder / "shown.yaml"
    path.write_text(
        yaml.safe_dump(
            {
                "schema": "unicon.workflow/1",
                "name": "shown",
                "robot": "go2",
                "platform": "fake",
                "rate": 100,
                "commands": [{"velocity_command": {"constant": [0.3, 0.0, 0.0]}}],
                "flow": FLOW,
            }
        )
    )
    return path


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    made = Rig(tmp_path, written(tmp_path))
    yield made
    made.end()


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """For tests after which it goes on as before."""
    folder = tmp_path_factory.mktemp("shared")
    made = Rig(folder, written(folder), duration=600.0)
    yield made
    made.end()


def test_it_sees_every_tick_and_where_the_flow_is(shared: Rig) -> None:
    rig = shared
    rig.until(lambda seen: seen["tick"] > 40)
    seen = rig.seen()
    assert seen["lost"] == 0
    assert seen["phase"] == "run"
    assert seen["velocity_command"][0] == pytest.approx(0.3)
    assert "2: hold" in seen["running"]
    assert "1: hold" not in seen["running"]
    assert 0 < seen["busy_ns"] < 1e9


def test_a_driver_replaces_the_script_until_it_lets_go(shared: Rig) -> None:
    rig = shared
    rig.until(lambda seen: seen["tick"] > 5)
    rig.say("hold", [0.5, 0.1, -0.2])
    time.sleep(0.2)
    assert rig.command() == [0.3, 0.0, 0.0]  # nobody has touched anything
    rig.say("touch")
    rig.until(lambda seen: seen["driving"])
    rig.until(lambda _: rig.command() == [0.5, 0.1, -0.2])
    rig.say("let_go")
    rig.until(lambda seen: not seen["driving"])
    rig.until(lambda _: rig.command() == [0.3, 0.0, 0.0])


# Of a page that stalls and of a process that was stopped the run knows the same: nothing comes.
@pytest.mark.parametrize(
    "how", [pytest.param("silent", marks=pytest.mark.slow), "stopped", "killed"]
)
def test_a_driver_who_is_not_heard_stands_until_a_new_touch(rig: Rig, how: str) -> None:
    rig.until(lambda seen: seen["tick"] > 5)
    rig.say("touch")
    rig.say("hold", [0.5, 0.0, 0.0])
    rig.until(lambda _: rig.command() == [0.5, 0.0, 0.0])
    pid = rig.process
    if how == "silent":
        rig.say("sleep", 0.8)  # its page stalls, and then goes on as before
    elif how == "stopped":
        os.kill(pid, signal.SIGSTOP)
    else:
        os.kill(pid, signal.SIGKILL)
        (rig.folder / "say").write_text("")
    begin = time.monotonic()
    while rig.command() != [0.0, 0.0, 0.0]:
        assert time.monotonic() - begin < 1.0
        time.sleep(0.01)
    if how == "stopped":
        os.kill(pid, signal.SIGCONT)
    elif how == "killed":
        before = rig.seen()["tick"]
        rig.until(lambda seen: seen["tick"] > before + 50, 10.0)
        rig.say("hold", [0.5, 0.0, 0.0])
    time.sleep(0.6)
    assert rig.command() == [0.0, 0.0, 0.0]
    assert any("the driver is not heard any more" in line for line in rig.lines)
    rig.until(lambda seen: not seen["driving"])  # a busy machine shows it what was before
    rig.say("touch")
    rig.until(lambda seen: seen["driving"])
    rig.until(lambda _: rig.command() == [0.5, 0.0, 0.0])
    assert rig.end().faults == []


def test_its_estop_ends_the_run_before_the_next_command(rig: Rig) -> None:
    rig.until(lambda seen: seen["tick"] > 5)
    rig.say("estop")
    rig.thread.join(4.0)
    assert not rig.thread.is_alive()
    assert rig.report is not None
    assert rig.report.faults == [FAULT]
    assert rig.seen()["faults"] == [FAULT]  # its last words


def test_what_it_wishes_is_done_and_answered(rig: Rig) -> None:
    rig.until(lambda seen: seen["tick"] > 5)
    rig.say("act", "pause", {})
    rig.until(lambda seen: seen["paused"])
    before = rig.seen()["tick"]
    rig.say("act", "step", {})
    rig.until(lambda seen: seen["tick"] == before + 1)
    rig.say("act", "start", {})
    rig.until(lambda seen: not seen["paused"])
    rig.say("act", "set_parameter", {"name": "max_vx", "value": 0.1})
    rig.until(lambda seen: seen["velocity_command"][0] < 0.11)
    rig.until(lambda seen: seen["max_vx"] == pytest.approx(0.1))  # what a new page is told
    rig.say("act", "set_parameter", {"name": "damping_scale", "value": 0.1})
    rig.say("act", "set_parameter", {"name": "rate", "value": 0.1})
    rig.say("act", "skill", {"name": "dance"})
    rig.say("act", "__init__", {})
    rig.say("act", "skill", {})
    rig.until(lambda seen: len(seen["answers"]) == 9)
    done = [done for _, done, _ in rig.seen()["answers"]]
    assert done == [True] * 4 + [False] * 5
    rig.say("act", "stop", {})
    rig.thread.join(5.0)
    assert not rig.thread.is_alive()


SHADOWED = """\
robot: go2
platform: fake
policies: {walk: go2_velocity}
shadow: {walk: {path: go2_velocity, bound: 3.0, limit: 1.0}}
flow: {policy: walk}
safety: [finite]
"""


def test_its_button_lets_the_shadow_drive(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime", reason="pip install onnxruntime")
    (tmp_path / "w.yaml").write_text(SHADOWED)
    rig = Rig(tmp_path, tmp_path / "w.yaml", rate=50.0)
    share = rig.program.states["shadow_walk_share"]
    rig.until(lambda seen: seen["tick"] > 60)
    for number, (done, text, ends) in enumerate(
        (
            (True, "shadow_walk takes over from walk", 1.0),
            (True, "back to walk", 0.0),
            (False, "refused: shadow_walk has been fit for 0.", 0.0),
        ),
        1,
    ):
        rig.say("act", "swap", {})
        rig.until(lambda seen, number=number: len(seen["answers"]) == number)  # type: ignore[misc]
        answer = rig.seen()["answers"][-1]
        assert (answer[1], answer[2][: len(text)]) == (done, text)
        rig.until(lambda _, ends=ends: share == ends)  # type: ignore[misc]
    assert rig.end().faults == []


def test_an_estop_in_a_pause_ends_it(rig: Rig) -> None:
    rig.until(lambda seen: seen["tick"] > 5)
    rig.say("act", "pause", {})
    rig.until(lambda seen: seen["paused"])
    rig.say("estop")
    rig.thread.join(4.0)
    assert rig.report is not None
    assert rig.report.faults == [FAULT]


@pytest.mark.slow
def test_a_sink_that_fails_is_told_and_started_again(rig: Rig) -> None:
    rig.until(lambda seen: seen["tick"] > 5)
    (rig.folder / "say").write_text('["raise"]\n')
    time.sleep(0.5)
    (rig.folder / "say").write_text("")
    before = rig.seen()["tick"]
    rig.until(lambda seen: seen["tick"] > before + 20, 10.0)
    assert any("RuntimeError: a sink that fails" in line for line in rig.lines)
    assert rig.end().faults == []


@pytest.mark.slow
def test_a_viewer_that_was_killed_is_told_again_what_the_run_said(rig: Rig) -> None:
    line = "it was told before"
    rig.until(lambda seen: seen["tick"] > 5)
    rig.program.tell(line)
    rig.until(lambda seen: line in seen["notes"])
    (rig.folder / "seen").unlink()
    os.kill(rig.process, signal.SIGKILL)
    rig.until(lambda seen: line in seen.get("notes", ()), 10.0)
    assert rig.end().faults == []


def test_a_viewer_that_stood_still_gets_the_newest_of_what_it_had_no_room_for(shared: Rig) -> None:
    rig = shared
    rig.until(lambda seen: seen["tick"] > 5)
    peripheral, pid = rig.view._peripheral, rig.process
    assert peripheral is not None
    os.kill(pid, signal.SIGSTOP)
    for size in (3000, 0):  # until its pipe is full to the last byte
        while peripheral.wish("texts", {"filler": "x" * size}):
            pass
    rig.program.tell("nobody could read this")
    time.sleep(0.5)
    os.kill(pid, signal.SIGCONT)
    rig.until(lambda seen: "nobody could read this" in seen["notes"])


def walked(folder: Path | None, *signals: int) -> str:
    """Return the hash of the commands of a walk, in which the viewer gets some signals."""
    document = load_document("go2_walk")
    view = View({"sink": "telling_sink:Telling", "folder": str(folder)})
    program = Program(document, hooks=[] if folder is None else [view.hook])
    runner = Runner(program, RunOptions(duration=5.0, speed="max", warn=lambda _: None))
    if folder is not None:
        view.attach(runner)
        assert view._peripheral is not None
        for each in signals:
            os.kill(view._peripheral.process.pid, each)
    report = runner.run()
    view.close()
    assert report.faults == []
    return report.sha256_commands


def test_what_becomes_of_the_viewer_changes_no_command(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    pytest.importorskip("onnxruntime")
    alone = walked(None)
    assert walked(tmp_path, signal.SIGSTOP, signal.SIGKILL) == alone


@pytest.mark.slow
def test_nor_does_one_that_looks_or_has_stopped(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    pytest.importorskip("onnxruntime")
    alone = walked(None)
    assert walked(tmp_path) == alone
    assert walked(tmp_path, signal.SIGSTOP) == alone
