"""The map and its codec are a distribution of their own: installed alone, it passes its tests."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from source_tree import ROOT, copy_source

ALONE = "import importlib.util as u; assert u.find_spec('unicon_core') is None; "
MAP = (
    "from unicon_base.resources import find_config; from unicon_msgs_map import load_map; "
    "load_map(find_config('maps', 'default'))"
)


@pytest.mark.slow
def test_the_map_alone_passes_its_tests(tmp_path: Path, under_colcon: bool) -> None:
    if under_colcon:
        pytest.skip("colcon tests its own installation")
    source = copy_source(tmp_path / "source")
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True, timeout=120)
    python = tmp_path / "venv" / "bin" / "python"
    pip = [python, "-m", "pip", "install", "-q"]
    others = subprocess.run(
        [*pip, "pytest", "hypothesis"], capture_output=True, text=True, timeout=600
    )
    if others.returncode:  # our own package's failure is none of the registry
        pytest.skip(f"pip reaches no registry: {others.stderr.splitlines()[-1]}")
    subprocess.run([*pip, source / "unicon_msgs_map"], check=True, timeout=600)
    work = tmp_path / "work"
    shutil.copytree(ROOT / "test" / "map", work / "test" / "map")
    shutil.copytree(ROOT / "config" / "maps", work / "config" / "maps")
    subprocess.run([python, "-c", ALONE + MAP], cwd=work, check=True, timeout=60)
    pytest_of_it = [python, "-m", "pytest", "-q", "--noconftest", "-m", "not slow", "test/map"]
    done = subprocess.run(pytest_of_it, cwd=work, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout[-2000:]


def test_its_tests_import_it_and_the_base_or_skip_without_the_rest() -> None:
    rooms = re.compile(r"^(?:from|import) unicon_(?!base|msgs_map)", re.MULTILINE)
    for path in (ROOT / "test" / "map").glob("test_*.py"):
        text = path.read_text(encoding="utf-8")
        assert not rooms.search(text.partition("importorskip")[0]), path.name
