"""`unicon excite`: workflows whose motion tells causes apart; and what cannot be asked for."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("mujoco")

from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import Program, load_document
from unicon_lab.diagnose import MOTIONS
from unicon_lab.diagnose.plant import KINDS, MOTION
from unicon_ros.cli.main import main

HUNG = ("wiggle", "drop")
RUNS = [("go2", kind) for kind in MOTIONS] + [("g1_29dof", kind) for kind in HUNG]


def written(subject: str, kind: str, folder: Path, *more: str) -> Path:
    """Write the workflow of a motion; return its file."""
    path = folder / f"{kind}.yaml"
    assert main(["excite", subject, "--kind", kind, "--out", str(path), *more]) == 0
    return path


def ran(path: Path, seconds: float | None, **overrides: Any) -> Program:
    """Run a workflow, which ends without a fault and upright; return its program."""
    program = Program(load_document(path, overrides))
    report = Runner(
        program, RunOptions(duration=seconds, speed="max", warn=lambda text: None)
    ).run()
    assert report.faults == []
    assert not report.fell
    return program


@pytest.mark.usefixtures("assets")
@pytest.mark.parametrize(("robot", "kind"), RUNS)
def test_what_is_written_is_clean_and_runs(
    robot: str, kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(robot, kind, tmp_path)
    said = capsys.readouterr().out
    hung = " --hung" if kind in HUNG else ""
    assert f"unicon diagnose {path.with_suffix('.mcap')}{hung}\n" in said
    assert f"unicon run {path} --record" in said
    assert main(["check", "-q", str(path)]) == 0
    ran(path, 2.0)


@pytest.mark.slow
@pytest.mark.usefixtures("assets")
@pytest.mark.parametrize(("robot", "kind"), RUNS)
def test_it_ends_by_itself_upright(robot: str, kind: str, tmp_path: Path) -> None:
    ran(written(robot, kind, tmp_path), None)


@pytest.mark.slow
@pytest.mark.usefixtures("assets")
@pytest.mark.parametrize("kind", ["sway", "rest"])
def test_a_humanoid_stands_by_the_policy_of_its_record(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["excite", "g1_29dof", "--kind", kind, "--out", str(tmp_path / "x.yaml")]) == 1
    assert "robot g1_29dof does not stand by gains" in capsys.readouterr().err
    record = tmp_path / "walk.mcap"
    run = ["run", "g1_walk", "--speed", "max", "--duration", "1", "--faults", "off"]
    assert main([*run, "--record", str(record)]) == 0
    path = written(str(record), kind, tmp_path)
    assert main(["check", "-q", str(path)]) == 0
    moved = abs(ran(path, None).states["base_pos_w"][:2])
    assert moved.max() < 0.3


def test_every_cause_has_its_motion() -> None:
    assert {*MOTION} < {*KINDS}
    assert {*MOTION.values(), "wiggle"} == {*MOTIONS}


def recorded(folder: Path, workflow: str) -> Path:
    """Record a workflow."""
    path, record = folder / "excited.yaml", folder / "real.mcap"
    path.write_text(workflow)
    run = ["run", str(path), "--speed", "max", "--record", str(record), "--faults", "off"]
    assert main(run) == 0
    return record


def test_a_record_gives_robot_platform_rate_gains_and_safety(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(
        "schema: unicon.robot/1\nextends: go2\nsimulated: {'*': {strength: 0.9}}\n"
    )
    record = recorded(
        tmp_path,
        f"""\
robot: {tmp_path}/mine.yaml
platform: mujoco
platforms: {{mujoco: {{passive: replace}}}}
rate: 100
scene: {{payload: {{mass: 1.0}}}}
flow: {{pose: {{duration: 0.2, stiffness_scale: 0.5}}}}
safety: [finite, {{tilt_stop: {{angle: 0.5}}}}, {{height_stop: {{lowest: 0.1}}}}]
""",
    )
    said = yaml.safe_load(written(str(record), "wiggle", tmp_path).read_text())
    assert said["robot"] == f"{tmp_path}/mine.yaml"
    assert said["platforms"] == {"mujoco": {"passive": "replace"}}
    assert said["rate"] == 100
    assert said["safety"] == ["finite", {"tilt_stop": {"angle": 0.5}}]
    assert "payload" not in said["scene"]
    assert said["flow"]["excite"]["stiffness_scale"] == 0.5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["gto2"], "unknown robot 'gto2'"),
        (["nothing.mcap"], "nothing.mcap"),
        (["empty.mcap"], "empty.mcap"),
        (["."], "."),
        (["go2", "--joints", "*_wheel"], "no joint like '*_wheel'"),
        (["go2", "--kind", "rest", "--joints", "*"], "a rest of go2 takes no --joints"),
        (["arx_x5", "--kind", "sway"], "robot arx_x5 does not stand by gains"),
        (["go2", "--out", "walk.yml"], "walk.yml is not a .yaml file"),
        (["go2", "--out", "there.yaml"], "there.yaml exists"),
        (["go2", "--out", "nowhere/it.yaml"], "cannot write nowhere/it.yaml"),
    ],
)
def test_what_cannot_be_written_is_one_line(
    words: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("empty.mcap", "there.yaml"):
        Path(name).touch()
    before = {*tmp_path.iterdir()}
    assert main(["excite", "--out", "x.yaml", *words]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert "foreseen" not in line
    assert {*tmp_path.iterdir()} == before


def test_a_full_disk_leaves_no_half_of_a_workflow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    assert main(["excite", "go2", "--out", str(tmp_path / "x.yaml")]) == 1
    assert "No space left on device" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_wiggle_names_the_weak_calf(tmp_path: Path) -> None:
    path, record, causes = (tmp_path / name for name in ("wiggle.yaml", "real.mcap", "causes.json"))
    written("go2", "wiggle", tmp_path)
    weak = "scene.joints={RL_calf_joint: {strength: 0.7}}"
    run = ["run", str(path), "--speed", "max", "--record", str(record), "--faults", "off"]
    assert main([*run, "--set", weak]) == 0
    assert main(["diagnose", str(record), "--hung", "--json", str(causes)]) == 0
    (found,) = json.loads(causes.read_text())["causes"]
    assert (found["kind"], found["where"]) == ("strength", "RL_calf_joint")
    assert found["size"] == pytest.approx(-0.3, abs=0.03)
