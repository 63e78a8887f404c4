"""The emulator behind a face that the test drives: what it obeys, tells, and does by itself."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import udp_robot
from numpy.typing import NDArray

from unicon_base.errors import UniconError
from unicon_core.blocks.maps import projected_gravity
from unicon_core.robots import Robot, load_robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_hardware.emulate import body
from unicon_hardware.emulate.body import Defects
from unicon_hardware.emulate.emulator import SILENCE, Emulator, emulated
from unicon_ros.cli.main import main

PERIOD = 0.002
ROBOT = load_robot("go2")


class Scripted:
    """A face whose commands are what the test says, as a target and a stiffness of all joints."""

    def __init__(self, states: States) -> None:
        self.rate, self.dead_man, self.obeys = 1.0 / PERIOD, float("inf"), True
        self.states = states
        self.commands: list[tuple[Any, float]] = []
        self.told: list[dict[str, NDArray[Any]]] = []
        self.closed = 0

    def tell(self) -> None:
        self.told.append({name: self.states[name].copy() for name in self.states})

    def hear(self) -> bool:
        if not self.commands:
            return False
        target, stiffness = self.commands.pop(0)
        for name, value in zip(COMMAND_STATES, (target, 0.0, 0.0, stiffness, 1.0)):
            self.states[name][...] = value
        return True

    def close(self) -> None:
        self.closed += 1


class Stage:
    """An emulated robot with a scripted face, a clock of its own, and what it has said."""

    def __init__(self, robot: Robot = ROBOT, model: str | None = "fake", **options: Any) -> None:
        self.lines: list[dict[str, Any]] = []
        self.now = 100.0

        def face(states: States, robot: Robot) -> Scripted:
            self.face = Scripted(states)
            return self.face

        self.emulator: Emulator = emulated(
            robot,
            face,
            model=model,
            say=lambda kind, **facts: self.lines.append({"kind": kind, **facts}),
            warn=lambda text: self.lines.append({"kind": "warning", "text": text}),
            **options,
        )

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.now += PERIOD
            self.emulator.tick(self.now)

    def of(self, kind: str) -> list[dict[str, Any]]:
        return [line for line in self.lines if line["kind"] == kind]

    @property
    def pos(self) -> NDArray[Any]:
        return self.face.told[-1]["joint_pos"]


def test_it_holds_its_posture_until_it_obeys_and_says_how_far_the_first_command_was() -> None:
    stage = Stage(still=True)
    face = stage.face
    face.obeys = False
    start = ROBOT.rest_joint_pos
    face.commands = [(start + 0.5, 40.0)] * 3
    stage.tick(100)
    np.testing.assert_allclose(stage.pos, start, atol=1e-6)
    assert [line["kind"] for line in stage.lines] == ["ready", "ignored"]
    assert stage.of("ready")[0]["posture"]["FR_calf_joint"] == -2.65
    face.obeys = True
    target = start + np.float32(0.1)
    face.commands = [(target, 40.0)] * 60
    stage.tick(500)
    np.testing.assert_allclose(stage.pos, target, atol=1e-3)
    assert stage.of("first")[0]["distance"] == pytest.approx(0.1, abs=1e-5)
    assert [line["count"] for line in stage.of("commands")] == [50]


def test_its_dead_man_damps_it_until_the_next_command() -> None:
    stage = Stage(still=True)
    face = stage.face
    face.dead_man = 0.1
    stage.tick(500)
    assert stage.of("damping") == []  # nobody has commanded yet
    target = ROBOT.rest_joint_pos + np.float32(0.1)
    face.commands = [(target, 40.0)]
    stage.tick(1)
    stage.tick(49)
    assert stage.of("damping") == []
    stage.tick(2)
    (damping,) = stage.of("damping")
    assert damping["by"] == "dead man"
    assert damping["silent"] == pytest.approx(0.1, abs=2 * PERIOD)
    assert not stage.face.states["joint_stiffness"].any()
    np.testing.assert_array_equal(face.states["joint_damping"], ROBOT.joint_damping)
    where = stage.pos.copy()
    stage.tick(100)
    sunk = stage.pos - where  # limp, and on its way to the middle of each range
    assert 0.0 < np.abs(sunk).max() < 0.02
    middle = 0.5 * (ROBOT.lower + ROBOT.upper)
    assert (sunk * (middle - where) >= 0.0).all()
    where = stage.pos.copy()
    face.commands = [(target, 40.0)]
    stage.tick(40)
    assert stage.of("first")[1]["distance"] == pytest.approx(np.abs(target - where).max(), abs=1e-3)
    assert np.abs(stage.pos - target).max() < np.abs(where - target).max()
    assert len(stage.of("silence")) == 1


def test_without_a_dead_man_it_goes_on_and_silence_is_told() -> None:
    stage = Stage(still=True)
    target = ROBOT.rest_joint_pos + np.float32(0.1)
    stage.face.commands = [(target, 40.0)]
    stage.tick(round(2 * SILENCE / PERIOD))
    np.testing.assert_allclose(stage.pos, target, atol=1e-3)
    assert len(stage.of("silence")) == 1
    assert stage.of("damping") == []
    stage.face.commands = [(target, 40.0), (target, 0.0)]
    stage.tick(2)
    assert [line["by"] for line in stage.of("damping")] == ["command"]
    assert len(stage.of("first")) == 2


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_command_that_is_not_finite_is_left(value: float) -> None:
    stage = Stage(still=True)
    target = ROBOT.rest_joint_pos + np.float32(0.1)
    stage.face.commands = [(target, 40.0), (value, 40.0), (target, value)]
    stage.tick(500)
    np.testing.assert_allclose(stage.pos, target, atol=1e-3)
    assert [line["count"] for line in stage.of("refused")] == [1]
    assert stage.emulator.ticks == 500


def test_sensors_and_motors_are_as_wrong_as_is_asked() -> None:
    swapped, dead = (0, 3), (5,)
    defects = Defects(swapped, dead, imu_upside_down=True, rate=50.0)
    stage = Stage(posture="default", defects=defects)
    target = ROBOT.default_joint_pos + np.float32(0.2)
    stage.face.commands = [(target, 40.0)] * 500
    stage.tick(500)
    assert len(stage.face.told) == 50
    told = stage.face.told[-1]
    assert abs(told["joint_pos"][5] - ROBOT.default_joint_pos[5]) < 0.1  # it sinks
    assert abs(told["joint_pos"][0] - target[3]) < 0.01
    assert abs(told["joint_pos"][3] - target[0]) < 0.01
    down = np.zeros(3, np.float32)
    projected_gravity(told["base_quat"], down)()
    assert down[2] == pytest.approx(1.0, abs=1e-3)  # by orientation and by accelerometer
    assert told["base_lin_acc"][2] == pytest.approx(-9.81, abs=0.2)
    np.testing.assert_allclose(told["projected_gravity"], down, atol=1e-2)


def test_the_same_seed_is_the_same_robot_and_another_one_another() -> None:
    stages = [Stage(posture="random", seed=seed) for seed in (3, 3, 4)]
    for stage in stages:
        stage.tick(20)
    one, same, other = (stage.face.told[-1] for stage in stages)
    for name in ("joint_pos", "joint_vel", "base_ang_vel", "base_lin_acc", "base_quat"):
        np.testing.assert_array_equal(one[name], same[name])
        assert (one[name] != other[name]).any()
    before = stages[0].face.told[-2]
    assert (before["base_ang_vel"] != one["base_ang_vel"]).all()  # noise
    for name in ("go2", "g1_29dof"):
        robot = load_robot(name)
        drawn = [body.random_posture(robot, np.random.default_rng(seed)) for seed in range(50)]
        assert all((robot.lower < pos).all() and (pos < robot.upper).all() for pos in drawn)
        assert np.ptp(drawn, axis=0).min() > 0.2


def test_a_robot_stands_lies_or_hangs_in_mujoco() -> None:
    pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")
    heights = {}
    for posture, hang in (("rest", False), ("default", False), ("random", True)):
        stage = Stage(model=None, posture=posture, hang=hang, seed=2)
        stage.tick(500)
        told = stage.face.told[-1]
        heights[posture] = float(told["base_pos_w"][2])
        assert told["projected_gravity"][2] < -0.95
        assert np.abs(told["joint_vel"]).max() < 1.0
        assert stage.of("ready")[0]["model"].endswith("go2.xml")
    assert heights["rest"] < 0.15
    assert heights["default"] > 0.25
    assert heights["random"] > 0.3


def test_a_gantry_lets_go_some_time_after_the_first_command() -> None:
    pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")
    stage = Stage(model=None, posture="default", let_go=0.1)
    start = stage.face.states["base_pos_w"][2].copy()
    stage.tick(500)
    assert stage.of("let go") == []
    assert stage.face.told[-1]["base_pos_w"][2] == pytest.approx(start, abs=0.01)
    stage.face.commands = [(ROBOT.default_joint_pos, 0.0)]
    stage.tick(500)
    assert len(stage.of("let go")) == 1
    assert stage.face.told[-1]["base_pos_w"][2] < 0.5 * start  # without stiffness it lies down


@pytest.mark.parametrize("busy", [0.0, 0.5])
def test_a_second_in_which_its_time_stood_still_is_told(busy: float) -> None:
    """A stall as of a busy machine; a driver sees a pause."""
    stage = Stage()
    hear, stalls = stage.face.hear, [busy]

    def stalled() -> bool:
        time.sleep(stalls.pop() if stalls else 0.0)
        return hear()

    stage.face.hear = stalled  # type: ignore[method-assign]
    stage.emulator.run(1.1)
    told = [line["missed"] for line in stage.of("late")]
    assert all(line["of"] == 500 for line in stage.of("late"))
    assert stage.of("ended")[0]["missed"] >= sum(told)
    assert max(told, default=0) >= 500 * busy - 5


def test_it_makes_up_for_short_stalls_and_its_time_goes_with_its_physics() -> None:
    stage = Stage()
    face, times = stage.face, []
    face.now = 0.0  # type: ignore[attr-defined]
    stage.emulator._timed = face  # type: ignore[assignment]
    tell = face.tell

    def late() -> None:
        times.append(face.now)  # type: ignore[attr-defined]
        time.sleep(0.02 if len(times) % 50 == 0 else 0.0)
        tell()

    face.tell = late  # type: ignore[method-assign]
    began = time.monotonic()
    stage.emulator.run(1.0)
    missed = stage.of("ended")[0]["missed"]
    assert stage.emulator.ticks + missed == 500
    assert times[-1] - times[0] == pytest.approx(499 * PERIOD, abs=1e-6)
    if not missed:  # this machine did not stall by itself
        assert np.diff(times) == pytest.approx(PERIOD, abs=1e-6)
        assert abs(times[0] - began) < 0.1


def test_torques_are_limited_by_the_servo() -> None:
    pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")
    stage = Stage(model=None, posture="default", hang=True)
    stage.face.commands = [(ROBOT.default_joint_pos + 0.3, 5000.0)] * 3
    stage.tick(3)
    effort = np.abs(stage.face.told[-1]["joint_effort"])
    assert (effort <= ROBOT.effort_limit * 1.001).all()
    assert effort.max() > 20.0


def test_a_robot_without_its_model_is_joints_alone_and_says_so() -> None:
    stage = Stage(load_robot("n1"), model=None)
    stage.tick(10)
    assert stage.of("ready")[0]["model"] is None
    assert "joints alone are emulated" in stage.of("warning")[0]["text"]
    with pytest.raises(UniconError, match=r"nowhere\.xml"):
        Stage(model="nowhere.xml")
    assert stage.face.closed == 0


def test_a_robot_that_no_run_would_drive_has_no_command_and_says_what_it_lacks() -> None:
    class Plain(Scripted):
        platform, reach = "ros", {"frames": False}

    def ready(robot: str) -> dict[str, Any]:
        lines: list[dict[str, Any]] = []
        emulated(
            load_robot(robot),
            lambda states, robot: Plain(states),
            model="fake",
            say=lambda kind, **facts: lines.append(facts),
        ).close()
        return lines[0]

    known, lacking = ready("go2"), ready("aliengo")
    assert "--set robot=go2 --set platform=ros" in known["command"]
    assert "refused" not in known
    assert lacking["command"] == ""
    assert "does not say joints.stiffness, joints.damping; find" in lacking["refused"]


def test_joints_alone_are_no_faster_than_the_robots() -> None:
    stage = Stage(posture="default", still=True)
    stage.face.commands = [(ROBOT.upper, 60.0)]
    stage.tick(30)
    speeds = np.abs([told["joint_vel"] for told in stage.face.told]).max(axis=0)
    assert (speeds <= ROBOT.velocity_limit * 1.001).all()
    assert speeds.max() > 15.0


def test_a_hand_that_takes_positions_has_a_loop_of_its_own() -> None:
    robot = load_robot("inspire_rh56_left")
    stage = Stage(robot, posture="default", still=True)
    target = 0.5 * (robot.lower + robot.upper)
    stage.face.commands = [(target, 0.0)]
    stage.tick(500)
    np.testing.assert_allclose(stage.pos, target, atol=1e-3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["go3"], "did you mean"),
        (["go2", "--face", "no_such"], "unknown face 'no_such'"),
        (["go2", "--face", "os:system"], "does not say that it makes one"),
        (["go2", "--face", "nowhere:face"], "no module 'nowhere'"),
        (["go2", "--set", "prot=1"], "has no option 'prot'; did you mean 'port'?"),
        (["go2", "--set", "port"], "has no '='"),
        (["go2", "--set", "port=many"], "port is 'many'; write a whole number"),
        (["go2", "--set", "dead_man=.nan"], "dead_man is nan; write a number"),
        (["go2", "--set", "port={"], "is not valid YAML"),
        (["go2", "--swap", "FL_hip", "FR_hip_joint"], "has no joint 'FL_hip'; did you mean"),
        (["go2", "--swap", "FR_hip_joint", "FR_hip_joint"], "with itself does nothing"),
        (["go2", "--dead", "arm"], "has no joint 'arm'; known: FL_calf_joint"),
        (["go2", "--leave", "arm"], "has no joint 'arm'; known: FL_calf_joint"),
        (["go2", "--leave", "FL_calf_joint"], "udp_robot:face' reports no mode of a motor"),
        (["go2", "--variant", "5"], "does not tell its variant"),
        (["go2", "--rate", "1000"], "--rate 1000: the robot tells at 500 Hz; give less"),
        (["go2", "--seed", "-1"], "seed is -1; write a whole number from 0"),
        (["go2", "--model", "nowhere.xml"], "nowhere.xml"),
    ],
)
def test_wrong_arguments_get_one_line(
    capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    own = ["--face", "udp_robot:face"] if "--face" not in arguments else []
    own += ["--set", "port=0"]
    assert main(["emulate", *own, *arguments]) == 1
    error = capsys.readouterr().err
    assert words in error
    assert len(error.splitlines()) == 1
    assert "foreseen" not in error


def test_a_robot_without_a_protocol_is_asked_for_its_face(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    new = replace(ROBOT, transport={"protocol": None})
    monkeypatch.setattr("unicon_core.robots.load_robot", lambda name: new)
    assert main(["emulate", "mine"]) == 1
    error = capsys.readouterr().err
    assert f"{ROBOT.path} names no protocol under transport; give --face, one of " in error
    assert "ros, unitree_dex3, unitree_go, " in error
    assert error.endswith(", or your own module:function\n")


def test_a_face_without_an_address_is_given_none(capsys: pytest.CaptureFixture[str]) -> None:
    face = "test_emulator:plain_face"
    assert main(["emulate", "go2", "--face", face, "--address", "127.0.0.2"]) == 1
    assert "has no address; leave --address out" in capsys.readouterr().err
    assert main(["emulate", "go2", "--face", face, "--model", "fake", "--duration", "0.05"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["kind"] for line in lines] == ["ready", "commands", "ended"]


def plain_face(states: States, robot: Robot) -> Scripted:
    return Scripted(states)


def test_two_at_one_address_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    taken = udp_robot.face(States(_states()), ROBOT, port=0)
    port = taken.where.rpartition(":")[2]
    try:
        arguments = ["emulate", "go2", "--face", "udp_robot:face", "--set", f"port={port}"]
        assert main(arguments) == 1
    finally:
        taken.close()
    assert "cannot be served: Address already in use; end the program" in capsys.readouterr().err


def _states() -> Any:
    from unicon_core.states import standard_states

    return standard_states(ROBOT.joint_names)
