"""Keywords of `Program`: the keys of a workflow file, which type checkers know."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from unicon_base.schema.records import record_of
from unicon_core.workflow.file import Workflow
from unicon_core.workflow.program import Described

PROGRAM = """\
from unicon_core import Program, block

Program({keywords}, platform="mujoco", flow=block("hold"))
"""


def test_they_are_the_keys_of_a_workflow_file() -> None:
    assert set(Described.__annotations__) == set(record_of(Workflow).keys) - {"schema"}


@pytest.mark.parametrize(
    ("keywords", "refused"),
    [
        ('robot="go2", rate=50', ""),
        ('robt="go2"', 'Unexpected keyword argument "robt" for "Program"; did you mean "robot"?'),
        ('robot="go2", rate="50"', 'Argument "rate" to "Program" has incompatible type "str"'),
    ],
)
@pytest.mark.slow
def test_a_type_checker_refuses_others(keywords: str, refused: str, tmp_path: Path) -> None:
    pytest.importorskip("mypy")
    (tmp_path / "mine.py").write_text(PROGRAM.format(keywords=keywords), "utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", str(tmp_path / "mine.py")]
    told = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    assert (refused or "Success: no issues found") in told
