"""`unicon check` names what a user's block remembers without declaring it."""

from __future__ import annotations

from pathlib import Path

import pytest

from unicon_core.check import check_workflow
from unicon_core.check.result import CheckResult, Finding

BLOCKS = """
from pathlib import Path

import numpy as np
from unicon_core.flow import Amends, Reads


class Hides:
    def __init__(self, joint_effort_ff: Amends):
        self.effort, self.count = joint_effort_ff, 0

    def __call__(self) -> None:
        Path(__file__).with_name("ticked").touch()
        self.count += 1
        self.effort += np.float32(1e-3 * self.count)


class Says(Hides):
    memory = ()


class Declares(Hides):
    memory = ("count",)


class Raises(Declares):
    def __call__(self) -> None:
        self.peer.send()


class Lacks(Declares):
    memory = ("counts",)


def plain(joint_pos: Reads, joint_effort_ff: Amends):
    def tick() -> None:
        joint_effort_ff[...] = 0.0 * joint_pos

    return tick
"""


DEPENDS = "its next tick depends on count, which it does not declare: a replay differs"
LACKS = "Lacks.memory names 'counts', which it lacks; it has effort, count"


@pytest.mark.parametrize(
    ("name", "named", "proven"),
    [
        ("Hides", "declares no memory: records lack its memory", DEPENDS),
        ("Declares", "", ""),
        ("Raises", "", None),
        ("Lacks", LACKS, LACKS),
        ("Says", "", DEPENDS),
        ("plain", "", ""),
    ],
)
def test_a_block_of_ones_own(
    name: str, named: str, proven: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    module = f"own_blocks_{name.lower()}"
    (tmp_path / f"{module}.py").write_text(BLOCKS)
    path = tmp_path / "w.yaml"
    path.write_text(
        "schema: unicon.workflow/1\nname: w\nrobot: go2\nplatform: fake\nrate: 50\n"
        f"flow: {{zip: [hold, {{call: '{module}:{name}'}}]}}\n"
    )
    found = notes(check_workflow(path))
    assert [named in note.evidence for note in found] == ([True] if named else [])
    assert not (tmp_path / "ticked").exists()  # a check ticks nothing of the user's
    if proven is None:  # it cannot be simulated
        return
    found = notes(check_workflow(path, twin=True))
    assert any(proven in note.evidence for note in found) == bool(proven)


def notes(result: CheckResult) -> list[Finding]:
    """Return what is said of memories."""
    found = [note for note in result.notes if note.code == "blocks.memory"]
    assert all("memory = (NAME, …)" in note.remedy for note in found)
    return found
