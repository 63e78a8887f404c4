"""Workflow documents: read, changed by `--set`, checked, with where each value stands.

platform=fake                          a key
flow.chain.0.pose.duration=2           an item of a list, by number
policies.walk.given.action.scale=0.5   also where the file says {given: {action.scale: …}}
states."my.state".unit=rad             quotes keep a dot in one key
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from unicon_base import AnyDict, AnyMapping, WorkflowError
from unicon_base.bounded_yaml import MAX_DEPTH, YamlError
from unicon_base.located_yaml import Located, other_kind, parse_value, read_yaml
from unicon_base.resources import find_config, list_config
from unicon_base.schema.read import refuse
from unicon_base.schema.records import record_of, type_of
from unicon_base.schema.types import Mistakes
from unicon_core.workflow.file import Workflow


@dataclass
class WorkflowDocument:
    """A workflow file's content.

    Attributes:
        name: name of the workflow.
        values: the document with overrides applied.
        located: the file, for `file:line`.
        overridden: paths that `--set` changed, keys with dots between them.
    """

    name: str
    values: AnyDict
    located: Located
    overridden: tuple[str, ...] = ()

    @property
    def path(self) -> Path:
        """The file."""
        return self.located.path

    def where(self, *path: str | int) -> str:
        """Return `file:line` of a value."""
        dotted = ".".join(map(str, path))
        if any(f"{dotted}.".startswith(f"{each}.") for each in self.overridden):
            return f"--set {dotted}"
        if path and path not in self.located.lines:  # made on the way to what was set
            for each in self.overridden:
                if each.startswith(f"{dotted}."):
                    return f"--set {each}"
        return self.located.where(path)

    def error(self, message: str, *path: str | int) -> WorkflowError:
        """Return the error for a value, or for what was set below it and the message names."""
        for each in self.overridden if path else ():
            _, _, last = each.rpartition(".")
            if each.startswith(".".join(map(str, (*path, "")))) and repr(last) in message:
                return WorkflowError(message, f"--set {each}")
        return WorkflowError(message, self.where(*path))

    def get(self, key: str, default: Any = None) -> Any:
        """Return a top-level value, the default where it is absent or null."""
        value = self.values.get(key)
        return default if value is None else value


def read_part(document: WorkflowDocument, kind: Any, value: Any, *path: str | int) -> Any:
    """Return a value of a workflow as a hint has it (see `schema`).

    Raises:
        WorkflowError: it is wrong; with file and line of each mistake.
    """
    mistakes = Mistakes(document.values)
    found = type_of(kind).read(value, path, mistakes)
    refuse(mistakes, lambda where, text: document.error(text, *where), f"workflow {document.name}")
    return found


_QUOTED = r"\"[^\"]*\"|'[^']*'"
_SETTING = re.compile(rf"((?:{_QUOTED}|[^=])+)=(.*)", re.DOTALL)
_STEP = re.compile(rf"(?:^|\.)({_QUOTED}|[^.]*)(?=\.|\Z)", re.DOTALL)
_QUOTE = re.compile(_QUOTED)


def split_setting(text: str) -> tuple[str, Any]:
    """Return path and value of a text as of `--set path=value`.

    Raises:
        WorkflowError: it has no `=`, or its value is not valid YAML.
    """
    found = _SETTING.fullmatch(text)
    if found is None:
        raise WorkflowError(
            f"--set {text!r} has no '='; write --set path=value, as platform=mujoco"
        )
    dotted, value = found.groups()
    try:
        return dotted.strip(), parse_value(value)
    except YamlError as error:
        shown = value if len(value) <= 60 else f"{value[:60]}…"
        raise WorkflowError(
            f"--set {dotted}: {shown!r} is not valid YAML: {error.problem}"
        ) from error


def set_value(values: AnyDict, dotted: str, value: Any) -> str:
    """Set a value and return its path without quotes; missing mappings are made.

    What is there already counts first, whichever of its keys have dots. List items go by number.
    A block or policy that is one word becomes a mapping where a part of it is set.

    Args:
        values: the document, changed.
        dotted: keys with dots between them.
        value: what to set.

    Raises:
        WorkflowError: the path leads to nothing that has parts, or may mean two values.
    """

    def wrong(text: str) -> WorkflowError:
        return WorkflowError(f"--set {dotted}{text}")

    steps: list[str] = _STEP.findall(dotted)
    if len(steps) > MAX_DEPTH:
        raise WorkflowError(
            f"--set {dotted[:60]}…: the path has {len(steps)} steps; at most {MAX_DEPTH} are read"
        )
    ways = list(_ways(values, steps))
    there = [keys for keys, left in ways if not left]
    if len(there) > 1:
        meant = " or ".join(".".join(f'"{key}"' for key in keys) for keys in there[:2])
        raise wrong(f" may mean {meant}; write the one that is meant")
    keys, left = min(ways, key=lambda way: len(way[1]))
    keys = (*keys, *map(_bare, left))
    here: Any = values
    for depth, key in enumerate(keys, 1):
        if isinstance(here, list) and not isinstance(key, int):
            items = (next(iter(i), None) if isinstance(i, dict) else f"{i!s:.30}" for i in here)
            named = ", ".join(f"{i} ({item})" for i, item in enumerate(islice(items, 12)))
            remedy = f"give a number from 0 to {len(here) - 1}: {named}"
            if not here:
                remedy = f"set the list: --set {dotted.rpartition('.')[0]}=[…]"
            raise wrong(f": {key!r} is not a place in a list of {len(here)}; {remedy}")
        if depth == len(keys):
            here[key] = value
            break
        inner = here[key] if isinstance(here, list) else here.get(key)
        if inner is None:
            inner = here[key] = {}
        elif isinstance(inner, str) and keys[depth] == inner:  # a block without options
            inner = here[key] = {inner: {}}
        elif isinstance(inner, str) and depth == 2 and keys[0] == "policies":
            inner = here[key] = {"path": inner}
        elif not isinstance(inner, dict | list):
            path = ".".join(f'"{k}"' if "." in str(k) else str(k) for k in keys[:depth])
            remedy = f"set it whole: --set {path}=VALUE"
            if path == "platform" and not isinstance(values.get("robot"), dict):
                option = dotted if len(keys) > 2 else f"platform.{inner}.{keys[1]}"
                remedy = f"its options: --set {option.replace('platform', 'platforms', 1)}={value}"
            raise wrong(f": {path} is {inner!r:.60}, which has no parts; {remedy}")
        here = inner
    return ".".join(map(str, keys))


def _ways(here: Any, steps: list[str]) -> Iterator[tuple[tuple[Any, ...], list[str]]]:
    """Yield the keys that a path may mean as far as they are there, and the steps that are left."""
    met = False
    for count in range(1, len(steps) + 1):
        if count > 1 and any(map(_QUOTE.fullmatch, steps[:count])):
            break
        key: Any = ".".join(map(_bare, steps[:count]))
        number = int(key) if key.isdecimal() and len(key) < 10 else -1
        known: Any = here if isinstance(here, dict) else ()
        if isinstance(here, list):
            known = range(len(here))
        key = key if key in known else number
        if key in known:
            met = True
            for keys, left in _ways(here[key], steps[count:]):
                yield (key, *keys), left
    if not met:
        yield (), steps


def _bare(step: str) -> str:
    return step[1:-1] if _QUOTE.fullmatch(step) else step


def workflow_names() -> list[str]:
    """Return the names of the workflows that `load_document` finds, sorted."""
    return list_config("workflows")


def description_of(name: str) -> str:
    """Return the description of a workflow, of which the keys alone are checked.

    Raises:
        WorkflowError: no such file, broken YAML, or an unknown or missing key.
    """
    located = read_yaml(find_config("workflows", name, error=WorkflowError), WorkflowError)
    values = located.value if isinstance(located.value, dict) else {}
    mistakes = Mistakes(values)
    record_of(Workflow).check_keys(values, (), mistakes)
    refuse(mistakes, located.error, f"workflow {name}")
    return str(values.get("description") or "")


def load_document(
    name_or_path: str | Path, overrides: Iterable[str] | AnyMapping = ()
) -> WorkflowDocument:
    """Read a workflow file.

    Args:
        name_or_path: a name in `config/workflows/`, or a path.
        overrides: `path=value` texts as of `--set`, or a mapping of dotted paths to values.

    Raises:
        WorkflowError: no such file, broken YAML, an unknown key, a wrong override.
    """
    path = find_config("workflows", name_or_path, error=WorkflowError)
    return document_at(read_yaml(path, WorkflowError), overrides)


def document_at(located: Located, overrides: Iterable[str] | AnyMapping = ()) -> WorkflowDocument:
    """Return the document of a workflow that was read; see `load_document`."""
    path, values = located.path, located.value
    if not isinstance(values, dict):
        raise WorkflowError("a workflow is a mapping with robot, platform and flow", f"{path}:1")
    pairs = overrides.items() if isinstance(overrides, Mapping) else map(split_setting, overrides)
    changed = tuple(set_value(values, *pair) for pair in pairs)
    return _checked(WorkflowDocument(path.stem, values, located, changed))


def document_of(values: AnyMapping, path: Path, line: int) -> WorkflowDocument:
    """Return the document of a workflow that is written in Python.

    Args:
        values: as of a workflow file; flows may be nodes.
        path: the Python file; relative paths are relative to its folder.
        line: where it stands.

    Raises:
        WorkflowError: a key is unknown, missing or wrong.
    """
    given = {key: value for key, value in values.items() if value is not None}
    states = given.get("states")
    if isinstance(states, Mapping):  # specifications as plain values
        given["states"] = {
            k: v.to_dict() if hasattr(v, "to_dict") else v for k, v in states.items()
        }
    return _checked(WorkflowDocument(path.stem, given, Located(path, given, {(): line})))


def _checked(document: WorkflowDocument) -> WorkflowDocument:
    values = document.values
    other = other_kind(values, "workflow")
    if other:
        raise document.error(other, "schema")
    read_part(document, Workflow, values)
    document.name = str(document.get("name", document.name))
    return document
