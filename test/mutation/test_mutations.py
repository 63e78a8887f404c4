"""Every safety block, gate and transition is missed by a test when it is gone or weak."""

from __future__ import annotations

import ast
import importlib.util
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
CORE = ROOT / "unicon_core"


def loaded() -> ModuleType:
    """Import tools/mutation/mutate_safety.py, which belongs to no package."""
    path = ROOT / "tools" / "mutation" / "mutate_safety.py"
    spec = importlib.util.spec_from_file_location("mutate_safety", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["mutate_safety"] = module  # dataclasses ask for it
    spec.loader.exec_module(module)
    return module


TOOL = loaded()


def test_every_mutation_fits_the_code_and_its_tests_are_there() -> None:
    changed = set()
    for row in TOOL.ROWS:
        before = (ROOT / row.file).read_text("utf-8")
        after = TOOL.mutated(row, before)
        ast.parse(after)
        assert after != before, row
        assert all((ROOT / test).is_file() for test in row.tests), row.tests
        assert (row.file, after) not in changed, f"twice: {TOOL.name_of(row)}"
        changed.add((row.file, after))


def test_a_place_that_is_gone_is_an_error() -> None:
    row = TOOL.Row("f.py", "Stop.__call__", "value > 1", "False", ())
    text = "class Stop:\n    def __call__(self):\n        return value > 1\n"
    assert TOOL.mutated(row, text).endswith("return False\n")
    removed = TOOL.mutated(row._replace(old="", new="None"), text)
    assert removed.endswith("        return None\n        return value > 1\n")
    for changed in (
        text.replace("> 1", "> 2"),
        text.replace("Stop", "Halt"),
        text.replace("> 1", "> 1 + (value > 1)"),
    ):
        with pytest.raises(TOOL.AnchorError, match=r"correct tools/mutation/table\.py"):
            TOOL.mutated(row, changed)


def test_all_that_looks_is_removed_once() -> None:
    """Each class with a tick in the rooms of safety blocks and gates that stops something."""
    there = {
        (f"unicon_core/{path.relative_to(CORE)}", node.name)
        for room in ("blocks/safety", "gates")
        for path in (CORE / room).glob("*.py")
        for node in ast.parse(path.read_text("utf-8")).body
        if isinstance(node, ast.ClassDef)
        for method in node.body
        if isinstance(method, ast.FunctionDef) and method.name == "__call__"
    }
    removed = {(row.file, row.where.split(".")[0]) for row in TOOL.ROWS if not row.old}
    shows = {"StartGate", "Passing", "ObservationRange"}
    predicates = {"Commanded", "Elapsed", "Settled"}
    assert {each for each in there - removed if each[1] not in shows | predicates} == set()


@pytest.mark.skipif(sys.platform != "linux", reason="the processes of a tree are found in /proc")
@pytest.mark.parametrize("behind", ["", ":elsewhere"])
def test_what_mutated_tests_left_running_or_stopped_is_ended(behind: str, tmp_path: Path) -> None:
    code = "import os, signal; print(flush=True); os.kill(os.getpid(), signal.SIGSTOP)"
    left = subprocess.Popen(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": f"{tmp_path}{behind}"},
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    assert left.stdout is not None
    left.stdout.readline()
    TOOL.end_those_of(tmp_path / "another")
    assert left.poll() is None
    TOOL.end_those_of(tmp_path)
    assert left.wait(10) == -signal.SIGKILL


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_no_mutation_survives() -> None:
    outcomes = list(TOOL.mutate(TOOL.ROWS, jobs=2))
    assert [outcome.name for outcome in outcomes if not outcome.killed] == []
