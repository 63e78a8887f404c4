"""The sweep of examples/terrain.yaml: difficult ground makes the Go2 fall, flat ground does not."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")

from unicon_base.schema.records import record_of
from unicon_base.schema.types import Mistakes
from unicon_core.platforms.kit.scene import Scene
from unicon_core.terrain.words import KINDS
from unicon_core.workflow.document import WorkflowDocument
from unicon_lab.sweep.plan import Plan, document_with
from unicon_lab.sweep.sweep_file import read_sweep
from unicon_ros.cli.main import main

FILE = Path(__file__).resolve().parents[2] / "examples" / "terrain.yaml"


def test_it_has_every_kind_of_terrain_and_each_is_one() -> None:
    plan = Plan(read_sweep(FILE))
    assert len(plan) == 340
    seen = set()
    for row in list(plan)[::20]:
        document: WorkflowDocument = document_with(plan.workflow_file, row.settings)
        scene = document.values["scene"]
        mistakes = Mistakes()
        record_of(Scene).read(scene, (), mistakes)
        assert mistakes.found == []
        uneven = Scene(**scene).uneven
        seen.add("flat" if uneven is None else uneven.kind)
    assert seen == {"flat", *KINDS} - {"pyramid"}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_difficult_ground_makes_it_fall(tmp_path: Path) -> None:
    table = pytest.importorskip("pyarrow.parquet", reason="pip install 'unicon_ros[sweep]'")
    text = FILE.read_text("utf-8").replace("[0, 19]", "[0, 3]")
    (tmp_path / "few.yaml").write_text(text, "utf-8")
    out = tmp_path / "out"
    assert main(["sweep", str(tmp_path / "few.yaml"), "--out", str(out), "--workers", "1"]) == 0
    fell: dict[str, int] = {}
    for shard in sorted(out.glob("shard-*.parquet")):
        for row in table.read_table(shard).to_pylist():
            said = row["set.scene.terrain"]
            fell[said] = fell.get(said, 0) + bool(row["fell"])
    assert len(fell) == 17
    assert fell["flat"] == fell['{"rough": {"height": 0.04}}'] == 0
    assert fell['{"rough": {"height": 0.12}}'] >= 1
    assert fell['{"slope": {"angle": -0.3}}'] >= 3
