"""Ten runs of all policies in MuJoCo, recorded, and replayed by the command line, bit-exact."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")
pytest.importorskip("rosbags")

from policies_of_all_kinds import WORKFLOW, write_policy

from unicon_ros.cli.main import main

PUSHED = ["--set", "scene.push={every: 1.5, velocity: 0.4}", "--set", "scene.seed=7"]
NOISY = ["--set", "scene.noise={joint_vel: 0.2, joint_pos: 0.01}", "--set", "scene.delay=1"]
FELLED = ["--set", "scene.push={every: 3.0, velocity: 6.0}"]
RUNS: dict[str, tuple[str, list[str], int]] = {
    "go2 with its commands": ("go2_walk", [], 0),
    "go2 pushed, with noise and delay": ("go2_walk", [*PUSHED, *NOISY], 0),
    "go2 at 500 Hz": ("go2_teleop", ["--duration", "4", "--set", "rate=500"], 0),
    "go2 that falls: its fault record": ("go2_walk", FELLED, 3),
    "go1": ("go1_walk", ["--duration", "6"], 0),
    "g1": ("g1_walk", ["--duration", "6"], 0),
    "g1 pushed": ("g1_walk", ["--duration", "6", *PUSHED], 0),
    "g1 of holosoma, with a gait": ("g1_holosoma", ["--duration", "6", *NOISY], 0),
    "histories": ("history", ["--duration", "6"], 0),
    "a recurrent network": ("recurrent", ["--duration", "6"], 0),
}


@pytest.mark.slow
@pytest.mark.parametrize("run", RUNS)
def test_no_byte_differs(
    run: str,
    assets: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("UNICON_ASSETS", str(assets))
    workflow, options, status = RUNS[run]
    if workflow in ("history", "recurrent"):
        policy = write_policy(tmp_path / workflow, workflow)
        file = tmp_path / "workflow.yaml"
        text = WORKFLOW.replace("POLICY", str(policy)).replace("fake\n", "mujoco\n")
        file.write_text(text, "utf-8")
        workflow = str(file)
    bag, faults = tmp_path / "run.mcap", tmp_path / "faults"
    arguments = [
        workflow,
        "--speed",
        "max",
        "--record",
        str(bag),
        "--faults",
        str(faults),
        "--quiet",
    ]
    assert main(["run", *arguments, *options]) == status
    bags = [bag, *faults.glob("*.mcap")]
    assert len(bags) == (2 if status else 1)
    capsys.readouterr()
    for each in bags:
        assert main(["replay", str(each), "--verify"]) == 0
        told = capsys.readouterr().out
        found = re.search(r"^0 of (\d+) ticks differ$", told, re.MULTILINE)
        assert found, told
        assert int(found[1]) > 99
        assert "note" not in told
