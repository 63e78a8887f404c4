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
from collections.abc import Mapping
from contextlib import suppress
from functools import cache, lru_cache
from importlib.metadata import EntryPoint, distribution, distributions
from pathlib import Path

from unicon_base import AnyDict, AnyMapping, UniconError, alternatives


def registered(kind: str) -> Mapping[str, EntryPoint]:
    """Return name to entry point of a group; of two with one name the first found.

    Args:
        kind: `blocks`, `platforms`, `policies`, `faces`, `config`, `commands` or `run`, whose
            group is `unicon.KIND`.
    """
    return all_registered().get(f"unicon.{kind}", {})


NEEDED = {"commands": ("add",), "run": ("OPTIONS", "CHECKS", "refuse", "attachments")}
"""What an object of a group has."""


@cache
def loaded(kind: str) -> AnyMapping:
    """Return name to object of a group, by name; without those whose package was removed.

    Another package that is broken is named on standard error and left out.

    Args:
        kind: a key of `NEEDED`.
    """
    found: AnyDict = {}
    for name, entry in sorted(registered(kind).items()):
        try:
            each = entry.load()
            lacking = [repr(word) for word in NEEDED[kind] if not hasattr(each, word)]
            why = f"it has no {', '.join(lacking)}" if lacking else ""
        except Exception as wrong:  # whatever another package's code raises
            gone = wrong.name or "?" if isinstance(wrong, ModuleNotFoundError) else "?"
            if f"{entry.module}.".startswith(f"{gone}."):
                continue
            why = f"{type(wrong).__name__}: {wrong}".splitlines()[0]
        if not why:
            found[name] = each
            continue
        with suppress(OSError):
            print(
                f"unicon: warning: unicon.{kind} {name!r} (entry point {entry.value}) is left out: "
                f"{why}; mend or uninstall its package",
                file=sys.stderr,
            )
    return found


def path_of(entry: EntryPoint, what: str, error: type[UniconError]) -> Path | None:
    """Return the folder or file that an entry point names; None where its function says so.

    Args:
        entry: its value is a path (text or `Path`), a function without parameters that returns
            one, or a package, whose folder is meant. It is imported.
        what: for the message, such as `"policy 'walk'"`.
        error: the class to raise.

    Raises:
        error: its module cannot be imported, or it gives no path that exists.
    """
    label = f"{what} (entry point {entry.value})"
    try:
        value = entry.load()
        if callable(value) and (value := value()) is None:
            return None
    except Exception as wrong:  # whatever another package's code raises
        reason = f"{type(wrong).__name__}: {wrong}".splitlines()[0]
        raise error(f"{label}: {reason}; install its package again") from wrong
    if hasattr(value, "__path__"):  # a package
        value = next(iter(value.__path__), None)
    if not isinstance(value, str | os.PathLike):
        raise error(
            f"{label}: its value is of type {type(value).__name__}; it must be the path of a "
            "folder or file, or a function that returns one"
        )
    path = Path(value)
    if not os.path.exists(path):
        raise error(f"{label}: no such path {path}; install its package again")
    return path.resolve()


@cache
def all_registered() -> Mapping[str, Mapping[str, EntryPoint]]:
    """Return our groups, each a name to its entry point.

    Each installed package is looked at once, and parsed only where it names a group of ours:
    `entry_points(group=…)` looks at and parses all of them for each group, at 10 ms each.
    """
    found: dict[str, dict[str, EntryPoint]] = {}
    for each in distributions():
        text = each.read_text("entry_points.txt")
        if not text or "[unicon." not in text:
            continue
        if distribution(each.metadata["Name"]).read_text("entry_points.txt") != text:
            continue  # an older one, which the first of its name hides
        for entry in each.entry_points:
            found.setdefault(entry.group, {}).setdefault(entry.name, entry)
    return found


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
            text = (prefix / _INDEX / RESOURCE / package).read_text("utf-8").strip()
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
