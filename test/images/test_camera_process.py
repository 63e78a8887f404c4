"""The process of a simulated camera: it comes back, several live side by side, topics are heard."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from unicon_base.errors import UniconError
from unicon_core.flow import Block, Stage
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.states.backends.shm import segments
from unicon_core.workflow import HookBlocks, Program, load_workflow
from unicon_ros.bench.report import free_domain
from unicon_ros.bridge.camera import Camera

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120), pytest.mark.usefixtures("gl")]

Viewer = Callable[..., "subprocess.Popen[str]"]
HEAD = """\
schema: unicon.workflow/1
robot: go2
platform: {platform}
rate: 100
flow: {{hold: {{}}}}
safety: [finite]
deferred:
"""
CAMERA = """\
  - camera: {{body: base_link, position: [0.4, 0, 0.1], width: 32, height: 24, rate: 20, {more}}}
"""


@pytest.fixture(autouse=True)
def domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))


class Rig:
    """A run with cameras; `act` is called in each tick with the program and its cameras."""

    def __init__(self, folder: Path, *cameras: str, platform: str = "fake") -> None:
        self.path = folder / "cameras.yaml"
        lines = [CAMERA.format(more=more) for more in cameras]
        self.path.write_text(HEAD.format(platform=platform) + "".join(lines))
        self.told: list[str] = []

    def run(self, seconds: float, act: Callable[[Program, list[Camera]], object]) -> Report:
        def hook(program: Program) -> HookBlocks:
            cameras = [block.tick for block in program.blocks if isinstance(block.tick, Camera)]
            return {Stage.OBSERVE: [Block("act", lambda: act(program, cameras))]}

        program = load_workflow(self.path, hooks=[hook])
        options = RunOptions(duration=seconds, warn=self.told.append)
        return Runner(program, options).run()


def clean() -> bool:
    """Tell whether nothing of ours is left in shared memory."""
    names = [each.name for each in segments()]
    return not [n for n in names if n.startswith(("camera-", "front-"))]


@pytest.mark.slow
def test_a_stopped_process_is_neutral_and_comes_back(tmp_path: Path) -> None:
    rig = Rig(tmp_path, "topic: '', stale: 0.5")
    seen: list[tuple[int, int, int]] = []

    def act(program: Program, cameras: list[Camera]) -> None:
        states, tick = program.states, int(program.states["tick"])
        if tick in (100, 220):
            number = signal.SIGSTOP if tick == 100 else signal.SIGCONT
            os.kill(cameras[0].peripheral.process.pid, number)
        names = ("camera_alive", "camera_handle", "camera_stamp_ns")
        seen.append(tuple(int(states[name]) for name in names))  # type: ignore[arg-type]

    report = rig.run(3.5, act)
    assert report.faults == []
    assert report.ticks == 350
    alive = [each[0] for each in seen]
    assert alive[95] == alive[-1] == 1
    assert seen[200] == (0, 0, 0)
    assert all(handle for ok, handle, _ in seen if ok)
    assert seen[-1][1] > seen[95][1]  # it goes on where it was
    assert 0 <= time.monotonic_ns() - seen[-1][2] < 2e9
    assert clean()


@pytest.mark.slow
def test_a_killed_process_is_started_again(tmp_path: Path) -> None:
    rig = Rig(tmp_path, "topic: ''")
    alive: list[int] = []
    frames: list[np.ndarray] = []

    def act(program: Program, cameras: list[Camera]) -> None:
        if int(program.states["tick"]) == 100:
            cameras[0].peripheral.process.kill()
        alive.append(int(program.states["camera_alive"]))
        frame = cameras[0].frame(int(program.states["camera_handle"]))
        if frame is not None:
            frames.append(frame.copy())

    report = rig.run(8.0, act)
    assert report.faults == []
    assert report.ticks == 800
    assert (alive[95], alive[150], alive[-1]) == (1, 0, 1)
    assert "camera: its process" in rig.told[0]
    assert "was killed by SIGKILL; its values are neutral" in rig.told[0]
    np.testing.assert_allclose(frames[-1], frames[0], atol=3)  # of a robot that stands
    assert clean()


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["mujoco", "pybullet"])
def test_two_cameras_live_beside_a_simulator_and_in_a_second_run(
    tmp_path: Path, platform: str
) -> None:
    if platform == "pybullet":
        pytest.importorskip("pybullet", reason="pip install 'unicon_ros[sim-pybullet]'")
    rig = Rig(
        tmp_path, "topic: ''", "topic: '', kind: depth, handle: front_handle", platform=platform
    )
    for _ in range(2):
        a_run(rig)


def a_run(rig: Rig) -> None:
    """Run with a camera of colours and one of depths, and look at what is left."""
    last: dict[str, Any] = {}
    rings: set[Path] = set()

    def act(program: Program, cameras: list[Camera]) -> None:
        for camera, name in zip(cameras, ("camera", "front")):
            frame = camera.frame(int(program.states[f"{name}_handle"]))
            rings.add(camera.ring.path)
            if frame is not None:
                last[name] = frame.copy()
                assert program.states[f"{name}_alive"] == 1

    report = rig.run(3.0, act)
    assert report.faults == []
    assert last["camera"].shape == (24, 32, 3)
    assert last["front"].shape == (24, 32)
    assert np.nanmin(last["front"]) > 0.3  # of the floor, from above
    assert np.ptp(last["camera"]) > 10
    assert clean()
    assert len(rings) == 2
    assert not [ring for ring in rings if ring.exists()]


@pytest.mark.slow
def test_a_default_subscriber_of_a_best_effort_camera_is_told(
    tmp_path: Path, viewer: Viewer
) -> None:
    viewer("front/image_raw", "Image")
    rig = Rig(tmp_path, "topic: front/image_raw, reliability: best_effort")
    rig.run(2.0, lambda *_: None)
    (told,) = [line for line in rig.told if "image_raw" in line]
    assert told == (
        "topic /front/image_raw: a subscription has an incompatible reliability (ours: "
        "best_effort, theirs: reliable), so nothing passes between us; set reliability "
        "of the camera, or the peer's"
    )


@pytest.mark.slow
def test_a_best_effort_subscriber_hears_a_default_camera_and_a_stalled_one_stops_nobody(
    tmp_path: Path, viewer: Viewer
) -> None:
    heard, stalled = (viewer("front/image_raw", "Image", *qos) for qos in (["best_effort"], []))
    rig = Rig(tmp_path, "topic: front/image_raw")
    handles: list[int] = []

    def act(program: Program, _: list[Camera]) -> None:
        if int(program.states["tick"]) == 150:
            os.kill(stalled.pid, signal.SIGSTOP)
        handles.append(int(program.states["camera_handle"]))

    report = rig.run(6.0, act)
    assert report.faults == []
    heard.kill()
    assert heard.stdout is not None
    stamps = [json.loads(line)["stamp"] for line in heard.stdout if line.endswith("}\n")]
    assert len(stamps) > 0.8 * handles[-1]
    before, after = handles[149], handles[-1] - handles[149]
    assert after > 1.5 * before  # three times as long
    assert [line for line in rig.told if "topic" in line] == []


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("handle: front", r"camera: handle 'front'; give NAME_handle, such as front_handle"),
        ("stale: 0.0", r"block 'camera': stale is 0\.0; write a number above 0 to 10 \[s\]"),
        pytest.param("topic: 'a b'", r"topic 'a b': ", marks=pytest.mark.slow),
    ],
)
def test_what_is_wrong_is_told_in_one_line(tmp_path: Path, more: str, message: str) -> None:
    with pytest.raises(UniconError, match=message) as caught:
        load_workflow(Rig(tmp_path, more).path).close()
    assert "\n" not in str(caught.value)
