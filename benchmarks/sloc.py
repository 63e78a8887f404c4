"""`unicon bench sloc`: what it takes to move a workflow to another robot, in lines, counted.

The counterpart of the UniCon paper's table of transfer effort. Each edit is made in a copy of a
workflow file, counted in the difference of both, and run; a robot that falls has failed, and what
cannot be run here is told.

Beside it stands what the same move took in public code that was written for one robot: the
counterpart of the row "Ad-hoc" in the paper, whose own code is not public: 852 lines for an H1, and
507, 627 and 770 changed ones for simulation, G1 and Adam. The files were counted by `code_of`, as
ours are; a test counts them again where they are.
"""

from __future__ import annotations

import io
import tokenize
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import unicon_core
from benchmarks.transfers import Transfer, lines_of, transferred
from unicon_base.resources import find_config
from unicon_ros.bench.report import Bench

_SKIPPED = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}

COMPONENTS = (
    ("platform unitree (H1, G1, Go2)", "unicon_hardware/unitree"),
    ("platform mujoco", "unicon_core/platforms/mujoco"),
    ("platform pnd (Adam)", "unicon_hardware/pnd"),
    ("DDS of both", "unicon_hardware/dds"),
    ("platform ros", "unicon_ros/bridge/ros_platform.py"),
    ("policies, all formats", "unicon_core/policies"),
)
"""What is shared by all workflows: the paper's columns H1 and G1, Sim, Adam and NN, and more."""

H1 = "h1_stand"
WALK = 8.0
"""So long do those run that walk, [s]: a Go2 stands up in the first four."""


HUNG = ("--posture=default", "--hang")
"""A humanoid in a posture: nobody balances it, so that it hangs on its gantry."""

TRANSFERS = (
    # the paper's workflows: H1, Sim, G1, Adam
    Transfer("H1", "H1", H1, {"platform": "unitree"}, {}, HUNG),
    Transfer("H1", "H1 in MuJoCo", H1, {"platform": "unitree"}, {"platform": "mujoco"}),
    Transfer("H1", "G1", H1, {"platform": "unitree"}, {"robot": "g1_29dof"}, HUNG),
    Transfer(
        "G1",
        "Adam",
        H1,
        {"robot": "g1_29dof", "platform": "unitree"},
        {"robot": "adam_lite", "platform": "pnd"},
        HUNG,
    ),
    # and more
    Transfer("H1 in MuJoCo", "G1 in MuJoCo", H1, {}, {"robot": "g1_29dof"}),
    Transfer("G1 in MuJoCo", "Adam in MuJoCo", H1, {"robot": "g1_29dof"}, {"robot": "adam_lite"}),
    Transfer("G1 in MuJoCo", "T1 in MuJoCo", H1, {"robot": "g1_29dof"}, {"robot": "t1"}),
    Transfer("G1 in MuJoCo", "Go2 in MuJoCo", H1, {"robot": "g1_29dof"}, {"robot": "go2"}),
    Transfer(
        "G1 in MuJoCo",
        "G1 behind ROS 2 topics",
        H1,
        {"robot": "g1_29dof"},
        {"platform": "ros"},
        ("--posture=default",),
    ),
    Transfer(
        "G1 walks in MuJoCo",
        "G1 walks",
        "g1_walk",
        {},
        {"platform": "unitree"},
        ("--posture=default", "--let-go=3"),
        WALK,
    ),
    Transfer("Go2 walks in MuJoCo", "Go2 walks", "go2_walk", {}, {"platform": "unitree"}, (), WALK),
)
"""The paper's row H1 → Sim → G1 → Adam without its policies, which are not public, and more moves,
two of them with a policy. A robot is emulated: behind its vendor's protocol, in front of MuJoCo."""


@dataclass(frozen=True)
class AdHoc:
    """Code for one move.

    Attributes:
        repository: on GitHub, with the commit's first digits.
        files: paths in it, and of each the file of `unitree_rl_gym` that it is laid out like, or
            "".
        lines: with code or content, of all files.
        new: of these, the ones that are not in the file that theirs is laid out like.
        note: what else there is to say.
    """

    repository: str
    files: Mapping[str, str] = field(repr=False)
    lines: int
    new: int
    note: str = ""

    def __str__(self) -> str:
        note = f"; {self.note}" if self.note else ""
        return f"{self.new} new of {self.lines} lines in {self.repository}{note}"


PAPER = {"H1": 852, "Sim": 507, "G1": 627, "Adam": 770}
"""The paper's row "Ad-hoc": its code base for H1, and lines changed for the others."""

_GYM = "unitreerobotics/unitree_rl_gym@276801e"
_REAL = "deploy/deploy_real"
_PROGRAM = (
    *("deploy_real.py", "config.py", "common/command_helper.py"),
    *("common/remote_controller.py", "common/rotation_helper.py"),
)
_H1 = f"{_REAL}/configs/h1.yaml"

AD_HOC = {
    "H1 → H1": AdHoc(
        _GYM, {f"{_REAL}/{name}": f"{_REAL}/{name}" for name in _PROGRAM} | {_H1: _H1}, 360, 0
    ),
    "H1 → H1 in MuJoCo": AdHoc(
        _GYM,
        {"deploy/deploy_mujoco/deploy_mujoco.py": "", "deploy/deploy_mujoco/configs/h1.yaml": ""},
        104,
        104,
        "a program of its own",
    ),
    "H1 → G1": AdHoc(
        _GYM, {f"{_REAL}/configs/g1.yaml": _H1}, 31, 22, "the program knows the messages of both"
    ),
    "G1 → Adam": AdHoc(
        "pndbotics/pnd_rl_mjlab@6c724bf",
        {f"{_REAL}/{name}": f"{_REAL}/{name}" for name in _PROGRAM}
        | {f"{_REAL}/configs/adam_sp_velocity_flat.yaml": _H1},
        640,
        541,
        "laid out as unitree_rl_gym; tracks motions as well",
    ),
    "G1 in MuJoCo → T1 in MuJoCo": AdHoc(
        "BoosterRobotics/booster_gym@da396a0",
        {"play_mujoco.py": ""},
        121,
        121,
        "a program of its own",
    ),
}
"""Move of `bench sloc` to public code that does the same."""


def code_of(text: str, python: bool = True) -> list[str]:
    """Return the lines with code: no blank ones or comments, in Python no docstrings either."""
    if not python:
        return [line for line in text.splitlines() if lines_of(line)]
    lines: set[int] = set()
    previous = tokenize.NEWLINE
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        documentation = token.type == tokenize.STRING and previous in _STARTS
        if token.type not in _SKIPPED and token.type != tokenize.ENDMARKER and not documentation:
            lines.update(range(token.start[0], token.end[0] + 1))
        if token.type not in (tokenize.NL, tokenize.COMMENT):
            previous = token.type
    return [line for number, line in enumerate(text.split("\n"), 1) if number in lines]


_STARTS = (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def run(rounds: int | None = None) -> Bench:
    """Count, and make and run each transfer; there is nothing to repeat.

    Args:
        rounds: taken for the command line's sake.
    """
    bench = Bench("sloc", 1)
    root = Path(unicon_core.__file__).resolve().parent.parent
    for name, place in COMPONENTS:
        path = root / place
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
        lines = sum(len(code_of(file.read_text("utf-8"))) for file in files)
        bench.facts[f"component: {name}"] = f"{lines} lines of Python, written once"
    bench.facts["the paper's ad-hoc code"] = ", ".join(
        f"{name} {lines}" for name, lines in PAPER.items()
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
        by_hand = f"ad hoc: {AD_HOC[move]}" if move in AD_HOC else ""
        verdict = {True: "ran", False: "FAILED", None: "not run here"}[outcome.ran]
        bench.facts[move] = "\n".join(
            (
                f"{_counted(outcome.lines, 'line')}, {_counted(outcome.words, 'word')}; "
                f"{verdict}: {outcome.told}",
                *(f"    {line}" for line in outcome.difference),
                *([f"    {by_hand}"] if by_hand else []),
            )
        )
    if tried:
        bench.ratio("transfers that ran / that were tried", ran / tried, 1.0, at_least=True)
    return bench
