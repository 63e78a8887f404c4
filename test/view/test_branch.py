"""A run that goes on from its past: bit-exact, with another gain, in a pause, and what refuses."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_push import Peripheral

from unicon_base.errors import Fault
from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner, RunOptions
from unicon_core.runtime.phases import Phase
from unicon_core.runtime.rollouts import BACK_S, EVERY_S
from unicon_core.states import States
from unicon_core.workflow import HookBlocks, Program, load_document
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording import open_record
from unicon_lab.replay import verify, workflow_of
from unicon_lab.view.driver import Driver
from unicon_lab.view.shown import PAGE
from unicon_ros.bridge.services import Controls
from unicon_ros.parameters import Tuning

SCENE = "scene: {seed: 3, noise: {joint_vel: 0.1}, delay: 1, push: {every: 2.0, velocity: 0.3}}\n"
WALKS = f"""\
schema: unicon.workflow/1
name: walks
robot: go2
platform: mujoco
{SCENE}rate: 50
policies: {{walk: go2_velocity}}
commands: [{{velocity_command: {{constant: [0.4, 0.0, 0.2]}}}}]
flow: {{chain: [{{pose: {{to: stand, duration: 0.4}}}}, {{policy: walk}}]}}
"""
DIVIDED = f"""\
name: branch-{os.getpid()}
parts: {{robot: {{publishes: [joint_pos]}}, desk: {{publishes: [velocity_command]}}}}
store: shm
"""
SECOND = 50  # ticks


class Branched:
    """A run at full speed whose viewer does behind each tick what a test says.

    Args:
        folder: of the workflow.
        acts: is given the run and the number of ticks that have run.
        ticks: of the run, which a fault then ends.
        text: of the workflow.
        slow: what each tick takes besides, in [s].
        part: of a divided workflow.
        options: of the run.

    Attributes:
        rows: number and states of each tick.
    """

    def __init__(
        self,
        folder: Path,
        acts: Callable[[Branched, int], object],
        ticks: int = 8 * SECOND,
        text: str = WALKS,
        slow: float = 0.0,
        part: str = "",
        **options: Any,
    ) -> None:
        path = folder / "walks.yaml"
        path.write_text(text)
        document, self.tuning, self.lines = load_document(path, []), Tuning(), list[str]()
        self.tuning.declare(document)
        self.peripheral, self.rows = Peripheral(), list[tuple[int, bytes]]()
        self._slow = slow
        self._acts, self._ticks, self.controls = acts, ticks, Controls(time.sleep)
        record = FaultRecord(str(folder), warn=str)
        self.program = Program(document, part=part, hooks=[self._hook, record.hook])
        given = {"speed": "max"} | options
        self.runner = Runner(self.program, RunOptions(warn=self.lines.append, **given))
        record.attach(self.runner)
        self.controls.runner = self.runner
        self.controls.others += [self.driver.look]
        self.driver.attach(self.peripheral, self.runner)  # type: ignore[arg-type]
        self.report = self.runner.run()
        assert self.report.faults == ["tripped by the test"], self.report.traceback
        self.record = record.write(self.report)

    def _hook(self, program: Program) -> HookBlocks:
        self.driver = Driver(program, States(PAGE), self.controls, self.tuning)
        blocks = {stage: list(each) for stage, each in self.tuning.hook(program).items()}
        for stage, each in self.driver.blocks().items():
            blocks[stage] = [*each, *blocks.get(stage, [])]
        if self._slow:
            blocks[Stage.RECV] = [Block("slow", lambda: time.sleep(self._slow), endless=True)]
        blocks[Stage.OBSERVE].append(Block("note", self._after))
        return blocks

    def _after(self) -> None:
        states = self.program.states
        if self.runner.phase is not Phase.RUN:  # it is damped
            return
        self.rows.append((int(states["tick"].flat[0]), states.buffer.tobytes()))
        self._acts(self, len(self.rows))
        if len(self.rows) == self._ticks:
            raise Fault("tripped by the test")

    def act(self, name: str, /, **arguments: Any) -> tuple[bool, str]:
        self.driver._act({"act": [name, 7, arguments]})
        _, done, text = self.peripheral.answers[-1]
        return done, text

    def branch(self, tick: float, then: str = "") -> tuple[bool, str]:
        return self.act("branch", tick=tick, then=then)

    def since(self, row: int, count: int) -> list[tuple[int, bytes]]:
        return self.rows[row : row + count]


def test_a_branch_without_a_change_repeats_the_ticks_bit_exact(tmp_path: Path) -> None:
    said: list[Any] = []

    def acts(run: Branched, count: int) -> None:
        if count in (4 * SECOND, 7 * SECOND):
            said.append(run.branch(2.2 * SECOND))

    run = Branched(tmp_path, acts, 12 * SECOND)
    assert [done for done, _ in said] == [True, True]
    first, second = 4 * SECOND, 7 * SECOND
    begin = run.rows[first][0]
    assert 1.5 * SECOND < begin <= 2.2 * SECOND
    assert said[0][1] == f"the run goes on from {begin / SECOND:.2f} s"
    assert run.rows[second][0] == begin
    original = run.since(begin, 2 * SECOND)  # until it was left
    original = original[: first - begin]
    assert len(original) >= 1.8 * SECOND
    assert run.since(first, len(original)) == original
    assert run.since(second, 3 * SECOND) == run.since(first, 3 * SECOND)
    assert len({states for _, states in original}) == len(original)  # it moved
    text = f"viewer: the run goes on from {begin / SECOND:.2f} s, set back from 4.00 s"
    assert text in run.lines


def test_another_gain_makes_another_run_and_its_record_says_so(tmp_path: Path) -> None:
    def acts(run: Branched, count: int) -> None:
        if count == 4 * SECOND:
            assert run.act("set_parameter", name="stiffness_scale", value=0.8)[0]
            assert run.branch(3 * SECOND)[0]
        if count == 6 * SECOND:  # with the gains of the flow again
            assert run.act("set_parameter", name="stiffness_scale", value=1.0)[0]
            assert run.branch(3 * SECOND)[0]

    run = Branched(tmp_path, acts)
    begin, first, second = run.rows[4 * SECOND][0], 4 * SECOND, 6 * SECOND
    original = run.since(begin, first - begin)
    assert run.since(first, 5) != original[:5]
    assert run.since(second, len(original)) == original
    assert run.record is not None
    record = open_record(run.record)
    verdict = verify(record, workflow_of(record))
    assert verdict.differing == 0
    assert verdict.ticks == len(record.ticks) - 1 > 6 * SECOND  # all but the one of the fault
    assert verdict.first is None
    text = f"the run was set back from tick {first} to tick {begin}: a branch"
    assert [note for note in verdict.notes if text in note] != []


def test_a_branch_from_scaled_gains_takes_their_factor_out_again(tmp_path: Path) -> None:
    """The pose writes no gains in its ticks: what a scale did to them must not stay."""
    stiff: list[float] = []

    def acts(run: Branched, count: int) -> None:
        stiff.append(float(run.program.states["joint_stiffness"][0]))
        if count == SECOND:
            run.act("set_parameter", name="stiffness_scale", value=0.5)
        if count == 3 * SECOND:
            run.act("set_parameter", name="stiffness_scale", value=1.0)
        if count == 4 * SECOND:
            assert run.branch(2 * SECOND)[0]

    text = WALKS.replace("{policy: walk}", "hold").replace("policies: {walk: go2_velocity}\n", "")
    Branched(tmp_path, acts, 5 * SECOND, text)
    assert stiff[SECOND - 1] == pytest.approx(2.0 * stiff[2 * SECOND])
    assert stiff[4 * SECOND :] == [stiff[SECOND - 1]] * SECOND


def test_a_pause_is_branched_at_once(tmp_path: Path) -> None:
    seen: list[Any] = []

    class Look:
        """What the page does in a pause: it branches, ticks once, and goes on."""

        def __init__(self, run: Branched) -> None:
            self.run, self.looks = run, 0

        def __call__(self) -> None:
            self.looks += 1
            if self.looks == 1:
                self.run.peripheral.listen = self.listen  # type: ignore[method-assign]
                self.run.driver._acts = memoryview(np.ones(1, np.int64).data)
            if self.looks == 3:
                seen.append(int(self.run.program.states["tick"]))
                self.run.controls.step()
            if self.looks == 5:
                self.run.controls.start()

        def listen(self) -> None:
            seen.append(self.run.branch(SECOND))

    def acts(run: Branched, count: int) -> None:
        if count == 2 * SECOND:
            run.controls.others.append(Look(run))
            run.controls.pause()

    run = Branched(tmp_path, acts, 3 * SECOND)
    assert [done for done, _ in seen[:1]] == [True]
    assert seen[1] == run.rows[2 * SECOND][0] <= SECOND
    assert [tick for tick, _ in run.since(2 * SECOND, 10)] == list(range(seen[1], seen[1] + 10))


@pytest.mark.parametrize(
    ("old", "new", "options", "answer"),
    [
        ("platform: mujoco\n", "platform: fake_robot\n", {"speed": "real"}, "is a real robot"),
        ("rate: 50", "rate: 50\nnum_robots: 2", {}, "leave out num_robots"),
        ("go2_velocity}", "{path: go2_velocity, child: {}}}", {}, "computes elsewhere"),
        ("name: walks\n", DIVIDED, {"part": "robot"}, "part 'robot' cannot go back without"),
        ("", "", {"native": True}, "leave out --native"),
        ("", "", {"returns": False}, "leave out --collect"),
    ],
)
def test_what_cannot_go_back_says_so(
    tmp_path: Path, old: str, new: str, options: dict[str, Any], answer: str
) -> None:
    said: list[Any] = []
    text = WALKS.replace(old, new)
    if "parts:" in text:
        text = text.replace("[{velocity", "[{on: desk, velocity")
    if "mujoco" not in text or "num_robots" in text:
        text = text.replace(SCENE, "")

    def acts(run: Branched, count: int) -> None:
        if count == 20:
            said.append(run.branch(10))

    Branched(tmp_path, acts, 25, text, **options)
    ((done, line),) = said
    assert not done
    assert line.startswith("branch is refused: ")
    assert answer in line
    assert "\n" not in line


@pytest.mark.parametrize("tick", [np.nan, np.inf, -np.inf, -1, 0, "x", None, [1]])
def test_a_moment_that_is_none_is_refused_and_the_run_goes_on(tmp_path: Path, tick: Any) -> None:
    said: list[Any] = []

    def acts(run: Branched, count: int) -> None:
        if count == 2 * SECOND:
            said.append(run.branch(tick))

    text = WALKS.replace("mujoco", "fake").replace(SCENE, "")
    run = Branched(tmp_path, acts, 3 * SECOND, text.replace("{policy: walk}", "hold"))
    ticks = [number for number, _ in run.rows]
    if tick == np.inf:  # the newest one that is kept
        assert said[0][0]
        assert ticks[2 * SECOND] in range(round((2 - EVERY_S) * SECOND) - 1, 2 * SECOND)
    else:
        assert not said[0][0]
        assert "refused" in said[0][1]
        assert ticks == list(range(3 * SECOND))


def test_a_minute_is_kept_and_no_more(tmp_path: Path) -> None:
    said: list[Any] = []

    def acts(run: Branched, count: int) -> None:
        if count == 90 * SECOND:
            said.extend(run.branch(second * SECOND) for second in (29, 32))

    text = WALKS.replace("mujoco", "fake").replace(SCENE, "")
    run = Branched(tmp_path, acts, 91 * SECOND, text.replace("{policy: walk}", "hold"))
    assert BACK_S == 60.0
    assert not said[0][0]
    assert "choose one from 30." in said[0][1]
    assert said[1][0]
    rewind = run.driver._rewind
    assert rewind is not None
    assert len(rewind._kept) <= round(BACK_S / EVERY_S)


def test_a_skill_or_a_swap_takes_over_where_it_branches(tmp_path: Path) -> None:
    text = WALKS + "shadow: {walk: {path: go2_stairs, limit: 1.0}}\n"

    def acts(run: Branched, count: int) -> None:
        if count == 5 * SECOND:
            assert run.branch(4 * SECOND, "swap")[0]
        if count == 7 * SECOND:
            assert run.branch(4 * SECOND)[0]
        if count == 8 * SECOND:
            assert run.branch(4 * SECOND, "fly")[0]

    run = Branched(tmp_path, acts, 9 * SECOND, text)
    share = [States(run.program.states.layout, buffer=None) for _ in range(2)]
    for states, row in zip(share, (7 * SECOND - 1, 8 * SECOND - 1)):
        states.buffer[:] = np.frombuffer(run.rows[row][1], np.uint8)
    assert [float(states["shadow_walk_share"]) for states in share] == [1.0, 0.0], run.lines
    assert any("shadow_walk takes over from walk" in line for line in run.lines)
    assert any("no skill 'fly'" in line for line in run.lines)


def test_a_swap_that_was_asked_for_is_left_behind_and_a_run_that_ends_is_not_branched(
    tmp_path: Path,
) -> None:
    text = WALKS + "shadow: {walk: {path: go2_stairs, limit: 1.0}}\n"
    ends: list[Any] = []

    def acts(run: Branched, count: int) -> None:
        if count == 5 * SECOND:
            assert run.act("swap")[0]
            assert run.branch(4 * SECOND)[0]
        if count == 7 * SECOND:
            assert run.act("swap")[0]
            assert run.branch(4 * SECOND, "swap")[0]
        if count == 8 * SECOND:
            run.runner.stop()
            ends.append(run.branch(4 * SECOND))

    run = Branched(tmp_path, acts, 8 * SECOND, text)
    share = [States(run.program.states.layout, buffer=None) for _ in range(2)]
    for states, row in zip(share, (7 * SECOND - 1, 8 * SECOND - 1)):
        states.buffer[:] = np.frombuffer(run.rows[row][1], np.uint8)
    assert [float(states["shadow_walk_share"]) for states in share] == [0.0, 1.0], run.lines
    assert not any("refused" in line for line in run.lines)
    assert ends == [(False, "branch is refused: the run is about to end")]


def test_moments_cost_a_tick_nothing_that_has_no_time(tmp_path: Path) -> None:
    """Where ticks leave too little slack nothing is kept, and a branch says that."""
    said: list[Any] = []

    def acts(run: Branched, count: int) -> None:
        if count == 60:
            said.append(run.branch(50))

    text = WALKS.replace("mujoco", "fake").replace(SCENE, "")
    Branched(tmp_path, acts, 62, text.replace("{policy: walk}", "hold"), 0.0195, speed="real")
    assert said == [(False, "branch is refused: that time is not kept; choose one from later on")]
