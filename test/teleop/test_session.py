"""Sessions of teleoperation, recorded: they replay to bit-exact commands."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from teleop_runs import ROOT, end, free_ports, put_on, start, workflow

from unicon_lab.recording import Record, open_record

pytest.importorskip("mujoco", reason="the arm moves in MuJoCo")
pytest.importorskip("daqp", reason="pip install 'unicon_ros[ik]'")
pytest.importorskip("websockets", reason="pip install 'unicon_ros[webxr]'")

HERE = str(Path(__file__).resolve().parent)


def replays(recording: Path) -> Record:
    """Hold that a recording replays bit-exactly; return it."""
    record = open_record(recording)
    command = [sys.executable, "-m", "unicon_ros", "replay", str(recording), "--verify"]
    paths = {**os.environ, "PYTHONPATH": HERE}
    done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, env=paths)
    assert done.returncode == 0, done.stderr
    assert f"0 of {len(record.ticks)} ticks differ" in done.stdout
    return record


@pytest.mark.slow
def test_a_session_of_the_arm_replays_to_the_same_commands(tmp_path: Path) -> None:
    text = (ROOT / "config" / "workflows" / "arx_vr.yaml").read_text("utf-8")
    path, recording = tmp_path / "arx.yaml", tmp_path / "session.mcap"
    path.write_text(
        text.replace("webxr: {}", 'call: {function: "scripted_headset:scripted", begin: 4.0}')
    )
    command = [sys.executable, "-m", "unicon_ros", "run", str(path), "--no-ros", "--quiet"]
    command += ["--speed", "max", "--duration", "9", "--record", str(recording)]
    subprocess.run(command, check=True, timeout=60.0, env={**os.environ, "PYTHONPATH": HERE})
    record = replays(recording)
    target, hand = record.states("hand_target"), record.states("hand_pose")
    first = int(np.flatnonzero(np.isfinite(target[:, 0]))[0])
    assert first == pytest.approx(400, abs=2)
    np.testing.assert_allclose(target[first, :3], hand[first, :3], atol=1e-6)  # no jump
    assert np.ptp(target[first:, 2]) > 0.1  # it went in circles
    far = np.linalg.norm(hand[first + 100 :, :3] - target[first + 100 :, :3], axis=1)[
        : 900 - first - 100
    ]
    assert np.median(far) < 0.008
    arm = record.states("joint_pos_target")
    assert np.abs(np.diff(arm, axis=0)).max() <= 0.02 * 1.01  # 2 rad/s


@pytest.mark.slow
def test_a_session_by_the_headsets_own_bytes_replays_too(tmp_path: Path) -> None:
    port, recording = free_ports(1), tmp_path / "session.mcap"
    run = start(workflow(tmp_path, port, name="arx_vr"), 14.0, "--record", str(recording))
    headset = put_on(port, 10.0, "--ahead", "0")
    try:
        text = run.communicate(timeout=60.0)[0]
        assert run.returncode == 0, text
    finally:
        end(headset)
        end(run)
    record = replays(recording)
    target, engaged = record.states("hand_target"), record.states("teleop_engaged")
    live = np.isfinite(target).all(axis=1)
    assert live.sum() > 200
    assert (engaged[live, 1] == 1).all()
    assert np.isnan(target[-1]).all()  # the headset has left
    assert np.ptp(target[live, 2]) > 0.05
