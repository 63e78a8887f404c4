"""WorkflowDocument: the content of a workflow file, with where each value stands."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from unicon_core.errors import WorkflowError
from unicon_core.located_yaml import Located

SCHEMA = "unicon.workflow/1"

KEYS = {
    "schema": "unicon.workflow/1",
    "name": "name of the workflow; the file's name unless given",
    "description": "one line",
    "robot": "robot file: name or path; or {MEMBER: NAME}, a body and its hands",
    "platform": "platform's name: the one word that changes from simulation to the robot; or "
    "{MEMBER: NAME}",
    "store": "where else states go: local, shm, or {zmq: ADDRESS}",
    "parts": "name to {publishes, silent}: the workflow runs in several processes",
    "scene": "how a simulation begins and what disturbs it, the same on every simulator",
    "platforms": "options by platform name",
    "rate": "ticks per second [Hz]; the policy's period unless given",
    "duration": "end of a run [s] unless --duration says otherwise",
    "num_robots": "batch dimension",
    "map": "message map: name or path",
    "ros": "true to mirror to ROS 2 without being asked",
    "states": "extra states: name to specification",
    "policies": "name to policy: a path, or {path, given, child}",
    "skills": "name to policy, or to {policy or do, enter, from, after, tilt, calm, button, blend, "
    "next}: what flow: skills switches between",
    "estimate": "blocks that compute what is not measured, right behind recv",
    "commands": "blocks that make commands, before ROS inputs may replace them",
    "start": "{gates, operator, approach, fade_in, at, together, late}: before a robot moves",
    "flow": "the graph",
    "wind_down": "the graph after the run, before the platform damps and closes; at most 5 s",
    "safety": "blocks between the flow and send, or only: and blocks, or none",
    "deferred": "blocks after send",
    "twin": "{platform, window, over, bound}: a simulator beside the robot, under its commands",
    "pacing": "{trigger, overrun, hang, spin_us, arrival_spin_us, dry_run_us, priority, cpu, "
    "lock_memory}",
    "check": "settings of the preflight check",
}


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
    values: dict[str, Any]
    located: Located
    overridden: tuple[str, ...] = ()

    @property
    def path(self) -> Path:
        """The file."""
        return self.located.path

    def where(self, *path: str | int) -> str:
        """Return `file:line` of a value."""
        dotted = ".".join(map(str, path))
        if any(f"{dotted}.".startswith(f"{set_path}.") for set_path in self.overridden):
            return f"--set {dotted}"
        if path and path not in self.located.lines:  # made on the way to what was set
            made = (each for each in self.overridden if each.startswith(f"{dotted}."))
            return next((f"--set {each}" for each in made), self.located.where(path))
        return self.located.where(path)

    def error(self, message: str, *path: str | int) -> WorkflowError:
        """Return the error for a value, or for what was set below it and the message names."""
        below = ".".join(map(str, (*path, "")))
        named = (x for x in self.overridden if x.startswith(below) and _last(x) in message)
        found = next(named, "") if path else ""
        return WorkflowError(message, f"--set {found}" if found else self.where(*path))

    def get(self, key: str, kind: type | tuple[type, ...], default: Any = None) -> Any:
        """Return a top-level value of the kind wanted.

        Raises:
            WorkflowError: it is of another kind.
        """
        value = self.values.get(key)
        if value is None:
            return default
        if not isinstance(value, kind) or (isinstance(value, bool) and kind in (int, (int, float))):
            kinds = kind if isinstance(kind, tuple) else (kind,)
            wanted = " or ".join(dict.fromkeys(_KIND_NAMES.get(k, k.__name__) for k in kinds))
            raise self.error(f"{key}: {value!r} is not a {wanted}", key)
        if isinstance(value, float) and not math.isfinite(value):
            raise self.error(f"{key}: {value!r} is not a finite number", key)
        return value


def _last(dotted: str) -> str:
    """Return the last key of a path as messages quote it."""
    return repr(dotted.rpartition(".")[2])


_KIND_NAMES = {dict: "mapping", list: "list", str: "word", int: "number", float: "number"}
