"""Weakens what keeps a robot safe, one place at a time, and tells which change no test notices.

    python tools/mutation/mutate_safety.py [--only WORD] [--jobs 2] [--json FILE]

Each mutation of `table.py` is made in a copy of the tree; the tests that are named beside it run
there, and one has to fail. Exit status 1 where a mutation survives.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Queue

sys.path.insert(0, str(Path(__file__).parent))
from table import ROWS, Row

__all__ = ["Outcome", "end_those_of", "mutate", "mutated"]

ROOT = Path(__file__).resolve().parents[2]
IGNORED = (".git", ".venv", "out", "build", "log", ".mypy_cache", ".ruff_cache", ".hypothesis")
TIMEOUT = 240.0
"""In [s], of the tests of one mutation; tests that hang have noticed it."""


class AnchorError(Exception):
    """The code has changed, and the table does not fit it any more."""


@dataclass(frozen=True)
class Outcome:
    """What the tests made of a mutation.

    Attributes:
        name: file, place and change.
        killed: a test failed.
        by: the first test that did, or `time-out`.
        seconds: that it took.
    """

    name: str
    killed: bool
    by: str
    seconds: float


def name_of(row: Row) -> str:
    """Return file, place and change, in one line."""
    change = f"{row.old.strip()} → {row.new.strip() or 'nothing'}" if row.old else "removed"
    place = f" {row.where}" if row.where else ""
    return f"{row.file.removeprefix('unicon_core/')}{place}: {' '.join(change.split())}"


def mutated(row: Row, text: str) -> str:
    """Return the text of a row's file with its mutation.

    Raises:
        AnchorError: the place is not there, or not once.
    """
    lines = text.splitlines(keepends=True)
    node = _found(ast.parse(text), row)
    if not row.old:
        assert isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        documented = ast.get_docstring(node) is not None and len(node.body) > 1
        first = node.body[1 if documented else 0]
        lines.insert(first.lineno - 1, f"{' ' * first.col_offset}return {row.new}\n")
        return "".join(lines)
    start, end = (0, len(lines))
    if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
        start, end = node.lineno - 1, node.end_lineno or len(lines)
    part = "".join(lines[start:end])
    if part.count(row.old) != 1:
        raise AnchorError(
            f"{row.file} {row.where}: {row.old!r} stands there {part.count(row.old)} times instead "
            "of once; correct tools/mutation/table.py"
        )
    return "".join(lines[:start]) + part.replace(row.old, row.new) + "".join(lines[end:])


def _found(tree: ast.Module, row: Row) -> ast.AST:
    node: ast.AST = tree
    for name in filter(None, row.where.split(".")):
        inside = [
            child for child in ast.iter_child_nodes(node) if getattr(child, "name", "") == name
        ]
        if len(inside) != 1:
            raise AnchorError(
                f"{row.file}: {row.where} is there {len(inside)} times instead of once; correct "
                "tools/mutation/table.py"
            )
        node = inside[0]
    return node


def mutate(rows: Sequence[Row], jobs: int = 2) -> Iterator[Outcome]:
    """Try each mutation, and the tests without any first.

    Raises:
        AnchorError: the table does not fit the code.
        RuntimeError: a test fails without a mutation.
    """
    for row in rows:
        mutated(row, (ROOT / row.file).read_text("utf-8"))
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        # Beside the copies as beside the tree: tests that lack their models are skipped.
        (Path(folder) / "shared").symlink_to(ROOT.parent / "shared")
        trees: Queue[Path] = Queue()
        for k in range(jobs):
            tree = Path(folder) / str(k)
            shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(*IGNORED), symlinks=True)
            trees.put(tree)
        files = sorted({test for row in rows for test in row.tests})
        failed = _failed(trees.queue[0], files, timeout=20 * TIMEOUT)
        if failed:
            raise RuntimeError(f"{failed} fails without any mutation; mend it first")

        def one(row: Row) -> Outcome:
            tree, began = trees.get(), time.monotonic()
            try:
                with _changed(tree / row.file, row):
                    by = _failed(tree, row.tests, timeout=TIMEOUT)
            finally:
                trees.put(tree)
            return Outcome(name_of(row), bool(by), by, round(time.monotonic() - began, 1))

        with ThreadPoolExecutor(jobs) as pool:
            yield from pool.map(one, rows)


@contextmanager
def _changed(path: Path, row: Row) -> Iterator[None]:
    before, times = path.read_text("utf-8"), path.stat()
    path.write_text(mutated(row, before), "utf-8")
    try:
        yield
    finally:
        path.write_text(before, "utf-8")
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))  # what was compiled is right


def _failed(tree: Path, tests: Sequence[str], timeout: float) -> str:
    """Run tests in a tree; return the first that fails, "" for none."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    environment = os.environ | {"PYTHONPATH": str(tree)}
    if timeout == TIMEOUT:  # a mutated file leaves nothing compiled
        environment["PYTHONDONTWRITEBYTECODE"] = "1"
    process = subprocess.Popen(
        command,
        cwd=tree,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        output, _ = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return "time-out"
    finally:
        end_those_of(tree)
    if not process.returncode:
        return ""
    told = [line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return told[0].split(" - ")[0] if told else output.strip()[-300:] or "a crash"


def end_those_of(tree: Path) -> None:
    """End what the tests in a tree left running, stopped, or in sessions of their own (Linux)."""
    marks = tuple(f"PYTHONPATH={tree}{end}".encode() for end in "\0:")  # a child's is longer
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):  # somebody else's, or gone
            pid, text = int(environment.parent.name), environment.read_bytes()
            if pid != os.getpid() and any(mark in text for mark in marks):
                os.kill(pid, signal.SIGKILL)


def main() -> int:
    """Run the mutations that are asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--only", default="", help="those whose name has this in it")
    parser.add_argument("--jobs", type=int, default=2, help="at once")
    parser.add_argument("--json", type=Path, help="write the table there")
    asked = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # tests need it
    rows = [row for row in ROWS if asked.only in name_of(row)]
    outcomes = []
    for outcome in mutate(rows, asked.jobs):
        outcomes.append(outcome)
        word = "killed  " if outcome.killed else "SURVIVED"
        print(f"{word} {outcome.seconds:6.1f} s  {outcome.name}  {outcome.by}", flush=True)
    survivors = [outcome for outcome in outcomes if not outcome.killed]
    print(f"{len(outcomes)} mutations, {len(outcomes) - len(survivors)} killed")
    if asked.json:
        asked.json.write_text(json.dumps([vars(outcome) for outcome in outcomes], indent=2))
    return bool(survivors)


if __name__ == "__main__":
    sys.exit(main())
