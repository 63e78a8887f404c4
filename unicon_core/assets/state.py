"""Which assets are at hand, and whether their files are what the list says."""

from __future__ import annotations

import os
from pathlib import Path

from unicon_core.assets.manifest import Asset
from unicon_core.resources import assets_roots, sha256_of


def asset_folder(asset: Asset) -> Path | None:
    """Return the folder of an asset that is at hand, `UNICON_ASSETS` before the cache; or None."""
    places = (root / asset.folder for root in assets_roots())
    return next((place for place in places if os.path.isdir(place)), None)


def wrong_files(folder: Path, asset: Asset) -> dict[str, str]:
    """Return the files that are not what the list says, and how so.

    Args:
        folder: of the asset.
        asset: what it is to be.
    """
    wrong = {}
    for file in asset.files:
        path = folder / file.name
        differs = _differs(path, file.size)
        if not differs:
            try:
                differs = "" if sha256_of(path) == file.sha256 else "another SHA-256"
            except OSError as error:
                differs = error.strerror or str(error)
        if differs:
            wrong[file.name] = differs
    return wrong


def _differs(path: Path, size: int) -> str:
    if not path.is_file():
        return "missing"
    there = path.stat().st_size
    return "" if there == size else f"{there} bytes, not {size}"
