"""Rehearsal: runs the first moment of some rows, and tells which files they read (`python -m`).

A million rows read few files: those of the first row, and of each word or list among the values
that are varied, such as the path of a policy. They are seen where Python opens a file, or finds
that it is there; what libraries open by themselves, meshes and networks, was looked for before.
"""

from __future__ import annotations

import importlib.metadata
import os
import pathlib
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from unicon_core.errors import UniconError
from unicon_core.resources import config_roots
from unicon_ros.sweep.draws import setting_of
from unicon_ros.sweep.on_ray.shipment import PACKAGES
from unicon_ros.sweep.piped import PipedProcess
from unicon_ros.sweep.plan import Plan

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
            if not isinstance(value, (int, float)) and value is not None:
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
    process = PipedProcess("unicon_ros.sweep.on_ray.rehearsal", log, {})
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
        if isinstance(path, (str, os.PathLike)):
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
    source = Path(__file__).resolve().parents[3]
    there = [*SYSTEM, *(str(source / name) for name in PACKAGES), sys.prefix, sys.base_prefix]
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
    import json

    from unicon_ros.sweep.piped import line_of
    from unicon_ros.sweep.worker import RowRunner

    with os.fdopen(int(sys.argv[1]), "rb") as incoming:
        task = json.loads(incoming.readline())
        watch = _Watch()
        told: dict[str, Any] = {}
        try:
            runner = RowRunner(task | {"duration": MOMENT})
            for settings in task["rows"]:
                runner(settings)
        except UniconError as error:
            told["error"] = str(error)
        else:
            told["files"] = to_ship({*watch.seen, *_modules()})
    with os.fdopen(int(sys.argv[2]), "wb", buffering=0) as outgoing:
        outgoing.write(line_of(told))
    return 0


if __name__ == "__main__":
    sys.exit(main())
