"""Seven robots walk in MuJoCo, and by one word as emulated robots: 10 s of their policies."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from emulated_runs import UNICON, ended
from peer import Peer
from vendor_robots import serve

from unicon_core.check import check_workflow

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = {"robot": "stand_in", "policy": "vendor"}

pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")
pytest.importorskip("onnxruntime", reason="pip install 'unicon_ros[sim]'")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

# A humanoid hangs until its policy has begun: nobody balances it before.
UPRIGHT = ("--posture=default", "--let-go=4.5")
WALKS = {
    "go1": ("go1_walk", ()),
    "go2": ("go2_walk", ()),
    "b2": ("b2_walk", ()),
    "g1_29dof": ("g1_walk", UPRIGHT),
    "h1": ("h1_walk", UPRIGHT),
    "h1_2": ("h1_2_walk", UPRIGHT),
    "t1": ("t1_walk", UPRIGHT),
}
# Metres in 10 s.
LEAST = 3.0
AHEAD = ("--set=commands=[{velocity_command: {constant: [0.5, 0.0, 0.0]}}]", "--duration=14")


def has_feet(workflow: str) -> None:
    """Skip where the meshes that are the robot's feet are absent."""
    for finding in check_workflow(workflow).findings:
        if finding.code == "model.collision":
            pytest.skip(f"{finding.evidence}: unicon assets fetch")


DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "reference" / "robots.md"


@pytest.fixture(scope="module")
def walked() -> Iterator[dict[str, dict[str, float]]]:
    """Metres by robot and world; UNICON_WRITE_GOLDEN=1 writes the table of the document."""
    metres: dict[str, dict[str, float]] = {}
    yield metres
    if not os.environ.get("UNICON_WRITE_GOLDEN"):
        return
    rows = ["| robot | workflow | in MuJoCo, 10 s | emulated robot, 14 s |", "|---|---|---|---|"]
    for robot, told in metres.items():
        cells = (f"{told[world]:.2f} m" if world in told else "" for world in ("mujoco", "robot"))
        rows.append(f"| `{robot}` | `{WALKS[robot][0]}` | {' | '.join(cells)} |")
    text, table = DOCUMENT.read_text("utf-8"), "\n".join(rows)
    begin, end = "<!-- walks: begin -->", "<!-- walks: end -->"
    text = re.sub(f"{begin}.*?{end}", f"{begin}\n{table}\n{end}", text, flags=re.DOTALL)
    DOCUMENT.write_text(text, "utf-8")


@pytest.mark.parametrize("robot", WALKS)
def test_it_walks_in_mujoco(
    robot: str,
    tmp_path: Path,
    at_hand: Callable[[str], None],
    walked: dict[str, dict[str, float]],
) -> None:
    workflow, report = WALKS[robot][0], tmp_path / "report.json"
    at_hand(workflow)
    has_feet(workflow)
    command = [*UNICON, "run", workflow, "--speed=max", "--duration=10", f"--report={report}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    told = json.loads(report.read_text("utf-8"))
    assert not told["fell"]
    walked.setdefault(robot, {})["mujoco"] = told["base_displacement_m"][0]
    assert told["base_displacement_m"][0] >= LEAST


@pytest.mark.parametrize("robot", WALKS)
def test_it_walks_as_an_emulated_robot_by_one_word(
    robot: str,
    processes: Callable[..., Peer],
    tmp_path: Path,
    at_hand: Callable[[str], None],
    walked: dict[str, dict[str, float]],
) -> None:
    pytest.importorskip(
        "cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-unitree]'"
    )
    workflow, more = WALKS[robot]
    at_hand(workflow)
    has_feet(workflow)
    served = serve(processes, robot, robot, *more)
    report = ended(served.run(workflow, tmp_path, *AHEAD), tmp_path)
    assert report["faults"] == []
    assert served.of("refused") == []
    walked.setdefault(robot, {})["robot"] = moved = served.moved()
    assert moved >= LEAST
