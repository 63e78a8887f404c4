"""What docs/howto/retargeting.md shows can be run, and its options are the block's."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest
import yaml

from benchmarks.retarget import run
from unicon_base.errors import RobotError
from unicon_base.schema.read import read_value
from unicon_core.robots import load_robot
from unicon_core.robots.robot import Hand
from unicon_manipulation.retargeting_block import Retarget
from unicon_ros.cli.main import main

TEXT = (Path(__file__).parents[2] / "docs" / "howto" / "retargeting.md").read_text("utf-8")
WORKFLOW, HAND = re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)


def test_the_workflows_are_clean(assets: Path, tmp_path: Path) -> None:
    pytest.importorskip("websockets")
    path = tmp_path / "hands.yaml"
    path.write_text(f"schema: unicon.workflow/1\nname: hands\n{WORKFLOW}", "utf-8")
    assert main(["check", str(path)]) == 0
    assert main(["check", "hand_webxr"]) == 0


def test_the_hand_is_one() -> None:
    said = yaml.safe_load(HAND)["hand"]
    read_value(Hand, said, lambda where, text: RobotError(text), "hand")


def test_every_option_is_told() -> None:
    options = set(inspect.signature(Retarget).parameters)
    options -= {"joint_pos", "joint_pos_command", "context"}
    assert options == set(re.findall(r"^\| `(\w+)` \| ", TEXT, re.MULTILINE)) - {"rohand"}


def test_every_hand_is_told_and_shown(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("inspire_rh56_left", "dex3_right", "xhand1_left", "rohand"):
        assert load_robot(name).hand is not None
        assert main(["robots", name]) == 0
        told = capsys.readouterr().out
        assert re.search(r"^hand +(left|right|left or right)$", told, re.MULTILINE)
        assert re.search(r"^tip of the thumb +on ", told, re.MULTILINE)


def test_the_bench_runs_without_the_other(assets: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.retarget.TICKS", 40)
    monkeypatch.setattr("benchmarks.retarget.find_spec", lambda name: None)
    bench = run(rounds=1)
    assert bench.ratios["joint_error_p99"]["holds"]
    assert "retarget" not in bench.ratios
    assert bench.facts["dex-retargeting"] == (
        "not compared, it is not installed: pip install dex-retargeting"
    )
    assert set(bench.cases) == {"unicon", "unicon: joint error [mrad]"}
