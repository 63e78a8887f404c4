"""`unicon bench sloc`: what it takes to move a workflow to another robot, in lines, counted.

The counterpart of the UniCon paper's table of transfer effort: for each move, which files differ
and how many lines of them anybody had to write; the workflow itself changes by one word.
"""

from __future__ import annotations

import io
import tokenize
from pathlib import Path

import unicon_core
from unicon_core.resources import find_config
from unicon_ros.bench.report import Bench

__all__ = ["lines_of_python", "lines_of_yaml", "run"]

_SKIPPED = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}

COMPONENTS = (
    ("platform mujoco", "unicon_core/platforms/sim/mujoco"),
    ("platform ros", "unicon_ros/bridge/ros_platform.py"),
    ("policies, all formats", "unicon_core/policies"),
)
"""What is shared by all workflows, beside the paper's columns Sim, robot driver and NN."""

MOVES = (
    # from, to, robot file that is needed, words of the workflow that change
    ("H1 behind ROS 2 topics", "H1 in MuJoCo", None, ("platform",)),
    ("H1 in MuJoCo", "G1 in MuJoCo", "g1_29dof", ("robot",)),
    ("G1 in MuJoCo", "T1 in MuJoCo", "t1", ("robot",)),
    ("G1 in MuJoCo", "Go2 in MuJoCo", "go2", ("robot",)),
    ("G1 in MuJoCo", "G1 behind ROS 2 topics", None, ("platform",)),
)
"""The paper's row H1 → Sim → G1 → another robot, and two more."""


def lines_of_python(text: str) -> int:
    """Return the lines with code: no blank ones, comments or docstrings."""
    lines: set[int] = set()
    previous = tokenize.NEWLINE
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        documentation = token.type == tokenize.STRING and previous in _STARTS
        if token.type not in _SKIPPED and token.type != tokenize.ENDMARKER and not documentation:
            lines.update(range(token.start[0], token.end[0] + 1))
        if token.type not in (tokenize.NL, tokenize.COMMENT):
            previous = token.type
    return len(lines)


_STARTS = (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)


def lines_of_yaml(text: str) -> int:
    """Return the lines with content: no blank ones, no comments."""
    stripped = (line.strip() for line in text.splitlines())
    return sum(bool(line) and not line.startswith("#") for line in stripped)


def run(rounds: int | None = None) -> Bench:
    """Count; there is nothing to repeat.

    Args:
        rounds: taken for the command line's sake.
    """
    bench = Bench("sloc", seed=0, rounds=1)
    root = Path(unicon_core.__file__).resolve().parent.parent
    for name, place in COMPONENTS:
        path = root / place
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
        lines = sum(lines_of_python(file.read_text(encoding="utf-8")) for file in files)
        bench.facts[f"component: {name}"] = f"{lines} lines of Python, written once"
    for source, target, robot, words in MOVES:
        needed = "no new file"
        if robot is not None:
            text = find_config("robots", robot).read_text(encoding="utf-8")
            needed = f"{lines_of_yaml(text)} lines of facts in config/robots/{robot}.yaml"
        bench.facts[f"{source} → {target}"] = (
            f"{needed}; workflow: 0 lines, {len(words)} word ({', '.join(words)})"
        )
    return bench
