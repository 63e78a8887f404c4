"""Another package's commands and options of a run: found, or named and left out where broken."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from source_tree import ROOT

COMMAND = """
from unicon_ros.cli.options import command

add = command("hello", lambda arguments: print("hello") or 0, "greet")
"""


def unicon(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    paths = [str(folder), str(ROOT), os.environ.get("PYTHONPATH", "")]
    return subprocess.run(
        [sys.executable, "-m", "unicon_ros", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths).rstrip(os.pathsep)},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


def package(folder: Path, entry_points: str, **modules: str) -> None:
    facts = folder / "another-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: another\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text(entry_points)
    for name, text in modules.items():
        (folder / f"{name}.py").write_text(text)


def test_a_command_of_another_package_is_one_of_ours(tmp_path: Path) -> None:
    package(tmp_path, "[unicon.commands]\nhello = another_command\n", another_command=COMMAND)
    done = unicon(tmp_path, "hello")
    assert (done.returncode, done.stdout, done.stderr) == (0, "hello\n", "")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("import missing_one", "ModuleNotFoundError: No module named 'missing_one'"),
        ("raise SystemError('at once')", "SystemError: at once"),
        ("", "it has no 'add';"),
        ("(", "SyntaxError: '(' was never closed"),
    ],
)
def test_a_broken_one_is_named_and_the_others_work(tmp_path: Path, text: str, why: str) -> None:
    package(tmp_path, "[unicon.commands]\nhello = another_command\n", another_command=text)
    done = unicon(tmp_path, "platforms", "fake")
    assert done.returncode == 0
    [line] = done.stderr.splitlines()
    assert line.startswith(
        "unicon: warning: unicon.commands 'hello' (entry point another_command) is left out: "
    )
    assert why in line
    assert line.endswith("mend or uninstall its package")


def test_broken_options_of_a_run_leave_a_run_as_it_is(tmp_path: Path) -> None:
    package(tmp_path, "[unicon.run]\nanother = another_options\n", another_options="OPTIONS = ()")
    words = ("run", "go2_stand", "--set", "platform=fake", "--no-ros", "--quiet")
    done = unicon(tmp_path, *words, "--speed", "max", "--duration", "0.1")
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("is left out: it has no 'CHECKS', 'refuse', 'attachments';") == 1


def test_what_was_removed_is_not_missed(tmp_path: Path) -> None:
    package(tmp_path, "[unicon.commands]\nhello = gone_with_its_folder.command\n")
    done = unicon(tmp_path, "platforms", "fake")
    assert (done.returncode, done.stderr) == (0, "")


ATTACHED = """
from unicon_ros.attachments import Attachment

OPTIONS, CHECKS = (), {}

class Broken(Attachment):
    def ended(self, report):
        raise RuntimeError("at the end")

def refuse(options): ...
def attachments(asked): return [Broken()]
"""


def test_one_that_fails_at_the_end_loses_neither_report_nor_status(tmp_path: Path) -> None:
    package(tmp_path, "[unicon.run]\nanother = another_options\n", another_options=ATTACHED)
    words = ("run", "go2_stand", "--set", "platform=fake", "--no-ros", "--report", "run.json")
    done = unicon(tmp_path, *words, "--speed", "max", "--duration", "0.1")
    assert done.returncode == 0, done.stderr
    assert "Broken        failed: RuntimeError: at the end" in done.stdout
    assert (tmp_path / "run.json").is_file()
