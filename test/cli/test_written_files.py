"""Files that a command is to write: refused before the work, and written whole; what is not."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from unicon_core.page import refuse_unwritable, write_file
from unicon_ros.cli.main import main

RUN = ["run", "go2_stand", "--set", "platform=fake", "--speed", "max", "--duration", "0.1"]


@pytest.mark.parametrize("option", ["--report", "--picture", "--trace"])
def test_a_run_that_could_not_write_its_files_does_not_begin(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    for path, why in (
        (tmp_path / "file" / "x.json", "file cannot be written to"),
        (tmp_path, "it is a folder"),
    ):
        assert main([*RUN, option, str(path)]) == 1
        said = capsys.readouterr()
        assert said.out == ""
        assert f"cannot write {path}: " in said.err
        assert why in said.err


def test_a_folder_that_may_not_be_written_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuse_unwritable(tmp_path / "new" / "folder" / "x.json")
    monkeypatch.setattr(os, "access", lambda path, _: Path(path) != tmp_path)
    with pytest.raises(Exception, match=r"cannot be written to; give a path in a writable folder"):
        refuse_unwritable(tmp_path / "new" / "x.json")


def test_a_check_that_cannot_write_says_so_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert main(["check", "go2_stand", "--json", str(tmp_path / "file" / "x.json")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "cannot write" in line
    assert "foreseen" not in line


def test_a_quiet_check_has_no_tables_and_its_file_has(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "x.json"
    assert main(["check", "-q", "go2_stand", "--json", str(out)]) == 0
    assert "Joints" not in capsys.readouterr().out
    assert '"title": "Joints"' in out.read_text("utf-8")


def test_what_is_no_file_stays_what_it_is(tmp_path: Path) -> None:
    pipe, heard = tmp_path / "pipe", list[bytes]()
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: heard.append(pipe.read_bytes()))
    reader.start()
    write_file(pipe, b"all of it")
    reader.join(10.0)
    assert heard == [b"all of it"]
    assert pipe.is_fifo()


def test_onnxruntime_keeps_what_it_knows_of_the_machine_to_itself(tmp_path: Path) -> None:
    """1.32 queues it below the home folder, to be sent; not where `CI` is set."""
    pytest.importorskip("onnxruntime", reason="onnxruntime is not installed: unicon_ros[sim]")
    hidden = ("CI", "GITHUB_ACTIONS", "ORT_DISABLE_TELEMETRY")
    home = {key: value for key, value in os.environ.items() if key not in hidden}
    command = [sys.executable, "-m", "unicon_ros", "run", "go2_walk", "--duration", "0.1"]
    subprocess.run(
        [*command, "--speed", "max"], env=home | {"HOME": str(tmp_path)}, check=True, timeout=120
    )
    assert [path for path in tmp_path.rglob("*") if "onnx" in path.name.lower()] == []
