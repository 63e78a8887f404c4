"""`drive`, `modes`, `button_stop` and `remote_stop`, and the two workflows that walk by buttons."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import EmergencyStopPressed, Fault, WorkflowError
from unicon_core.blocks.controls.gamepad import EVENT
from unicon_core.blocks.controls.modes import modes
from unicon_core.blocks.safety.stops import ButtonStop, RemoteStop
from unicon_core.blocks.velocity_command import Drive
from unicon_core.check import check_workflow
from unicon_core.flow import Block, Stage
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States, StateSpec
from unicon_core.states.standard import BUTTONS, control_states, standard_states
from unicon_core.workflow import HookBlocks, Program, load_document
from unicon_core.workflow.autowire import BuildContext, autowire

TO = {
    "passive": {"button": "B"},
    "stand": {"button": "A", "from": ["passive", "walk"], "tilt": 0.5},
    "walk": {"button": "start", "from": ["stand"], "after": 0.1, "calm": True},
}


class Hands:
    """The control states, and buttons that are pressed and let go."""

    def __init__(self) -> None:
        robot = load_robot("go2")
        mode = {"mode": StateSpec((), "int32")}
        self.states = States(standard_states(robot.joint_names) | control_states() | mode)
        self.told: list[str] = []
        self.context = BuildContext(self.states, robot, 0.02, tell=self.told.append)
        self.states["controls_alive"][...] = 1
        names = ("sticks", "buttons", "controls_alive", "velocity_command")
        self.controls = {name: self.states[name] for name in names}

    def hold(self, *names: str) -> None:
        self.states["buttons"][...] = [int(name in names) for name in BUTTONS]

    def modes(self, to: Mapping[str, Any] = TO, begin: str = "passive") -> Any:
        return autowire(modes, "modes", self.context, {"begin": begin, "to": to}).tick


@pytest.fixture
def hands():
    return Hands()


def test_sticks_drive_while_the_button_is_held(hands):
    tick = Drive(**hands.controls, speed=(1.0, 0.5, 2.0), dead_zone=0.2, hold="R1")
    command = hands.states["velocity_command"]
    sticks = hands.states["sticks"]
    sticks[...] = (1.0, 0.6, 0.1, 0.0)
    tick()
    assert not command.any()
    hands.hold("R1")
    tick()
    assert command.tolist() == pytest.approx([0.5, -0.5, 0.0])
    sticks[...] = (0.0, -1.0, -1.0, 0.0)
    tick()
    assert command.tolist() == pytest.approx([-1.0, 0.0, 2.0])
    sticks[0] = np.nan
    tick()
    assert command[1] == 0.0
    hands.states["controls_alive"][...] = 0
    tick()
    assert not command.any()


def test_buttons_change_modes_and_wrong_ones_are_refused_with_the_reason(hands):
    tick = hands.modes()
    hands.hold("A")  # held down from before: it counts once it is pressed
    assert tick() == "passive"
    hands.hold("start")
    assert tick() == "passive"
    assert hands.told == ["start is refused: walk is entered from stand, and this is passive"]
    hands.hold("A")
    hands.states["projected_gravity"][...] = (1.0, 0.0, 0.0)
    assert tick() == "passive"
    assert hands.told[-1] == "A is refused: the base leans 1.57 rad, at most 0.5 are allowed"
    hands.states["projected_gravity"][...] = (0.0, 0.0, -1.0)
    assert tick() == "passive"  # it is still held
    hands.hold()
    tick()
    hands.hold("A")
    assert tick() == "stand"
    assert hands.told[-1] == "mode: stand"
    assert hands.states["mode"] == 1
    hands.hold("start")
    assert tick() == "stand"
    assert hands.told[-1] == "start is refused: stand is not at its end, press it again in 0.1 s"
    hands.hold()
    for _ in range(6):
        tick()
    hands.states["sticks"][1] = 0.5
    hands.hold("start")
    assert tick() == "stand"
    assert hands.told[-1] == "start is refused: a stick is pushed; let go of it first"
    hands.states["sticks"][1] = 0.0
    hands.hold()
    tick()
    hands.hold("start")
    assert tick() == "walk"
    hands.states["projected_gravity"][...] = np.nan
    hands.hold("B", "A")
    assert tick() == "passive"  # the first in the list, whatever else is pressed
    tick.reset()
    hands.hold("A")
    assert tick() == "passive"


@pytest.mark.parametrize(
    ("to", "message"),
    [
        ({}, "to is {}; write {stand: {button: A}}"),
        ({"stand": "A"}, "to.stand is 'A'; write {button: NAME}"),
        ({"stand": {"button": "a"}}, "to.stand.button 'a' is not known; known: A, B"),
        (
            {"stand": {"button": "A", "form": []}},
            "to.stand: unknown key 'form'; did you mean 'from'",
        ),
        ({"stand": {"button": "A", "from": ["lie"]}}, "to.stand.from: no mode 'lie'"),
        ({"stand": {"button": "A", "from": "passive"}}, "to.stand.from is 'passive'; write a list"),
        ({"stand": {"button": "A", "after": "2"}}, "to.stand.after is '2'; write a number from 0"),
        ({"stand": {"button": "A", "tilt": 9.0}}, "tilt"),
        ({"stand": {"button": "A", "calm": 1}}, "to.stand.calm is 1; write true or false"),
        ({"stand": {"button": "A"}, "walk": {"button": "A"}}, "button A leads to stand and to"),
    ],
)
def test_wrong_modes_are_named(hands, to, message):
    with pytest.raises(WorkflowError) as raised:
        hands.modes(to)
    assert message in str(raised.value)


def test_a_button_or_a_lost_device_stops(hands):
    seen = {name: hands.states[name] for name in ("buttons", "controls_alive")}
    tick = ButtonStop(**seen, period=0.02, on=["select", "F1"], lost=0.04)
    tick()
    hands.hold("F1")
    with pytest.raises(Fault, match="the operator pressed F1"):
        tick()
    hands.hold()
    hands.states["controls_alive"][...] = 0
    tick()
    tick()
    with pytest.raises(Fault, match="not heard for 3 ticks; more than 2"):
        tick()
    tick.reset()
    tick()
    for stop in (ButtonStop, RemoteStop):
        with pytest.raises(WorkflowError, match=r"on\.0 'halt' is not known; known: A, B"):
            autowire(stop, "stop", hands.context, {"on": ["halt"]})
        with pytest.raises(WorkflowError, match="on is 'select'; write a list of buttons"):
            autowire(stop, "stop", hands.context, {"on": "select"})


def test_the_remote_stops_where_all_buttons_are_held_for_two_ticks(hands):
    buttons = hands.states["buttons"]
    tick = RemoteStop(buttons, robot=load_robot("go1"))
    assert tick.names == ("L2", "B")
    for pressed in ([], ["L2"], ["B"], ["L2", "B"], ["L2"], ["L2", "B"]):  # never for two ticks
        hands.hold(*pressed)
        tick()
    with pytest.raises(EmergencyStopPressed, match=r"the operator pressed L2\+B on the remote"):
        tick()
    tick.reset()
    tick()
    RemoteStop(buttons, robot=load_robot("t1"), on=["select"])
    with pytest.raises(WorkflowError, match=r"t1.yaml has no transport.stop_buttons; give on: "):
        RemoteStop(buttons, robot=load_robot("t1"))


@pytest.mark.parametrize(
    ("robot", "platform", "commands", "found"),
    [
        ("go1", "unitree_legged", [], "note"),
        ("go1", "unitree_legged", [{"drive": {"hold": "L2"}}], "note"),
        ("go1", "unitree_legged", [{"drive": {"hold": "L2"}}, {"button_stop": {"on": ["B"]}}], ""),
        ("t1", "booster", [], "left out"),
        ("go1", "mujoco", [], "none"),
    ],
)
def test_check_names_the_buttons_that_stop_and_who_else_uses_them(
    tmp_path, robot, platform, commands, found
):
    inputs = [each for each in commands if "drive" in each]
    stops = [each for each in commands if "drive" not in each]
    values = {
        "schema": "unicon.workflow/1",
        "robot": robot,
        "platform": platform,
        "rate": 50,
        "commands": inputs,
        "flow": "hold",
        "safety": ["finite", "joint_limits", *stops],
    }
    path = tmp_path / "ours.yaml"
    path.write_text(json.dumps(values), "utf-8")
    result = check_workflow(path)
    codes = [each.code for each in (*result.findings, *result.notes)]
    if found in ("left out", "none"):
        assert "safety.remote" not in codes
        left = [n.evidence for n in result.notes if n.code == "safety.less"]
        wanted = "t1.yaml has no transport.stop_buttons"
        assert any(wanted in each for each in left) == (found == "left out")
    elif found == "note":
        assert [n.culprit for n in result.notes if n.code == "safety.remote"] == ["L2+B"]
        assert not result.findings
    else:
        (error,) = [each for each in result.findings if each.code == "safety.remote"]
        assert "and means something else to drive, button_stop" in error.evidence


CODES = {"A": 0x130, "B": 0x131, "X": 0x133, "R1": 0x137, "select": 0x13A, "start": 0x13B}


class Player:
    """Presses buttons of a pipe at ticks, and notes mode and posture."""

    def __init__(self, folder: Path, script: Mapping[int, tuple[str | int, int]]) -> None:
        self.path = folder / "pad"
        os.mkfifo(self.path)
        self._file = os.open(self.path, os.O_RDWR | os.O_NONBLOCK)
        self._script = dict(script)
        self._tick = 0
        self.modes: list[int] = []
        self.x: list[float] = []
        self.height: list[float] = []

    def hook(self, program: Program) -> HookBlocks:
        states = program.states

        def play() -> None:
            self.modes.append(int(states["mode"]))
            self.x.append(float(states["base_pos_w"][0]))
            self.height.append(float(states["base_pos_w"][2]))
            said = self._script.get(self._tick)
            if said is not None:
                what, value = said
                kind, code = (1, CODES[what]) if isinstance(what, str) else (3, what)
                os.write(self._file, EVENT.pack(0, 0, kind, code, value))
            self._tick += 1

        return {Stage.OBSERVE: [Block("play", play, endless=True)]}

    def run(self, workflow: str, duration: float) -> tuple[list[str], Any]:
        told: list[str] = []
        document = load_document(workflow, {"commands": [{"gamepad": {"device": str(self.path)}}]})
        document.values["commands"].append({"drive": {"speed": [0.8, 0.4, 0.8], "hold": "R1"}})
        program = Program(document, hooks=[self.hook])
        runner = Runner(program, RunOptions(speed="max", duration=duration, warn=told.append))
        report = runner.run()
        os.close(self._file)
        return told, report


GO2 = {
    5: ("start", 1),
    8: ("start", 0),
    10: ("A", 1),
    12: ("A", 0),
    50: ("start", 1),
    52: ("start", 0),  # too early
    140: ("X", 1),
    142: ("X", 0),
    260: ("A", 1),
    262: ("A", 0),
    400: ("start", 1),
    402: ("start", 0),
    410: ("R1", 1),
    411: (0x01, -32768),
    560: (0x01, 0),
    561: ("R1", 0),
    600: ("A", 1),
    602: ("A", 0),
    700: ("B", 1),
    702: ("B", 0),
}


def test_a_go2_goes_through_all_its_modes(tmp_path):
    pytest.importorskip("mujoco")
    pytest.importorskip("onnxruntime")
    player = Player(tmp_path, GO2)
    told, report = player.run("go2_buttons", 15.0)
    assert report.faults == []
    assert [line for line in told if line.startswith("mode: ")] == [
        f"mode: {mode}" for mode in ("stand", "lie", "stand", "walk", "stand", "passive")
    ]
    refused = [line for line in told if "refused" in line]
    assert refused[0].startswith("start is refused: walk is entered from stand")
    assert refused[1].startswith("start is refused: stand is not at its end")
    assert len(refused) == 2
    x = np.array(player.x)
    height = np.array(player.height)
    assert height[130] > 0.25  # stands
    assert height[255] < 0.15  # lies
    assert x[560] - x[410] > 1.0  # walks
    assert abs(x[690] - x[620]) < 0.1  # stands again
    assert height[690] > 0.25
    assert height[-1] < 0.2  # lets go


def test_select_stops_the_run(tmp_path):
    pytest.importorskip("mujoco")
    pytest.importorskip("onnxruntime")
    player = Player(tmp_path, {20: ("select", 1)})
    _, report = player.run("go2_buttons", 2.0)
    assert report.faults == ["the operator pressed select"]
    assert report.ticks < 25


def test_a_g1_goes_through_all_its_modes(tmp_path, assets):
    pytest.importorskip("mujoco")
    pytest.importorskip("onnxruntime")
    script = {
        1: ("A", 1),
        3: ("A", 0),
        30: ("start", 1),
        32: ("start", 0),
        90: ("start", 1),
        92: ("start", 0),
        100: ("R1", 1),
        101: (0x01, -32768),
        250: (0x01, 0),
        251: ("R1", 0),
        320: ("X", 1),
        322: ("X", 0),
    }
    player = Player(tmp_path, script)
    told, report = player.run("g1_buttons", 10.0)
    assert report.faults == []
    assert [line for line in told if line.startswith("mode: ")] == [
        f"mode: {mode}" for mode in ("stand", "walk", "lie")
    ]
    assert any(line.startswith("start is refused: stand is not at its end") for line in told)
    x = np.array(player.x)
    height = np.array(player.height)
    assert height[:310].min() > 0.65
    assert x[250] - x[100] > 0.8
    assert height[-1] < 0.6
