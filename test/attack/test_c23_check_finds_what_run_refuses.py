"""What `unicon run` refuses or would ignore, `unicon check` finds: one build serves both."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="the checks are run on a model")

from toy_workflows import codes

from unicon_core.check import check_workflow
from unicon_core.check.subject import on_platform
from unicon_core.workflow import load_document
from unicon_ros.cli.main import main

WORKFLOW = """
robot: go2
platform: mujoco
rate: 50
flow: {hold: {duration: 0.1}}
"""

REFUSED = {
    "an unknown key of pacing": ("pacing: {spin: 3}", "pacing: unknown key 'spin'"),
    "a negative spin": ("pacing: {spin_us: -1}", "spin_us is -1; write a number from 0 [µs]"),
    "a trigger without data": ("pacing: {trigger: state}", "cannot tell when its data arrive"),
    "a map that is not there": ("map: nonexist", "map is 'nonexist': unknown map"),
    "a word for ros": ("ros: 'yes'", "ros is 'yes'; write true or false"),
    "a negative duration": ("duration: -1", "duration is -1; write a number above 0"),
    "no duration": ("duration: 0", "duration is 0; write a number above 0"),
    "an endless duration": ("duration: .inf", "duration is inf; write a number above 0"),
    "a duration of nan": ("duration: .nan", "duration is nan; write a number above 0"),
    "a duration beyond time": ("duration: 1.0e+308", "duration is 1e+308; write a number above 0"),
    "no safety list": ("safety: {finite: {}}", "safety: missing key 'only'"),
}


def written(folder: Path, text: str) -> Path:
    path = folder / "attack.yaml"
    path.write_text(WORKFLOW + text + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("case", REFUSED)
def test_both_refuse_it(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, told = REFUSED[case]
    path = str(written(tmp_path, text))
    assert main(["check", path]) == 1
    assert told in " ".join(capsys.readouterr().out.split())
    assert main(["run", path, "--speed", "max", "--quiet"]) == 1
    assert told in capsys.readouterr().err


def test_a_pose_of_nan_is_refused_by_both(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(written(tmp_path, "").resolve())
    flow = "flow={pose: {to: {FR_hip_joint: .nan}}}"
    assert main(["check", path, "--set", flow]) == 1
    assert main(["run", path, "--set", flow, "--quiet"]) == 1
    assert "to.FR_hip_joint is nan; write a number" in capsys.readouterr().err


PLATFORM = """
robot: {robot}
platform: ros
platforms: {{ros: {{map: ./map.yaml, connect: 0.1}}}}
rate: 50
flow: {{hold: {{duration: 0.1}}}}
{more}
"""
SENSORS = """
subscribe:
  - topic: joint_states
    type: sensor_msgs/msg/JointState
    fields: {{{fields}}}
publish:
  - topic: commands
    type: {type}
    fields: {{{sent}}}
"""
JOINTS = "name: $joint_names, position: joint_pos, velocity: joint_vel"
SENT = "name: $joint_names, position: joint_pos_target"
STATE = "sensor_msgs/msg/JointState"
MISFITS = {
    "an undeclared state": (JOINTS + ", effort: torque", STATE, SENT, "", "'torque'"),
    "an undeclared state that is sent": (JOINTS, STATE, SENT + ", effort: torque", "", "'torque'"),
    "an array of another length": ("'position[:9]': base_quat", STATE, SENT, "", "base_quat"),
    "another number of motors": (
        JOINTS,
        "unitree_go/msg/LowCmd",
        "'motor_cmd[:20].q': joint_pos_target",
        "",
        "",
    ),
    "what nobody measures": (
        JOINTS,
        STATE,
        SENT,
        "safety: [{when: {if: 'base_ang_vel[0] > 9', do: finite}}]",
        "base_ang_vel",
    ),
}


@pytest.mark.parametrize("case", MISFITS)
def test_a_map_that_does_not_fit_the_robot_is_found_without_ros(case: str, tmp_path: Path) -> None:
    fields, kind, sent, more, told = MISFITS[case]
    text = SENSORS.format(fields=fields, type=kind, sent=sent)
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    path = tmp_path / "robot.yaml"
    path.write_text(PLATFORM.format(robot="go2", more=more), encoding="utf-8")
    result = check_workflow(path)
    assert codes(result) == ["build"], result.text()
    assert told in result.findings[0].evidence


def test_a_map_that_fits_is_clean(tmp_path: Path) -> None:
    text = SENSORS.format(fields=JOINTS, type=STATE, sent=SENT)
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    path = tmp_path / "robot.yaml"
    path.write_text(PLATFORM.format(robot="go2", more=""), encoding="utf-8")
    result = check_workflow(path)
    assert result.clean, result.text()


PROTOCOL = """
from unicon_core.platforms.platform import Facts, Platform

def make(states, robot, period) -> Platform:
    raise AssertionError("nothing is opened")

make.facts = Facts("toy", protocols=("twig_can",))
"""


def test_a_robot_of_another_protocol_is_refused_by_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "toy_protocol.py").write_text(PROTOCOL, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    path = str(written(tmp_path, ""))
    overrides = ["--set", "platform=toy_protocol:make"]
    assert main(["check", path, *overrides]) == 1
    assert "robot go2 speaks unitree_go" in capsys.readouterr().out
    assert main(["run", path, *overrides, "--quiet"]) == 1
    assert "robot go2 speaks unitree_go" in capsys.readouterr().err


def test_the_map_of_the_mirror_is_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mirror.yaml").write_text(
        SENSORS.format(fields=JOINTS, type=STATE, sent=SENT), encoding="utf-8"
    )
    path = str(written(tmp_path, ""))
    assert main(["check", path, "--ros"]) == 0
    capsys.readouterr()
    assert main(["check", path, "--map", str(tmp_path / "mirror.yaml")]) == 1
    told = " ".join(capsys.readouterr().out.split())
    assert "would write state 'joint_pos', which platform 'mujoco' writes" in told


def test_a_twin_waits_for_no_data(tmp_path: Path) -> None:
    document = load_document(written(tmp_path, "pacing: {trigger: state}"), {"platform": "ros"})
    assert on_platform(document, "mujoco").values["pacing"] == {}


BLIND = """
from unicon_core.platforms.platform import Facts, Platform

def make(states, robot, period) -> Platform:
    raise AssertionError("nothing is opened")

make.facts = Facts("toy", writes=("joint_pos", "joint_vel", "stamp_ns"))
"""


def test_what_a_platform_says_that_it_does_not_write_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "toy_blind.py").write_text(BLIND, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    path = written(tmp_path, "safety: [finite, tilt_stop]")
    (found,) = check_workflow(path, ["platform=toy_blind:make"]).findings
    assert "'tilt_stop' reads 'projected_gravity', which no block writes" in str(found)
