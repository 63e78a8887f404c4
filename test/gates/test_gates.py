"""Gates: each names what is missing and how to go on; a robot in order passes them all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gate_robots
import numpy as np
import pytest
from gate_robots import reasons

from unicon_base.errors import Fault
from unicon_core import Program, block, policy
from unicon_core.check import check_workflow, refuse_errors
from unicon_core.gates.gate import StartGate
from unicon_core.runtime.startup_sequence import prepared

ROBOT = "gate_robots:make"


def program_of(wrong: str = "", **described: Any) -> Program:
    """Build a Go2 that walks under its policy, on a robot of which one thing is wrong."""
    keys = {"robot": "go2", "rate": 50, "policies": {"walk": "go2_velocity"}} | described
    keys.setdefault("flow", policy("walk"))
    keys.setdefault("safety", {"only": ["finite", "joint_limits"]})  # stops are gates besides
    return Program(platform=ROBOT, platforms={ROBOT: {"wrong": wrong}}, **keys)


def test_a_robot_in_order_passes_all_gates_and_they_are_all_there() -> None:
    program = program_of()
    said = reasons(program)
    names = ["data", "rate", "changing", "imu", "posture", "tilt", "command"]
    assert said == dict.fromkeys(names, "")
    assert all(gate.about for gate in program.gates)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("wrong", "gate", "words"),
    [
        (
            "silent",
            "data",
            "joint_pos of FR_hip_joint has not been told, and block 'policy' reads it",
        ),
        ("silent", "rate", "new data come at 0 Hz, needed are 40 Hz"),
        ("slow", "rate", "new data come at 16 Hz, needed are 40 Hz; see whether platform 'wrong'"),
        ("never joint_vel", "data", "joint_vel of RL_calf_joint has not been told"),
        ("nan joint", "data", "joint_vel of FL_thigh_joint is nan"),
        ("frozen IMU", "changing", "the IMU sent the same bytes for"),
        ("frozen joints", "changing", "the joints' sensors sent the same bytes for"),
        ("in units of g", "imu", "|base_lin_acc| is 1.00 m/s² at rest"),
        ("without gravity", "imu", "|base_lin_acc| is 0.01 m/s² at rest"),
        ("upside down", "imu", "gravity by base_lin_acc is 3.14 rad away from projected_gravity"),
        ("quaternion of zeros", "imu", "base_quat has length 0.000 instead of 1"),
        ("turning", "imu", "the base turns at 0.90 rad/s"),
        ("gravity and quaternion", "imu", "the IMU contradicts itself"),
        ("beyond its limit", "posture", "joint_pos of FR_calf_joint is 0.5 rad"),
        ("leaning", "tilt", "the base leans by 1.20 rad, allowed are 1.00"),
    ],
)
def test_a_gate_names_what_is_wrong_and_the_remedy(wrong: str, gate: str, words: str) -> None:
    said = reasons(program_of(wrong))
    assert words in said[gate]
    assert "; " in said[gate]
    assert "\n" not in said[gate]
    others = {name for name, text in said.items() if text and name != gate}
    # Who is silent is slow, too, and says 0 of every joint; gravity that points up is a tilt.
    also = {"silent": {"data", "rate", "posture"}, "gravity and quaternion": {"tilt"}}
    assert not others - also.get(wrong, set())


def test_a_gate_that_did_not_hold_holds_once_all_is_well() -> None:
    program = program_of("slow")
    assert reasons(program)["rate"]
    program.platform.wrong = ""  # type: ignore[attr-defined]
    assert not any(reasons(program).values())


def test_a_tilt_stop_of_the_workflow_says_how_far_the_base_may_lean() -> None:
    program = program_of("leaning", safety=["finite", {"tilt_stop": {"angle": 1.4}}])
    assert reasons(program)["tilt"] == ""


def test_a_stop_of_the_workflow_that_would_trip_is_a_reason() -> None:
    safety = ["finite", "joint_limits", "tilt_stop", "range_stop", "encoder_stop", "stale_stop"]
    program = program_of("beyond its limit", safety=safety)
    said = reasons(program)
    assert "encoder_stop" not in said  # it looks at commands
    assert said["stale_stop"] == ""
    assert said["range_stop"].endswith("; it would end the run at once")
    program.platform.wrong = "silent"  # type: ignore[attr-defined]
    assert "the robot's data is stale" in reasons(program)["stale_stop"]
    program.platform.wrong = ""  # type: ignore[attr-defined]
    assert not any(reasons(program).values())


def test_a_velocity_command_has_to_be_zero_where_somebody_reads_it() -> None:
    program = program_of()
    program.states.velocity_command[0] = 0.6
    assert "velocity_command is vx 0.6 m/s, vy 0 m/s" in reasons(program)["command"]
    assert "command" not in reasons(program_of(flow=block("hold")))


def test_only_what_is_told_is_asked_for() -> None:
    """A platform that measures joints alone has no IMU to look at, nor stamps."""
    from unicon_core.gates.build import gates_of
    from unicon_core.platforms.platform import Facts

    program = program_of(flow=block("hold"), policies={})
    program.platform.facts = Facts("bare", writes=("joint_pos", "joint_vel"))
    for node in program.stages[gate_robots.Stage.RECV]:
        node.writes = ("joint_pos", "joint_vel")  # type: ignore[union-attr]
    assert [gate.name for gate in gates_of(program)] == ["data", "posture"]


def test_an_accelerometer_that_nobody_fills_in_is_none() -> None:
    program = program_of()
    program.platform.wrong = "no accelerometer"  # type: ignore[attr-defined]
    gate_robots.WRONG["no accelerometer"] = lambda _, states: states["base_lin_acc"].fill(0)
    assert reasons(program)["imu"] == ""


@pytest.mark.parametrize(("wrong", "right"), [("", True), ("variant", False)])
def test_a_robot_of_another_variant_is_refused(wrong: str, right: bool) -> None:
    program = program_of(wrong, robot="g1_29dof", flow=block("hold"), policies={})
    if right:
        assert reasons(program, 2)["variant"].startswith("the robot has not reported its variant")
        assert reasons(program)["variant"] == ""
        return
    with pytest.raises(Fault, match="reports mode_machine 4, and g1_29dof"):
        reasons(program)


def test_the_variant_of_a_robot_in_a_child_process_is_asked_for() -> None:
    program = Program(
        robot="g1_29dof",
        platform={"child": ROBOT},
        platforms={ROBOT: {"wrong": "variant"}},
        rate=50,
        flow=block("hold"),
        silent=True,
    )
    try:
        with pytest.raises(Fault, match="mode_machine 4"):
            reasons(program)
    finally:
        program.close()


def test_a_robot_waits_while_another_one_commands_it() -> None:
    program = Program(robot="go2", platform="gate_robots:shared", rate=50, flow=block("hold"))
    assert reasons(program, 2)["commanders"] == (
        "1 others send to rt/command; end them, one alone may command a robot"
    )
    assert reasons(program)["commanders"] == ""


def test_a_robot_whose_own_controller_lets_go_behind_the_gates_does_not_wait_for_it() -> None:
    program = Program(robot="go2", platform="gate_robots:prepared", rate=50, flow=block("hold"))
    assert "commanders" not in reasons(program, 2)
    prepare = prepared(program)
    assert prepare is not None
    assert prepare() == "1 others send to rt/command; end them, one alone may command a robot"
    reasons(program, 40)
    assert prepare() == ""  # it has let go, and nobody else is left
    plain = Program(robot="go2", platform="gate_robots:shared", rate=50, flow=block("hold"))
    assert prepared(plain) is None
    silent = Program(
        robot="go2", platform="gate_robots:prepared", rate=50, flow=block("hold"), silent=True
    )
    look = prepared(silent)
    assert look is not None
    assert look() == ""  # it sends nothing, and its own controller goes on


def test_in_a_simulator_gates_are_shown_and_hold() -> None:
    program = Program(robot="go2", platform="fake", rate=50, flow=block("hold"))
    assert {gate.name for gate in program.gates} >= {"data", "imu", "posture"}
    assert [gate() for gate in program.gates] == [""] * len(program.gates)
    assert "in a simulator" in program.gates[0].about  # type: ignore[attr-defined]


def test_looking_changes_no_state_that_is_told() -> None:
    program = Program(robot="go2", platform="fake_robot", rate=50, flow=block("hold"))
    assert not any(reasons(program).values())
    gate_robots.waiting(program)()
    assert program.states.joint_pos.tolist() == program.robot.default_joint_pos.tolist()


def test_without_gates_every_start_tells_so() -> None:
    program = program_of(start={"gates": False})
    assert program.gates == []
    told = refuse_errors(program, ["pose.start"])
    assert "start: {gates: false}: the robot is moved whatever it tells of itself" in told
    assert not any("moved whatever" in line for line in refuse_errors(program_of(), ["pose.start"]))


def test_a_gate_of_ones_own_needs_a_name_and_a_call() -> None:
    class Battery:
        name = "battery"

        def __call__(self) -> str:
            return "the battery is at 3 %; charge it"

    gate: StartGate = Battery()
    program = program_of()
    program.gates.append(gate)
    assert reasons(program, 1)["battery"] == "the battery is at 3 %; charge it"


@pytest.mark.filterwarnings("error", "ignore::ResourceWarning")  # of whatever ran before
def test_garbage_in_any_state_is_a_reason_and_never_an_exception() -> None:
    program = program_of(flow=block("hold"), policies={})
    random, states = np.random.default_rng(0), program.states
    garbage = np.array([np.nan, np.inf, -np.inf, 1e30, -1e30, 0.0, 1e-40, 1.0], np.float32)
    tick = gate_robots.waiting(program)
    names = [name for name in program.platform.facts.writes if states[name].dtype.kind == "f"]
    for _ in range(300):
        with np.errstate(all="ignore"):
            tick()
        for name in random.choice(names, 2):
            states[name].flat[random.integers(states[name].size)] = random.choice(garbage)
        states.stamp_ns[...] = random.integers(-(2**62), 2**62)
        for gate in program.gates:
            said = gate()
            assert isinstance(said, str)
            assert "\n" not in said
    assert not any(reasons(program).values())  # and no garbage stays behind


def test_who_outlives_the_process_that_ticks_is_asked(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("robot: go2\nplatform: fake_robot\nrate: 50\nflow: hold\n")

    def told(*overrides: str) -> str:
        notes = check_workflow(path, overrides).notes
        return "".join(str(note) for note in notes if note.code == "start.watchdog")

    assert "platform: {child: fake_robot}" in told()
    assert not told("platform={child: fake_robot}")
    assert not told("platform=fake")
