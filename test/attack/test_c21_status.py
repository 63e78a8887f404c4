"""A faulted run is never status 0, whatever becomes of its output."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from runs import Run

from unicon_lab.recording import open_record

FULL = Path("/dev/full")


def closed_pipe() -> int:
    reader, writer = os.pipe()
    os.close(reader)
    return writer


@pytest.mark.parametrize("quiet", [True, False])
def test_a_fault_is_told_by_the_status_when_the_reader_has_gone(
    tmp_path: Path, quiet: bool
) -> None:
    writer = closed_pipe()
    run = Run(tmp_path, "fault: fault", arguments=["--quiet"] if quiet else [])
    run.start(stdout=writer, stderr=writer)
    os.close(writer)
    status, _, _ = run.wait()
    assert status == 3
    assert run.report["faults"] == ["the robot says so"]


@pytest.mark.skipif(not FULL.exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize(("fault", "wanted"), [("fault", 3), ("none", 1)])
def test_a_full_device_behind_the_output_is_one_line(
    tmp_path: Path, fault: str, wanted: int
) -> None:
    with FULL.open("w") as full:
        run = Run(tmp_path, f"fault: {fault}", more="duration: 0.2").start(stdout=full)
        status, _, err = run.wait()
    assert status == wanted
    assert run.report["ticks"] == (5 if fault == "fault" else 10)
    assert "Traceback" not in err
    if fault == "none":
        assert err == "unicon: error: cannot write to standard output: No space left on device\n"


@pytest.mark.skipif(not FULL.exists(), reason="this system has no /dev/full")
def test_even_errors_that_nobody_can_read_keep_their_status(tmp_path: Path) -> None:
    with FULL.open("w") as full:
        run = Run(tmp_path, "fault: value").start(stdout=full, stderr=full)
        status, _, _ = run.wait()
    assert status == 3


def test_a_good_run_into_a_pipe_that_has_gone_is_good(tmp_path: Path) -> None:
    writer = closed_pipe()
    run = Run(tmp_path, more="duration: 0.2").start(stdout=writer, stderr=subprocess.PIPE)
    os.close(writer)
    status, _, err = run.wait()
    assert (status, err) == (0, "")


@pytest.mark.skipif(not FULL.exists(), reason="this system has no /dev/full")
def test_a_report_that_cannot_be_written_does_not_hide_the_fault(tmp_path: Path) -> None:
    (tmp_path / "report.json").symlink_to(FULL)
    run = Run(tmp_path, "fault: fault").start()
    status, out, err = run.wait()
    assert status == 3
    assert "the robot says so" in out
    assert "give a path in a writable folder" in err


@pytest.mark.parametrize(
    "closed",
    [
        "<&- >&- 2>&-",
        *(pytest.param(some, marks=pytest.mark.slow) for some in ("2>&-", ">&- 2>&-")),
    ],
)
def test_a_run_without_standard_files_ends_as_it_should(closed: str, tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    (tmp_path / "w.yaml").write_text("robot: go2\nplatform: fake\nrate: 50\nflow: hold\n")
    run = "-m unicon_ros run w.yaml --no-ros --speed max --duration 0.2 --record run.mcap"
    shell = f"exec {sys.executable} {run} {closed}"
    done = subprocess.run(["sh", "-c", shell], cwd=tmp_path, timeout=60, check=False)
    assert done.returncode == 0
    assert len(open_record(tmp_path / "run.mcap").ticks) == 10


def test_a_command_without_standard_output_ends_as_it_should() -> None:
    command = f"exec {sys.executable} -m unicon_ros states >&-"
    done = subprocess.run(["sh", "-c", command], stderr=subprocess.PIPE, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
