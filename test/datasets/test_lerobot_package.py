"""LeRobot's own reader opens what we write, and its writer writes the same: UNICON_LEROBOT.

That is the Python of an environment that has lerobot 0.4 and what this package needs of its own
(`pip install lerobot pyyaml rosbags`); without, the tests' own, where it has lerobot.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pyarrow")
pytest.importorskip("av")

from unicon_lab.datasets.export import Wanted, export_dataset

ROOT = Path(__file__).resolve().parents[2]
PYTHON = os.environ.get("UNICON_LEROBOT", sys.executable)

pytestmark = pytest.mark.slow


def python(*arguments: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "HF_HUB_OFFLINE": "1"}
    done = subprocess.run(
        [PYTHON, *arguments], capture_output=True, text=True, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def package() -> None:
    """Skip without lerobot."""
    found = subprocess.run(
        [PYTHON, "-c", "import lerobot.datasets.lerobot_dataset"], capture_output=True, check=False
    )
    if found.returncode:
        pytest.skip("UNICON_LEROBOT: a Python with lerobot")


def opened(folder: Path, out: Path) -> dict[str, Any]:
    """Return what LeRobot's reader finds in a data set."""
    reader = Path(__file__).with_name("lerobot_reader.py")
    python(str(reader), str(folder), str(out))
    with np.load(out) as file:
        return dict(file)


@pytest.mark.parametrize("video", [True, False])
@pytest.mark.usefixtures("package")
def test_both_write_what_the_public_reader_opens(
    video: bool, bags: list[Path], tmp_path: Path
) -> None:
    wanted = Wanted(fps=20, task="stand still", video=video, writer="own")
    export_dataset(bags, tmp_path / "own", wanted)
    names = [str(bag) for bag in bags]
    arguments = [*names, "--out", str(tmp_path / "theirs"), "--fps", "20", "--task", "stand still"]
    told = python(
        *("-m", "unicon_ros", "bag", "export", "--lerobot", *arguments),
        *(() if video else ("--no-video",)),
    )
    assert "written by lerobot" in told  # since it is installed there
    ours = opened(tmp_path / "own", tmp_path / "own.npz")
    theirs = opened(tmp_path / "theirs", tmp_path / "theirs.npz")
    assert ours.keys() == theirs.keys()
    for key, mine in ours.items():
        other = theirs[key]
        if mine.dtype.kind == "U":
            assert (mine == other).all(), (key, mine, other)
            continue
        assert mine.shape == other.shape
        if key.startswith("stats/") and key.rpartition("/")[2].startswith("q"):
            # Theirs are estimated from 5,000 bins, and of an episode of n frames lie up to 1 / n
            # of its range beside ours.
            spread = float(np.max(ours[key.rpartition("/")[0] + "/max"])) + 1e-6
            assert np.abs(mine - other).max() < 0.2 * spread, key
        elif key.startswith("stats/observation.images") and key.endswith("/std"):
            continue  # 0.4.4 squares 8-bit colours in 8 bits, so that its deviation is wrong
        elif key.startswith("observation.images") and video:
            assert np.abs(mine - other).mean() < 0.01, key
        else:
            assert np.allclose(mine, other, rtol=1e-6, atol=2e-6), key
