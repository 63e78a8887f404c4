"""docs/howto/add_a_simulator.md its simulator passes the suite; a policy walks in it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from unicon_core.conformance import Conformance
from unicon_core.platforms.kit import joint_model

pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "howto" / "add_a_simulator.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"```python title=(\S+)\n(.*?)```", TEXT, re.DOTALL))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the files of the document lie."""
    place = tmp_path_factory.mktemp("theirs")
    for name, text in FILES.items():
        (place / name).write_text(text, encoding="utf-8")
    return place


def ran(folder, *words):
    """Run Python beside those files."""
    return subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.slow
def test_its_simulator_passes_the_whole_suite(folder):
    done = ran(folder, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_my_simulator.py")
    found = re.search(r"(\d+) passed", done.stdout)
    assert done.returncode == 0, done.stdout
    tests = [name for name in dir(Conformance) if name.startswith("test_")]
    assert found is not None
    assert int(found[1]) >= len(tests) >= 25


def test_a_policy_walks_in_it(folder):
    pytest.importorskip("onnxruntime", reason="the policy needs onnxruntime")
    told = "platform=my_simulator:make", "platforms={'my_simulator:make': {timestep: 0.002}}"
    words = ["go2_walk", "--speed", "max", "--set", told[0], "--set", told[1]]
    done = ran(folder, "-m", "unicon_ros", "run", *words)
    assert done.returncode == 0, done.stderr
    moved = re.search(r"base +moved \+(\d+\.\d+) ", done.stdout)
    assert moved is not None
    assert float(moved[1]) > 3.5
    assert "did not fall" in done.stdout


def test_what_it_names_is_there():
    methods = re.findall(r"^\| `(\w+)` \|", TEXT, re.MULTILINE)
    assert methods == ["__init__", "place", "joints", "base", "step", "add_velocity", "close"]
    assert all(f"def {method}(self" in FILES["my_simulator.py"] for method in methods)
    said = str(joint_model.lost.__doc__)
    for word in ("armature", "self-collision", "contact friction", "terrain"):
        assert word in said
        assert f"`{word}`" in TEXT
