"""The package of one's own in `examples/pan_tilt`, as its user has it: built, sourced, run."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "examples" / "pan_tilt"
HERE = Path(__file__).resolve().parent
BUILT = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")


def run(*command: str, cwd: Path, **more: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **more}
    return subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300, check=False
    )


def same_python() -> str:
    """Return a PYTHONPATH with this source tree."""
    return os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])


def test_it_runs_from_its_source_tree_as_after_pip_install_e(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    pytest.importorskip("onnxruntime")
    source = shutil.copytree(PACKAGE, tmp_path / "pan_tilt", ignore=BUILT)
    made = run(sys.executable, "setup.py", "-q", "egg_info", cwd=source)  # as -e does
    assert made.returncode == 0, made.stderr
    report = tmp_path / "report.json"
    command = [sys.executable, "-m", "unicon_ros", "run", "pan_tilt_look", "--no-ros"]
    command += ["--speed", "max", "--duration", "3", "--report", str(report)]
    path = f"{source}{os.pathsep}{same_python()}"
    done = run(*command, cwd=tmp_path, PYTHONPATH=path)
    assert done.returncode == 0, done.stdout + done.stderr
    told = json.loads(report.read_text(encoding="utf-8"))
    assert (told["workflow"], told["robot"], told["ticks"]) == ("pan_tilt_look", "pan_tilt", 150)
    assert told["faults"] == []
    maps = run(
        *(sys.executable, "-m", "unicon_ros", "check", "pan_tilt_look", "--ros"),
        cwd=tmp_path,
        PYTHONPATH=path,
    )
    assert maps.returncode == 0, maps.stdout
    assert maps.stdout.rstrip().endswith("clean")


def test_every_file_of_the_package_is_installed_with_its_name(tmp_path: Path) -> None:
    """What setup.py names is all there is: a forgotten file would be missed by users alone."""
    source = shutil.copytree(PACKAGE, tmp_path / "pan_tilt", ignore=BUILT)
    done = run(
        *(sys.executable, "setup.py", "-q", "install_data", f"--install-dir={tmp_path / 'data'}"),
        cwd=source,
    )
    assert done.returncode == 0, done.stderr
    share = tmp_path / "data" / "share" / "pan_tilt"
    for folder in ("config", "msg"):
        wanted = {p.relative_to(source) for p in (source / folder).rglob("*") if p.is_file()}
        assert wanted == {p.relative_to(share) for p in (share / folder).rglob("*") if p.is_file()}


@pytest.fixture(scope="module", params=["copied", "symlinked"])
def workspace(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, under_colcon: bool
) -> Path:
    """A colcon workspace with the example, built in each of the two ways to install."""
    if under_colcon:
        pytest.skip("colcon runs these tests already")
    pytest.importorskip("rclpy", reason="the example runs with ROS")
    beside = Path(sys.executable).with_name("colcon")
    colcon = str(beside) if beside.exists() else shutil.which("colcon")
    if colcon is None:
        pytest.skip("colcon is not installed: pip install colcon-common-extensions 'setuptools<80'")
    root = tmp_path_factory.mktemp(f"downstream_{request.param}")
    shutil.copytree(PACKAGE, root / "src" / "pan_tilt", ignore=BUILT)
    options = ["--symlink-install"] if request.param == "symlinked" else []
    done = run(colcon, "build", *options, "--event-handlers", "console_direct+", cwd=root)
    assert done.returncode == 0, done.stdout + done.stderr
    return root


def sourced(root: Path, *command: str) -> tuple[str, ...]:
    """Return the command line that runs a command with the workspace sourced."""
    script = f'. {root}/install/setup.bash && export PYTHONPATH="$PYTHONPATH:{ROOT}" && exec "$@"'
    return ("bash", "-c", script, "sourced", *command)


@pytest.mark.slow
@pytest.mark.ros
def test_its_executable_runs_its_own_robot_block_map_policy_and_workflow(
    workspace: Path, processes: Callable[..., Any], tmp_path: Path
) -> None:
    look = workspace / "install" / "pan_tilt" / "lib" / "pan_tilt" / "look"
    report = tmp_path / "report.json"
    head = processes(*sourced(workspace, str(look), "--duration", "20", "--report", str(report)))
    peer = processes(*sourced(workspace, sys.executable, str(HERE / "gaze_peer.py"), "0.8", "-0.3"))

    def looks_there() -> bool:
        gazes = peer.of("gaze")
        return bool(gazes) and abs(gazes[-1]["pan"] - 0.8) < 0.02 > abs(gazes[-1]["tilt"] + 0.3)

    end = time.monotonic() + 60
    while not looks_there():
        assert time.monotonic() < end, (peer.of("gaze")[-1:], peer.errors, head.errors)
        time.sleep(0.05)
    assert {line["frame"] for line in peer.of("gaze")} == {"base_link"}
    status, errors = head.end(60)
    assert status == 0, errors
    assert "is left out" not in errors
    told = json.loads(report.read_text(encoding="utf-8"))
    assert (told["workflow"], told["robot"], told["faults"]) == ("pan_tilt_look", "pan_tilt", [])
    topics = told["bridge"]["topics"]
    assert topics["/gaze"]["published"] > 100
    assert topics["/look_at"]["received"] > 10
    assert topics["/look_at"]["rejected"] == 0


@pytest.mark.slow
@pytest.mark.ros
@pytest.mark.parametrize(
    ("kind", "name"),
    [("robots", "pan_tilt"), ("policies", "pan_tilt_look"), ("workflows", "pan_tilt_look")],
)
def test_its_names_are_listed_in_a_sourced_workspace(workspace: Path, kind: str, name: str) -> None:
    python = (sys.executable, "-m", "unicon_ros")
    listed = run(*sourced(workspace, *python, kind), cwd=workspace)
    assert listed.returncode == 0, listed.stderr
    assert name in [line.split()[0] for line in listed.stdout.splitlines() if line.strip()]
    blocks = run(*sourced(workspace, *python, "blocks"), cwd=workspace)
    assert "pan_tilt.blocks:look_around" in blocks.stdout
