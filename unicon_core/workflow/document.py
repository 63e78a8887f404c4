"""Workflow documents: read, changed by `--set`, checked, with where each value stands.

    platform=fake                          a key
    flow.chain.0.pose.duration=2           an item of a list, by number
    policies.walk.given.action.scale=0.5   also where the file says {given: {action.scale: …}}
    states."my.state".unit=rad             quotes keep a dot in one key

And their settings: how ticks are timed, how a run begins, what is safe.

    start: {operator: false, approach: 0.3, fade_in: 2.0}
    start: none                    # a test bench: commands at once, as told at every start
    start: {at: "2026-11-22T21:00:00", late: go}     # with others: unicon_core/synchronised_start
    start: {together: {robots: [left, right], me: left}}

In a simulator gates are shown and pass by themselves, and there is neither approach nor fade-in.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Literal

from unicon_base import AnyDict, AnyMapping, WorkflowError
from unicon_base.bounded_yaml import MAX_DEPTH, YamlError
from unicon_base.located_yaml import Located, other_kind, parse_value, read_yaml
from unicon_base.resources import find_config, list_config
from unicon_base.schema.marks import Made, Within, positive
from unicon_base.schema.read import refuse
from unicon_base.schema.records import record_of, type_of
from unicon_base.schema.types import Here, Mistakes
from unicon_core.bounds import POSE_SPEED
from unicon_core.pacing import Pacing
from unicon_core.synchronised_start.meeting import Party
from unicon_core.synchronised_start.rendezvous import Moment, moment_of
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


DEFAULT_SAFETY: tuple[Any, ...] = ("finite", "joint_limits")
"""What stands between the flow and `send` of a simulator where a workflow does not say."""

NO_SAFETY = "none"
ONLY = "only"


@dataclass(frozen=True)
class Safety:
    """What a workflow says of its safety blocks.

    Attributes:
        blocks: as they are written.
        path: where they stand in the document.
        exact: `none` or `only`: a robot gets no others.
    """

    blocks: list[Any]
    path: tuple[str, ...] = ("safety",)
    exact: bool = False

    @property
    def words(self) -> str:
        """How it is written, for messages."""
        return f"safety: {NO_SAFETY if not self.blocks else ONLY}" if self.exact else "safety"


MOMENTS = ("at", "together")
"""Keys that say at which moment the flow begins."""

LONGEST_FADE = 10.0
"""Of `fade_in` in [s]."""


@dataclass(frozen=True)
class StartSettings:
    """How a robot begins to move.

    Attributes:
        gates: ask the gates before anything is sent; without them every start tells so.
        operator: wait for the operator's go.
        approach: how fast joints go to where the flow begins in [rad/s].
        fade_in: how long stiffness grows from zero, and then how long the flow's commands take to
            come in, in [s]; 0 for commands at once, without approach.
        at: the flow's first tick is at that moment of the wall clock, behind all of these.
        together: it is at a moment that robots agree on.
        late: `fault` where this one or another is late or never comes, `go` to begin without.
    """

    gates: bool = True
    operator: bool = True
    approach: Annotated[float, positive(POSE_SPEED, "rad/s")] = 0.5
    fade_in: Annotated[float, Within(0.0, LONGEST_FADE, "s")] = 1.0
    at: Annotated[Moment | None, Made(moment_of)] = None
    together: Party | None = None
    late: Literal["fault", "go"] = "fault"

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note two moments."""
        if found.get("at") is not None and found.get("together") is not None:
            here.note("at and together both say when; leave one out", "at")

    @property
    def alone(self) -> bool:
        """Whether who is late begins alone."""
        return self.late == "go"


Start = Literal["none"] | StartSettings
"""Of `start:`."""

NONE = StartSettings(gates=False, operator=False, fade_in=0.0)
"""Of `start: none`."""


def pacing_of(document: WorkflowDocument) -> Pacing:
    """Return how ticks are timed."""
    pacing: Pacing = read_part(document, Pacing, document.get("pacing", {}), "pacing")
    if pacing.every is not None and pacing.trigger == "deadline":
        text = "pacing.every counts the platform's data; set pacing.trigger: state, or leave it out"
        raise document.error(text, "pacing", "every")
    return pacing


def start_of(document: WorkflowDocument) -> StartSettings:
    """Return how the run begins."""
    said = read_part(document, Start, document.get("start", {}), "start")
    settings: StartSettings = NONE if said == "none" else said
    if settings.together is not None:
        settings = replace(settings, together=settings.together.within(document.path.parent))
    return settings


def safety_of(document: WorkflowDocument) -> Safety:
    """Return what is said under `safety:`; `safety: none` has no blocks."""
    value = document.values.get("safety")
    if value is None:
        return Safety(list(DEFAULT_SAFETY))
    if value == NO_SAFETY:
        return Safety([], exact=True)
    if isinstance(value, dict):
        return Safety(value[ONLY], ("safety", ONLY), exact=True)
    return Safety(value)
