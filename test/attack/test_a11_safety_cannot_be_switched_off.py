"""Options that would switch a safety block off are refused, and so are implausible figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("mujoco", reason="the checks are run on a model")
pytest.importorskip("onnxruntime", reason="the policies need onnxruntime")
pytest.importorskip("onnx", reason="the test networks are written with onnx")

from toy_workflows import ROOT, check, codes, note_of, text_of, write_workflow

from unicon_base.errors import UniconError
from unicon_core.check import check_workflow
from unicon_core.robots import load_robot, robot_names
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow
from unicon_msgs_map import MapFileError, load_map, parse_map
from unicon_ros.cli.main import main

STAND = """
robot: go2
platform: fake
rate: 100
flow: {pose: {to: stand, duration: 0.5}}
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "attack.yaml"
    path.write_text(STAND + text, encoding="utf-8")
    return path


SWITCHED_OFF = [
    ({"joint_limits": {"margin": -1e30}}, "margin is -1e+30; write a number from 0 to 12.5664"),
    ({"joint_limits": {"margin": -10}}, "margin is -10; write a number from 0 to 12.5664 [rad]"),
    ({"velocity_stop": {"factor": -1}}, "factor is -1; write a number above 0 to 3"),
    ({"velocity_stop": {"factor": float("inf")}}, "factor is inf"),
    ({"velocity_stop": {"limit": float("inf")}}, "limit is inf; write a number above 0 to 200"),
    ({"rate_limit": {"max_rate": float("inf")}}, "max_rate is inf; write a number above 0 to 200"),
    ({"effort_limits": {"scale": float("inf")}}, "scale is inf; write a number above 0 to 1"),
    ({"tilt_stop": {"angle": 3.1}}, "angle is 3.1; write a number above 0 to 1.5708 [rad]"),
    ({"stale_stop": {"timeout": 1e30}}, "timeout is 1e+30; write a number above 0 to 5 [s]"),
]


@pytest.mark.parametrize(("block", "told"), SWITCHED_OFF, ids=lambda value: str(value)[:40])
def test_an_option_that_switches_a_block_off_is_refused_with_range_and_remedy(
    tmp_path: Path, block: dict[str, Any], told: str
) -> None:
    path = written(tmp_path, yaml.safe_dump({"safety": ["finite", block]}))
    with pytest.raises(UniconError) as error:
        load_workflow(path).close()
    assert told in str(error.value)
    assert "; to run without it leave it out of safety:" in str(error.value)
    assert codes(check_workflow(path)) == ["build"]


def test_safety_none_is_told_at_every_start_and_in_the_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, "safety: none\n")
    report = tmp_path / "report.json"
    for _ in range(2):
        status = main(["run", str(path), "--speed", "max", "--quiet", "--report", str(report)])
        assert status == 0
        assert "warning: safety: none: commands are sent as they are" in capsys.readouterr().err
    assert '"safety": []' in report.read_text(encoding="utf-8")
    assert "no block looks at commands" in note_of(check_workflow(path), "safety.none")


def test_an_empty_safety_section_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UniconError, match=r"write \[finite, joint_limits\], .*or none"):
        load_workflow(written(tmp_path, "safety: []\n"))


@pytest.mark.parametrize("clamp", ["joint_limits", "rate_limit", "effort_limits"])
def test_limits_before_finite_are_refused(tmp_path: Path, clamp: str) -> None:
    path = written(tmp_path, f"safety: [{clamp}, finite]\n")
    with pytest.raises(UniconError, match=f"'finite' stands behind '{clamp}', which hides"):
        load_workflow(path)
    load_workflow(written(tmp_path, f"safety: [finite, {clamp}]\n")).close()


def test_a_pose_is_no_step(tmp_path: Path) -> None:
    changes = {"flow.pose.duration": 0}
    with pytest.raises(UniconError, match=r"duration is 0; write a number from 0.1"):
        load_workflow(written(tmp_path, ""), changes)
    overrides = {"scene.initial_pose": "rest", "flow.pose.duration": 0.1}
    workflow = load_workflow(written(tmp_path, ""), overrides)
    runner = Runner(workflow, RunOptions(speed="max"))
    fastest, last = 0.0, None
    done = False
    while not done:
        done = runner.tick(0)
        target = workflow.states["joint_pos_target"].copy()
        if last is not None:
            fastest = max(fastest, float(abs(target - last).max()) / workflow.period)
        last = target
    runner.close()
    assert 5.0 < fastest <= 10.0
    assert abs(last - workflow.robot.default_joint_pos).max() < 1e-5


@pytest.mark.parametrize(
    ("key", "value"), [("stiffness_scale", 1e9), ("stiffness_scale", -1), ("damping_scale", -1)]
)
def test_a_factor_on_gains_is_bounded(tmp_path: Path, key: str, value: float) -> None:
    with pytest.raises(UniconError, match=f"{key} is .*; write a number from 0 to"):
        load_workflow(written(tmp_path, ""), {f"flow.pose.{key}": value})


def test_a_margin_of_nan_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "safety: [finite, {joint_limits: {margin: .nan}}]\n")
    with pytest.raises(UniconError, match="block 'joint_limits': margin is nan; write a number"):
        load_workflow(path)


def test_a_pose_of_nan_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UniconError, match=r"block 'pose': to\.FR_hip_joint is nan; write a number"):
        load_workflow(written(tmp_path, ""), {"flow.pose.to": {"FR_hip_joint": float("nan")}})


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "toy"


def test_a_policy_that_moves_a_lying_robot_first_is_an_error_on_hardware(folder: Path) -> None:
    path = write_workflow(folder)
    line = text_of(check_workflow(path, ["platform=ros", "start=none"]), "pose.start")
    assert "rad from where it is when the robot lies: the motors would make a step" in line
    assert "the motors would make a step" in note_of(check_workflow(path), "pose.start")
    risen = ["platform=ros", "flow={chain: [{pose: {to: stand}}, {policy: walk}]}"]
    assert check_workflow(path, risen).clean


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"joints.0.upper": 1e30}, "upper is 1e+30; write a number from -12.5664 to 12.5664"),
        ({"joints.0.stiffness": 1e30}, "stiffness is 1e+30; write a number from 0 to 2000"),
        ({"joints.0.damping": 1e9}, "damping is 1000000000.0; write a number from 0 to 200"),
        ({"joints.0.effort": 1e6}, "effort is 1000000.0; write a number above 0 to 1000"),
        ({"joints.0.velocity": 1e4}, "velocity is 10000.0; write a number above 0 to 200"),
        ({"transport.pos_stop": float("nan")}, "pos_stop is nan; write a number"),
        ({"transport.pos_stop": float("inf")}, "pos_stop is inf; write a number"),
    ],
)
def test_implausible_figures_of_a_robot_are_refused(
    folder: Path, change: dict[str, Any], told: str
) -> None:
    assert told in text_of(check(folder, robot=change), "build")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"stiffness": 1e9}, "stiffness is 1000000000.0; write a number from 0 to 2000 [N·m/rad]"),
        ({"damping": 1e9}, "write a number from 0 to 200 [N·m·s/rad]"),
        ({"action.scale": 1e3}, "a position has at most 12.5664 rad"),
        ({"default_joint_pos": 80.0}, "to 12.5664 [rad] (are these degrees?)"),
        ({"observation.terms.0.scale": 1e9}, "write a number from -1e+06 to 1e+06"),
    ],
)
def test_implausible_figures_of_a_contract_are_refused(
    folder: Path, change: dict[str, Any], told: str
) -> None:
    assert told in text_of(check(folder, change), "build")


MAP = """
subscribe:
  - topic: cmd_vel
    type: geometry_msgs/msg/Twist
    timeout: {timeout}
    rate: {rate}
    qos: {{deadline: {deadline}}}
    fields: {{linear.x: {{state: "velocity_command[0]", scale: {scale}, offset: {offset}}}}}
"""


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("timeout", "1.0e+30", "timeout is 1e+30; write a number above 0 to 60 [s]"),
        ("timeout", ".inf", "timeout is inf; write a number above 0 to 60 [s]"),
        ("rate", "1.0e+30", "rate is 1e+30; write a number above 0 to 10000 [Hz]"),
        ("deadline", ".inf", "qos.deadline is inf; write a number above 0"),
        ("scale", "-.inf", "scale is -inf; write a number from -1e+12"),
        ("offset", ".inf", "offset is inf; write a number from -1e+12"),
    ],
)
def test_implausible_figures_of_a_map_are_refused(key: str, value: str, told: str) -> None:
    good = {"timeout": "0.5", "rate": "50", "deadline": "0.1", "scale": "1.0", "offset": "0.0"}
    parse_map(MAP.format(**good))
    with pytest.raises(MapFileError) as error:
        parse_map(MAP.format(**{**good, key: value}))
    assert told in str(error.value)


def test_all_that_we_ship_is_plausible() -> None:
    assert [load_robot(name).name for name in robot_names()] == robot_names()
    for path in sorted((ROOT / "config" / "maps").glob("*.yaml")):
        load_map(path)
