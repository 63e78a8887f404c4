"""A sweep that every test of the folder may read, run once by two workers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

SWEEP = """\
workflow: go2_walk
duration: 0.6
set: {flow: {policy: walk}, scene.initial_pose: "policy:walk", scene.push.every: 0.1}
vary:
  scene.seed: {range: [0, 9]}
  scene.push.velocity: {linspace: [0.2, 4.0, 2]}
early_stop: fall
keep: [joint_pos, projected_gravity]
"""


@pytest.fixture(scope="session")
def done(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Return the folder of a sweep whose file, `sweep.yaml`, lies beside it."""
    pytest.importorskip("mujoco")
    pytest.importorskip("onnxruntime")
    pytest.importorskip("pyarrow")
    from unicon_ros.cli.main import main

    folder = tmp_path_factory.mktemp("sweep")
    (folder / "sweep.yaml").write_text(SWEEP, "utf-8")
    out = folder / "out"
    status = main(["sweep", str(folder / "sweep.yaml"), "--out", str(out), "--workers", "2"])
    assert status == 0
    return out
