"""What commands print on a terminal of 80 columns, and in a pipe: whole words, colours, status."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from contextlib import suppress
from pathlib import Path

import pytest

from unicon_base.resources import same_modules
from unicon_core.text_table import aligned, display_width, fitted
from unicon_ros.cli import console as console_module
from unicon_ros.cli.console import CLEAR, Console
from unicon_ros.cli.main import main

RUN = ["run", "STAND", "--no-ros", "--faults", "off"]
COMMANDS = (
    ["show", "go2_walk"],
    ["check", "go2_stand"],
    ["policies"],
    ["policies", "go2_velocity"],
    ["robots"],
    ["robots", "go2"],
    ["blocks", "pose"],
    ["workflows"],
    ["doctor"],
    [*RUN, "--speed", "max", "-v"],
)
SCRIPT = """\
import json, sys
from unicon_ros.cli.main import main
for command in json.loads(sys.argv[1]):
    print(f"=== {command}", flush=True)
    main(command)
"""
STAND = """\
schema: unicon.workflow/1
robot: go2
platform: fake
rate: 50
duration: 1.0
flow: {hold: {}}
"""
RED = "\x1b[31m"


@pytest.fixture
def stand(tmp_path: Path) -> str:
    """A workflow of one second."""
    path = tmp_path / "stand.yaml"
    path.write_text(STAND)
    return str(path)


def on_terminal(commands: object, columns: int = 80, **environment: str) -> str:
    """Return what commands print, one after the other, in one process on a real terminal."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    there = {**same_modules(), "TERM": "xterm", **environment}
    for name in {"COLUMNS", "NO_COLOR"} - environment.keys():
        there.pop(name, None)
    argv = [sys.executable, "-c", SCRIPT, json.dumps(commands)]
    process = subprocess.Popen(argv, stdin=theirs, stdout=theirs, stderr=theirs, env=there)
    os.close(theirs)
    found = b""
    with suppress(OSError):  # EIO: the other end is closed
        while part := os.read(ours, 1 << 16):
            found += part
    process.wait(60)
    os.close(ours)
    return found.decode().replace("\r\n", "\n")


def piped(commands: object) -> str:
    """Return what commands print into a pipe."""
    argv = [sys.executable, "-c", SCRIPT, json.dumps(commands)]
    done = subprocess.run(argv, capture_output=True, text=True, env=same_modules(), timeout=120)
    return done.stdout


def words(text: str) -> list[str]:
    """Return the letters and digits of a text in an order that does not tell where lines end."""
    return sorted(set(re.findall(r"[\w.+-]+", text)))


def test_the_widest_commands_fit_80_columns_and_lose_no_figure(stand: str) -> None:
    commands = [[stand if word == "STAND" else word for word in c] for c in COMMANDS]
    shown = on_terminal(commands)
    parts = shown.split("=== ")[1:]
    assert len(parts) == len(commands)
    for part in parts:
        for line in re.sub(r"\x1b\[[\d;]*[mK]", "", part.partition("\n")[2]).split("\n"):
            assert display_width(line.rpartition("\r")[2]) <= 80, (part.partition("\n")[0], line)
    # The same words and numbers as in a pipe, where lines are as long as they are.
    stable = [["show", "go2_walk"], ["policies", "go2_velocity"], ["robots"]]
    plain = piped(stable)
    assert max(map(len, plain.split("\n"))) > 100
    assert "\x1b" not in plain
    narrow = "".join(part for part in parts if any(part.startswith(f"{c}") for c in stable))
    assert [each for each in words(plain) if each not in words(narrow)] == []


def test_the_status_line_is_rewritten_and_does_not_scroll(stand: str) -> None:
    shown = on_terminal(
        [[word if word != "STAND" else "go2_walk" for word in RUN] + ["--duration", "1.0"]]
    )
    lines = shown.split("\n")
    status = [line for line in lines if CLEAR in line]
    assert len(status) == 1, status
    looks = [each for each in status[0].split(CLEAR) if " Hz" in each]
    assert 3 <= len(looks) <= 5
    for look in looks:
        assert len(look) < 80
        assert re.fullmatch(
            r"\d\.\d s run  [\d.]+ Hz  late -?[\d.]+ ms  overruns \d+"
            r"  command -?[\d.]+ -?[\d.]+ -?[\d.]+",
            look,
        ), look


@pytest.mark.parametrize("environment", [{}, {"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_faults_are_red_on_a_terminal_alone(environment: dict[str, str]) -> None:
    shown = on_terminal([["run", "go2_wolk"]], **environment)
    assert (f"{RED}unicon: error:\x1b[0m unknown workflow" in shown) is (not environment)
    assert ("\x1b" in shown) is (not environment)


def test_a_fault_and_a_fall_are_red_in_the_summary(tmp_path: Path) -> None:
    path = tmp_path / "trips.yaml"
    path.write_text(STAND.replace("fake", "mujoco") + "safety: [{tilt_stop: {angle: 0.001}}]\n")
    shown = on_terminal([["run", str(path), *RUN[2:], "--speed", "max"]])
    assert re.search(r"\x1b\[31mfaults  +\w", shown), shown
    assert "\x1b[31mended" not in shown


def test_the_result_comes_first_and_the_table_of_blocks_on_request(
    stand: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UNICON_TRACEBACK", "")
    command = [stand if word == "STAND" else word for word in RUN] + ["--speed", "max"]
    assert main(command) == 0
    plain = capsys.readouterr().out
    assert plain.startswith("workflow      ")
    assert "p50 µs" not in plain
    assert main([*command, "-v"]) == 0
    more = capsys.readouterr().out
    assert more.startswith("workflow      ")
    assert 0 < more.index("faults        none") < more.index("p50 µs")
    assert re.search(r"^hold +[\d.]+ +[\d.]+ +[\d.]+ +[\d.]+%$", more, re.M)


def test_a_status_that_is_too_long_loses_its_last_values_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    taken: list[str] = []
    console = Console()
    monkeypatch.setattr(console, "_outlet", taken.append)
    monkeypatch.setattr(console_module.os, "get_terminal_size", lambda _: os.terminal_size((30, 9)))
    console.status({"1.0 s": "run", "50.0 Hz": "", "late": "12345.6 ms", "overruns": 1234567})
    assert taken == [f"{CLEAR}1.0 s run  50.0 Hz"]
    console.status({"0123456789": "x" * 40})  # one value stays
    assert len(taken) == 2
    monkeypatch.setattr(console_module.os, "get_terminal_size", lambda _: os.terminal_size((0, 0)))
    console.status({"late": "1.0 ms"})
    assert taken[-1] == f"{CLEAR}late 1.0 ms"


class Terminal:
    """A standard output that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def test_lines_keep_their_column_and_tables_their_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [["joint", "said"], ["FL_hip_joint", "one " * 40], ["FR", "-1.25 … 3.75"]]
    piped_lines = aligned(rows)
    assert max(map(len, piped_lines)) > 100
    assert fitted("a  " + "word " * 40) == "a  " + "word " * 40
    monkeypatch.setattr(sys, "stdout", Terminal())
    monkeypatch.setenv("COLUMNS", "80")
    assert max(map(len, aligned(rows))) <= 80
    assert any("-1.25 … 3.75" in line for line in aligned(rows))
    assert " ".join(aligned(rows)).count("one") == 40
    assert aligned(rows, width=1 << 20) == piped_lines
    first, *others = fitted("│  └─ ● policy    reads " + "joint_pos, " * 12).split("\n")
    assert first.startswith("│  └─ ● policy    reads")
    assert {len(line) - len(line.lstrip()) for line in others} == {18}
    monkeypatch.setenv("COLUMNS", "200")
    assert fitted("a  " + "word " * 30) == "a  " + "word " * 30
    for odd in ("", "\n", "   ", "x" * 300, "\x00 \x1b[31m", "Ä" * 90):
        assert fitted(odd).replace("\n", "").strip() == odd.replace("\n", "").strip()
