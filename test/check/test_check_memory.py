"""`unicon check` names what a user's block remembers without declaring it."""

from __future__ import annotations

from pathlib import Path

import pytest

from unicon_core.check import check_workflow

BLOCKS = """
import numpy as np
from unicon_core.flow import Amends, Reads


class Hides:
    def __init__(self, joint_effort_ff: Amends):
        self.effort, self.count = joint_effort_ff, 0

    def __call__(self) -> None:
        self.count += 1
        self.effort += np.float32(1e-3 * self.count)


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


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Hides", "its next tick depends on count, which it does not declare: a replay differs"),
        ("Declares", ""),
        ("Raises", ""),
        ("Lacks", "Lacks.memory names 'counts', which it lacks; it has effort, count"),
        ("plain", ""),
    ],
)
def test_a_block_of_ones_own(
    name: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    module = f"own_blocks_{name.lower()}"
    (tmp_path / f"{module}.py").write_text(BLOCKS)
    path = tmp_path / "w.yaml"
    path.write_text(
        "schema: unicon.workflow/1\nname: w\nrobot: go2\nplatform: fake\nrate: 50\n"
        f"flow: {{zip: [hold, {{call: '{module}:{name}'}}]}}\n"
    )
    result = check_workflow(path)
    found = [note for note in result.notes if note.code == "blocks.memory"]
    assert [words in note.evidence for note in found] == ([True] if words else [])
    assert all("memory = (NAME, …)" in note.remedy for note in found)
