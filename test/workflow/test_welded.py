"""A model may lack joints that no policy moves: they are welded in simulation, and it is told."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from unicon_base.resources import find_config
from unicon_ros.cli.main import main

pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")

TAIL = (
    "  - {name: tail_joint, lower: -1.0, upper: 1.0, velocity: 20.0, effort: 30.0, default: 0.3, "
    "rest: 0.3, stiffness: 20.0, damping: 1.0}\n"
)


@pytest.fixture
def tailed(tmp_path: Path) -> list[str]:
    """A Go2 with a tail, which its model does not have."""
    text = find_config("robots", "go2").read_text("utf-8").replace("name: go2\n", "name: tailed\n")
    text = text.replace("imu: {", f"{TAIL}imu: {{", 1).replace("models/go2/", f"{tmp_path.name}/")
    text = text.replace(
        text[text.index("models:") : text.index("\n", text.index("models:"))], "models: {}"
    )
    path = tmp_path / "tailed.yaml"
    path.write_text(text, "utf-8")
    model = find_config("robots", "go2").parents[1] / "models/go2/go2.xml"
    return ["go2_walk", "--set", f"robot={path}", "--set", f"scene.model={model}"]


def test_it_walks_as_without_the_joint_and_says_so(
    tailed: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", *tailed]) == 0
    note = "lacks tail_joint, which no policy moves: they are taken as welded"
    told = " ".join(capsys.readouterr().out.split())
    assert note in told
    assert "[joints.welded" in told
    moved = []
    for arguments in (tailed, ["go2_walk"]):
        report = tmp_path / "report.json"
        ends = ["--duration", "8", "--speed", "max", "--quiet", "--report", str(report)]
        assert main(["run", *arguments, *ends]) == 0
        told = json.loads(report.read_text("utf-8"))
        assert not told["faults"]
        assert not told["fell"]
        moved.append(told["base_displacement_m"][0])
        err = capsys.readouterr().err
        assert (note in err) == (arguments is tailed)
    assert moved[0] == pytest.approx(moved[1], abs=0.1)
    assert moved[1] > 1.0


@pytest.mark.parametrize(
    "more",
    [
        ["--set", "platform=pybullet"],  # whose engine has no stand-in for it
        ["--set", "policies={}", "--set", "flow={pose: {to: stand}}"],  # a pose moves it
    ],
)
def test_it_is_refused_where_it_would_move(
    tailed: list[str], more: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    if "platform=pybullet" in more:
        pytest.importorskip("pybullet")
    assert main(["check", *tailed, *more]) == 1
    assert "no joint 'tail_joint'" in " ".join(capsys.readouterr().out.split())
    assert main(["run", *tailed, *more]) == 1
    assert "no joint 'tail_joint'" in capsys.readouterr().err


def test_a_joint_that_the_policy_moves_is_still_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = find_config("robots", "go2").parents[1] / "models/go2/go2.xml"
    model = tmp_path / "go2.xml"
    model.write_text(source.read_text("utf-8").replace("FR_calf_joint", "other_joint"), "utf-8")
    assert main(["run", "go2_walk", "--set", f"scene.model={model}"]) == 1
    assert "no joint 'FR_calf_joint'" in capsys.readouterr().err
