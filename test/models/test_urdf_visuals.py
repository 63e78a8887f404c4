"""A URDF's own visuals in robot_description: its meshes, wherever it says that they are."""

from __future__ import annotations

import xml.etree.ElementTree as Xml
from dataclasses import replace

import numpy as np
import pytest
from worn_meshes import WEDGE, write_stl

from unicon_core.models.kinematic_tree import urdf
from unicon_core.models.load import load_model
from unicon_core.models.visual_meshes import dressed
from unicon_core.robots import load_robot

pytest.importorskip("mujoco")

URDF = """\
<robot name="mine">
  <mujoco><compiler meshdir="{meshdir}" discardvisual="{discard}"/></mujoco>
  <material name="blue"><color rgba="0 0 1 1"/></material>
  <link name="trunk">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual>
      <origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 0.6"/>
      <geometry><mesh filename="{mesh}" scale="1 -1 0.5"/></geometry>
      <material name="blue"/>
    </visual>
    <visual><geometry><cylinder radius="0.1" length="0.2"/></geometry>
      <material name="own"><color rgba="1 0 0 1"/></material></visual>
    <visual><geometry><mesh filename="{mesh}"/></geometry></visual>
    <collision><geometry><box size="1 1 1"/></geometry></collision>
  </link>
  <link name="arm">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://mine/gone.dae"/></geometry></visual>
    <collision><geometry><sphere radius="0.2"/></geometry></collision>
  </link>
  <joint name="FR_hip_joint" type="revolute"><parent link="trunk"/><child link="arm"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>
"""


@pytest.fixture
def robot():
    """A Go2 that has lost all joints but one, whose base is its trunk."""
    go2 = load_robot("go2")
    arrays = {k: v[:1] for k, v in vars(go2).items() if isinstance(v, np.ndarray)}
    return replace(go2, joint_names=go2.joint_names[:1], feet={}, base_frame="trunk", **arrays)


def written(path, mesh, meshdir="", discard="true"):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(URDF.format(mesh=mesh, meshdir=meshdir, discard=discard), "utf-8")
    return path


def described(path, robot):
    _, links, lacking = dressed(path, robot)
    return Xml.fromstring(urdf(links, robot)), lacking


def shapes(root, link, use="visual"):
    return [each.tag for each in root.findall(f"link[@name='{link}']/{use}/geometry/*")]


def mesh_of(root):
    (name,) = {each.get("filename", "") for each in root.iter("mesh")}
    return name


@pytest.mark.parametrize("discard", ["true", "false"])
def test_its_visuals_stay_as_they_stand(robot, tmp_path, discard):
    file = write_stl(tmp_path / "mine" / "meshes" / "shell é.STL")
    place = tmp_path / "mine" / "urdf" / "mine.urdf"
    root, lacking = described(
        written(place, "package://mine/meshes/shell é.STL", discard=discard), robot
    )
    assert mesh_of(root) == file.as_uri()
    assert shapes(root, "trunk") == ["mesh", "cylinder", "mesh"]
    assert "mesh" not in shapes(root, "trunk", "collision")
    first, second, third = root.findall("link[@name='trunk']/visual")
    origin = first.find("origin")
    mesh = first.find("geometry/mesh")
    assert origin is not None
    assert mesh is not None
    assert origin.get("xyz") == "0.1 0.2 0.3"
    turned = [float(word) for word in origin.get("rpy", "").split()]
    assert turned == pytest.approx([0.4, -0.5, 0.6])
    assert mesh.get("scale") == "1 -1 0.5"
    colours = [each.find("material/color") for each in (first, second, third)]
    assert [None if c is None else c.get("rgba") for c in colours] == ["0 0 1 1", "1 0 0 1", None]
    # The arm's only visual is absent: what collides stands for it.
    assert shapes(root, "arm") == shapes(root, "arm", "collision") == ["sphere"]
    said = "1 visual meshes (first: package://mine/gone.dae) are absent; add the files"
    assert lacking.endswith(said)


def test_the_uri_of_an_installed_package_stays(robot, tmp_path, monkeypatch):
    write_stl(tmp_path / "install" / "share" / "theirs" / "shell.stl")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install"))
    root, _ = described(written(tmp_path / "a.urdf", "package://theirs/shell.stl"), robot)
    assert mesh_of(root) == "package://theirs/shell.stl"


@pytest.mark.parametrize("figure", ["nan", "1e999", "", "1 2", "wide"])
def test_a_visual_with_a_figure_that_is_none_is_left_out(robot, tmp_path, figure):
    write_stl(tmp_path / "shell.stl")
    path = written(tmp_path / "a.urdf", "shell.stl")
    path.write_text(path.read_text().replace('radius="0.1"', f'radius="{figure}"'))
    assert shapes(described(path, robot)[0], "trunk") == ["mesh", "mesh"]


@pytest.mark.parametrize(
    "name",
    ["parts/shell.stl", "file://{folder}/parts/shell.stl", "{folder}/parts/shell.stl", "shell.stl"],
)
def test_paths_of_any_kind_are_found(robot, tmp_path, name):
    file = write_stl(tmp_path / "a folder" / "parts" / "shell.stl")
    named = name.format(folder=file.parents[1])
    root, _ = described(written(tmp_path / "a folder" / "a.urdf", named, "parts"), robot)
    assert mesh_of(root) == file.as_uri()


@pytest.mark.parametrize(
    "name",
    [
        "../secret.stl",
        "package://mine/../../secret.stl",
        "package://theirs/../../../secret.stl",
        "file://{folder}/secret.stl",
        "{folder}/secret.stl",
        "file:///etc/passwd",
        "/etc/passwd",
        "file:///dev/zero",
    ],
)
def test_a_strangers_urdf_names_nothing_outside_of_its_folder(robot, tmp_path, monkeypatch, name):
    write_stl(tmp_path / "secret.stl")
    (tmp_path / "install" / "share" / "theirs").mkdir(parents=True)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install"))
    path = written(tmp_path / "mine" / "a.urdf", name.format(folder=tmp_path))
    root, lacking = described(path, robot)
    assert "<mesh" not in Xml.tostring(root, encoding="unicode")
    assert shapes(root, "trunk") == ["box"]
    assert "visual meshes" in lacking


def test_meshes_are_opened_where_they_are_found_whatever_meshdir_says(robot, tmp_path):
    """As in Unitree's G1: `meshdir="meshes"`, and files that are called `meshes/NAME` too."""
    write_stl(tmp_path / "meshes" / "shell.stl", WEDGE)
    path = written(tmp_path / "g.urdf", "meshes/shell.stl", "meshes", discard="false")
    assert load_model(path, robot).model.nmesh == 2  # one for each scale
    assert mesh_of(described(path, robot)[0]).endswith("/meshes/shell.stl")
