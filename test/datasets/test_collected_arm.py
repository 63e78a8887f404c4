"""`unicon run arx_demos --collect`: the shipped workflow with cameras makes a data set."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
from teleop_runs import end, free_ports, put_on
from test_collect import Terminal, table

from unicon_core.workflow import load_document

pytest.importorskip("mujoco", reason="the arm moves in MuJoCo")
pytest.importorskip("daqp", reason="pip install 'unicon_ros[ik]'")
pytest.importorskip("websockets", reason="pip install 'unicon_ros[webxr]'")

QUICK = ("flow.chain.0.pose.duration=0.4", "wind_down=damp", "commands.0.webxr.port={port}")
SMALL = [f"deferred.{n}.camera.{each}" for n in (0, 1) for each in ("width=80", "height=64")]


def test_it_is_arx_vr_with_cameras() -> None:
    demos, plain = (load_document(name).values for name in ("arx_demos", "arx_vr"))
    assert demos["commands"][0] == {"webxr": {"cameras": ["front"]}}
    handles = [each["camera"]["handle"] for each in demos["deferred"]]
    assert handles == ["front_handle", "wrist_handle"]
    demos["commands"][0] = plain["commands"][0]
    own = {"name", "description", "deferred"}
    assert {k: v for k, v in demos.items() if k not in own} == {
        k: v for k, v in plain.items() if k not in own
    }


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_one_command_collects_pictures_and_actions_of_a_hand(tmp_path: Path) -> None:
    port = free_ports(1)
    sets = [f"--set={each.format(port=port)}" for each in [*QUICK, *SMALL]]
    options = ["--episodes", "2", "--task", "reach", *sets]
    terminal = Terminal(tmp_path, *options, workflow="arx_demos")
    try:
        terminal.until("s start, k keep")
        headset = put_on(port, 60.0, "--ahead", "0")  # takes hold 5 s later
        terminal.until("a headset came")
        time.sleep(6.0)
        for kept in (1, 2):
            terminal.press("s", "started")
            time.sleep(1.5)
            terminal.press("k", f"{kept} of 2 episodes are kept")
        terminal.until("action: ", 120.0)
        assert terminal.run.wait(60.0) == 0
    finally:
        terminal.run.kill()
        terminal.run.wait()
    end(headset)
    features = json.loads((tmp_path / "demos/meta/info.json").read_text())["features"]
    for name in ("front", "wrist"):
        assert features[f"observation.images.{name}"]["shape"] == [64, 80, 3]
        frames = list((tmp_path / f"demos/videos/observation.images.{name}").rglob("*.mp4"))
        assert frames
        assert frames[0].stat().st_size > 1000
    rows = table(tmp_path).to_pydict()
    assert set(rows["episode_index"]) == {0, 1}
    action = np.array(rows["action"])
    assert features["action"]["names"][:2] == ["joint1", "joint2"]
    assert np.isfinite(action).all()
    first = action[np.array(rows["episode_index"]) == 0]
    height = features["action"]["names"].index("hand_target.z")
    assert np.ptp(first[:, height]) > 0.02  # goes in circles
    assert np.ptp(first[:, 1]) > 0.02  # and joint2 is commanded to follow
    assert np.ptp(np.array(rows["operator.webxr_right_controller"])[:, 1]) > 0.02
