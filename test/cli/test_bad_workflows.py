"""Every bad workflow file stands beside the exact line that it gets.

`test/bad_workflows/NAME.yaml` is run; what it prints must be `NAME.txt`, with the folder written as
`DIR`, the configuration's as `CONFIG` and the assets' as `ASSETS`. UNICON_WRITE_GOLDEN=1 writes
those files anew: read the difference before you commit it.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import policy_folders
import pytest

from unicon_ros.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
BAD = ROOT / "test" / "bad_workflows"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the bad workflows with the policies that they name."""
    copy = tmp_path_factory.mktemp("bad") / "workflows"
    shutil.copytree(BAD, copy)
    policy_folders.write_all(copy / "policies")
    return copy


def run(capsys: pytest.CaptureFixture[str], folder: Path, *arguments: str) -> tuple[int, str]:
    status = main(["run", *arguments, "--no-ros", "--duration", "0.1", "--speed", "max"])
    told = capsys.readouterr().err
    return status, told.replace(str(folder), "DIR").replace(str(ROOT / "config"), "CONFIG")


def check_golden(name: str, told: str) -> None:
    golden = BAD / f"{name}.txt"
    if os.environ.get("UNICON_WRITE_GOLDEN"):
        golden.write_text(told, encoding="utf-8")
    assert told == golden.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", sorted(path.stem for path in BAD.glob("*.yaml")))
def test_a_bad_workflow_gets_its_one_line(
    name: str, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    status, told = run(capsys, folder, str(folder / f"{name}.yaml"))
    assert status == 1
    assert told.count("\n") == 1
    assert told.startswith("unicon: error: ")
    check_golden(name, told)


def test_an_unknown_workflow_is_named_with_the_known_ones(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, told = run(capsys, folder, "go2_stan")
    assert status == 1
    assert "unknown workflow 'go2_stan'; did you mean 'go2_stand'? known: " in told
    assert told.endswith("or give a path to a .yaml file\n")


@pytest.mark.parametrize(
    ("module", "workflow", "overrides", "line"),
    [
        (
            "mujoco",
            "go2_stand",
            [],
            "platform 'mujoco' needs mujoco: pip install 'unicon_ros[sim]'",
        ),
        (
            "onnxruntime",
            "observation_size.yaml",
            ["policies.walk=policies/good"],
            "policy policy.onnx needs onnxruntime: pip install 'unicon_ros[sim]'",
        ),
        ("rclpy", "go2_stand", None, "the ROS 2 bridge needs rclpy: "),
    ],
)
def test_a_missing_package_is_told_with_its_install_command(
    module: str,
    workflow: str,
    overrides: list[str] | None,
    line: str,
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for loaded in [name for name in sys.modules if name.split(".")[0] == module]:
        monkeypatch.delitem(sys.modules, loaded)
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.chdir(folder)
    arguments = ["run", workflow, "--duration", "0.1", "--speed", "max"]
    arguments += ["--ros"] if overrides is None else ["--no-ros"]
    for override in overrides or []:
        arguments += ["--set", override]
    assert main(arguments) == 1
    told = capsys.readouterr().err
    assert told.startswith(f"unicon: error: {line}")
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    ("override", "line"),
    [
        ("platform", "--set 'platform' has no '='; write --set path=value, as platform=mujoco"),
        (
            "safety.7=x",
            "--set safety.7: '7' is not a place in a list of 2; give a number from 0 to 1: "
            "0 (finite), 1 (joint_limits)",
        ),
        (
            "rate.x=1",
            "--set rate.x: rate is 50, which has no parts; set it whole: --set rate=VALUE",
        ),
        (
            "platform={",
            "--set platform: '{' is not valid YAML: "
            "expected the node content, but found '<stream end>'",
        ),
    ],
)
def test_a_bad_override_is_told(
    override: str, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "go2_stand", "--no-ros", "--set", override]) == 1
    assert capsys.readouterr().err == f"unicon: error: {line}\n"


def test_wrong_usage_exits_with_2(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["run"])
    assert stopped.value.code == 2
    assert "WORKFLOW" in capsys.readouterr().err
