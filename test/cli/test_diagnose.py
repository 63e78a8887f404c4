"""`unicon diagnose`: the table, the JSON, and one line for what cannot be diagnosed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("mujoco")

from unicon_base.errors import UniconError
from unicon_lab.diagnose import Cause, Diagnosis
from unicon_lab.diagnose.diagnosis import diagnose
from unicon_lab.diagnose.fit import fit_record
from unicon_lab.recording import open_record
from unicon_ros.cli.main import main

EXCITED = """\
robot: go2
platform: mujoco
rate: 50
scene: {joints: {RL_calf_joint: {strength: 0.5}}}
flow: {excite: {signal: random, frequency: 2, duration: SECONDS, fade: 0.2, amplitude: 0.1}}
"""


def recorded(folder: Path, seconds: float, scene: str = "") -> str:
    workflow, record = folder / "excited.yaml", folder / f"real{seconds}.mcap"
    text = EXCITED.replace("SECONDS", f"{seconds}")
    workflow.write_text(text.replace("scene: {", f"scene: {{{scene}"))
    run = ["run", str(workflow), "--speed", "max", "--record", str(record), "--faults", "off"]
    assert main([*run, "--force", "pose.floor"] if "gantry" in scene else run) == 0
    return str(record)


def test_what_cannot_be_diagnosed_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    garbage = tmp_path / "garbage.mcap"
    garbage.write_bytes(b"\x89MCAP0\r\n" + bytes(range(256)) * 10)
    short = recorded(tmp_path, 0.6)
    for arguments, message in (
        ([str(garbage)], str(garbage)),
        ([str(tmp_path / "nothing.mcap")], "nothing.mcap"),
        ([short], "at least 8 windows"),
        ([short, "no_such_walk"], "no_such_walk"),
        ([short, "--robot", "g1_29dof"], "robot g1_29dof has others"),
        ([short, "--processes", "-1"], "--processes is -1"),
    ):
        capsys.readouterr()
        assert main(["diagnose", *arguments]) == 1
        (line,) = [e for e in capsys.readouterr().err.splitlines() if e.startswith("unicon: err")]
        assert message in line


@pytest.mark.parametrize("complete", [True, False])
def test_causes_stand_in_a_table_and_in_json(
    complete: bool,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    causes = (
        Cause("term_order", "a and b", "contract", 0.97, *[float("nan")] * 3, remedy="swap them"),
        Cause("strength", "", "plant", 0.9, -0.3, -0.4, -0.2, alike=("payload",), next="wiggle"),
        Cause("payload", "", "plant", 0.6, 4.0, 3.5, 4.5, "kg"),
    )
    found = Diagnosis(causes, ("something is not known",), 50, complete)
    monkeypatch.setattr("unicon_lab.diagnose.diagnosis.diagnose", lambda *_, **__: found)
    record, file = recorded(tmp_path, 0.6), tmp_path / "causes.json"
    capsys.readouterr()
    assert main(["diagnose", record, "--json", str(file)]) == (0 if complete else 130)
    said = " ".join(capsys.readouterr().out.split())
    for text in (
        "term order of a and b 97%",
        "-30.0% -40.0% to -20.0%",
        "+4 kg +3.5 kg to +4.5 kg",
        "does not tell it from: payload to tell them apart, record a wiggle",
        "remedy: swap them",
        "note: something is not known",
    ):
        assert text in said
    written = json.loads(file.read_text())
    assert written["causes"][0]["size"] is None
    assert written["causes"][2]["high"] == 4.5


def test_nothing_found_is_an_answer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "unicon_lab.diagnose.diagnosis.diagnose", lambda *_, **__: Diagnosis((), (), 40)
    )
    record = recorded(tmp_path, 0.6)
    capsys.readouterr()
    assert main(["diagnose", record]) == 0
    assert "nothing found: no cause explains more of the record than" in capsys.readouterr().out


@pytest.mark.slow
def test_a_base_without_measured_velocity_hides_no_weak_motor(tmp_path: Path) -> None:
    record = open_record(recorded(tmp_path, 4.0, "noise: {base_quat: 0.001}, "))
    del record.layout.slots["base_lin_vel"]  # type: ignore[attr-defined]
    fit, _ = fit_record(
        record, "real.mcap", words=["strength"], joints=["R*_calf_joint"], processes=1
    )
    (found,) = fit.parameters
    assert (found.joint, found.word) == ("RL_calf_joint", "strength")
    assert found.after == pytest.approx(0.5, abs=0.05)


def test_a_reference_is_of_the_same_robot(tmp_path: Path) -> None:
    record = open_record(recorded(tmp_path, 3.0))
    other = open_record(recorded(tmp_path, 3.2))
    joints = other.layout.specs["joint_pos"]
    turned = replace(joints, names=joints.names[::-1])
    other.layout.specs["joint_pos"] = turned  # type: ignore[index]
    with pytest.raises(UniconError, match="the reference is of"):
        diagnose(record, "real.mcap", reference=other, processes=1)


def test_a_robot_that_hung_needs_no_velocity_of_its_base(tmp_path: Path) -> None:
    """Its IMU swings and drifts as it likes; the weak calf is found by the joints alone."""
    held = "gantry: true, initial_height: 1.0, noise: {base_quat: 0.01}, "
    record = open_record(recorded(tmp_path, 4.0, held))
    del record.layout.slots["base_lin_vel"]  # type: ignore[attr-defined]
    fit, overlay = fit_record(
        record, "real.mcap", hung=True, words=["strength"], joints=["R*_calf_joint"], processes=1
    )
    (found,) = fit.parameters
    assert (found.joint, found.word) == ("RL_calf_joint", "strength")
    assert found.after == pytest.approx(0.5, abs=0.03)
    assert fit.causes == ()
    assert "RL_calf_joint" in overlay


@pytest.mark.alone
@pytest.mark.parametrize(
    ("number", "worker"),
    [
        (signal.SIGINT, None),
        (signal.SIGKILL, None),
        (signal.SIGINT, signal.SIGSTOP),
        (signal.SIGCONT, signal.SIGKILL),
    ],
)
def test_a_signal_ends_it_and_its_processes(
    number: signal.Signals, worker: signal.Signals | None, tmp_path: Path
) -> None:
    """Ctrl-C says what is known so far, a killed process what to do; nothing stays behind."""
    words = [sys.executable, "-m", "unicon_ros", "diagnose", recorded(tmp_path, 30.0)]
    run = subprocess.Popen(
        [*words, "--processes", "2"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        children = Path(f"/proc/{run.pid}/task/{run.pid}/children")
        wait_for(lambda: len(children.read_text().split()) >= 3)  # and the resource tracker
        time.sleep(1.0)
        pids = children.read_text().split()
        if worker is not None:
            works = (
                pid for pid in pids if "spawn_main" in Path(f"/proc/{pid}/cmdline").read_text()
            )
            os.kill(int(next(works)), worker)
        run.send_signal(number)
        said, wrong = run.communicate(timeout=30)  # held open by what stays behind
    finally:
        run.kill()
    if number == signal.SIGINT:
        assert run.returncode == 130
        assert "interrupted" in said
    if worker == signal.SIGKILL:
        assert (run.returncode, said) == (1, "")
        assert "a process that replays the record was killed" in wrong
    wait_for(lambda: not any(running(pid) for pid in pids))


def running(pid: str) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_for(it: Callable[[], bool]) -> None:
    end = time.monotonic() + 30.0
    while not it():
        assert time.monotonic() < end
        time.sleep(0.05)
