"""Prints the test files that a change can touch, for `make test-changed`.

    python tools/lib/changed_tests.py [REVISION]      # changes since REVISION (default: HEAD)

A test file is printed where it, a helper beside it, or a module that it imports, in any number of
steps, has changed. A registered block, platform or command counts as imported where its name
stands. A change of configuration or of `conftest.py` touches every test.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from unicon_core.blocks import BUILTIN as BLOCKS  # noqa: E402
from unicon_core.platforms import BUILTIN as PLATFORMS  # noqa: E402

WORD = re.compile(r"\w+")
WHOLE = ("conftest.py", "setup.py", "pyproject.toml", "Makefile", "config/", "test/passing.py")
"""Beginnings and ends of paths that touch everything."""


def changed(revision: str) -> set[str]:
    """Return paths that differ from a revision, those that git does not track included."""
    commands = (
        ["git", "diff", "--name-only", revision],
        ["git", "ls-files", "--others", "--exclude-standard"],
    )
    done = [
        subprocess.run(c, cwd=ROOT, capture_output=True, text=True, check=True) for c in commands
    ]
    return {line for each in done for line in each.stdout.splitlines()}


def modules() -> dict[str, Path]:
    """Return module name to file: the packages, and the helpers of tests by their bare names."""
    found = {}
    for path in [*ROOT.glob("unicon_*/**/*.py"), *ROOT.glob("benchmarks/**/*.py")]:
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        found[name.removesuffix(".__init__")] = path
    for path in ROOT.glob("test/**/*.py"):
        found.setdefault(path.stem, path)
    return found


MODULES = modules()
REGISTERED = dict(
    re.findall(r'"(\w+) = (unicon[\w.]+)', (ROOT / "setup.py").read_text("utf-8"))
) | {name: place.partition(":")[0] for name, place in (BLOCKS | PLATFORMS).items()}
"""Name of a block, platform or command to its module."""


@cache
def imports_of(path: Path) -> frozenset[Path]:
    """Return the files that a file imports."""
    return frozenset(MODULES[each] for each in {*_named(path)} if each in MODULES)


def _named(path: Path) -> Iterator[str]:
    text = path.read_text("utf-8")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if node.value.startswith("unicon_") and path.name != "moved.py":
                yield node.value.partition(":")[0]  # a place, as of a patch
            if path.is_relative_to(ROOT / "test"):
                yield from (
                    REGISTERED[word] for word in WORD.findall(node.value) if word in REGISTERED
                )


def touched(paths: set[str]) -> list[str]:
    """Return the test files that a change of some paths touches."""
    tests = sorted(ROOT.glob("test/**/test_*.py"))
    if any(path.startswith(WHOLE) or path.endswith(WHOLE) for path in paths):
        return [path.relative_to(ROOT).as_posix() for path in tests]
    files = {ROOT / path for path in paths}
    found = []
    for test in tests:
        seen, todo = {test}, [test]
        while todo and not seen & files:
            new = imports_of(todo.pop()) - seen
            seen |= new
            todo += new
        if seen & files:
            found.append(test.relative_to(ROOT).as_posix())
    return found


if __name__ == "__main__":
    print("\n".join(touched(changed(sys.argv[1] if len(sys.argv) > 1 else "HEAD"))))
