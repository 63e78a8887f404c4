"""What users can name stays: commands, options, keys, blocks, robots, topics, exports."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from source_tree import ROOT

HERE = Path(__file__).parent


def lines_of(name: str) -> list[str]:
    return (HERE / name).read_text("utf-8").splitlines()


def test_nothing_that_a_user_can_name_is_lost_without_a_reason() -> None:
    missing = subprocess.run(
        [sys.executable, str(ROOT / "tools/lib/inventory.py"), str(HERE / "inventory.txt")],
        capture_output=True,
        text=True,
        check=True,
        timeout=90,
    ).stdout.splitlines()
    gone = dict(line.split(" # ", 1) for line in lines_of("inventory_gone.txt") if line)
    assert all(gone.values())
    assert {line for line in missing if line} == set(gone)
