"""Files that other installed packages bring: by the ament path, and by entry points of Python.

    package://my_robot/models/arm.xml     share/my_robot/models/arm.xml of an ament prefix
    config_folders()                      robots, workflows, maps and policies of other packages

An ament prefix is a folder of `AMENT_PREFIX_PATH`, as a sourced workspace sets it, or that of this
Python, where pip and the ROS wheels put their share. A package tells its configuration folder in
one of two ways, or in both:

- the resource index: an empty file `share/ament_index/resource_index/unicon.config/PACKAGE` means
  `share/PACKAGE/config`; one with a line in it, that folder below the prefix;
- an entry point `PACKAGE` of the group `unicon.config`: a package folder, a path, or a function
  that returns one, or None. So it is found without a share, as after `pip install -e`.
"""

from __future__ import annotations

import os
import sys
from functools import lru_cache
from pathlib import Path

from unicon_base.errors import UniconError, alternatives
from unicon_base.registered import path_of, registered

PACKAGE = "package://"
RESOURCE = "unicon.config"
_INDEX = Path("share") / "ament_index" / "resource_index"
_OURS = "unicon_ros"
_SOURCE_TREE = Path(__file__).resolve().parent.parent


def prefixes() -> tuple[Path, ...]:
    """Return the ament prefixes, the first one wins; the last is that of this Python."""
    return _prefixes(os.environ.get("AMENT_PREFIX_PATH", ""), sys.prefix)


def share_folder(package: str) -> Path | None:
    """Return the share folder of a package, or None where no package of that name is installed.

    Ours is the source tree, where we run from one. That of a package without a share is the folder
    that holds its registered configuration folder.
    """
    if package == _OURS and os.path.isdir(_SOURCE_TREE / "config"):
        return _SOURCE_TREE
    if "/" in package or package in ("", ".", ".."):
        return None
    for prefix in prefixes():
        if os.path.isdir(prefix / "share" / package):
            return prefix / "share" / package
    registered_there = registered_folders().get(package)
    return registered_there.parent if isinstance(registered_there, Path) else None


def package_file(reference: str, what: str, error: type[UniconError] = UniconError) -> Path:
    """Return the file or folder that `package://PACKAGE/PATH` means.

    Args:
        reference: the text.
        what: for the message, such as `"model"`.
        error: the class to raise.

    Raises:
        error: no such package, or no such file in it; the message names where was searched.
    """
    package, _, rest = reference.removeprefix(PACKAGE).partition("/")
    share = share_folder(package)
    if share is None:
        known = alternatives(package, _packages())
        raise error(
            f"{what} {reference!r}: no package {package!r} is installed; {known}; {shares()}"
        )
    path = share / rest
    if not rest or rest.startswith("/") or ".." in Path(rest).parts:
        raise error(f"{what} {reference!r}: write {PACKAGE}{package}/PATH, below {share}")
    if not os.path.exists(path):
        raise error(
            f"{what} {reference!r}: no such file; looked in {share}; correct the path, or build "
            "and source the package's workspace again"
        )
    return path


def shares() -> str:
    """Return where packages are looked for, for messages."""
    return (
        f"looked in share/ of {', '.join(map(str, prefixes()))} (AMENT_PREFIX_PATH adds prefixes; "
        "source the package's workspace)"
    )


def indexed_folders() -> tuple[Path, ...]:
    """Return the configuration folders that the resource index of the ament prefixes names."""
    return tuple(folder for prefix in prefixes() for folder in _indexed(prefix))


def registered_folders() -> dict[str, Path | str]:
    """Return the configuration folders of entry points, by name; the reason where there is none.

    Their modules are imported, 11 ms for a look at all installed packages besides: only for what is
    not found elsewhere, and for lists.
    """
    found: dict[str, Path | str] = {}
    for name, entry in registered("config").items():
        try:
            path = path_of(entry, f"entry point {name} of {RESOURCE}", UniconError)
        except UniconError as error:
            found[name] = str(error)
        else:
            if path is not None:
                found[name] = path
    return found


@lru_cache(maxsize=8)
def _prefixes(ament_path: str, python: str) -> tuple[Path, ...]:
    given = [Path(path) for path in ament_path.split(os.pathsep) if path]
    return tuple(path for path in dict.fromkeys([*given, Path(python)]) if os.path.isdir(path))


@lru_cache(maxsize=64)
def _indexed(prefix: Path) -> tuple[Path, ...]:
    try:
        markers = sorted(os.listdir(prefix / _INDEX / RESOURCE))
    except OSError:
        return ()
    found = []
    for package in markers:
        if package.startswith(".") or package == _OURS:
            continue
        try:
            text = (prefix / _INDEX / RESOURCE / package).read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError):
            continue
        found.append(prefix / (text or f"share/{package}/config"))
    return tuple(found)


def _packages() -> set[str]:
    names = set(registered_folders())
    for prefix in prefixes():
        try:
            names.update(os.listdir(prefix / _INDEX / "packages"))
        except OSError:
            continue
    return names
