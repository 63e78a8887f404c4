"""Skills: asked for by button, state and in Python, refused with the values, blended, followed."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import WorkflowError
from unicon_core.blocks.controls.device import declares_controls
from unicon_core.blocks.postures import JointCommand
from unicon_core.flow import Writes
from unicon_core.robots import Robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states.standard import BUTTONS
from unicon_core.workflow import Program, load_workflow
from unicon_core.workflow.flow_yaml import skills_of

SKILLS = {
    "rise": {"do": {"pose": {"to": "stand", "duration": 0.2}}, "next": "stand"},
    "stand": {"do": "hold", "button": "A"},
    "crouch": {
        "do": {"call": {"function": f"{__name__}:Leap"}},
        "blend": 0.2,
        "next": "stand",
        "enter": "joint_pos[1] > 0.5 and max(abs(spin[0]), abs(spin[1])) < 1",
    },
    "limp": {"do": {"damp": {"damping": 3.0}}, "button": "B", "from": ["stand"], "after": 0.1},
}


def hands(buttons: Writes, sticks: Writes, controls_alive: Writes) -> Any:
    """The device: somebody else writes the buttons."""
    return lambda: None


hands.declares = declares_controls  # type: ignore[attr-defined]


class Leap:
    """Be at rest at once, and done after 15 ticks."""

    def __init__(self, command: JointCommand, *, robot: Robot) -> None:
        self.command, self.rest, self.tick = command, robot.rest_joint_pos, 0

    def __call__(self) -> bool:
        self.command.joint_pos_target[...] = self.rest
        self.command.joint_stiffness[...], self.command.joint_damping[...] = 40.0, 1.0
        self.tick += 1
        return self.tick == 15

    def reset(self) -> None:
        self.tick = 0


class Run:
    """A workflow that is ticked by hand."""

    def __init__(self, **more: Any) -> None:
        self.told: list[str] = []
        values: dict[str, Any] = {
            "robot": "go2",
            "platform": "fake",
            "rate": 50,
            "states": {
                "wanted": {"dtype": "int32", "initial": -1},
                "spin": {"shape": [2], "initial": 0.01},
            },
            "commands": [{"call": {"function": f"{__name__}:hands"}}],
            "skills": SKILLS,
            "flow": {"skills": {"on": "wanted"}},
            "safety": ["finite", "joint_limits"],
        }
        self.program = Program(**{**values, **more})
        self.states = self.program.states
        self.runner = Runner(self.program, RunOptions(speed="max", warn=self.told.append))
        skills = skills_of(self.program)
        assert skills is not None
        self.skills = skills

    def tick(self, count: int = 1) -> bool:
        return [self.runner.tick(0) for _ in range(count)][-1]

    def press(self, *names: str) -> None:
        self.states["buttons"][...] = [int(name in names) for name in BUTTONS]
        self.tick()
        self.states["buttons"][...] = 0
        self.tick()


@pytest.fixture
def run() -> Iterator[Run]:
    made = Run()
    yield made
    made.program.close()


def test_it_begins_with_the_first_and_what_follows_comes_at_its_end(run: Run) -> None:
    run.tick(10)
    assert (run.skills.now, int(run.states["skill"])) == ("rise", 0)
    last = run.states["joint_pos_target"].copy()
    run.tick()  # its last command once more
    assert run.skills.now == "rise"
    np.testing.assert_array_equal(run.states["joint_pos_target"], last)
    run.tick()
    assert (run.skills.now, int(run.states["skill"])) == ("stand", 1)
    assert run.told == ["skill: stand"]
    run.tick(100)
    assert run.told == ["skill: stand"]


def test_a_button_a_state_and_a_call_ask_for_a_skill(run: Run) -> None:
    run.tick(20)
    run.press("B")
    assert run.skills.now == "limp"
    assert not run.skills.ask("stand")
    run.tick()
    assert run.skills.now == "stand"
    run.states["wanted"][...] = 2
    run.tick()
    assert run.skills.now == "crouch"
    run.tick(20)
    assert run.skills.now == "stand"  # the state has not changed: it asks no more
    run.states["wanted"][...] = -1
    run.tick(3)
    run.states["wanted"][...] = 2
    run.tick()
    assert run.skills.now == "crouch"


def test_who_is_refused_is_told_why_with_the_values(run: Run) -> None:
    run.tick(2)
    assert run.skills.ask("limp") == "limp is entered from stand, and this is rise"
    run.tick(10)
    assert run.skills.now == "stand"
    assert "press it again in" in run.skills.ask("limp")
    run.tick(6)
    spin = run.states["spin"]
    spin[...] = [0.0, -1.5]
    reason = run.skills.ask("crouch")
    assert reason.startswith(f"{SKILLS['crouch']['enter']} does not hold: joint_pos[1] is 0.")
    assert reason.endswith("spin[0] is 0., spin[1] is -1.5")
    run.states["wanted"][...] = 2
    run.tick()
    run.states["wanted"][...] = 9
    run.tick()
    assert f"skill crouch (number 2) is refused: {reason}" in run.told
    assert run.told[-1] == "skill number 9 is refused: there are 0 to 3"
    assert run.skills.now == "stand"
    spin[...] = 0.0
    assert run.skills.ask("crouch") == ""
    assert run.skills.ask("stand") == ""  # it runs already; the last one who asks has it
    run.tick()
    assert run.skills.now == "stand"


def test_commands_do_not_jump_and_limp_joints_get_their_gains_in_time(run: Run) -> None:
    run.tick(30)
    names = ("joint_pos_target", "joint_stiffness", "joint_damping")
    before = [run.states[name].copy() for name in names]
    assert not run.skills.ask("crouch")
    jump = np.abs(run.program.robot.rest_joint_pos - before[0]).max()
    assert jump > 0.8
    largest = 0.0
    for _ in range(12):
        run.tick()
        now = [run.states[name].copy() for name in names]
        largest = max(largest, *(float(np.abs(a - b).max()) for a, b in zip(now[:1], before[:1])))
        before = now
    assert 0.0 < largest < jump / 5
    run.tick(40)
    assert not run.skills.ask("limp")
    gains = []
    for _ in range(30):
        run.tick()
        gains.append(float(run.states["joint_stiffness"].max()))
    assert gains[-1] == 0.0
    assert max(np.abs(np.diff(gains))) <= gains[0]
    assert all(a >= b for a, b in pairwise(gains))


def test_who_asks_in_the_tick_of_an_end_is_heard(run: Run) -> None:
    run.tick(11)
    assert run.skills.now == "rise"  # done: what follows comes in the next tick
    assert run.skills.ask("crouch") == ""
    run.tick()
    assert run.skills.now == "crouch"


def test_a_skill_without_a_next_ends_the_flow_and_a_reset_begins_anew() -> None:
    skills = {"rise": {"do": {"pose": {"to": "stand", "duration": 0.1}}}, "stand": {"do": "hold"}}
    run = Run(skills=skills, flow="skills")
    assert run.tick(5)
    run.runner.reset()
    assert not run.skills.ask("stand")
    run.tick(2)
    assert run.skills.now == "stand"
    run.runner.reset()
    run.tick()
    assert run.skills.now == "rise"
    run.program.close()


def test_without_buttons_no_device_is_asked_for() -> None:
    skills = {"one": {"do": "hold", "tilt": 0.5}, "two": {"do": "damp"}}
    run = Run(skills=skills, flow="skills", commands=[])
    assert "buttons" not in run.states
    assert run.skills.reads == ("projected_gravity",)
    assert not run.skills.ask("two")
    run.tick()
    assert run.skills.now == "two"
    run.states["projected_gravity"][...] = [0.0, 1.0, 0.0]
    assert run.skills.ask("one") == "the base leans 1.57 rad, at most 0.5 are allowed"
    run.program.close()


@pytest.mark.parametrize(
    ("skills", "flow", "told"),
    [
        ({"a": {"do": "hold", "next": "c"}}, "skills", "skills.a.next is 'c', which is no skill"),
        ({"a": {"do": "hold", "entry": "1"}}, "skills", "skills.a: unknown key 'entry'"),
        ({"a": {"do": "hold", "policy": "b"}}, "skills", "give {policy: NAME}, or {do: FLOW}"),
        ({"a": {"do": "hold", "blend": -1}}, "skills", "blend is -1"),
        ({"a": {"do": "hold", "enter": "no_state > 1"}}, "skills", "no state 'no_state'"),
        ({"a": {"do": "hold", "enter": True}}, "skills", "enter is true"),
        ({"a": {"do": "hold", "from": ["b"]}}, "skills", "skills.a.from: no mode 'b'"),
        ({"a b": {"do": "hold"}}, "skills", "unknown key 'a b'; write letters, digits and _"),
        ({"a": {"do": "hold"}}, {"skills": {"on": "joint_pos"}}, "not a state with one whole"),
        (
            {"a": {"do": "hold"}},
            {"skills": {"begin": "a"}},
            "flow.skills: unknown key 'begin'; known: on",
        ),
        ({"a": {"policy": "walk"}}, "skills", "no policy 'walk'"),
        ({}, "skills", "the workflow has none"),
        (
            {"a": {"do": "hold", "button": "A"}, "b": {"do": "hold", "button": "A"}},
            "skills",
            "button A leads to a and to b",
        ),
    ],
)
def test_what_is_wrong_is_told(skills: Any, flow: Any, told: str) -> None:
    with pytest.raises(WorkflowError) as caught:
        Run(skills=skills, flow=flow)
    assert told in str(caught.value)


def test_the_g1_stands_walks_dances_and_stands(assets: Path) -> None:
    pytest.importorskip("mujoco", reason="it is simulated")
    pytest.importorskip("onnxruntime", reason="its policies are ONNX")
    program = load_workflow("g1_skills", {"policies.dance.given.motion.end": 8.0})
    runner = Runner(program, RunOptions(speed="max", warn=lambda _: None))
    skills, states = skills_of(program), program.states
    assert skills is not None
    seen, steps, target = [], [], states["joint_pos_target"].copy()
    for tick in range(900):
        if tick == 50:
            assert not skills.ask("walk")
        if 60 <= tick < 200:
            states["velocity_command"][...] = [0.5, 0.0, 0.0]
        if tick == 200:
            states["velocity_command"][...] = 0.0
        if tick == 250:
            states["wanted"][...] = 2
        runner.tick(0)
        assert states["projected_gravity"][2] < -0.6, tick
        if not seen or seen[-1] != skills.now:
            seen.append(skills.now)
            if tick:
                steps.append(float(np.abs(states["joint_pos_target"] - target).max()))
        target = states["joint_pos_target"].copy()
    program.close()
    assert seen == ["stand", "walk", "dance", "stand"]
    assert states["base_pos_w"][0] > 0.8
    assert max(steps) < 0.1  # rad: the policies are up to 0.9 rad apart


def test_the_file_is_read_with_its_lines(tmp_path: Path) -> None:
    path = tmp_path / "two.yaml"
    path.write_text(
        "robot: go2\nplatform: fake\nrate: 50\nskills:\n  a: {do: hold}\n  b: {do: nothing}\n"
        "flow: skills\n",
        encoding="utf-8",
    )
    with pytest.raises(WorkflowError, match=r"two\.yaml:6: unknown block 'nothing'"):
        load_workflow(path)
