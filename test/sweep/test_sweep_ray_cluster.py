"""Engine `ray` on clusters of this machine: the same table as `local`, whatever is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from ray_nodes import TOKEN, Node, left_of

from unicon_base.resources import same_modules
from unicon_lab.sweep.folder import read_journal
from unicon_lab.sweep.results import Results

pytest.importorskip("ray", reason="pip install 'unicon_ros[ray]'")
pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")
pytest.importorskip("pyarrow")
pytestmark = pytest.mark.slow

SWEEP = """\
workflow: go2_walk
duration: 3
set: {flow: {policy: walk}, scene.initial_pose: "policy:walk", scene.push.every: 0.5}
vary:
  scene.seed: {range: [0, 99]}
  scene.push.velocity: {linspace: [0.2, 2.0, 4]}
early_stop: fall
timeout: 10
"""
ROWS = 400


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a sweep file; its table by engine `local` lies beside it, in `local`."""
    path = tmp_path_factory.mktemp("ray") / "sweep.yaml"
    path.write_text(SWEEP)
    run = started(path, "local", "--engine", "local")
    assert run.wait(300) == 0
    return path


@pytest.fixture
def head(tmp_path: Path) -> Iterator[Node]:
    """Return the head of a cluster."""
    with tempfile.TemporaryDirectory(prefix="ray_", ignore_cleanup_errors=True) as folder:
        node = Node(tmp_path / "head.log", folder=folder)
        try:
            yield node
        finally:
            node.close()


@pytest.fixture
def second(tmp_path: Path, head: Node) -> Iterator[Node]:
    """Return another node of it."""
    node = Node(tmp_path / "second.log", head.address)
    try:
        yield node
    finally:
        node.close()


def started(
    sweep: Path, out: str, *arguments: str, environment: dict[str, str] | None = None
) -> subprocess.Popen[str]:
    """Start the command in the sweep's folder."""
    return subprocess.Popen(
        [sys.executable, "-m", "unicon_ros", "sweep", sweep.name, "--out", out, *arguments],
        cwd=sweep.parent, env=same_modules() | (environment or {}), text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def on_ray(sweep: Path, out: str, address: str = "") -> subprocess.Popen[str]:
    if not address:
        return started(sweep, out, "--engine", "ray")
    return started(sweep, out, "--engine", "ray", "--address", address, environment=TOKEN)


def wait_for(folder: Path, rows: int, run: subprocess.Popen[str]) -> None:
    """Wait until so many rows are written."""
    until = time.monotonic() + 180.0
    while not folder.exists() or len(read_journal(folder)) < rows:
        assert run.poll() is None, run.communicate()
        assert time.monotonic() < until
        time.sleep(0.05)


def same(sweep: Path, out: str, run: subprocess.Popen[str]) -> None:
    """Hold what came out equal to what `local` has."""
    said = run.communicate(timeout=300)
    assert run.returncode == 0, said
    here, there = Results(sweep.parent / "local"), Results(sweep.parent / out)
    assert (len(there), there.failed) == (ROWS, 0)
    assert there.sha256 == here.sha256


def test_two_nodes_that_lose_a_worker_and_then_one_of_them(
    sweep: Path, head: Node, second: Node
) -> None:
    out = sweep.parent / "nodes"
    run = on_ray(sweep, "nodes", head.address)
    wait_for(out, 20, run)
    assert head.processes("ray::RowActor")
    assert second.kill("ray::RowActor") == 1
    wait_for(out, 100, run)
    for worker in head.processes("ray::RowActor"):
        worker.send_signal(signal.SIGSTOP)
    wait_for(out, 180, run)
    second.kill("")
    same(sweep, "nodes", run)


def test_a_command_that_is_killed_goes_on_and_leaves_no_ray(sweep: Path) -> None:
    out = sweep.parent / "killed"
    for rows, number in ((20, signal.SIGKILL), (60, signal.SIGINT)):
        run = on_ray(sweep, "killed")
        wait_for(out, rows, run)
        os.kill(run.pid, number)
        said = run.communicate(timeout=60)
        assert run.returncode != 0, said
        until = time.monotonic() + 30.0
        while left_of(f"{tempfile.gettempdir()}/unicon_ray_"):
            assert time.monotonic() < until
            time.sleep(0.2)
    same(sweep, "killed", on_ray(sweep, "killed"))
    assert not list(Path(tempfile.gettempdir()).glob("unicon_ray_*"))


def test_a_head_that_is_lost_is_told_and_another_goes_on(
    sweep: Path, tmp_path: Path, head: Node
) -> None:
    run = started(sweep, "headless", "--engine", "ray", "--address", head.address)
    said = run.communicate(timeout=90)
    assert said[1].count("\n") == 1
    assert "a cluster that has tokens wants RAY_AUTH_MODE=token here, too; what Ray" in said[1]
    out = sweep.parent / "headless"
    run = on_ray(sweep, "headless", head.address)
    wait_for(out, 20, run)
    head.kill("")
    said = run.communicate(timeout=60)
    assert run.returncode == 1
    assert f"Ray's head node at {head.address} is lost: " in said[1]
    assert said[1].count("\n") == 1
    same(sweep, "headless", on_ray(sweep, "headless"))
