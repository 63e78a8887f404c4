"""Copies of the source tree, for tests that build or install it and must leave it untouched."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
PACKAGES = (
    *("unicon_base", "unicon_core", "unicon_msgs_map", "unicon_ros", "unicon_sims"),
    *("unicon_hardware", "unicon_manipulation", "unicon_lab"),
)
"""Import packages of the distribution."""
BUILT = {"build", "install", "log", "out", "dist", "__pycache__"}


def tracked_files() -> list[str]:
    """Return the files of the source tree as POSIX paths: what git knows or would add.

    Without git (an unpacked archive, a colcon workspace): everything that no tool has built.
    """
    asked = subprocess.run(
        ["git", "-C", str(ROOT), "ls-files", "--cached", "--others", "--exclude-standard"],
        capture_output=True,
        text=True,
        check=False,
    )
    if asked.returncode == 0 and asked.stdout:
        names = asked.stdout.splitlines()
    else:
        names = [p.relative_to(ROOT).as_posix() for p in ROOT.rglob("*")]
    return sorted(n for n in names if (ROOT / n).is_file() and not _built(Path(n)))


def copy_source(to: Path) -> Path:
    """Copy the source tree to a folder that does not exist yet, and return it."""
    for name in tracked_files():
        target = to / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, target)
    return to


def _built(path: Path) -> bool:
    folders = path.parts[:-1]
    hidden = any(part.startswith(".") and part != ".ci" for part in folders)
    egg_info = any(part.endswith(".egg-info") for part in folders)
    return hidden or egg_info or path.suffix == ".pyc" or any(part in BUILT for part in folders)
