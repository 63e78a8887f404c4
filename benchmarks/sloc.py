"""`unicon bench sloc`: what it takes to move a workflow to another robot, in lines, counted.

The counterpart of the UniCon paper's table of transfer effort. Each edit of `sloc.yaml` is made in
a copy of a workflow file, counted in the difference of both texts, and run in a process of its own:
`unicon run FILE`. A robot that falls has failed, and what cannot be run here is told. Where the
platform is a vendor's or `ros`, `unicon emulate` emulates a robot behind that protocol.

Beside it stands what the same move took in public code that was written for one robot: the
counterpart of the row "Ad-hoc" in the paper, whose own code is not public: 852 lines for an H1, and
507, 627 and 770 changed ones for simulation, G1 and Adam. The files were counted by `code_of`, as
ours are; a test counts them again where they are.
"""

from __future__ import annotations

import difflib
import io
import json
import os
import re
import subprocess
import sys
import time
import tokenize
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread

import unicon_core
from unicon_base import AnyDict, AnyMapping, UniconError
from unicon_base.located_yaml import read_yaml
from unicon_base.resources import assets_root, find_config
from unicon_core.robots import load_robot
from unicon_core.workflow import load_document
from unicon_ros.bench.report import Bench, free_domain

TIMEOUT = 120.0
"""Longest run in [s]: an emulated robot on a busy machine takes its time."""

AGAIN = 2
"""How often a run in real time is repeated where it failed: the machine may have stood still."""

READY = 60.0
"""How long an emulated robot may take to be there, [s]: it reads its model."""

GONE = 5.0
"""How long it may take to end, [s]."""

SIMULATED = ("mujoco", "pybullet", "fake", "fake_robot")
"""Platforms that need nobody else."""

NEEDED = {"mujoco": ["mujoco"], "ros": ["rclpy"], "unitree": ["cyclonedds"], "pnd": ["cyclonedds"]}
"""What a platform imports."""

PATIENCE = {"silence": 2.0, "connect": 30.0}
"""Options of a vendor's platform, [s], for a machine that stands still now and then."""


@dataclass(frozen=True)
class Transfer:
    """One move.

    Attributes:
        source: in words.
        target: in words.
        workflow: name in config/workflows.
        before: what makes the source of that file: key to word.
        edit: what makes the target of the source; nothing where the file is run as it is.
        robot: arguments of `unicon emulate`, where the target is to be run against one.
        seconds: of ticks, [s].
    """

    source: str
    target: str
    workflow: str
    before: Mapping[str, str] = field(default_factory=dict)
    edit: Mapping[str, str] = field(default_factory=dict)
    robot: Sequence[str] = ()
    seconds: float = 2.0


# Moves, what they took elsewhere, and what is shared by all workflows.
TABLE: AnyDict = read_yaml(Path(__file__).with_name("sloc.yaml")).value
TRANSFERS = [Transfer(**move) for move in TABLE["moves"]]


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
    text = find_config("workflows", transfer.workflow).read_text("utf-8")
    source = edited(text, transfer.before)
    target = edited(source, transfer.edit)
    changed = difference(source, target)
    removed, added = (
        " ".join(line[1:] for line in changed if line[0] == sign).split() for sign in "-+"
    )
    words = sum(a != b for a, b in zip(removed, added)) + abs(len(removed) - len(added))
    with TemporaryDirectory(prefix="unicon_sloc_") as folder:
        path = Path(folder) / f"{transfer.workflow}.yaml"
        path.write_text(target, "utf-8")
        values = load_document(path).values
        missing = _missing(values)
        ran, told = (None, missing) if missing else _run(path, values, transfer)
        for _ in range(AGAIN if values["platform"] != "mujoco" else 0):
            if ran is not False:
                break
            ran, told = _run(path, values, transfer)
    return Outcome(changed, words, ran, told)


def _missing(values: AnyMapping) -> str:
    """Return what this machine lacks for a workflow, "" where it has all."""
    platform, policies = values["platform"], values.get("policies")
    for module in (*NEEDED.get(platform, ()), *(["onnxruntime"] if policies else [])):
        if find_spec(module) is None:
            return f"{module} is not installed"
    model = load_robot(values["robot"]).models if platform == "mujoco" else ""
    foreign = "assets:" in f"{model} {policies} {values.get('scene')}"
    if foreign and assets_root() is None:
        return "there are no assets; set UNICON_ASSETS"
    return ""


def _run(path: Path, values: AnyMapping, transfer: Transfer) -> tuple[bool, str]:
    """Run a workflow in a process of its own; return whether it did, and how it ended."""
    report = path.with_suffix(".json")
    report.unlink(missing_ok=True)
    command = [sys.executable, "-m", "unicon_ros", "run", str(path), "--quiet", "--yes"]
    command += ["--report", str(report), "--faults", "off", "--duration", f"{transfer.seconds:g}"]
    if values["platform"] == "mujoco":
        command += ["--speed", "max"]
    try:
        with emulated(values["platform"], values["robot"], transfer.robot) as robot:
            done = subprocess.run(
                [*command, *robot.sets],
                capture_output=True,
                text=True,
                timeout=TIMEOUT,
                env=robot.environment,
            )
    except subprocess.TimeoutExpired:
        return False, f"not over after {TIMEOUT:g} s"
    except UniconError as error:
        return False, str(error)
    if not report.is_file():
        lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        return False, lines[-1]
    said = json.loads(report.read_text("utf-8"))
    if said["faults"]:
        return False, said["faults"][0]
    moved = (robot.moved or said["base_displacement_m"])[0]
    hangs = "--hang" in transfer.robot or said["fell"] is None  # here or in the scene
    held = ", hanging on a gantry" if hangs else ""
    fell = ", and fell" if said["fell"] else ""
    told = f"{said['ticks']} ticks, {moved:+.2f} m ahead{held}{fell}"
    return done.returncode == 0 and not fell, told


@dataclass
class _Robot:
    """The robot of a run.

    Attributes:
        environment: of the run.
        sets: arguments by which the run finds it; they are of this machine, and no edit.
        moved: how far its base has moved, [m], once it has ended; None: the run's report says.
    """

    environment: Mapping[str, str]
    sets: tuple[str, ...] = ()
    moved: list[float] | None = None


@contextmanager
def emulated(platform: str, name: str, arguments: Sequence[str]) -> Iterator[_Robot]:
    """Let a robot be there behind the protocol of a platform.

    Raises:
        UniconError: it is not.
    """
    robot = _Robot(dict(os.environ))
    if platform in SIMULATED:
        yield robot
        return
    domain = free_domain()
    command = [sys.executable, "-m", "unicon_ros", "emulate", name, *arguments]
    if platform == "ros":
        robot.environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        command += ["--face", "ros", "--model", "fake"]
    else:
        command += ["--set", f"domain={domain}"]
        options = {"address": "127.0.0.1", "domain": domain, **PATIENCE}
        robot.sets = ("--set", f"platforms={json.dumps({platform: options})}")
    pipes: AnyDict = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=robot.environment, **pipes) as process:
        lines = list[str]()
        watcher = Thread(target=lines.extend, args=(process.stdout,), daemon=True)  # as they come
        watcher.start()
        try:
            end = time.monotonic() + READY
            while not lines:
                if process.poll() is not None or time.monotonic() > end:
                    process.kill()
                    assert process.stderr is not None
                    told = process.stderr.read().splitlines()[-1:] or ["it said nothing"]
                    raise UniconError(f"no robot: {told[0]}")
                time.sleep(0.05)
            yield robot
            process.terminate()
            watcher.join(GONE)
            ended = [line for line in map(json.loads, lines) if line["kind"] == "ended"]
            robot.moved = ended[0]["moved"] if ended and platform != "ros" else None
        finally:
            process.kill()
            watcher.join(GONE)


_SKIPPED = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
_STARTS = (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)


def code_of(text: str) -> list[str]:
    """Return the lines with code of a Python file: no blank ones, comments or docstrings."""
    lines: set[int] = set()
    previous = tokenize.NEWLINE
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        documentation = token.type == tokenize.STRING and previous in _STARTS
        if token.type not in _SKIPPED and token.type != tokenize.ENDMARKER and not documentation:
            lines.update(range(token.start[0], token.end[0] + 1))
        if token.type not in (tokenize.NL, tokenize.COMMENT):
            previous = token.type
    return [line for number, line in enumerate(text.split("\n"), 1) if number in lines]


def run(rounds: int | None = None) -> Bench:
    """Count, and make and run each transfer; there is nothing to repeat.

    Args:
        rounds: taken for the command line's sake.
    """
    bench = Bench("sloc", 1)
    root = Path(unicon_core.__file__).resolve().parent.parent
    for name, place in TABLE["components"].items():
        path = root / place
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
        lines = sum(len(code_of(file.read_text("utf-8"))) for file in files)
        bench.facts[f"component: {name}"] = f"{lines} lines of Python, written once"
    bench.facts["the paper's ad-hoc code"] = ", ".join(
        f"{name} {lines}" for name, lines in TABLE["paper"].items()
    )
    tried, ran = 0, 0
    for transfer in TRANSFERS:
        robot = transfer.edit.get("robot")
        if robot is not None:
            text = find_config("robots", robot).read_text("utf-8")
            written = f"{lines_of(text)} lines of facts, written once"
            bench.facts[f"robot file: {robot}"] = written
        outcome = transferred(transfer)
        tried += outcome.ran is not None
        ran += outcome.ran is True
        move = f"{transfer.source} → {transfer.target}"
        by_hand = []
        if found := TABLE["ad_hoc"].get(move):
            note = f"; {found['note']}" if "note" in found else ""
            code = f"{found['new']} new of {found['lines']} lines in {found['repository']}"
            by_hand = [f"    ad hoc: {code}{note}"]
        counted = ", ".join(
            f"{count} {what}{'s' * (count != 1)}"
            for count, what in ((outcome.lines, "line"), (outcome.words, "word"))
        )
        verdict = {True: "ran", False: "FAILED", None: "not run here"}[outcome.ran]
        bench.facts[move] = "\n".join(
            (
                f"{counted}; {verdict}: {outcome.told}",
                *(f"    {line}" for line in outcome.difference),
                *by_hand,
            )
        )
    if tried:
        bench.ratio("transfers that ran / that were tried", ran / tried, 1.0, at_least=True)
    return bench
