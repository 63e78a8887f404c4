"""A simulated camera: a plain subscriber sees what the model shows, and the ticks go on."""

from __future__ import annotations

import json
import re
import subprocess
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from unicon_base.errors import UniconError
from unicon_core.flow import Block, Stage
from unicon_core.models.find import pick_model
from unicon_core.models.kinematic_tree import read_tree, urdf
from unicon_core.models.load import load_model
from unicon_core.robots import load_robot
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.workflow import HookBlocks, Program, load_workflow
from unicon_ros.bench.report import free_domain

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]

ROOT = Path(__file__).resolve().parent.parent.parent
WIDTH, HEIGHT, FOVY = 64, 48, 60.0
ABOVE = 1.0  # m, the camera above the base
WORKFLOW = """\
schema: unicon.workflow/1
robot: go2
platform: fake
rate: 100
flow: {{hold: {{}}}}
safety: [finite]
deferred:
  - call:
      function: unicon_ros.bridge.camera:camera
      {where}
      width: {width}
      height: {height}
      kind: {kind}
      topic: {topic}
      rate: 20
"""


@pytest.fixture(autouse=True)
def domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    def written(
        kind: str = "color",
        where: str = "{body: base_link, position: [0.4, 0.0, 0.1]}",
        topic: str = "camera/image_raw",
    ) -> Path:
        path = tmp_path / "camera.yaml"
        options = where.strip("{}").replace(", position", "\n      position")
        path.write_text(
            WORKFLOW.format(kind=kind, where=options, topic=topic, width=WIDTH, height=HEIGHT)
        )
        return path

    return written


def run(path: Path, seconds: float, hooks: Any = ()) -> tuple[Report, Program]:
    workflow = load_workflow(path, hooks=list(hooks))
    return Runner(workflow, RunOptions(duration=seconds)).run(), workflow


class Heard:
    """What a peer tells while a run goes on, which it ends once all have told enough."""

    def __init__(self, peer: subprocess.Popen[str]) -> None:
        self.lines: list[dict[str, Any]] = []
        self._peer = peer
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self) -> None:
        assert self._peer.stdout is not None
        for line in self._peer.stdout:
            with suppress(json.JSONDecodeError):  # cut off by the kill
                self.lines.append(json.loads(line))

    def end(self) -> list[dict[str, Any]]:
        self._peer.kill()
        self._thread.join(10.0)
        return self.lines


def until_heard(path: Path, count: int, *peers: Heard, hooks: Any = ()) -> Report:
    """Run until each peer has heard so many pictures."""
    runner: list[Runner] = []

    def ends(workflow: Program) -> HookBlocks:
        def look() -> None:
            if all(len(peer.lines) >= count for peer in peers):
                runner[0].stop()

        return {Stage.OBSERVE: [Block("ends", look)]}

    workflow = load_workflow(path, hooks=[*hooks, ends])
    runner.append(Runner(workflow, RunOptions(duration=20.0)))
    return runner[0].run()


@pytest.mark.alone
@pytest.mark.usefixtures("gl")
def test_a_plain_subscriber_sees_the_sky_above_and_the_floor_below(
    write: Callable[..., Path], viewer: Callable[[str, str], subprocess.Popen[str]]
) -> None:
    peer = Heard(viewer("camera/image_raw", "Image"))
    handles: list[int] = []
    shapes: list[Any] = []

    def look(workflow: Program) -> HookBlocks:
        (camera,) = [b.tick for b in workflow.blocks if "camera" in b.name or b.name == "call"]

        def note() -> None:
            handle = int(workflow.states["camera_handle"])
            handles.append(handle)
            frame = camera.frame(handle)
            shapes.append(None if frame is None else frame.shape)

        return {Stage.OBSERVE: [Block("look", note)]}

    report = until_heard(write(), 15, peer, hooks=[look])
    heard = peer.end()
    assert report.faults == []
    assert len(heard) > 5
    assert heard[-1]["size"] == [WIDTH, HEIGHT]
    assert heard[-1]["frame"] == "base_link_camera_optical_frame"
    assert len({line["stamp"] for line in heard}) == len(heard)
    upper, lower = np.array(heard[-1]["upper"]), np.array(heard[-1]["lower"])
    assert np.abs(upper - lower).max() > 10.0  # two different things are seen
    # The states carry a number, and behind it the frame lies in place.
    assert handles[0] == 0
    assert handles == sorted(handles)
    assert len(set(handles)) > 5
    assert shapes[-1] == (HEIGHT, WIDTH, 3)
    # Rendering takes longer than a tick; the ticks do not wait for it.
    assert report.overruns < 0.25 * report.ticks


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("kind", ["cloud", pytest.param("depth", marks=pytest.mark.slow)])
def test_depths_are_where_the_floor_is(
    kind: str, write: Callable[..., Path], viewer: Callable[[str, str], subprocess.Popen[str]]
) -> None:
    name = "Image" if kind == "depth" else "PointCloud2"
    peer = Heard(viewer("camera/depth", name))
    heights: list[float] = []

    def note(workflow: Program) -> HookBlocks:
        return {
            Stage.OBSERVE: [
                Block("note", lambda: heights.append(float(workflow.states["base_pos_w"][2])))
            ]
        }

    report = until_heard(write(kind=kind, topic="camera/depth"), 5, peer, hooks=[note])
    heard = peer.end()
    assert report.faults == []
    assert heard
    last = heard[-1]
    # The lowest row of pixels looks down by nearly half the field of view onto the floor.
    down = np.tan(np.radians(FOVY) / 2) * (HEIGHT - 1) / HEIGHT
    expected = (heights[-1] + 0.1) / down
    middle = last["values"][WIDTH // 2]
    z = middle[2] if kind == "cloud" else middle[0]
    assert z == pytest.approx(expected, rel=0.03)
    if kind == "cloud":
        assert middle[1] == pytest.approx(heights[-1] + 0.1, rel=0.03)  # y is down
        assert abs(middle[0]) < 0.05 * z
    assert 0.2 < last["finite"] < 0.9  # what is beyond 20 m is not a measurement


@pytest.mark.usefixtures("gl")
def test_the_camera_info_stands_beside_the_pictures_with_their_stamps(
    write: Callable[..., Path], viewer: Callable[[str, str], subprocess.Popen[str]]
) -> None:
    pictures = Heard(viewer("front/image_raw", "Image"))
    infos = Heard(viewer("front/camera_info", "CameraInfo"))
    report = until_heard(write(topic="front/image_raw"), 25, pictures, infos)
    assert report.faults == []
    seen = {line["stamp"]: line for line in pictures.end()}
    heard = {line["stamp"]: line for line in infos.end()}
    both = seen.keys() & heard.keys()
    assert len(both) > 5
    assert len(both) > 0.8 * max(len(seen), len(heard))
    for stamp in both:
        assert heard[stamp]["frame"] == seen[stamp]["frame"] == "base_link_camera_optical_frame"
        assert heard[stamp]["size"] == seen[stamp]["size"] == [WIDTH, HEIGHT]
        assert heard[stamp]["model"] == "plumb_bob"
        focal = 0.5 * HEIGHT / np.tan(np.radians(0.5 * FOVY))
        right, down = 0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1)
        k = [focal, 0.0, right, 0.0, focal, down, 0.0, 0.0, 1.0]
        assert heard[stamp]["k"] == pytest.approx(k)


@pytest.mark.usefixtures("gl")
def test_a_camera_process_that_is_killed_leaves_the_ticks_alone(write: Callable[..., Path]) -> None:
    killed: list[int] = []

    def kill(workflow: Program) -> HookBlocks:
        (camera,) = [b.tick for b in workflow.blocks if hasattr(b.tick, "frame")]

        def act() -> None:
            if int(workflow.states["tick"]) == 50:
                camera.peripheral.process.kill()
                killed.append(1)

        return {Stage.OBSERVE: [Block("kill", act)]}

    report, _ = run(write(), 1.0, [kill])
    assert killed
    assert report.faults == []
    assert report.ticks == 100


@pytest.mark.usefixtures("gl")  # a model is read where it is drawn
@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("{body: nose}", r"camera: no body 'nose' in .*go2\.xml; "),
        ("{camera: front}", r"camera: no camera 'front' in .*; or mount one: body: NAME"),
    ],
)
def test_what_is_not_in_the_model_is_one_line(
    write: Callable[..., Path], where: str, message: str
) -> None:
    refused(write(where=where), message)


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("{far: 3}", r"camera: give either camera: NAME of the model, or body: NAME to mount"),
        (
            "{body: base_link, reliability: sure}",
            r"camera\.yaml:8: block 'call': reliability 'sure' is not known; .* reliable",
        ),
        ("{body: base_link, fovy: 0}", r"block 'call': fovy is 0; write a number above 0 \[°\]"),
    ],
)
def test_what_is_wrong_is_one_line(write: Callable[..., Path], where: str, message: str) -> None:
    refused(write(where=where.replace(", ", "\n      ")), message)


def refused(path: Path, message: str) -> None:
    with pytest.raises(UniconError, match=message) as caught:
        load_workflow(path).close()
    assert "\n" not in str(caught.value)


def test_without_opengl_the_error_names_what_to_install(
    write: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    with pytest.raises(UniconError, match=r"camera: no offscreen OpenGL \(.*apt install libegl1"):
        load_workflow(write())


@pytest.mark.usefixtures("gl")
def test_the_camera_is_in_the_model_that_the_platform_simulates(
    write: Callable[..., Path], tmp_path: Path
) -> None:
    go2 = (ROOT / "config" / "models" / "go2" / "go2.xml").read_text("utf-8")
    mast = '<body name="mast" pos="0 0 3"/>\n</worldbody>'
    (tmp_path / "mast.xml").write_text(go2.replace("</worldbody>", mast), "utf-8")
    path = write(where="{body: mast}", topic="''")
    refused(path, r"no body 'mast' in .*go2\.xml")
    own = {"platform": "mujoco", "scene.model": "./mast.xml"}
    load_workflow(path, own).close()


@pytest.mark.usefixtures("gl")
def test_a_urdf_without_its_meshes_is_drawn_too(write: Callable[..., Path], tmp_path: Path) -> None:
    robot = load_robot("go2")
    text = urdf(read_tree(load_model(pick_model(robot), robot).model, robot), robot)
    mesh = '<visual><geometry><mesh filename="lost.stl"/></geometry></visual>'
    (tmp_path / "go2.urdf").write_text(
        text.replace('<link name="base_link">', f'<link name="base_link">{mesh}'), "utf-8"
    )
    options = f"{{body: FL_foot\n      model: {tmp_path}/go2.urdf}}"
    report, _ = run(write(where=options, topic="''"), 0.2)
    assert report.faults == []


@pytest.mark.usefixtures("gl")
def test_a_robot_that_stands_in_the_world_needs_no_base(
    write: Callable[..., Path], tmp_path: Path
) -> None:
    go2 = load_robot("go2")
    text = go2.path.read_text("utf-8").replace("kind: quadruped", "kind: arm")
    text = text.replace("name: go2", "name: table").replace("feet: [", "#").replace("feet: ", "f: ")
    (tmp_path / "table.yaml").write_text(text, "utf-8")
    fixed = (ROOT / "config" / "models" / "go2" / "go2.xml").read_text("utf-8")
    fixed = re.sub(r"<freejoint[^>]*/>|<keyframe>.*</keyframe>", "", fixed, flags=re.DOTALL)
    (tmp_path / "table.xml").write_text(fixed, "utf-8")
    own = {"robot": "./table.yaml", "platform": "mujoco", "scene.model": "./table.xml"}
    workflow = load_workflow(write(topic="''"), own)
    assert "base_pos_w" not in workflow.platform.facts.writes
    workflow.close()
