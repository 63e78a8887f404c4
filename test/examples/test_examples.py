"""Every example runs as its user runs it, says what it promises, and fits on a page."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow

EXAMPLES = sorted(Path(__file__).resolve().parents[2].joinpath("examples").glob("[0-9]*.py"))
LONGEST = 60

SAYS = {
    "01_ten_lines": r"base +moved \+[4-9]\.\d\d .*did not fall",
    "02_own_block": r"500 ticks, done",
    "03_paper_equations": r"= \(g1, h1\) \(g2, h2\) \(g3, h3\)\n"
    r".*= \(g1\) \(g2\) \(g3\) \(h1\) \(h2\) \(h3\)\n.*= \(f1\) \(f2\)\n",
    "04_go2_walk": r"sha256_commands [0-9a-f]{64}",
    "05_ros": r"published [1-9]\d+, received \d+, duration",
    "06_modes": r"walked to \+\d\.\d\d \+\d\.\d\d m and stood again",
    "07_gates_and_wind_down": r"done; at the end the thigh is at 1\.36 rad",
    "08_many_robots": r"8 robots went \d",
    "09_observer": r"largest joint velocity \d+\.\d rad/s",
    "10_test_a_block": r"fast joints are softened",
}


def output(path: Path, *arguments: str) -> str:
    environment = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    done = subprocess.run(
        [sys.executable, str(path), *arguments],
        capture_output=True,
        text=True,
        timeout=100,
        env=environment,
        cwd=path.parent,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_it_runs_and_says(path: Path, request: pytest.FixtureRequest) -> None:
    arguments = []
    if path.stem == "05_ros":
        pytest.importorskip("rclpy", reason="this one needs ROS")
        arguments = ["1"]
    assert len(path.read_text(encoding="utf-8").splitlines()) <= LONGEST
    said = output(path, *arguments)
    assert re.search(SAYS[path.stem], said), said


def test_the_program_of_go2_walk_sends_what_the_workflow_sends() -> None:
    path = next(path for path in EXAMPLES if path.stem == "04_go2_walk")
    report = Runner(load_workflow("go2_walk"), RunOptions(speed="max")).run()
    assert output(path).strip() == f"sha256_commands {report.sha256_commands}"
