"""Shipment: our code, our configurations and the files that rows read, as one archive.

    unicon_core/  unicon_msgs_map/  unicon_ros/  config/
    files/data/push/policy/policy.yaml          what /data/push/policy/policy.yaml means here

Ray unpacks it on each node, once, and workers begin in it. `arrive` puts them where the sweep was
started, among the copies: relative paths lead to copies, and so do absolute ones (`UNICON_COPIES`).
"""

from __future__ import annotations

import os
import sys
import zipfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from unicon_core.errors import UniconError
from unicon_core.resources import assets_cache, assets_root, config_roots

FILES = "files"
MOST_BYTES = 400_000_000
"""Of an archive; Ray takes 500 MiB."""
PACKAGES = ("unicon_core", "unicon_msgs_map", "unicon_ros")
FOLDERS = ("UNICON_PATH", "AMENT_PREFIX_PATH")
"""Variables that list folders in which files are looked for."""
_SOURCE = Path(__file__).resolve().parents[3]
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same files are the same archive, which nodes have already


def manifest(task: dict[str, Any]) -> dict[str, Any]:
    """Return what `arrive` has to know, as plain values.

    Args:
        task: as of `worker.RowRunner`.
    """
    assets = assets_root()
    return {
        "task": task,
        "cwd": os.getcwd(),
        "source": str(_SOURCE),
        "config": str(_own_config()),
        "python_path": [os.path.abspath(path) for path in sys.path if path],
        "folders": {name: os.environ.get(name, "") for name in FOLDERS},
        "assets": "" if assets is None else str(assets.absolute()),
        "cache": str(assets_cache() or ""),
    }


def pack(archive: Path, files: Iterable[str]) -> None:
    """Write the archive.

    Args:
        archive: the zip file to write.
        files: files and folders, as absolute paths.

    Raises:
        UniconError: a file cannot be read or written, or all of them are too many bytes.
    """
    whole = 0
    try:
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as out:
            for name, path in sorted(dict(_places(files)).items()):
                if path is None:
                    out.writestr(zipfile.ZipInfo(f"{name}/", _EPOCH), b"")
                    continue
                whole += path.stat().st_size
                if whole > MOST_BYTES:
                    raise UniconError(
                        f"the sweep reads more than {MOST_BYTES // 1_000_000} MB of files (up to "
                        f"{path}), which is too much to ship; use --engine local"
                    )
                info = zipfile.ZipInfo(name, _EPOCH)
                info.compress_type = zipfile.ZIP_DEFLATED
                info.external_attr = 0o644 << 16
                out.writestr(info, path.read_bytes())
    except OSError as error:
        if error.filename in (None, archive, str(archive)):
            said = f"cannot write {archive}: {error.strerror}; make room, or set TMPDIR"
        else:
            said = f"cannot ship {error.filename}: {error.strerror}; correct it"
        raise UniconError(said) from error


def _own_config() -> Path:
    """Return the folder of our configurations."""
    return next(root for root in config_roots() if (root / "robots" / "go2.yaml").is_file())


def _places(files: Iterable[str]) -> Iterator[tuple[str, Path | None]]:
    """Yield names in the archive and their files; None for a folder."""
    for package in PACKAGES:
        yield from _below(_SOURCE / package, package)
    yield from _below(_own_config(), "config")
    yield f"{FILES}{os.getcwd()}", None
    for text in files:
        yield f"{FILES}{text}", None if os.path.isdir(text) else Path(text)


def _below(folder: Path, name: str) -> Iterator[tuple[str, Path | None]]:
    for path in folder.rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts:
            yield f"{name}/{path.relative_to(folder).as_posix()}", path


def arrive(root: Path, told: dict[str, Any]) -> tuple[dict[str, Any], Callable[[object], str]]:
    """Make this process find the copies; return its task, and a function that tells of originals.

    Args:
        root: folder of what was unpacked.
        told: the manifest.
    """
    files = root / FILES

    def copy(text: str) -> str:
        at = files / text.lstrip("/")
        return str(at) if at.exists() else text

    def original(said: object) -> str:
        text = str(said).replace(str(files), "").replace(str(root / "config"), told["config"])
        return text.replace(str(root), told["source"])

    os.environ["UNICON_COPIES"] = str(files)
    for name, listed in told["folders"].items():
        os.environ[name] = os.pathsep.join(copy(each) for each in listed.split(os.pathsep) if each)
    if told["assets"]:
        os.environ["UNICON_ASSETS"] = copy(told["assets"])
    if (cache := copy(told["cache"])) != told["cache"]:
        os.environ["XDG_CACHE_HOME"] = str(Path(cache).parents[1])
    copies = [copy(path) for path in told["python_path"]]
    sys.path[:0] = [path for path in copies if path.startswith(str(files))]
    os.chdir(copy(told["cwd"]))
    task = dict(told["task"])
    for key in ("workflow", "reference"):
        if task[key] is not None:
            task[key] = copy(task[key])
    return task, original
