"""Pushes by a viewer: a spring to the cursor, bounded, released by silence; its records replay."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Fault
from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow import HookBlocks, Program, load_document
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording import open_record
from unicon_lab.replay import verify, workflow_of
from unicon_lab.view.driver import LARGEST_PUSH, REACH, SHARE, Driver
from unicon_lab.view.shown import DEAD_MAN, DRIVING, GIVEN_BACK, PAGE, shown_of
from unicon_lab.view.view import View
from unicon_ros.bridge.services import Controls

WORKFLOW = """\
schema: unicon.workflow/1
name: pushed
robot: go2
platform: mujoco
rate: 50
flow: {chain: [{pose: {to: stand, duration: 0.2}}, hold]}
"""
TRUNK = "base_link"


class Peripheral:
    """The process of a viewer that says what a test lets it say."""

    started, heard = 1, staticmethod(print)

    def __init__(self) -> None:
        self.answers: list[tuple[Any, ...]] = []

    def __call__(self) -> bool:
        return True

    def listen(self) -> None:
        """Nothing lies in the pipe."""

    def wish(self, what: str, *given: Any) -> bool:
        self.answers.append(given)
        return True


class Pushed:
    """A run at full speed whose viewer does in each tick what a test says.

    Args:
        folder: of the workflow.
        acts: is given the run and the tick before it begins.
        ticks: of the run, which a fault then ends.
        overrides: of the workflow.
    """

    def __init__(
        self, folder: Path, acts: Callable[[Pushed, int], None], ticks: int = 60, **overrides: Any
    ) -> None:
        path = folder / "pushed.yaml"
        path.write_text(WORKFLOW)
        document = load_document(path, overrides)
        view = View({"sink": "page"})
        view.declare(document)
        self.told, self.peripheral, self.rows = States(PAGE), Peripheral(), list[Any]()
        self._acts, self._ticks, self._count = acts, ticks, 0
        record = FaultRecord(str(folder), warn=str)
        self.program = Program(document, hooks=[self._hook, record.hook])
        runner = Runner(self.program, RunOptions(speed="max", warn=str))
        record.attach(runner)
        self.driver.attach(self.peripheral, runner)  # type: ignore[arg-type]
        self.shown, _ = shown_of(self.program, runner.graph)
        self.report = runner.run()
        self.record = record.write(self.report)

    def _hook(self, program: Program) -> HookBlocks:
        self.driver = Driver(program, self.told, Controls(time.sleep))
        blocks: dict[Stage, list[Any]] = {k: list(v) for k, v in self.driver.blocks().items()}
        blocks[Stage.RECV] = [Block("a viewer", self._before)]
        blocks[Stage.OBSERVE].append(Block("note", self._after))
        return blocks

    def _before(self) -> None:
        self._count += 1
        if self._count > self._ticks:
            raise Fault("tripped by the test")
        self.say(stamp=0.0)
        self._acts(self, self._count)

    def _after(self) -> None:
        states = self.program.states
        names = ("external_force", "external_force_body", "external_push", "base_pos_w")
        self.rows.append([np.array(states[name]) for name in names if name in states])

    def say(self, stamp: float | None = None, **values: Any) -> None:
        """Publish states of the viewer's process; `stamp` is how long ago it was heard, [s]."""
        for name, value in values.items():
            self.told[f"view_{name}"][...] = value
        if stamp is not None:
            self.told["view_stamp_ns"][...] = time.monotonic_ns() - round(1e9 * stamp)

    def drag(self, goal: tuple[float, float, float], body: str = TRUNK) -> None:
        """Take the wheel, and drag the middle of a body to a place in the world."""
        number = self.program.platform.bodies.index(body)  # type: ignore[attr-defined]
        self.say(mode=DRIVING, touch=1, pull_body=number, pull_goal=goal)

    def act(self, name: str, **arguments: Any) -> tuple[bool, str]:
        self.driver._act({"act": [name, 7, arguments]})
        number, done, text = self.peripheral.answers[-1]
        assert number == 7
        return done, text

    @property
    def forces(self) -> np.ndarray:
        return np.array([row[0] for row in self.rows])


def test_a_drag_pulls_as_a_spring_and_never_harder_than_a_part_of_the_weight(
    tmp_path: Path,
) -> None:
    near, far = (0.1, 0.0, 0.35), (0.0, 90.0, 0.3)
    goals = {20: near, 40: far}
    run = Pushed(tmp_path, lambda it, n: it.drag(goals[n]) if n in goals else None)
    largest = SHARE * run.program.platform.weight  # type: ignore[attr-defined]
    assert largest == pytest.approx(0.5 * 15.0 * 9.81, rel=0.1)  # half of a Go2
    assert not run.forces[:20].any()  # the viewer is heard after `send`
    place = run.rows[29][3]
    assert run.forces[30] == pytest.approx(largest / REACH * (near - run.rows[30][3]), rel=0.05)
    assert np.linalg.norm(run.forces[45:], axis=1) == pytest.approx(largest, rel=1e-4)
    assert run.rows[-1][3][1] > place[1] + 0.01  # it moves there


@pytest.mark.parametrize(
    "release",
    [
        lambda it: it.say(stamp=DEAD_MAN + 0.05),
        lambda it: it.say(mode=GIVEN_BACK, pull_body=0),
        lambda it: it.say(mode=GIVEN_BACK),
        lambda it: it.say(pull_body=0),
        lambda it: it.say(pull_body=-3),
        lambda it: it.say(pull_body=1_000_000),
        lambda it: it.say(mode=0, touch=0, stamp=1e6),  # its process was killed
    ],
    ids=["silence", "let go", "given back", "released", "body -3", "body 1e6", "killed"],
)
def test_a_drag_ends(tmp_path: Path, release: Callable[[Pushed], None]) -> None:
    def acts(it: Pushed, tick: int) -> None:
        if tick == 10:
            it.drag((1.0, 0.0, 0.3))
        if tick >= 30:
            release(it)

    run = Pushed(tmp_path, acts, 40)
    assert run.forces[20:29].all(axis=0)[0]
    assert not run.forces[30:].any()
    assert not any(row[1] for row in run.rows[30:])


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_drag_to_nowhere_does_not_pull(tmp_path: Path, value: float) -> None:
    run = Pushed(tmp_path, lambda it, n: it.drag((value, 0.0, 0.0)) if n == 9 else None, 30)
    assert not run.forces.any()
    assert run.report.faults == ["tripped by the test"]


def test_a_record_of_pushes_replays_and_is_simulated_again_bit_exact(tmp_path: Path) -> None:
    def acts(it: Pushed, tick: int) -> None:
        if tick == 20:
            it.drag((0.3, 0.4, 0.4), "FL_calf")
        if tick == 40:
            it.say(mode=GIVEN_BACK)
            assert it.act("push", velocity=[0.0, 0.5]) == (True, "pushed by 0.5 m/s")

    run = Pushed(tmp_path, acts)
    assert run.record is not None
    record = open_record(run.record)
    verdict = verify(record, workflow_of(record, None, {}))
    assert verdict.first is None, verdict.first
    names = ("external_force", "external_force_point", "external_force_body", "external_push")
    assert record.states("external_force").any()
    assert np.flatnonzero(record.states("external_push").any(axis=1)).tolist() == [39]
    program = Program(workflow_of(record, None, {}))
    same = list[bool]()
    for row in range(len(record.ticks)):
        program.platform.recv()
        measured = ("joint_pos", "joint_vel", "base_pos_w", "base_lin_vel")
        same += [program.states[n].tobytes() == record.states(n)[row].tobytes() for n in measured]
        for name in (*COMMAND_STATES, *names):
            program.states[name][...] = record.states(name)[row]
        if program.states["external_push"].any():
            program.platform.push(program.states["external_push"].astype(float))  # type: ignore[attr-defined]
        if record.ended[row]:
            program.platform.send()
    program.close()
    assert all(same), np.flatnonzero(np.logical_not(same))


def test_a_push_is_along_the_robots_heading_for_one_tick(tmp_path: Path) -> None:
    answers = []

    def acts(it: Pushed, tick: int) -> None:
        if tick == 20:
            answers.append(it.act("push", velocity=[0.5, 0.0]))

    run = Pushed(tmp_path, acts, 30)
    pushes = np.array([row[2] for row in run.rows])
    assert np.flatnonzero(pushes.any(axis=1)).tolist() == [19]
    assert pushes[19] == pytest.approx([0.5, 0.0], abs=0.02)


@pytest.mark.parametrize(
    ("velocity", "said"),
    [
        ([np.nan, 0.0], "give two numbers"),
        ([2.1, 0.0], f"at most {LARGEST_PUSH:g} m/s"),
        ([0.5], "give two numbers"),
        ("fast", "push is refused: could not convert"),
        (None, "push is refused"),
    ],
)
def test_a_push_that_is_none_is_refused(tmp_path: Path, velocity: Any, said: str) -> None:
    def acts(it: Pushed, tick: int) -> None:
        if tick == 5:
            done, text = it.act("push", velocity=velocity)
            assert not done
            assert said in text

    run = Pushed(tmp_path, acts, 10)
    assert run.report.faults == ["tripped by the test"]
    assert not any(row[2].any() for row in run.rows)


def test_what_is_no_simulator_is_not_pushed(tmp_path: Path) -> None:
    def acts(it: Pushed, tick: int) -> None:
        if tick == 5:
            it.say(mode=DRIVING, touch=1, pull_body=1, pull_goal=(1.0, 0.0, 0.0))
            done, text = it.act("push", velocity=[0.5, 0.0])
            assert not done
            assert "platform 'fake' cannot push a base" in text

    run = Pushed(tmp_path, acts, 10, platform="fake")
    assert (run.shown.bodies, run.shown.pushes) == ((), False)
    assert run.report.faults == ["tripped by the test"]


@pytest.mark.parametrize("platform", ["unitree_sdk2", {"child": "mujoco"}, None, "mujocco"])
def test_what_is_no_simulator_of_ours_has_no_states_of_pushes(platform: Any) -> None:
    document: Any = SimpleNamespace(values={"platform": platform})
    document.get = document.values.get
    View({"sink": "page"}).declare(document)
    assert set(document.values["states"]) == {"gain_scale"}
