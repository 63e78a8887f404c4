"""/tf and /tf_static for real: a plain listener chains them to where the simulator has the feet.

Where tf2_msgs is missing (the wheels) the listener's type support is generated from our own text,
see `tools/lib/make_type_support.py`; that needs cmake and a C++ compiler. Who publishes goes
without, as a user of the wheels does.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from peer import Peer

from unicon_core.models.loaded import rotate

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(900)]

HERE = Path(__file__).resolve().parent


@pytest.fixture
def listeners(
    tf2_environment: dict[str, str], peers: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> Callable[[], Any]:
    """Starts listeners to /tf and /tf_static, which import tf2_msgs."""

    def start() -> Any:
        with monkeypatch.context() as patch:
            for name, value in tf2_environment.items():
                patch.setenv(name, value)
            return peers("tf_listener")

    return start


def test_a_listener_finds_the_feet_where_the_simulator_has_them(
    listeners: Callable[[], Any],
    sway: Path,
) -> None:
    robot = Peer(sys.executable, str(HERE / "feet_of_the_simulator.py"), str(sway), "8")
    try:
        robot.wait_for(lambda: len(robot.of("feet")) > 50, "the simulator")
        listener = listeners()  # late: /tf_static is latched
        assert robot.end(60)[0] == 0
        static = {line["child"]: line for line in listener.of("static")}
        assert {"FR_foot", "imu_link"} <= set(static)
        by_stamp: dict[int, dict[str, Any]] = {}
        for line in listener.of("tf"):
            by_stamp.setdefault(line["stamp"], {})[line["child"]] = line
        truth = {line["stamp"]: line["at"] for line in robot.of("feet")}
        compared = 0
        for stamp, moving in by_stamp.items():
            if "base_link" not in moving or "FR_calf" not in moving:
                continue  # odometry comes at another rate than the links
            for foot in ("FR_foot", "RL_foot"):
                found = place(foot, moving | static)
                np.testing.assert_allclose(found, truth[stamp][foot], atol=2e-6)
                compared += 1
        assert compared > 100
    finally:
        robot.kill()


def place(frame: str, transforms: dict[str, Any]) -> np.ndarray:
    """Return a frame's origin in odom, by chaining its parents."""
    position = np.zeros(3)
    while frame != "odom":
        line = transforms[frame]
        position = np.array(line["at"]) + rotate(np.array(line["wxyz"]), position)
        frame = line["parent"]
    return position


CAMERA = """\
deferred:
  - call:
      function: unicon_ros.bridge.camera:camera
      body: base_link
      position: [0.3, 0.0, 0.05]
      width: 32
      height: 24
      topic: front/image_raw
      frame_prefix: robot1/
"""


def test_a_listener_finds_the_optical_frame_of_a_camera(
    listeners: Callable[[], Any],
    processes: Callable[..., Any],
    sway: Path,
) -> None:
    sway.write_text(sway.read_text() + CAMERA)
    run = processes(sys.executable, "-m", "unicon_ros", "run", str(sway), "--duration", "6")
    listener = listeners()
    status, errors = run.end(60)
    if "no offscreen OpenGL" in errors:
        pytest.skip(errors)
    assert status == 0, errors
    (line,) = listener.of("static")
    assert line["parent"] == "robot1/base_link"
    assert line["child"] == "robot1/base_link_camera_optical_frame"
    assert line["at"] == pytest.approx([0.3, 0.0, 0.05])
    # Its z axis is the body's x, its y is down.
    turn = np.array(line["wxyz"])
    np.testing.assert_allclose(rotate(turn, np.array((0.0, 0.0, 1.0))), (1, 0, 0), atol=1e-9)
    np.testing.assert_allclose(rotate(turn, np.array((0.0, 1.0, 0.0))), (0, 0, -1), atol=1e-9)


def test_two_robots_in_two_namespaces_share_tf_without_a_frame_in_common(
    listeners: Callable[[], Any],
    nodes: Callable[..., Any],
    processes: Callable[..., Any],
    sway: Path,
) -> None:
    parameters = ("-p", f"workflow:={sway}", "-p", "frame_prefix:=robot1/")
    nodes("--ros-args", "-r", "__ns:=/robot1", *parameters)
    command = ("-m", "unicon_ros", "run", str(sway), "--ros", "--duration", "60")
    own = ("--namespace", "robot2", "--frame-prefix", "robot2/")
    processes(sys.executable, *command, *own)
    listener = listeners()
    robots = ("robot1/", "robot2/")

    def parents(prefix: str) -> dict[str, str]:
        """Return the parent of each frame that a robot tells, both without the prefix."""
        told = [line for line in list(listener.lines) if line["child"].startswith(prefix)]
        assert all(line["parent"].startswith(prefix) for line in told)
        return {line["child"][len(prefix) :]: line["parent"][len(prefix) :] for line in told}

    wanted = {"base_link", "FR_calf", "FR_foot", "imu_link"}
    listener.wait_for(
        lambda: all(wanted <= parents(prefix).keys() for prefix in robots), "all frames", 60.0
    )
    assert all(line["child"].startswith(robots) for line in listener.lines)
    assert parents("robot1/") == parents("robot2/")
    assert parents("robot1/")["base_link"] == "odom"
