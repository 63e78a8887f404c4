"""Platform `gazebo`: a workflow that changes one word, and a peer that behaves as gz does."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from peer import Peer, wait_for

from unicon_base.errors import PlatformError, WorkflowError
from unicon_base.resources import find_config
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.kit.start import start_of
from unicon_core.robots import load_robot
from unicon_core.workflow import load_workflow
from unicon_msgs_map import load_map
from unicon_ros.cli.main import main

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]

GO2 = load_robot("go2")
ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "howto" / "gazebo.md").read_text("utf-8")
BLOCKS = re.findall(r"^```yaml\n# (\w+)\n(.*?)^```", TEXT, re.M | re.S)
EXAMPLE = ROOT / "examples" / "gazebo"
WORKFLOW = """\
schema: unicon.workflow/1
robot: go2
platform: gazebo
platforms: {gazebo: {map: MAP, connect: 15.0}}
start: {operator: false}
rate: RATE
flow:
  chain: [{pose: {to: stand, duration: 1.0}}, hold]
safety: {only: [finite, joint_limits]}
pacing: {hang: 5.0}                      # a busy machine may hold a process up
"""


@pytest.fixture
def gazebo(peers: Callable[..., Peer], tmp_path: Path) -> Callable[..., Peer]:
    """Starts a Go2 in a world of gz, on its belly."""
    mujoco = pytest.importorskip("mujoco", reason="pip install 'unicon_ros[sim]'")

    def start(interface: str, seconds: float, kp: float, kd: float) -> Peer:
        begin = start_of(GO2, Scene(initial_pose="rest"))
        mujoco.mj_saveModel(begin.loaded.model, str(tmp_path / "go2.mjb"), None)
        said = {
            "joints": GO2.joint_names,
            "interface": interface,
            "position": begin.joint_pos.tolist(),
            "base": [*begin.position.tolist(), *begin.quat.tolist()],
            "limit": GO2.effort_limit.tolist(),
            "kp": [kp] * 12,
            "kd": [kd] * 12,
        }
        (tmp_path / "said.json").write_text(json.dumps(said))
        paths = (str(tmp_path / "go2.mjb"), str(tmp_path / "said.json"))
        return peers("gz_ros2_control", *paths, f"{seconds}")

    return start


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "rate", "interface"), [("gazebo", 50, "position"), ("gazebo_effort", 150, "effort")]
)
def test_a_robot_in_gazebo_stands_up(
    runs: Callable[..., Any],
    gazebo: Callable[..., Peer],
    tmp_path: Path,
    name: str,
    rate: int,
    interface: str,
) -> None:
    path = tmp_path / "stand.yaml"
    path.write_text(WORKFLOW.replace("MAP", name).replace("RATE", str(rate)))
    peer = gazebo(interface, 40.0, 120.0, 3.0)
    run = runs(path, duration=30.0)
    states = run.program.states
    wait_for(lambda: _standing(states), "it to stand, as its own states say", 30.0)
    assert 0 < int(states.stamp_ns) < 1e9 * (peer.of("gazebo")[-1]["time"] + 0.5)  # simulated
    notes = run.program.platform.info()["notes"]
    assert any(("not at each physics step" in note) == (interface == "effort") for note in notes)
    assert run.end().faults == []
    # A controller keeps the last for ever: targets, or no torque.
    wanted = np.zeros(12) if interface == "effort" else np.array(states.joint_pos_target)

    def kept() -> bool:
        return bool(np.allclose(peer.of("gazebo")[-1]["last"][interface], wanted, atol=1e-3))

    peer.wait_for(kept, "what a run leaves behind")
    last = peer.of("gazebo")[-1]
    assert last["dropped"] == 0
    assert last["commands"] > 0.3 * rate


def _standing(states: Any) -> bool:
    """Return whether joints, height and specific force are those of a Go2 that stands."""
    away = np.abs(states.joint_pos - GO2.default_joint_pos).max()
    felt = np.abs(states.base_lin_acc - (0.0, 0.0, 9.81)).max()
    return bool(away < 0.15 and states.base_pos_w[2] > 0.25 and felt < 2.0)


@pytest.mark.slow
@pytest.mark.timeout(150)
def test_go2_walk_walks_in_gazebo_by_one_word(
    runs: Callable[..., Any], gazebo: Callable[..., Peer], tmp_path: Path
) -> None:
    text = (ROOT / "config" / "workflows" / "go2_walk.yaml").read_text("utf-8")
    path = tmp_path / "go2_walk.yaml"
    path.write_text(
        text.replace("platform: mujoco", "platform: gazebo") + "start: {operator: false}\n"
    )
    kp, kd = _gains()
    peer = gazebo("position", 60.0, kp, kd)
    run = runs(path)
    wait_for(lambda: not run.alive, "the end of the run", 90.0)
    report = run.report
    assert report.faults == []
    assert not report.fell
    ways = np.array([line["base"][:2] for line in peer.of("gazebo")])
    print("way in Gazebo [m]", np.linalg.norm(np.diff(ways, axis=0), axis=1).sum())
    assert np.linalg.norm(np.diff(ways, axis=0), axis=1).sum() > 0.6 * 6.0


def _gains() -> tuple[float, float]:
    """Return what examples/gazebo gives the controller."""
    gains = _controllers()["pid_controller"]["ros__parameters"]["gains"]
    ((p, d),) = {(each["p"], each["d"]) for each in gains.values()}
    return p, d


def _controllers() -> dict[str, Any]:
    said: dict[str, Any] = yaml.safe_load((EXAMPLE / "controllers.yaml").read_text("utf-8"))
    return said


def test_nobody_there_is_one_line_that_says_where_to_look(tmp_path: Path) -> None:
    path = tmp_path / "stand.yaml"
    path.write_text(WORKFLOW.replace("MAP", "gazebo").replace("RATE", "50").replace("15.0", "0.2"))
    with pytest.raises(PlatformError) as said:
        load_workflow(path)
    (line,) = str(said.value).splitlines()
    assert line.startswith("platform 'gazebo': no message on /joint_states within 0.2 s")
    assert "start Gazebo with its controllers and bridge (docs/howto/gazebo.md)" in line


def test_an_option_that_ros_would_refuse_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "stand.yaml"
    path.write_text(WORKFLOW.replace("connect: 15.0", "connect: 0").replace("MAP", "gazebo"))
    path.write_text(path.read_text().replace("RATE", "50"))
    with pytest.raises(
        WorkflowError, match=r"platform 'gazebo': connect is 0; write a number above 0 \[s\]"
    ):
        load_workflow(path)


def test_the_check_says_where_the_servo_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "stand.yaml"
    for name, words in (("gazebo", "do not reach Gazebo"), ("gazebo_effort", "50 times a second")):
        path.write_text(WORKFLOW.replace("MAP", name).replace("RATE", "50"))
        assert main(["check", str(path)]) == 0
        assert words in " ".join(capsys.readouterr().out.split())


# docs/howto/gazebo.md and examples/gazebo


def test_every_block_says_what_it_is() -> None:
    assert [title for title, _ in BLOCKS] == ["workflow", "bridge"]


def test_the_plugins_are_well_formed_and_name_a_joint_of_the_robot() -> None:
    robot = ElementTree.parse(EXAMPLE / "plugins.xml").getroot()
    joints = [joint.attrib["name"] for joint in robot.iterfind("ros2_control/joint")]
    assert joints
    assert set(joints) <= set(GO2.joint_names)
    assert robot.findtext("gazebo/sensor/topic") == "/imu"


def test_the_page_names_the_controllers_of_each_map() -> None:
    types = _controllers()["controller_manager"]["ros__parameters"]
    for name in ("gazebo", "gazebo_effort"):
        (row,) = re.findall(rf"^ *\| `{name}` \| (.*?) \|", TEXT, re.M)
        named = re.findall(r"`(\w+)`", row)
        topics = load_map(find_config("maps", name, error=PlatformError)).publish
        assert set(named) <= types.keys()
        assert {spec.topic.split("/")[0] for spec in topics} <= set(named)


def test_the_bridge_has_the_maps_topics_and_types() -> None:
    (text,) = [text for title, text in BLOCKS if title == "bridge"]
    bridged = {entry["ros_topic_name"].strip("/"): entry for entry in yaml.safe_load(text)}
    assert all(entry["direction"] == "GZ_TO_ROS" for entry in bridged.values())
    heard = load_map(find_config("maps", "gazebo", error=PlatformError)).subscribe
    needed = {spec.topic: spec.type for spec in heard if spec.topic != "joint_states"}
    assert {topic: bridged[topic]["ros_type_name"] for topic in needed} == needed
    assert bridged["clock"]["ros_type_name"] == "rosgraph_msgs/msg/Clock"


def test_the_controllers_are_those_of_the_maps_with_the_robots_joints_in_its_order() -> None:
    said = _controllers()
    types = said["controller_manager"]["ros__parameters"]
    for name in ("gazebo", "gazebo_effort"):
        for spec in load_map(find_config("maps", name, error=PlatformError)).publish:
            controller = spec.topic.split("/")[0]
            joints = said[controller]["ros__parameters"]["joints"]
            prefix = "" if name == "gazebo_effort" else "pid_controller/"
            assert joints == [prefix + joint for joint in GO2.joint_names]
            assert types[controller]["type"].startswith("forward_command_controller/")
    pid = said["pid_controller"]["ros__parameters"]
    assert pid["dof_names"] == list(GO2.joint_names) == list(pid["gains"])


def test_a_documented_workflow_is_clean(tmp_path: Path) -> None:
    (text,) = [text for title, text in BLOCKS if title == "workflow"]
    path = tmp_path / "documented.yaml"
    path.write_text(text)
    assert main(["check", str(path)]) == 0
