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
import unicon_lab.analysis
import unicon_lab.sweep
from unicon_core import __version__

PACKAGES = ("numpy", "mujoco", "onnxruntime", "scipy")
"""Packages whose version may move the last bit of a row."""


@lru_cache
def code_sha256() -> str:
    """Return the SHA-256 of the code that makes rows: `unicon_core`, this folder, the analysis."""
    digest = hashlib.sha256()
    for package in (unicon_core, unicon_lab.sweep, unicon_lab.analysis):
        folder = Path(str(package.__file__)).parent
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
