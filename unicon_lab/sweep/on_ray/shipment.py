"""Shipment: our code, our configurations and the files that rows read, as one archive.

    unicon_core/  unicon_msgs_map/  unicon_ros/  config/
    files/data/push/policy/policy.yaml          what /data/push/policy/policy.yaml means here

Ray unpacks it on each node, once, and workers begin in it. `arrive` puts them where the sweep was
started, among the copies: relative paths lead to copies, and so do absolute ones (`UNICON_COPIES`).
"""

from __future__ import annotations

import importlib.metadata
import os
import pathlib
import sys
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from unicon_base import AnyDict, UniconError
from unicon_base.resources import assets_cache, assets_root, config_roots
from unicon_lab.sweep.draws import setting_of
from unicon_lab.sweep.plan import Plan
from unicon_lab.sweep.pool import Line, PipedProcess

FILES = "files"
MOST_BYTES = 400_000_000
"""Of an archive; Ray takes 500 MiB."""
PACKAGES = (
    *("unicon_base", "unicon_core", "unicon_msgs_map", "unicon_ros", "unicon_sims"),
    *("unicon_hardware", "unicon_manipulation", "unicon_lab"),
)
FOLDERS = ("UNICON_PATH", "AMENT_PREFIX_PATH")
"""Variables that list folders in which files are looked for."""
_SOURCE = Path(__file__).resolve().parents[3]
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same files are the same archive, which nodes have already


def manifest(task: AnyDict) -> AnyDict:
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
    for file in importlib.metadata.distribution("unicon_ros").files or ():
        path = Path(str(file.locate()))  # what it registers: blocks, platforms, commands
        if path.name in ("METADATA", "PKG-INFO", "entry_points.txt") and path.is_file():
            yield f"{path.parent.name}/{path.name}", path
    yield from _below(_own_config(), "config")
    yield f"{FILES}{os.getcwd()}", None
    for text in files:
        yield f"{FILES}{text}", None if os.path.isdir(text) else Path(text)


def _below(folder: Path, name: str) -> Iterator[tuple[str, Path | None]]:
    for path in folder.rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts:
            yield f"{name}/{path.relative_to(folder).as_posix()}", path


def arrive(root: Path, told: AnyDict) -> tuple[AnyDict, Callable[[object], str]]:
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


MOMENT = 0.05
"""Of a rollout in [s]: some blocks open files in the first tick."""
SYSTEM = ("/proc", "/sys", "/dev", "/run", "/etc", "/usr", "/lib", "/lib64", "/bin", "/sbin")


def rehearsed(plan: Plan) -> Iterator[tuple[str, ...]]:
    """Yield settings of rows that read all that any row reads."""
    first = plan.row(0)
    yield first.settings
    base = len(plan.sweep.settings)
    for place, each in enumerate(plan.sweep.parameters):
        for value in each.values or ():
            if not isinstance(value, int | float) and value is not None:
                settings = list(first.settings)
                settings[base + place] = setting_of(each.path, value)
                yield tuple(settings)


def files_of(plan: Plan, log: Path) -> list[str]:
    """Return the files and folders that the rows of a plan read, as absolute paths.

    Args:
        plan: of the sweep.
        log: for what engines print.

    Raises:
        UniconError: the rehearsal has failed.
    """
    process = PipedProcess("unicon_lab.sweep.on_ray.shipment", log, {})
    found: list[str] | None = None
    why = ""
    try:
        process.write(plan.task() | {"rows": [list(each) for each in rehearsed(plan)]})
        while not process.over:
            for told in process.heard():
                found, why = told.get("files"), told.get("error", "")
    finally:
        how = process.end()
    if found is None:
        raise UniconError(f"cannot tell which files the sweep reads: {why or how}; see {log}")
    return found


class _Watch:
    """Which paths this process opens, or finds to be there."""

    def __init__(self) -> None:
        self.seen: set[str] = set()
        stat = os.stat

        def watched(path: Any, *rest: Any, **options: Any) -> os.stat_result:
            found = stat(path, *rest, **options)
            self.note(path)
            return found

        os.stat = watched
        if accessor := getattr(pathlib, "_NormalAccessor", None):  # Python 3.10
            accessor.stat = staticmethod(watched)
        sys.addaudithook(self._hook)

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            self.note(arguments[0])

    def note(self, path: Any) -> None:
        """Remember a path."""
        if isinstance(path, str | os.PathLike):
            with suppress(TypeError):
                self.seen.add(os.path.abspath(os.fspath(path)))


def _modules() -> Iterator[str]:
    """Yield the files of all modules: a compiled one is read in place of its source."""
    for module in list(sys.modules.values()):
        with suppress(Exception):  # some modules are none
            if module.__file__ is not None:
                yield module.__file__


def _installed(elsewhere: tuple[str, ...]) -> set[str]:
    """Return files and folders of packages that pip has put into other folders of `sys.path`.

    As by `--user`, `--target` or a `.pth`. Python opens their modules alone: without the libraries
    that these load by themselves, a copy would be half a package. What somebody writes in such a
    folder, or installs as editable, is in no RECORD there.

    Args:
        elsewhere: folders that are not looked into.
    """
    found = set()
    for folder in {os.path.abspath(path) for path in sys.path if path}:
        if folder.startswith(elsewhere):
            continue
        for package in importlib.metadata.distributions(path=[folder]):
            if package.read_text("RECORD") is not None:
                first = {file.parts[0] for file in package.files or ()} - {".."}
                found |= {os.path.join(folder, name) for name in first}
    return found


def to_ship(seen: Iterable[str]) -> list[str]:
    """Return those of some paths that a node does not have by itself, sorted.

    It has the system, Python with its packages, wherever pip has put them, and our code; of these
    our configurations are shipped all the same, since a workflow may be one. Where a folder is a
    link, what was read behind it gets a place in it.
    """
    roots = [f"{root}{os.sep}" for root in config_roots()]
    there = [*SYSTEM, *(str(_SOURCE / name) for name in PACKAGES), sys.prefix, sys.base_prefix]
    there += _installed(tuple(there))
    has = tuple(f"{each}{os.sep}" for each in there)

    def wanted(path: str) -> bool:
        if path.endswith(".pyc") or "\0" in path or not os.path.exists(path):
            return False
        if path.startswith(tuple(roots)):
            return True
        return not path.startswith(has) and path not in there

    paths = {path for path in seen if wanted(path)}
    links = [path for path in paths if os.path.isdir(path) and os.path.realpath(path) != path]
    for link in links:
        behind = os.path.realpath(link) + os.sep
        paths |= {os.path.join(link, p[len(behind) :]) for p in paths if p.startswith(behind)}
    return sorted(path for path in paths if os.path.isfile(path) or os.path.isdir(path))


def main() -> int:
    """Rehearse, and tell."""
    from unicon_lab.sweep.worker import RowRunner

    line, watch = Line(), _Watch()
    task = line.read()
    try:
        runner = RowRunner(task | {"duration": MOMENT})
        for settings in task["rows"]:
            runner(settings)
    except UniconError as error:
        line.write({"error": str(error)})
    else:
        line.write({"files": to_ship({*watch.seen, *_modules()})})
    return 0


if __name__ == "__main__":
    sys.exit(main())
