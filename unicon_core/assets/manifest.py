"""The list of assets, `config/assets.yaml`: which files there are, where from, which licences.

With which of them are at hand, and whether their files are what the list says.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

from unicon_base import UniconError, alternatives
from unicon_base.located_yaml import Located, read_yaml
from unicon_base.resources import assets_roots, config_files, sha256_of

FOLDERS = {"model": "models", "policy": "policies"}
"""Kinds of assets, and the folder of each below the assets folder."""
LICENCES = "LICENSES/"
"""What the names of an asset's licence files begin with."""
LARGEST = 1 << 30
"""Bytes that one file may have."""


@dataclass(frozen=True)
class Source:
    """A public repository on GitHub at one commit, and under which licence what it has is."""

    repository: str
    commit: str
    licence: str

    def url(self, path: str) -> str:
        """Return the address of one of its files."""
        return (
            f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/"
            f"{quote(path, safe='/')}"
        )


@dataclass(frozen=True)
class AssetFile:
    """One file.

    Attributes:
        name: its path below the asset's folder, with slashes.
        source: where it is from.
        path: its path there.
        size: in [byte].
        sha256: 64 hexadecimal digits.
        mirrored: its path below the asset's folder on a mirror.
    """

    name: str
    source: Source
    path: str
    size: int
    sha256: str
    mirrored: str


@dataclass(frozen=True)
class Asset:
    """A model with its meshes, or a policy.

    Attributes:
        name: as in `unicon assets fetch NAME`.
        kind: `model` or `policy`.
        files: licences first.
    """

    name: str
    kind: str
    files: tuple[AssetFile, ...]

    @property
    def folder(self) -> str:
        """Its folder below the assets folder, such as `models/g1_29dof`."""
        return f"{FOLDERS[self.kind]}/{self.name}"

    @property
    def size(self) -> int:
        """Of all files together in [byte]."""
        return sum(file.size for file in self.files)

    @property
    def sources(self) -> tuple[Source, ...]:
        """Where its files are from."""
        return tuple(dict.fromkeys(file.source for file in self.files))

    @property
    def licence(self) -> str:
        """The licences of its files, with commas between them."""
        return ", ".join(dict.fromkeys(source.licence for source in self.sources))


def load_assets() -> dict[str, tuple[Asset, ...]]:
    """Return what can be fetched by its names: one asset, or the several of a set.

    Of one name the first configuration folder's counts.

    Raises:
        UniconError: a list is malformed, or a file's name leads out of its folder.
    """
    found: dict[str, tuple[Asset, ...]] = {}
    for path in config_files("assets.yaml"):
        found = {**_read(path), **found}
    return dict(sorted(found.items()))


def named(names: Sequence[str], assets: dict[str, tuple[Asset, ...]]) -> list[Asset]:
    """Return assets by their names, those of sets among them.

    Raises:
        UniconError: there is none of a name.
    """
    for name in names:
        if name not in assets:
            raise UniconError(f"unknown asset {name[:80]!r}; {alternatives(name, assets)}")
    return list(dict.fromkeys(asset for name in names for asset in assets[name]))


def _read(path: Path) -> dict[str, tuple[Asset, ...]]:
    document = read_yaml(path)
    values = document.value
    if not isinstance(values, dict):
        raise document.error((), "give a mapping of names to assets, or to lists of them")
    sets = {name: value for name, value in values.items() if isinstance(value, list)}
    assets: dict[str, tuple[Asset, ...]] = {}
    assets |= {str(name): (_asset(document, name),) for name in values if name not in sets}
    for name, members in sets.items():
        for member in members:
            if str(member) not in assets:
                raise document.error((name,), f"set {name!r} names {member!r}, which is no asset")
        assets[str(name)] = tuple(assets[str(member)][0] for member in members)
    return assets


def _asset(document: Located, key: Any) -> Asset:
    told, name = document.value[key], str(key)
    try:
        sources = [Source(**{k: str(v) for k, v in each.items()}) for each in told["sources"]]
        files = [_file(str(path), sources, *row) for path, row in told["files"].items()]
        if told["kind"] not in FOLDERS or not files or not _plain(name) or "/" in name:
            raise ValueError
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise document.error(
            (key,),
            f"asset {name!r} is not {{kind: {' or '.join(FOLDERS)}, sources: [{{repository, "
            "commit, licence}, …], files: {PATH: [source, path, bytes, sha256]}}, paths without "
            "'..'",
        ) from error
    files.sort(key=lambda file: not file.name.startswith(LICENCES))
    return Asset(name, told["kind"], tuple(files))


def _file(
    name: str,
    sources: list[Source],
    source: int,
    path: str,
    size: int,
    sha: Any,
    mirrored: str = "",
) -> AssetFile:
    digits = isinstance(sha, str) and re.fullmatch("[0-9a-f]{64}", sha)
    plain = all(map(_plain, (name, path, mirrored or name)))
    if not (plain and digits and 0 <= size <= LARGEST and source >= 0):
        raise ValueError
    return AssetFile(name, sources[source], path, size, sha, mirrored or name)


def _plain(path: str) -> bool:
    """Whether a path stays in its folder."""
    pure = PurePosixPath(path)
    inside = pure.parts and not pure.is_absolute() and ".." not in pure.parts
    return bool(inside) and not {"\\", "\0"} & set(path) and str(pure) == path


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
