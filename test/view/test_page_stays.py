"""A page that is open when its run ends: it stays until it is closed, and says how that was."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("viser", reason="no live page: pip install 'unicon_ros[view]'")

from test_push_page import STANDS, Tab, until


class Page(Tab):
    """A page that keeps what the run said beside its e-stop."""

    def __init__(self, port: int) -> None:
        self.briefs: list[str] = []
        self.answers: list[str] = []
        super().__init__(port)

    def _take(self, said: dict[str, Any]) -> None:
        if said["type"] == "RunJavascriptMessage" and "brief(" in said["source"]:
            self.briefs.append(said["source"])
        if said["type"].startswith("Notification"):
            self.answers.append(str(said))
        super()._take(said)


@pytest.fixture
def run(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """A run of 3 s on the command line with a page, and its port."""
    path = tmp_path / "stands.yaml"
    path.write_text(STANDS.format(platform="mujoco"))
    command = [sys.executable, "-m", "unicon_ros", "run", str(path), "--duration", "3"]
    process = subprocess.Popen(
        [*command, "--view", "--view-port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"},
    )
    try:
        yield process, served(process)
    finally:
        process.kill()
        process.communicate()


def served(process: subprocess.Popen[str]) -> int:
    """Return the port of the page, once it is served."""
    assert process.stderr is not None
    found = (re.search(r"view: http://127\.0\.0\.1:(\d+)$", line) for line in process.stderr)
    return int(next(each for each in found if each)[1])


def printed(process: subprocess.Popen[str]) -> str:
    """Return what a run prints, up to the line about its page."""
    lines = []
    assert process.stdout is not None
    for line in process.stdout:
        lines.append(line)
        if line.startswith("page "):
            break
    return "".join(lines)


def test_a_page_stays_until_it_is_closed(run: tuple[subprocess.Popen[str], int]) -> None:
    process, port = run
    page = Page(port)
    try:
        text = printed(process)
        assert "ended         duration" in text
        assert f"127.0.0.1:{port} stays until it is closed; Ctrl-C ends it" in text
        until(lambda: any("ended: duration" in brief for brief in page.briefs))
        time.sleep(3.0)
        assert process.poll() is None
        page.set(" ", "stop")
        until(lambda: any("the run has ended" in answer for answer in page.answers))
        assert process.poll() is None
    finally:
        page.close()
    assert process.wait(15.0) == 0


def test_a_simulation_runs_again_at_the_same_address(
    run: tuple[subprocess.Popen[str], int],
) -> None:
    process, port = run
    page = Page(port)
    try:
        printed(process)
        page.set("Run again", True)
    finally:
        page.close()
    assert served(process) == port
    again = Page(port)
    try:
        assert process.poll() is None
        until(lambda: any("run" in brief for brief in again.briefs))
        assert "ended         duration" in printed(process)
    finally:
        again.close()
    assert process.wait(15.0) == 0


def test_a_signal_ends_a_page_that_stays(run: tuple[subprocess.Popen[str], int]) -> None:
    process, port = run
    page = Page(port)
    try:
        printed(process)
        time.sleep(1.0)  # until the report is written, a signal does what it does by default
        process.send_signal(signal.SIGINT)
        assert process.wait(10.0) == 0
    finally:
        page.close()


def test_nothing_waits_where_nobody_looks(run: tuple[subprocess.Popen[str], int]) -> None:
    process, _ = run
    text, _ = process.communicate(timeout=60.0)
    assert process.returncode == 0
    assert "page " not in text
