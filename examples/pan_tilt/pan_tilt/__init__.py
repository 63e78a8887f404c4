"""A head with two joints: what a package of one's own looks like beside unicon_ros."""

from __future__ import annotations

from pathlib import Path

__all__ = ["config"]


def config() -> Path | None:
    """Return the folder with robots, workflows, maps and policies where we run from a source tree.

    So `pip install -e` finds it, which installs no share. Elsewhere the resource index tells it.
    """
    beside = Path(__file__).resolve().parent.parent / "config"
    return beside if beside.is_dir() else None
