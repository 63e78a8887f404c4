"""The rover of examples/ follows its command by velocities of its wheels, and is stopped safely."""

from __future__ import annotations

import runpy
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")

from unicon_base.errors import Fault, RobotError
from unicon_core.blocks.postures import Commands
from unicon_core.blocks.safety.ranges import command_stop
from unicon_core.check import check_workflow
from unicon_core.flow import Block, Stage
from unicon_core.gates.build import beginning
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States, standard_states
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow import HookBlocks, Program, load_document

HERE = Path(__file__).resolve().parents[2] / "examples" / "rover"
WORKFLOW = HERE / "drive.yaml"
KEPT = (
    *("joint_pos", "joint_vel", "base_lin_vel", "base_ang_vel", "velocity_command"),
    *("joint_pos_target", "joint_vel_target", "joint_effort_ff"),
    *("joint_stiffness", "joint_damping", "joint_effort", "projected_gravity"),
)


def driven(
    spoil: Any = None,
    speed: str = "max",
    workflow: Path = WORKFLOW,
    own: tuple[str, ...] = ("action", "slewed_command"),
    **overrides: Any,
) -> tuple[Any, dict[str, np.ndarray]]:
    """The report of a run, and its states in every tick; `spoil` gets tick and states before it."""
    kept = (*KEPT, *own)
    rows: dict[str, list[Any]] = {name: [] for name in kept}

    def hook(program: Program) -> HookBlocks:
        states = program.states

        def before() -> None:
            if spoil is not None:
                spoil(len(rows["joint_pos"]), states)

        def look() -> None:
            for name, row in rows.items():
                row.append(states[name].copy())

        amends = ("joint_vel", "base_ang_vel", "velocity_command")
        return {
            Stage.INPUT: [Block("spoil", before, amends=amends, endless=True)],
            Stage.OBSERVE: [Block("look", look, endless=True)],
        }

    program = Program(load_document(workflow, overrides), hooks=[hook])
    report = Runner(program, RunOptions(speed=speed, warn=str)).run()
    return report, {name: np.array(row) for name, row in rows.items()}


@pytest.fixture(scope="module")
def whole() -> tuple[Any, dict[str, np.ndarray]]:
    return driven()


STEADY = {(250, 400): (0.8, 0.0), (550, 700): (0.5, 1.0), (850, 1000): (-0.5, 0.0)}


def test_it_follows_its_command(whole: tuple[Any, dict[str, np.ndarray]]) -> None:
    report, told = whole
    assert not report.faults
    for (begin, end), (vx, wz) in STEADY.items():
        np.testing.assert_allclose(told["velocity_command"][begin:end, ::2], [(vx, wz)] * 150)
        assert told["base_lin_vel"][begin:end, 0].mean() == pytest.approx(vx, abs=0.01)
        assert told["base_ang_vel"][begin:end, 2].mean() == pytest.approx(wz, abs=0.01)
    assert np.abs(told["base_lin_vel"][1100:, :2]).max() < 0.01
    assert told["joint_pos"][:, :2].max() > 30.0  # wheels turn without end
    assert (told["projected_gravity"][:, 2] < -0.99).all()


def test_wheels_get_velocities_and_the_mast_positions(whole: Any) -> None:
    _, told = whole
    policy = slice(0, 1150)
    assert not told["joint_stiffness"][policy, :2].any()
    np.testing.assert_allclose(told["joint_damping"][policy, :2], 0.8)
    np.testing.assert_allclose(told["joint_stiffness"][policy, 2], 10.0)
    assert not told["joint_vel_target"][policy, 2].any()
    assert not told["joint_effort_ff"].any()
    turning = slice(600, 700)
    np.testing.assert_allclose(told["joint_pos_target"][turning, 2], 0.4, rtol=1e-5)
    np.testing.assert_allclose(told["joint_pos"][turning, 2], 0.4, atol=0.02)
    # In the policy's own ticks the target of a wheel is where it was measured.
    own = np.arange(200, 400, 2)
    np.testing.assert_array_equal(told["joint_pos_target"][own, :2], told["joint_pos"][own, :2])


def test_the_command_changes_no_faster_than_its_slew(whole: Any) -> None:
    _, told = whole
    change = np.abs(np.diff(told["slewed_command"][0:1150:2], axis=0)).max(axis=0)
    np.testing.assert_allclose(change, [1.5 * 0.02, 0.0, 4.0 * 0.02], rtol=1e-4)
    assert np.abs(np.diff(told["base_lin_vel"][:1150:5, 0])).max() < 2.0 * 1.5 * 0.05


@pytest.mark.usefixtures("time_passes")
def test_real_and_max_send_the_same() -> None:
    def sent(speed: str) -> str:
        report, _ = driven(speed=speed, duration=1.6)
        assert report.ticks == 160
        assert not report.faults
        return str(report.sha256_commands)

    assert sent("real") == sent("max")


def test_it_equals_a_plain_loop_outside_unicon(whole: Any) -> None:
    ort = pytest.importorskip("onnxruntime")
    session = ort.InferenceSession(HERE / "policy" / "policy.onnx")
    _, told = whole
    seen, last, f = np.zeros(3, np.float32), np.zeros(3, np.float32), np.float32
    for tick in range(0, 1150, 2):
        step = f([1.5, 1.0, 4.0]) * f(0.02)
        seen = seen + np.clip(told["velocity_command"][tick] - seen, -step, step)
        rims = told["joint_vel"][tick, :2] * f(0.08)
        obs = np.concatenate([seen, told["base_ang_vel"][tick, 2:], rims, last], dtype=f)
        last = np.clip(session.run(None, {"obs": obs[None]})[0][0], f(-1.8), f(1.8))
        np.testing.assert_array_equal(told["action"][tick], last)
        speeds = np.append(last[:2] * f(12.5), f(0.0))
        np.testing.assert_array_equal(told["joint_vel_target"][tick], speeds)
        assert told["joint_pos_target"][tick, 2] == np.clip(last[2], f(-1.2), f(1.2))


@pytest.mark.parametrize("state", ["joint_vel", "base_ang_vel"])
def test_a_nan_damps_the_wheels(state: str) -> None:
    def spoil(tick: int, states: Any) -> None:
        if tick == 300:
            states[state][...] = np.nan

    report, told = driven(spoil, duration=8)
    assert "is nan" in report.faults[0]
    damped = slice(report.ticks, None)
    assert report.ticks == 300
    assert len(told["action"][damped]) == 50
    assert not told["joint_vel_target"][damped].any()
    assert not told["joint_effort_ff"][damped].any()
    assert not told["joint_stiffness"][damped, :2].any()
    assert told["joint_stiffness"][report.ticks - 1, 2] == 10.0
    assert not told["joint_stiffness"][-1].any()
    np.testing.assert_allclose(told["joint_damping"][damped, :2], 0.8)
    assert told["base_lin_vel"][report.ticks - 1, 0] == pytest.approx(0.8, abs=0.02)
    assert abs(told["base_lin_vel"][-1, 0]) < 0.15  # it has braked
    assert (told["projected_gravity"][:, 2] < -0.9).all()


def test_a_command_that_is_not_a_number_is_none_and_it_slows_down_by_its_slew() -> None:
    def spoil(tick: int, states: Any) -> None:
        if tick >= 250:
            states.velocity_command[0] = np.nan

    report, told = driven(spoil, duration=4)
    assert not report.faults
    np.testing.assert_allclose(np.diff(told["slewed_command"][250:290:2, 0]), -0.03, rtol=1e-3)
    assert abs(told["base_lin_vel"][-1, 0]) < 0.01


def test_a_stop_in_full_speed_damps_the_wheels() -> None:
    def stop(tick: int, states: Any) -> None:
        if tick == 350:
            raise Fault("emergency stop")  # as the bridge raises it

    report, told = driven(stop, duration=8)
    assert report.faults == ["emergency stop"]
    assert not told["joint_vel_target"][report.ticks :].any()
    assert abs(told["base_lin_vel"][-1, 0]) < 0.15


def test_an_approach_leaves_wheels_where_they_are() -> None:
    program = Program(load_document(WORKFLOW, {"platform": "fake_robot"}))
    try:
        program.states.joint_pos[...] = (1000.0, -500.0, 0.5)
        target = beginning(program)
        assert target.joint_pos.tolist() == [1000.0, -500.0, 0.0]
        assert target.stiffness.tolist() == [0.0, 0.0, 10.0]
    finally:
        program.close()


def test_targets_of_wheels_may_be_far_and_others_may_not() -> None:
    robot = load_robot(HERE / "rover.yaml")
    states = States(standard_states(robot.joint_names))
    command = Commands(**{name: states[name] for name in COMMAND_STATES})
    stop = command_stop(command, states=states, robot=robot)
    states.joint_pos_target = [5e4, -5e4, 0.0]
    stop()
    states.joint_pos_target[2] = 26.0
    with pytest.raises(Fault, match="joint_pos_target of mast_joint is 26 rad"):
        stop()
    states.joint_pos_target = [np.inf, 0.0, 0.0]
    with pytest.raises(Fault, match="joint_pos_target of left_wheel_joint is inf rad"):
        stop()


def test_check_is_clean_and_tells_velocities(capsys: pytest.CaptureFixture[str]) -> None:
    result = check_workflow(WORKFLOW)
    assert not result.findings
    assert "left_wheel_joint   velocity" in result.text()
    assert "-25 … 25" in result.text()


@pytest.mark.parametrize(
    ("overrides", "code", "message"),
    [
        (
            {"platform": "ros", "platforms.ros.map": "ros2_control_position"},
            "action.unsent",
            "it gives left_wheel_joint, right_wheel_joint a velocity, and platform 'ros' does not "
            "send joint_vel_target; choose a map",
        ),
        (
            {"safety": ["finite", {"joint_limits": {"states": {"joint_pos_target": "action"}}}]},
            "safety.partial",
            "it changes action, which is not sent",
        ),
        (
            {"safety": ["finite", {"velocity_limits": {"states": {"joint_vel_target": "action"}}}]},
            "safety.partial",
            "it changes action, which is not sent",
        ),
    ],
)
def test_what_check_finds(overrides: dict[str, Any], code: str, message: str) -> None:
    found = [each for each in check_workflow(WORKFLOW, overrides).findings if each.code == code]
    assert message in str(found[0])


def changed(folder: Path, *changes: tuple[str, str]) -> Path:
    """A rover with other facts in its contract; return its workflow."""
    shutil.copytree(HERE, folder / "rover")
    path = folder / "rover" / "policy" / "policy.yaml"
    text = path.read_text("utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, "utf-8")
    return folder / "rover" / "drive.yaml"


def test_wheels_that_are_told_too_much_are_a_finding(tmp_path: Path) -> None:
    workflow = changed(tmp_path, ("[12.5, 12.5, 1.0]", "[25, 25, 1.0]"))
    bare = {"safety": ["finite", "joint_limits"]}
    found = {each.code: str(each) for each in check_workflow(workflow, bare).findings}
    assert "beyond the velocity limits of left_wheel_joint, right_wheel_joint" in str(found)
    assert "add velocity_limits to safety" in found["action.reach"]
    assert not check_workflow(workflow).findings


def test_a_torque_reaches_the_joint_within_its_limit(tmp_path: Path) -> None:
    workflow = changed(
        tmp_path,
        ('{"*_wheel_joint": velocity}', '{"*_wheel_joint": velocity, mast_joint: torque}'),
        ("[12.5, 12.5, 1.0]", "[12.5, 12.5, 7.0]"),
        ("stiffness: [0.0, 0.0, 10.0]", "stiffness: 10.0"),
        ("damping: [0.8, 0.8, 0.5]", "damping: 0.8"),
    )
    _, told = driven(workflow=workflow, duration=5)
    assert not told["joint_stiffness"].any()
    np.testing.assert_allclose(told["joint_damping"][:, 2], 0.0)
    torque, applied = told["joint_effort_ff"][:, 2], told["joint_effort"][:, 2]
    wanted = 7.0 * told["action"][:, 2]
    np.testing.assert_array_equal(torque, np.clip(wanted, -2.0, 2.0).astype(np.float32))
    assert wanted.max() == pytest.approx(2.8)  # beyond: the limit cuts it off
    np.testing.assert_allclose(applied[401:], torque[400:-1], atol=1e-5)


def test_a_policy_of_positions_leaves_no_velocity_behind(tmp_path: Path) -> None:
    drive = changed(tmp_path)
    park = yaml.safe_load((HERE / "policy" / "policy.yaml").read_text("utf-8"))
    park |= {"name": "park", "action": {"scale": [0.0, 0.0, 0.1]}}
    shutil.copytree(HERE / "policy", tmp_path / "park")
    (tmp_path / "park" / "policy.yaml").write_text(yaml.safe_dump(park), "utf-8")
    flow = [{"loop": {"do": {"policy": "drive"}, "until": {"elapsed": 3.0}}}, {"policy": "park"}]
    report, told = driven(
        workflow=drive,
        duration=5,
        policies={"drive": "./policy", "park": str(tmp_path / "park")},
        flow={"chain": flow},
        own=("drive_action", "park_action"),
    )
    assert not report.faults
    assert told["joint_vel_target"][299, :2].min() > 9.0
    assert not told["joint_vel_target"][301:].any()
    assert abs(told["base_lin_vel"][-1, 0]) < 0.1


def test_the_network_is_what_its_program_writes(tmp_path: Path) -> None:
    runpy.run_path(str(HERE / "make_network.py"))["write"](tmp_path / "policy.onnx")
    written = (HERE / "policy" / "policy.onnx").read_bytes()
    assert (tmp_path / "policy.onnx").read_bytes() == written


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ("lower: -.inf,  upper: 2.0", "lower is endless; a wheel has lower: -.inf and upper: .inf"),
        ("lower: .inf,  upper: -.inf", "lower is inf, which is not below upper -inf"),
    ],
)
def test_half_a_wheel_is_refused(tmp_path: Path, limits: str, message: str) -> None:
    text = (HERE / "rover.yaml").read_text("utf-8")
    assert "lower: -1.2,  upper: 1.2" in text
    path = tmp_path / "rover.yaml"
    path.write_text(text.replace("lower: -1.2,  upper: 1.2", limits), "utf-8")
    with pytest.raises(RobotError) as caught:
        load_robot(path)
    assert message in str(caught.value)


def test_a_wheeled_robot_floats_and_does_not_walk() -> None:
    robot = load_robot(HERE / "rover.yaml")
    assert (robot.floats, robot.walks) == (True, False)
    assert robot.endless.tolist() == [True, True, False]
    assert not robot.missing_facts()
    assert not replace(robot, kind="arm").floats
