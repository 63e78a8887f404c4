"""What other installed packages bring: robots, workflows, maps, policies, models and messages."""

from __future__ import annotations

import importlib
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from unicon_base import packages
from unicon_base.errors import ModelError, PolicyError, RobotError, UniconError
from unicon_base.packages import all_registered, share_folder
from unicon_base.resources import config_roots, find_config, find_resource
from unicon_core.models.find import find_model
from unicon_core.policies import load_policy, policy_names
from unicon_core.robots import load_robot, robot_names
from unicon_core.workflow import load_workflow, workflow_names
from unicon_msgs_map import MapFileError, Messages, MessageTypeError, load_map, parse_map

ROOT = Path(__file__).resolve().parents[2]
INDEX = Path("share") / "ament_index" / "resource_index"
WORKFLOW = """\
robot: {robot}
platform: fake
policies: {{walk: {policy}}}
flow: {{policy: walk}}
map: {map}
"""
MAP = """\
publish:
  - topic: feet
    type: their_msgs/msg/Feet
    fields: {header.stamp: stamp_ns, "feet[0].load": "joint_effort[0]"}
"""


def write_share(share: Path, robot: str = "their_go2") -> None:
    """Write the share folder of a package with one of each kind."""
    config = share / "config"
    for kind in ("robots", "workflows", "maps", "policies"):
        (config / kind).mkdir(parents=True)
    text = find_config("robots", "go2").read_text(encoding="utf-8")
    text = text.replace("name: go2\n", f"name: {robot}\n", 1)
    text = text.replace("models/", "package://unicon_ros/config/models/")
    (config / "robots" / f"{robot}.yaml").write_text(text, encoding="utf-8")
    names = {"robot": robot, "policy": f"{robot}_walk", "map": f"{robot}_map"}
    (config / "workflows" / f"{robot}_run.yaml").write_text(WORKFLOW.format(**names))
    (config / "maps" / f"{robot}_map.yaml").write_text(MAP)
    shutil.copytree(ROOT / "config/policies/go2_velocity", config / "policies" / f"{robot}_walk")


@pytest.fixture
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A prefix of the ament path, as colcon leaves it, with their_robots and their_msgs."""
    prefix = tmp_path / "install"
    write_share(prefix / "share" / "their_robots")
    messages = prefix / "share" / "their_msgs" / "msg"
    messages.mkdir(parents=True)
    (messages / "Feet.msg").write_text("std_msgs/Header header\nFoot[] feet\n")
    (messages / "Foot.msg").write_text("string<=8 name\nfloat64 load\n")
    for kind in ("packages", "unicon.config"):
        (prefix / INDEX / kind).mkdir(parents=True)
    for name in ("their_robots", "their_msgs"):
        (prefix / INDEX / "packages" / name).touch()
    (prefix / INDEX / "unicon.config" / "their_robots").touch()
    before = os.environ.get("AMENT_PREFIX_PATH")
    path = os.pathsep.join([str(prefix), *([before] if before else [])])
    monkeypatch.setenv("AMENT_PREFIX_PATH", path)
    return prefix


@pytest.fixture
def registered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of `sys.path` with a package that tells its configuration by an entry point."""
    site = tmp_path / "site"
    write_share(site / "their_code", "their_other")
    (site / "their_code" / "__init__.py").write_text("")
    info = site / "their_code-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: their-code\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[unicon.config]\ntheir_code = their_code.config\ntheir_gone = their_code:gone\n"
    )
    monkeypatch.syspath_prepend(str(site))
    importlib.invalidate_caches()
    all_registered.cache_clear()
    yield site
    for name in [each for each in sys.modules if each.split(".")[0] == "their_code"]:
        del sys.modules[name]
    all_registered.cache_clear()


def test_what_the_resource_index_names_is_found_by_name(prefix: Path) -> None:
    assert "their_go2" in robot_names()
    assert "their_go2_run" in workflow_names()
    assert "their_go2_walk" in policy_names()
    share = prefix / "share" / "their_robots" / "config"
    assert find_config("maps", "their_go2_map") == share / "maps" / "their_go2_map.yaml"
    program = load_workflow("their_go2_run")
    assert program.robot.name == "their_go2"
    program.close()


def test_what_an_entry_point_names_is_found_by_name(registered: Path) -> None:
    assert "their_other" in robot_names()
    assert "their_other_run" in workflow_names()
    assert "their_other_walk" in policy_names()
    program = load_workflow("their_other_run")
    assert program.robot.path == registered / "their_code/config/robots/their_other.yaml"
    program.close()


def test_entry_points_are_not_looked_at_for_what_is_found_before(
    registered: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def looked() -> None:
        raise AssertionError("installed packages were looked through")

    monkeypatch.setattr(packages, "registered", lambda kind: looked())
    program = load_workflow("go2_walk")
    program.close()
    find_config("maps", "default")


def test_a_name_of_ours_is_not_taken_over(prefix: Path, tmp_path: Path) -> None:
    theirs = prefix / "share" / "their_robots" / "config" / "robots"
    (theirs / "go2.yaml").write_text(find_config("robots", "go2").read_text(encoding="utf-8"))
    assert load_robot("go2").path == ROOT / "config" / "robots" / "go2.yaml"
    wanted = load_robot("package://their_robots/config/robots/go2.yaml")
    assert wanted.path == theirs / "go2.yaml"


def test_a_marker_may_name_another_folder(prefix: Path) -> None:
    shutil.move(prefix / "share/their_robots/config", prefix / "share/their_robots/unicon")
    (prefix / INDEX / "unicon.config" / "their_robots").write_text("share/their_robots/unicon\n")
    assert load_robot("their_go2").name == "their_go2"


def test_package_paths_work_in_workflow_robot_model_policy_and_map(
    prefix: Path, tmp_path: Path
) -> None:
    config = "package://their_robots/config"
    path = tmp_path / "own.yaml"
    path.write_text(
        WORKFLOW.format(
            robot=f"{config}/robots/their_go2.yaml",
            policy=f"{config}/policies/their_go2_walk",
            map=f"{config}/maps/their_go2_map.yaml",
        )
    )
    program = load_workflow(path)
    assert program.robot.name == "their_go2"
    share = prefix / "share" / "their_robots"
    assert program.policies["walk"].path == share / "config/policies/their_go2_walk/policy.yaml"
    program.close()
    own = find_model("package://unicon_ros/config/models/go2/go2.xml")
    assert own.samefile(find_model(load_robot("go2").models["mjcf"], load_robot("go2").path.parent))
    shutil.copy(own, share / "go2.xml")
    found = find_model("package://their_robots/go2.xml")
    assert found == share / "go2.xml"
    (tmp_path / "scene.yaml").write_text(
        "robot: go2\nplatform: mujoco\nrate: 50\nflow: {hold: {}}\n"
        "scene: {model: package://their_robots/go2.xml}\n"
    )
    robot = load_robot("their_go2")
    assert robot.models["mjcf"].startswith("package://unicon_ros/")
    assert find_model(robot.models["mjcf"], robot.path.parent) == own
    pytest.importorskip("mujoco")
    simulated = load_workflow(tmp_path / "scene.yaml")
    assert simulated.platform.model_path == found  # type: ignore[attr-defined]
    simulated.close()


def test_installed_messages_are_known_with_their_parts(prefix: Path) -> None:
    feet = Messages().struct("their_msgs/Feet")
    assert list(feet.fields) == ["header", "feet"]
    text = Messages().definition("their_msgs/msg/Feet").text
    assert "MSG: their_msgs/Foot" in text.splitlines()
    mapping = load_map(find_config("maps", "their_go2_map"))
    assert mapping.publish[0].type == "their_msgs/msg/Feet"


def test_a_map_names_messages_of_a_package(prefix: Path) -> None:
    share = prefix / "share" / "their_msgs"
    (share / "more_msgs").mkdir()
    (share / "more_msgs" / "Step.msg").write_text("float64 height\n")
    text = (
        "messages: [package://their_msgs/more_msgs]\n"
        "publish:\n  - {topic: a, type: more_msgs/msg/Step, fields: {height: h}}\n"
    )
    assert parse_map(text).publish[0].type == "more_msgs/msg/Step"
    with pytest.raises(MapFileError) as caught:
        parse_map(text.replace("more_msgs]", "none]"))
    assert str(caught.value).startswith("mapping:1: messages 'package://their_msgs/none': no such")


def test_ready_made_and_shipped_definitions_come_first(prefix: Path) -> None:
    for package, name, text in (
        ("geometry_msgs", "Vector3", "float32 other\n"),
        ("unitree_go", "MotorCmd", "float32 other\n"),
    ):
        folder = prefix / "share" / package / "msg"
        folder.mkdir(parents=True)
        (folder / f"{name}.msg").write_text(text)
        assert "other" not in Messages().struct(f"{package}/msg/{name}").fields
    (prefix / "share/unitree_go/msg/Other.msg").write_text("MotorCmd cmd\n")
    with pytest.raises(MessageTypeError, match="already present with different definition"):
        Messages().struct("unitree_go/msg/Other")


@pytest.mark.parametrize("text", ["", "float64 = = 3\n", "\0\x01", "Loop again\n"])
def test_an_installed_message_that_is_broken_is_told(prefix: Path, text: str) -> None:
    (prefix / "share/their_msgs/msg/Loop.msg").write_text(text)
    if text == "":
        assert list(Messages().struct("their_msgs/Loop").fields)  # an empty message
        return
    with pytest.raises(MessageTypeError, match="their_msgs/msg/"):
        Messages().struct("their_msgs/Loop")


def test_an_unknown_type_is_told_with_those_of_its_package(prefix: Path) -> None:
    with pytest.raises(MessageTypeError) as caught:
        Messages().struct("their_msgs/msg/Fet")
    assert str(caught.value) == (
        "message type 'their_msgs/msg/Fet' is unknown; did you mean 'their_msgs/msg/Feet'? known: "
        f"their_msgs/msg/Feet, their_msgs/msg/Foot; looked in {prefix}/share/their_msgs/msg; or "
        "name its .msg file under 'messages'"
    )


def test_errors_name_where_was_searched(prefix: Path, registered: Path) -> None:
    share = f"{prefix}/share/their_robots/config"
    for error, look in (
        (RobotError, lambda: load_robot("their_g2")),
        (PolicyError, lambda: load_policy("their_g2_walk")),
        (UniconError, lambda: find_config("maps", "their_g2_map")),
    ):
        with pytest.raises(error) as caught:
            look()
        told = str(caught.value)
        assert f"{ROOT / 'config'}, " in told
        assert share in told
        assert f"{registered}/their_code/config (UNICON_PATH adds folders)" in told
        assert (
            "entry point their_gone of unicon.config (entry point their_code:gone): "
            "AttributeError: module 'their_code' has no attribute 'gone'; install its package again"
        ) in told
    with pytest.raises(UniconError) as caught:
        find_config("maps", "own/none.yaml")
    assert f"looked below {Path.cwd()}, {ROOT / 'config'}, " in str(caught.value)


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("package://their_robot/a.xml", "no package 'their_robot' is installed; did you mean "),
        ("package:///a.xml", "no package '' is installed; known: "),
        ("package://../a.xml", "no package '..' is installed; "),
        ("package://their_robots", "write package://their_robots/PATH, below "),
        ("package://their_robots/../their_msgs/msg", "write package://their_robots/PATH, below "),
        ("package://their_robots//etc/hosts", "write package://their_robots/PATH, below "),
        ("package://their_robots/no.xml", "no such file; looked in "),
        ("package://their_robots/\0", "no such file; looked in "),
    ],
)
def test_a_wrong_package_path_is_told(prefix: Path, reference: str, message: str) -> None:
    with pytest.raises(ModelError) as caught:
        find_resource(reference, "model", error=ModelError)
    assert str(caught.value).startswith(f"model {reference!r}: {message}")
    if message.startswith("no package"):
        assert f"looked in share/ of {prefix}, " in str(caught.value)


def test_a_folder_is_no_configuration_file(prefix: Path) -> None:
    with pytest.raises(RobotError, match=r"is a folder; name a \.yaml file in it"):
        load_robot("package://their_robots/config/robots")


def test_without_a_share_a_package_is_where_its_registered_folder_is(registered: Path) -> None:
    assert share_folder("their_code") == registered / "their_code"
    assert load_robot("package://their_code/config/robots/their_other.yaml").name == "their_other"


def test_meshes_of_a_package_are_found_on_the_ament_path(prefix: Path, tmp_path: Path) -> None:
    from unicon_core.models.absent import mesh_places

    mesh = prefix / "share" / "their_robots" / "meshes" / "box.stl"
    mesh.parent.mkdir()
    mesh.touch()
    places = mesh_places(tmp_path / "r.urdf", tmp_path, "package://their_robots/meshes/box.stl")
    assert mesh in places


def test_folders_come_once(prefix: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNICON_PATH", str(prefix / "share" / "their_robots" / "config"))
    roots = list(config_roots())
    assert len(roots) == len(set(roots))
    assert roots[0] == prefix / "share" / "their_robots" / "config"
