"""`unicon run` and the node refuse what `unicon check` calls an error, unless it is forced."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mujoco", reason="the checks are run on a model")
pytest.importorskip("onnxruntime", reason="the policies need onnxruntime")
pytest.importorskip("onnx", reason="the test networks are written with onnx")

from toy_workflows import codes, write_workflow

from unicon_base.errors import UniconError
from unicon_core.check import check_workflow, refuse_errors
from unicon_core.check.check import Subject
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow
from unicon_ros.cli.main import main

STIFF = {"stiffness": 500.0, "damping": 5.0}
LAME = {**STIFF, "damping": 0.0}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "toy"


def run(*arguments: str) -> int:
    return main(["run", *arguments, "--speed", "max", "--duration", "0.2", "--quiet"])


@pytest.mark.parametrize("policy", [STIFF, {"stiffness": 1e9}], ids=["stiff", "1e9"])
def test_what_check_calls_an_error_is_not_run(
    folder: Path, policy: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(write_workflow(folder, policy))
    assert main(["check", path]) == 1
    capsys.readouterr()
    assert run(path) == 1
    assert "unicon: error: " in capsys.readouterr().err


def test_all_errors_are_listed_with_the_codes_to_force(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(str(write_workflow(folder, LAME))) == 1
    told = capsys.readouterr().err
    assert "at your own risk with --force gains.damping --force gains.stiff:" in told
    assert "\n  1. policy 'walk', damping: " in told
    assert "\n  2. policy 'walk', stiffness: FL_hip_joint: 500 N·m/rad reaches its effort" in told


def test_forced_errors_are_told_at_start_and_in_the_report(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, report = str(write_workflow(folder, LAME)), tmp_path / "report.json"
    assert run(path, "--force", "gains.stiff") == 1
    assert "--force gains.damping: policy 'walk', damping" in capsys.readouterr().err
    both = ["--force", "gains.stiff", "--force", "gains.damping"]
    assert run(path, *both, "--report", str(report)) == 0
    told = capsys.readouterr()
    assert "warning: forced: policy 'walk', stiffness" in told.err
    assert "forced        gains.damping, gains.stiff" in told.out
    assert json.loads(report.read_text())["forced"] == ["gains.damping", "gains.stiff"]


def test_what_is_forced_without_need_is_not_in_the_report(folder: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    assert run(str(write_workflow(folder)), "--force", "gains.stiff", "--report", str(report)) == 0
    assert json.loads(report.read_text())["forced"] == []


def test_an_unknown_code_is_refused_with_alternatives(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(str(write_workflow(folder)), "--force", "gains.stif") == 1
    assert "no finding has the code 'gains.stif'; did you mean 'gains.stiff'?" in (
        capsys.readouterr().err
    )


def test_what_the_workflow_accepts_is_run(folder: Path) -> None:
    assert run(str(write_workflow(folder, STIFF, {"check": {"accept": ["gains.stiff"]}}))) == 0


HARDWARE = """
from unicon_core.platforms import fake

def make(states, robot, period):
    platform = fake.make_robot(states, robot, period)
    touched = []
    platform.recv = platform.send = lambda: touched.append(1)
    platform.close = lambda: touched.append("closed")
    make.touched = touched
    return platform

make.facts = fake.FakeRobot.facts
"""


def test_on_hardware_a_refused_workflow_is_closed_and_nothing_is_sent(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "toy_motors.py").write_text(HARDWARE, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    path = str(write_workflow(folder))
    assert run(path, "--set", "platform=toy_motors:make") == 1  # begins with the policy
    import toy_motors  # type: ignore[import-not-found]

    assert toy_motors.make.touched == ["closed"]
    assert "pose.start" in codes(check_workflow(path, ["platform=toy_motors:make", "start=none"]))


def test_the_gate_leaves_the_commands_as_they_are(folder: Path) -> None:
    def digest(gate: bool) -> str:
        workflow = load_workflow(folder / "toy.yaml")
        if gate:
            before = workflow.states.buffer.tobytes()
            refuse_errors(workflow)
            assert workflow.states.buffer.tobytes() == before
        return Runner(workflow, RunOptions(duration=0.5, speed="max")).run().sha256_commands

    write_workflow(folder, gain=0.05)
    assert digest(True) == digest(False)


def test_run_checks_the_workflow_that_it_runs(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workflow = load_workflow(write_workflow(folder))
    seen: list[Subject] = []
    monkeypatch.setattr(
        "unicon_core.check.check.static_checks", lambda subject, result: seen.append(subject)
    )
    refuse_errors(workflow)
    workflow.close()
    assert seen[0].program is workflow
    assert seen[0].live


def test_the_node_refuses_it_too(folder: Path) -> None:
    rclpy = pytest.importorskip("rclpy", reason="the node needs ROS 2")
    from rclpy.parameter import Parameter

    from unicon_ros.node import UniconNode

    path = str(write_workflow(folder, STIFF))
    rclpy.init()
    try:
        for force, configured in (("", False), ("gains.stiff", True)):
            overrides = [
                Parameter("workflow", value=path),
                Parameter("force", value=[force]),
                Parameter("autostart", value=False),
            ]
            node = UniconNode(f"gate_{configured}".lower(), parameter_overrides=overrides)
            node.trigger_configure()
            assert (node.runner is not None) is configured, node.error
            assert ("gains.stiff" in node.error) is not configured
            node._release()
            node.destroy_node()
    finally:
        rclpy.shutdown()


def test_unknown_codes_are_refused_before_anything_is_checked(folder: Path) -> None:
    workflow = load_workflow(write_workflow(folder))
    with pytest.raises(UniconError, match="no finding has the code ''"):
        refuse_errors(workflow, [""])
    workflow.close()
