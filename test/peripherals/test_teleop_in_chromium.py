"""A session of teleoperation by a real browser with an emulated headset; it replays bit-exactly."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]
pytest.importorskip("playwright.sync_api", reason="pip install playwright")
pytest.importorskip("mujoco", reason="the arm moves in MuJoCo")
pytest.importorskip("daqp", reason="pip install 'unicon_ros[ik]'")

from test_webxr_in_chromium import HEADSET, SMALL, browser, iwer  # noqa: E402, F401

from unicon_lab.recording import open_record  # noqa: E402


def test_a_hand_in_the_browser_moves_the_arm(
    browser: Any,  # noqa: F811
    iwer: str,  # noqa: F811
    tmp_path: Path,
) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    recording = tmp_path / "session.mcap"
    quick = ["flow.chain.0.pose.duration=0.4", f"commands.0.webxr.port={port}"]
    command = [sys.executable, "-m", "unicon_ros", "run", "arx_vr", "--no-ros", "--quiet"]
    command += [
        "--duration",
        "15",
        "--record",
        str(recording),
        "--set",
        quick[0],
        "--set",
        quick[1],
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as run:
        page = browser.new_page()
        page.set_viewport_size(SMALL)
        page.add_init_script(iwer + HEADSET)
        for _ in range(50):
            try:
                page.goto(f"http://127.0.0.1:{port}/")
                break
            except Exception:
                time.sleep(0.2)
        page.evaluate("headset.primaryInputMode = 'controller'")
        page.get_by_role("button", name="Start").click()
        hand = "headset.controllers.right"
        page.evaluate(f"{hand}.position.set(0.2, 1.2, -0.6)")
        page.locator("#status", has_text="Connected").wait_for()
        page.wait_for_timeout(1500)  # software draws its first frames slowly
        page.evaluate(f"{hand}.updateButtonValue('squeeze', 1)")
        page.wait_for_timeout(500)
        for step in range(20):  # 8 cm up, in 1 s
            page.evaluate(f"{hand}.position.set(0.2, {1.2 + 0.004 * (step + 1)}, -0.6)")
            page.wait_for_timeout(50)
        page.close()
        assert run.wait(60.0) == 0
    record = open_record(recording)
    target = np.asarray(record.states("hand_target"))
    live = np.isfinite(target).all(axis=1)
    assert np.ptp(target[live, 2]) == pytest.approx(0.08, abs=0.005)
    command = [sys.executable, "-m", "unicon_ros", "replay", str(recording), "--verify"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60.0)
    assert done.returncode == 0, done.stderr
    assert f"0 of {len(target)} ticks differ" in done.stdout
