"""Identity: what a sweep's rows were made with, so that no two kinds of rows get mixed up."""

from __future__ import annotations

import hashlib
import importlib.metadata
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import unicon_core
from unicon_core import __version__

PACKAGES = ("numpy", "mujoco", "onnxruntime", "scipy")
"""Packages whose version may move the last bit of a row."""
ROWS = (
    *("unicon_base", "unicon_core", "unicon_manipulation", "unicon_sims"),
    *("unicon_lab/sweep", "unicon_lab/analysis"),
)
"""Folders of the code that makes rows."""


@lru_cache
def code_sha256() -> str:
    """Return the SHA-256 of the code that makes rows."""
    digest = hashlib.sha256()
    ours = Path(str(unicon_core.__file__)).parents[1]
    for folder in (ours / name for name in ROWS):
        for path in sorted(folder.rglob("*.py")):
            digest.update(f"{path.relative_to(folder)}\n".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def versions() -> dict[str, str]:
    """Return the versions of what makes rows."""
    found = {"unicon_ros": __version__}
    for name in PACKAGES:
        with suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


def differing(there: Mapping[str, str], here: Mapping[str, str]) -> Iterator[tuple[str, str, str]]:
    """Yield name, version there and version here of what differs, by name."""
    for name in sorted({*there, *here}):
        if there.get(name) != here.get(name):
            yield name, there.get(name, "absent"), here.get(name, "absent")


def changes(there: Mapping[str, Any], here: Mapping[str, Any], identity: Mapping[str, Any]) -> str:
    """Return how a folder's sweep differs from the one at hand, "" where it does not.

    Args:
        there: what the folder says.
        here: the same of now.
        identity: of the sweep at hand.
    """
    if there["sha256"] != here["sha256"]:
        said = there["identity"]
        which = [key for key in identity if said.get(key) != identity[key]]
        return f"it differs in {', '.join(which) or 'the file'}"
    if there.get("versions") != here["versions"]:
        found = differing(there.get("versions") or {}, here["versions"])
        return ", ".join(f"{name} was {old} and is {new}" for name, old, new in found)
    if there.get("code") != here["code"]:
        return "it was made by other code of the same version"
    if there.get("program") != here["program"]:
        return "robot, model or policy are other files by now"
    return ""
