"""What the attacks on files share: a workflow in a folder, and what the command line says of it."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import pytest

from unicon_ros.cli.main import main

__all__ = ["BASE", "one_line", "run_bounded", "told", "workflow"]

BASE = "robot: go2\nplatform: fake\nrate: 50\nflow: {hold: {duration: 0.1}}\n"

REPOSITORY = Path(__file__).resolve().parents[2]


def workflow(folder: Path, text: str = BASE, name: str = "w.yaml") -> Path:
    """Write a workflow file."""
    path = folder / name
    path.write_text(text, "utf-8")
    return path


def told(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    """Run the command line in this process; return status and everything that it said."""
    status = main([str(argument) for argument in arguments])
    spoken = capsys.readouterr()
    return status, spoken.out + spoken.err


def one_line(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Run the command line, which must refuse with status 1 and one line; return that."""
    status, spoken = told(capsys, *arguments)
    assert status == 1, spoken
    assert "Traceback" not in spoken
    errors = [line for line in spoken.splitlines() if line.startswith("unicon: error: ")]
    assert len(errors) == 1, spoken
    return errors[0].removeprefix("unicon: error: ")


def run_bounded(*arguments: object, cpu_s: int = 30, memory: int = 4 << 30) -> tuple[int, str]:
    """Run the command line in a process that may use so much time and memory and no more."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s))
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))

    done = subprocess.run(
        [sys.executable, "-m", "unicon_ros", *map(str, arguments)],
        capture_output=True,
        text=True,
        preexec_fn=limit,
        cwd=REPOSITORY,
        timeout=300,
    )
    return done.returncode, done.stdout + done.stderr
