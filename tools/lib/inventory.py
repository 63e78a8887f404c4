"""Lists what users can name: commands, options, keys, blocks, robots, platforms, topics, exports.

    python tools/lib/inventory.py                                   the list
    python tools/lib/inventory.py test/packaging/inventory.txt      what is missing of a kept list

`test/packaging/inventory_gone.txt` has each missing line with the reason. An export is missing
where it cannot be imported any more, be it by an old path.
"""

from __future__ import annotations

import argparse
import inspect
import json
import re
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
EXPORTS = (
    *("unicon_core", "unicon_core.states", "unicon_core.flow", "unicon_core.blocks"),
    *("unicon_core.policies", "unicon_core.platforms", "unicon_core.robots", "unicon_core.models"),
    *("unicon_core.testing", "unicon_core.conformance", "unicon_msgs_map"),
)
"""Import packages whose public names users write."""


def inventory() -> list[str]:
    """Return the sorted lines, each a kind and a name."""
    kinds = (commands, keys, registered, documents, ros, exports)
    return sorted({line for kind in kinds for line in kind()})


def commands() -> Iterator[str]:
    from unicon_ros.cli.bench import BENCHES
    from unicon_ros.cli.main import _parser

    yield from (f"bench {name}" for name in BENCHES)
    yield from _parsed(_parser(), "unicon")


def _parsed(parser: argparse.ArgumentParser, name: str) -> Iterator[str]:
    yield f"command {name}"
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for word, below in action.choices.items():
                yield from _parsed(below, f"{name} {word}")
        else:
            for word in action.option_strings or [str(action.dest)]:
                yield f"option {name} {word}"


def keys() -> Iterator[str]:
    for path in sorted((ROOT / "config/schemas").glob("*.json")):
        for key in _keys(json.loads(path.read_text("utf-8"))):
            yield f"key {path.stem} {key}"


def _keys(node: Any) -> Iterator[str]:
    if isinstance(node, dict):
        yield from node.get("properties", {})
        for below in node.values():
            yield from _keys(below)
    elif isinstance(node, list):
        for below in node:
            yield from _keys(below)


def registered() -> Iterator[str]:
    from unicon_base.errors import UniconError
    from unicon_core.workflow.registry import find_factory, known

    for kind in ("blocks", "platforms", "faces"):
        for name in known(kind):
            yield f"{kind} {name}"
            factory = find_factory(kind, name, UniconError)
            for option in inspect.signature(factory).parameters:
                yield f"{kind} {name} {option}"


def documents() -> Iterator[str]:
    for kind in ("robots", "workflows", "maps", "policies", "models", "rviz"):
        for path in sorted((ROOT / "config" / kind).rglob("*")):
            if path.suffix in {".yaml", ".xml", ".rviz", ".onnx"}:
                yield f"config {path.relative_to(ROOT / 'config')}"
    for path in sorted((ROOT / "unicon_core/policies/importers").glob("*.py")):
        for name in re.findall(r"^def (\w+)_facts\(", path.read_text("utf-8"), re.MULTILINE):
            yield f"policy format {name}"


def ros() -> Iterator[str]:
    from unicon_ros.parameter_table import DECLARED, SERVICES

    yield from (f"service {name}" for name in SERVICES)
    yield from (f"parameter {name} {default!r}" for name, default, _ in DECLARED)
    for path in sorted((ROOT / "config/maps").glob("*.yaml")):
        document = yaml.safe_load(path.read_text("utf-8"))
        for way in ("publish", "subscribe"):
            for entry in document.get(way) or ():
                yield f"topic {path.stem} {way} {entry['topic']} {entry.get('type', '')}".rstrip()


def exports() -> Iterator[str]:
    for name in EXPORTS:
        yield from (f"export {name}.{word}" for word in getattr(import_module(name), "__all__", ()))
    written = [
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "examples").rglob("*.py"),
        ROOT / "README.md",
    ]
    for path in written:
        found = re.findall(
            r"^from (unicon_[\w.]+) import ([\w, ]+)$", path.read_text("utf-8"), re.M
        )
        for module, words in found:
            yield from (f"export {module}.{word.split()[0]}" for word in words.split(","))


def missing(kept: list[str]) -> list[str]:
    """Return the lines of a kept list that no longer hold."""
    here = set(inventory())
    return [line for line in kept if line not in here and not _imported(line)]


def _imported(line: str) -> bool:
    kind, _, name = line.partition(" ")
    try:
        return kind == "export" and resolve_name(name) is not None
    except (ImportError, AttributeError):
        return False


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    kept = [Path(name).read_text("utf-8").splitlines() for name in sys.argv[1:]]
    print("\n".join(missing(kept[0]) if kept else inventory()))
