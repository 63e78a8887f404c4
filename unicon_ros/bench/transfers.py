"""Transfers: moves a workflow to another platform or robot by an edit of its file, and runs it.

For `unicon bench sloc`. The edit is made in a copy of the file, the lines are counted in the
difference of the two texts, and what is then run is a process of its own: `unicon run FILE`.
"""

from __future__ import annotations

import difflib
import json
import os
import re
import select
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from unicon_core.errors import UniconError
from unicon_core.resources import assets_root, find_config
from unicon_core.robots import load_robot
from unicon_core.workflow import load_document
from unicon_ros.bench.domains import free_domain

__all__ = ["Outcome", "Transfer", "difference", "edited", "lines_of", "transferred"]

SECONDS = 2.0
"""Of ticks of each run, [s]."""

TIMEOUT = 120.0
"""Longest run in [s]: a stand-in on a busy machine takes its time."""

AGAIN = 2
"""How often a run in real time is repeated where it failed: the machine may have stood still."""

STAND_IN = ("--face", "ros", "--model", "fake", "--posture", "default")
"""Of `unicon emulate`: a robot behind plain topics."""

GONE = 5.0
"""How long a stand-in may take to end, [s]."""


@dataclass(frozen=True)
class Transfer:
    """One move.

    Attributes:
        source: in words.
        target: in words.
        workflow: name in config/workflows.
        before: what makes the source of that file: key to word.
        edit: what makes the target of the source; nothing where the file is run as it is.
    """

    source: str
    target: str
    workflow: str
    before: Mapping[str, str] = field(default_factory=dict)
    edit: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    """What became of one.

    Attributes:
        difference: of the two files, changed lines alone, with `-` and `+`.
        words: that differ in them.
        ran: it ran to its end without a fault, and the robot stood; None: not tried here.
        told: how it ended, or why not.
    """

    difference: tuple[str, ...]
    words: int
    ran: bool | None
    told: str

    @property
    def lines(self) -> int:
        """Lines that somebody had to write."""
        return lines_of("\n".join(line[1:] for line in self.difference if line[0] == "+"))


def lines_of(text: str) -> int:
    """Return the lines of YAML with content: no blank ones, no comments."""
    stripped = (line.strip() for line in text.splitlines())
    return sum(bool(line) and not line.startswith("#") for line in stripped)


def edited(text: str, edit: Mapping[str, str]) -> str:
    """Return a workflow's text with other words behind top-level keys.

    Raises:
        UniconError: a key is not there, or has more than a word behind it.
    """
    for key, word in edit.items():
        line = re.compile(rf"^({re.escape(key)}:[ ]+)[^\s{{\[]+(?=[ ]*(#|$))", re.MULTILINE)
        text, count = line.subn(rf"\g<1>{word}", text, count=1)
        if not count:
            raise UniconError(f"bench sloc: the workflow has no line '{key}: WORD' to edit")
    return text


def difference(before: str, after: str) -> tuple[str, ...]:
    """Return the lines in which two texts differ, with `-` and `+`."""
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), lineterm="", n=0)
    return tuple(line for line in lines if not line.startswith(("---", "+++", "@@")))


def transferred(transfer: Transfer) -> Outcome:
    """Make the edit and run the target.

    Raises:
        UniconError: the edit cannot be made.
    """
    text = find_config("workflows", transfer.workflow).read_text(encoding="utf-8")
    source = edited(text, transfer.before)
    target = edited(source, transfer.edit)
    changed = difference(source, target)
    removed = " ".join(line[1:] for line in changed if line[0] == "-").split()
    added = " ".join(line[1:] for line in changed if line[0] == "+").split()
    words = sum(a != b for a, b in zip(removed, added)) + abs(len(removed) - len(added))
    with TemporaryDirectory(prefix="unicon_sloc_") as folder:
        path = Path(folder) / f"{transfer.workflow}.yaml"
        path.write_text(target, encoding="utf-8")
        values = load_document(path).values
        missing = _missing(values)
        ran, told = (None, missing) if missing else _run(path, values)
        for _ in range(AGAIN if values["platform"] != "mujoco" else 0):
            if ran is not False:
                break
            ran, told = _run(path, values)
    return Outcome(changed, words, ran, told)


def _missing(values: Mapping[str, Any]) -> str:
    """Return what this machine lacks for a workflow, "" where it has all."""
    platform, policies = values["platform"], values.get("policies")
    wanted = {"mujoco": ["mujoco"], "ros": ["rclpy"]}.get(platform, [])
    for module in (*wanted, *(["onnxruntime"] if policies else [])):
        if find_spec(module) is None:
            return f"{module} is not installed"
    model = load_robot(values["robot"]).models if platform == "mujoco" else ""
    foreign = "assets:" in f"{model} {policies} {values.get('scene')}"
    if foreign and assets_root() is None:
        return "there are no assets; set UNICON_ASSETS"
    return ""


def _run(path: Path, values: Mapping[str, Any]) -> tuple[bool, str]:
    """Run a workflow in a process of its own; return whether it did, and how it ended."""
    report = path.with_suffix(".json")
    command = [sys.executable, "-m", "unicon_ros", "run", str(path), "--quiet", "--yes"]
    command += ["--report", str(report), "--faults", "off", "--duration", f"{SECONDS:g}"]
    if values["platform"] == "mujoco":
        command += ["--speed", "max"]
    try:
        with _robot(values["platform"], values["robot"]) as environment:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=TIMEOUT, env=environment
            )
    except subprocess.TimeoutExpired:
        return False, f"not over after {TIMEOUT:g} s"
    except UniconError as error:
        return False, str(error)
    if not report.is_file():
        lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        return False, lines[-1]
    said = json.loads(report.read_text(encoding="utf-8"))
    if said["faults"]:
        return False, said["faults"][0]
    fell = ", and fell" if said["fell"] else ""
    told = f"{said['ticks']} ticks, {said['base_displacement_m'][0]:+.2f} m ahead{fell}"
    balances = bool(values.get("policies"))  # nobody does in a posture
    return done.returncode == 0 and not (fell and balances), told


@contextmanager
def _robot(platform: str, robot: str) -> Iterator[dict[str, str]]:
    """Let a robot stand behind topics where the platform is ROS; give the environment of both.

    Raises:
        UniconError: it does not begin.
    """
    if platform != "ros":
        yield dict(os.environ)
        return
    environment = os.environ | {"ROS_DOMAIN_ID": str(free_domain())}
    command = [sys.executable, "-m", "unicon_ros", "emulate", robot, *STAND_IN]
    standin = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    )
    try:
        assert standin.stdout is not None
        assert standin.stderr is not None
        came = select.select([standin.stdout], [], [], TIMEOUT)[0]
        if not (came and '"ready"' in standin.stdout.readline()):
            standin.kill()
            why = standin.stderr.read().strip().splitlines() or [f"not there after {TIMEOUT:g} s"]
            raise UniconError(f"the emulated robot did not begin: {why[-1]}")
        yield environment
    finally:
        standin.terminate()
        with suppress(subprocess.TimeoutExpired):
            standin.communicate(timeout=GONE)
        standin.kill()
        standin.communicate()
