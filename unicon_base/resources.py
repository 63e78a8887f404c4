"""Where files are found: configurations, models and policies, for everybody who loads one.

Order: a path given; the folders of `UNICON_PATH`; the source tree's `config/`; our share folder of
the ament prefixes; that of the installed package; what other packages bring, by the ament resource
index, then by entry points (`unicon_base/packages.py`). `package://NAME/PATH` is a package's file.
Where `UNICON_COPIES` names a folder that has `data/walk`, that is what `/data/walk` means.

Names come from files: `os.path` tells that a name which is too long, or holds a NUL, is not a file,
where `pathlib` raises.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from unicon_base import UniconError, alternatives
from unicon_base.packages import PACKAGE, indexed_folders, package_file, registered_folders

CHUNK = 1 << 20
"""Bytes of a file that are in memory at once."""
_SOURCE_TREE = Path(__file__).resolve().parent.parent
_SHARE = Path("share") / "unicon_ros" / "config"


@lru_cache(maxsize=8)
def _roots(unicon_path: str, ament_path: str) -> tuple[Path, ...]:
    candidates = [Path(p).expanduser() for p in unicon_path.split(os.pathsep) if p]
    candidates.append(_SOURCE_TREE / "config")
    candidates += [Path(p) / _SHARE for p in ament_path.split(os.pathsep) if p]
    candidates.append(Path(sys.prefix) / _SHARE)
    candidates += [p / _SHARE for p in (_SOURCE_TREE, *_SOURCE_TREE.parents)]
    candidates += indexed_folders()
    found: list[Path] = []
    for root in candidates:
        if os.path.isdir(root) and root not in found:
            found.append(root)
    return tuple(found)


def config_roots() -> Iterator[Path]:
    """Yield the existing configuration folders, the first one wins.

    Those of entry points come last: to find them costs more than all the others.
    """
    roots = _roots(os.environ.get("UNICON_PATH", ""), os.environ.get("AMENT_PREFIX_PATH", ""))
    yield from roots
    for folder in registered_folders().values():
        if isinstance(folder, Path) and folder not in roots:
            yield folder


def config_files(name: str) -> Iterator[Path]:
    """Yield the files of a name below the configuration folders, the first one wins."""
    return (path for root in config_roots() if os.path.isfile(path := root / name))


def looked_in(kind: str) -> str:
    """Return where a kind of configuration was looked for, for messages."""
    roots = ", ".join(map(str, dict.fromkeys(config_roots())))
    broken = [reason for reason in registered_folders().values() if isinstance(reason, str)]
    return "; ".join([f"looked in {kind}/ of {roots} (UNICON_PATH adds folders)", *broken])


def list_config(kind: str, suffix: str = ".yaml") -> list[str]:
    """Return the names known for a kind of configuration, sorted.

    Args:
        kind: a folder of the configuration roots, such as `"robots"`.
        suffix: ending of the files; `"/"` lists folders.
    """
    names: set[str] = set()
    for root in config_roots():
        for path in (root / kind).glob("*") if os.path.isdir(root / kind) else ():
            if suffix == "/" and os.path.isdir(path):
                names.add(path.name)
            elif suffix != "/" and path.name.endswith(suffix) and os.path.isfile(path):
                names.add(path.name[: -len(suffix)])
    return sorted(names)


def find_config(
    kind: str,
    name: str | Path,
    suffix: str = ".yaml",
    *,
    error: type[UniconError] = UniconError,
    relative_to: Path | None = None,
) -> Path:
    """Return the file that a name or a path means.

    Args:
        kind: a folder of the configuration roots, such as `"robots"` or `"workflows"`.
        name: a bare name (`go2`), a path to a file (it has a slash or the suffix), or
            `package://PACKAGE/PATH`.
        suffix: ending of the files.
        error: the class to raise.
        relative_to: folder that a relative path is looked up in before the working folder.

    Raises:
        error: nothing there; the message names what is known.
    """
    text = str(name)
    if text.startswith(PACKAGE):
        path = package_file(text, kind.rstrip("s"), error).resolve()
        if not os.path.isfile(path):
            raise error(f"{kind.rstrip('s')} {text!r} is a folder; name a {suffix} file in it")
        return path
    if "/" in text or os.sep in text or text.endswith(suffix):
        given = _given(text)
        for base in _bases(relative_to):
            if os.path.isfile(base / given):
                return (base / given).resolve()
        names = ", ".join(list_config(kind, suffix)) or "none is known"
        raise error(
            f"no file {text}; give an existing path, or a name: {names}{_below(given, relative_to)}"
        )
    for path in config_files(f"{kind}/{text}{suffix}"):
        return path
    known = alternatives(text, list_config(kind, suffix))
    raise error(
        f"unknown {kind.rstrip('s')} {text!r}; {lying_here(text, suffix, relative_to)}{known}; "
        f"{looked_in(kind)}; "
        f"or give a path to a {suffix} file"
    )


def lying_here(name: str, suffix: str = "", relative_to: Path | None = None) -> str:
    """Return how to write the path of what a bare name may mean, for messages; "" if nothing does.

    Args:
        name: that was not found.
        suffix: ending of the file that is wanted, "" for a folder too.
        relative_to: folder that is looked in before the working folder.
    """
    for base in (relative_to or Path.cwd(), Path.cwd()) if name else ():
        for tried in (name, f"{name}{suffix}", f"{Path(name).stem}{suffix}"):
            if os.path.isfile(base / tried) or (not suffix and os.path.isdir(base / tried)):
                return f"there is ./{tried} here: write ./{tried}; "
    return ""


def _given(text: str) -> Path:
    """Return the path that a text means: where a process runs on copies, a copy if there is one."""
    path = Path(os.path.expanduser(text))
    copies = os.environ.get("UNICON_COPIES")
    if not copies or not path.is_absolute():
        return path
    copy = Path(copies, *path.parts[1:])
    return copy if os.path.exists(copy) else path


def _bases(relative_to: Path | None) -> Iterator[Path]:
    """Yield the folders that a relative path is looked up in."""
    if relative_to is not None:
        yield relative_to
    yield Path.cwd()
    yield from config_roots()


def _below(given: Path, relative_to: Path | None) -> str:
    """Return where a path was looked for, for messages."""
    bases = ", ".join(dict.fromkeys(map(str, _bases(relative_to))))
    return "" if given.is_absolute() else f"; looked below {bases}"


def assets_root() -> Path | None:
    """Return the folder of other people's models and policies, or None: the first of several."""
    return next(assets_roots(), None)


def assets_roots() -> Iterator[Path]:
    """Yield the existing folders of other people's models and policies, the first one wins.

    `UNICON_ASSETS`, then what was fetched.
    """
    given = os.environ.get("UNICON_ASSETS")
    own = Path(given).expanduser() if given else None
    for path in (own, assets_cache()):
        if path is not None and os.path.isdir(path):
            yield path


def assets_cache() -> Path | None:
    """Return where `unicon assets fetch` puts them; None for a user without a home.

    That is `$XDG_CACHE_HOME/unicon/assets`, else `~/.cache/unicon/assets`.
    """
    return _user("XDG_CACHE_HOME", ".cache", "assets")


def native_cache() -> Path | None:
    """Return where compiled ticks lie, `$XDG_CACHE_HOME/unicon/native`; None without a home."""
    return _user("XDG_CACHE_HOME", ".cache", "native")


def user_folder(name: str, given: str = "") -> Path | None:
    """Return where files of this user lie that outlive a run: a folder that is given, else ours.

    That is `$XDG_STATE_HOME/unicon/NAME`, else `~/.local/state/unicon/NAME`; None for a user
    without a home.
    """
    if given:
        return Path(given).expanduser()
    return _user("XDG_STATE_HOME", ".local/state", name)


def _user(variable: str, folder: str, name: str) -> Path | None:
    given = os.environ.get(variable, "")
    try:
        return (Path(given) if given else Path.home() / folder) / "unicon" / name
    except RuntimeError:
        return None


def find_resource(
    reference: str | Path,
    what: str,
    *,
    error: type[UniconError] = UniconError,
    relative_to: Path | None = None,
) -> Path:
    """Return the file or folder that a reference in a configuration means.

    Args:
        reference: a path (absolute, or relative to the referring file, the working folder or a
            configuration root), `assets:PATH` below the assets folder, or `package://NAME/PATH`.
        what: for the message, such as `"model"`.
        error: the class to raise.
        relative_to: folder of the referring file.
    """
    text = str(reference)
    if text.startswith("assets:"):
        return _asset(text, what, error)
    if text.startswith(PACKAGE):
        return package_file(text, what, error).resolve()
    given = _given(text)
    for base in _bases(relative_to):
        if os.path.exists(base / given):
            return (base / given).resolve()
    looked = _below(given, relative_to)
    raise error(f"{what} {text!r}: no such file{looked}; correct the path or put the file there")


def _asset(text: str, what: str, error: type[UniconError]) -> Path:
    """Return the file of the assets folders that `assets:PATH` means."""
    below = text.removeprefix("assets:")
    roots = [*assets_roots()]
    for root in roots:
        if os.path.exists(root / below):
            return root / below
    name = below.split("/")[1] if below.count("/") else ""
    lists = (path.read_text("utf-8", "replace") for path in config_files("assets.yaml"))
    listed = any(f"\n{name}:\n" in f"\n{text}" for text in lists)
    looked = f"no file {below} in {', '.join(map(str, roots))} (UNICON_ASSETS)"
    if not roots:
        looked = "the assets folder is not at hand"
    if not (name and listed):
        raise error(f"{what} {text!r}: {looked}; set UNICON_ASSETS to the folder that has it")
    raise error(f"{what} {text!r}: {looked}; get it: unicon assets fetch {name}")


def file_beside(file: Path, reference: str | Path, what: str, *, error: type[UniconError]) -> Path:
    """Return the file that a data file names: in its own folder or below, wherever links lead.

    Data files come from anybody, so they reach nothing outside the folder that was handed over. A
    folder whose files are all links to one other folder, as colcon installs them, is that folder.

    Args:
        file: the data file.
        reference: what it names; need not exist.
        what: for the message, such as `"onnx"`.
        error: the class to raise.

    Raises:
        error: an absolute path, or one that leads out of the folder.
    """
    text = str(reference)
    remedy = f"put it into {file.parent} and name it from there"
    try:
        folders = (file.parent.resolve(), file.resolve().parent)
        path = file.parent / text
        target = path.resolve()
    except (OSError, RuntimeError, ValueError) as wrong:  # endless links, a NUL
        raise error(f"{what} {text[:80]!r} is not a path ({wrong}); {remedy}") from wrong
    inside = any(target.is_relative_to(folder) for folder in folders)
    if not text or Path(text).is_absolute() or ".." in Path(text).parts or not inside:
        raise error(f"{what} {text[:80]!r} is not in the folder of {file.name}; {remedy}")
    return path


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file of any size, 64 digits, as `sha256sum` tells it."""
    found = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(CHUNK):
            found.update(chunk)
    return found.hexdigest()


def sha256_text(text: str) -> str:
    """Return the SHA-256 of a text in UTF-8, 64 digits."""
    return hashlib.sha256(text.encode()).hexdigest()


def same_modules() -> dict[str, str]:
    """Return our environment, changed so that another Python finds the modules that we find."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
