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

MOVES = (
    # from, to, robot file, platform folder or file (None: the one it had)
    ("G1, MuJoCo", "Go2, MuJoCo", "go2", None),
    ("G1, MuJoCo", "H1, MuJoCo", "h1", None),
    ("G1, MuJoCo", "G1 behind ROS 2 topics", None, "unicon_ros/bridge/ros_platform.py"),
    ("G1, MuJoCo", "T1 behind ROS 2 topics", "t1", "unicon_ros/bridge/ros_platform.py"),
)


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
    mujoco = sum(
        lines_of_python(path.read_text(encoding="utf-8"))
        for path in sorted((root / "unicon_core/platforms/mujoco").glob("*.py"))
    )
    bench.fact("platform mujoco [lines of Python]", mujoco)
    for source, target, robot, platform in MOVES:
        robot_lines = platform_lines = 0
        if robot is not None:
            path = find_config("robots", robot)
            robot_lines = lines_of_yaml(path.read_text(encoding="utf-8"))
        if platform is not None:
            platform_lines = lines_of_python((root / platform).read_text(encoding="utf-8"))
        words = (robot is not None) + (platform is not None)
        bench.fact(
            f"{source} → {target}",
            f"robot file {robot_lines} lines of YAML (shipped), platform {platform_lines} lines "
            f"of Python (shipped), workflow 0 lines: {words} changed "
            f"{'word' if words == 1 else 'words'}",
        )
    return bench
