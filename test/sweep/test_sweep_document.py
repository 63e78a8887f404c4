"""docs/howto/sweep.md and docs/reference/sweep.md: the sweep is one, the lists are complete."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from unicon_core.platforms.kit.scene import SCENE_KEYS
from unicon_lab.sweep.draws import KINDS
from unicon_lab.sweep.figures import COLUMNS
from unicon_lab.sweep.plan import Plan
from unicon_lab.sweep.sweep_file import SweepDocument, read_sweep
from unicon_ros.cli.main import main

DOCS = Path(__file__).resolve().parents[2] / "docs"
TEXT = "".join((DOCS / kind / "sweep.md").read_text("utf-8") for kind in ("howto", "reference"))


def test_its_sweep_is_one(tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    (block,) = re.findall(r"```yaml title=push.yaml\n(.*?)```", TEXT, re.DOTALL)
    (tmp_path / "push.yaml").write_text(block, "utf-8")
    sweep = read_sweep(tmp_path / "push.yaml")
    plan = Plan(sweep)
    assert len(plan) == 2000
    assert {each.kind for each in sweep.parameters} < {*KINDS, "list"}
    for path in re.findall(r"`scene\.(\w+)", TEXT):
        assert path in SCENE_KEYS


def test_its_tables_say_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert set(COLUMNS) <= set(re.findall(r"`(\w+)`", TEXT))
    assert set(SweepDocument.__dataclass_fields__) <= set(re.findall(r"\b(\w+)\b", TEXT))
    assert all(f"`{{{kind}: [" in TEXT for kind in KINDS)
    with pytest.raises(SystemExit):
        main(["sweep", "--help"])
    options = set(re.findall(r"--[a-z-]+", capsys.readouterr().out))
    commands = re.findall(r"^unicon sweep .*", TEXT, re.MULTILINE)
    given = {w for line in commands for w in shlex.split(line, comments=True) if w[:2] == "--"}
    assert given <= options
    assert {option.split(" ")[0] for option in re.findall(r"`(--[a-z]+)", TEXT)} <= options
