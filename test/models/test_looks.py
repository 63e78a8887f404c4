"""Meshes in robot_description: where MuJoCo has them, and none but the model's own."""

from __future__ import annotations

import xml.etree.ElementTree as Xml
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from worn_meshes import WEDGE, go2_with_meshes, stl_vertices, write_stl

from unicon_core.models.kinematic_tree import read_tree, urdf
from unicon_core.models.load import load_model
from unicon_core.models.visual_meshes import dressed
from unicon_core.robots import load_robot

mujoco = pytest.importorskip("mujoco")

MJCF = """\
<mujoco>
  <compiler meshdir="parts"/>
  <default><mesh scale="0.5 0.5 0.5"/></default>
  <asset>
    <material name="red" rgba="1 0 0 1"/>
    <mesh name="mirrored" file="a shell é.stl" scale="1 -2 0.5" refpos="0.1 0.2 -0.3"/>
    <mesh name="turned" file="a shell é.stl" refpos="0.1 0.2 0.3" refquat="0.8 0 0.6 0"/>
    <mesh file="deeper/../deeper/foot.STL"/>
    {mesh}
  </asset>
  <worldbody>
    <body name="base_link" pos="0 0 1"><freejoint/>
      <geom type="mesh" mesh="mirrored" pos="0.1 0.2 0.3" quat="0.6 0 0.8 0" material="red"
        contype="0" conaffinity="0" name="seen"/>
      <geom type="mesh" mesh="mirrored" name="touched"/>
      <geom size="0.1"/>
      <geom size="0.4" rgba="1 1 1 0"/>
      <body name="arm" pos="0.3 0 0" euler="10 20 30">
        <joint name="FR_hip_joint" pos="0 0.05 0.1" axis="0 1 0"/>
        <geom type="mesh" mesh="foot" name="shared" rgba="0 1 0 0.5" euler="20 0 50"/>
        <geom type="mesh" mesh="turned" name="second" pos="0 1 0" euler="0 70 0"/>
        <geom type="mesh" mesh="foot" name="hidden" group="3"/>
        <body name="cover"><geom type="mesh" mesh="foot" group="3"/></body>
        {geom}
      </body>
    </body>
  </worldbody>
</mujoco>
"""
FAR = '<geom type="mesh" mesh="far"/>'


@pytest.fixture
def robot():
    """A Go2 that has lost all joints but one."""
    go2 = load_robot("go2")
    arrays = {k: v[:1] for k, v in vars(go2).items() if isinstance(v, np.ndarray)}
    return replace(go2, joint_names=go2.joint_names[:1], feet={}, **arrays)


def model(folder, mesh="", geom=""):
    write_stl(folder / "parts" / "a shell é.stl")
    write_stl(folder / "parts" / "deeper" / "foot.STL", WEDGE * (1, 2, 0.3))
    path = folder / "robot.xml"
    path.write_text(MJCF.format(mesh=mesh, geom=geom), "utf-8")
    return path


def described(path, robot):
    _, links, lacking = dressed(path, robot)
    return Xml.fromstring(urdf(links, robot)), lacking


def visuals(root, link):
    return root.findall(f"link[@name='{link}']/visual")


def shapes(root, link):
    return [each.find("geometry/*").tag for each in visuals(root, link)]  # type: ignore[union-attr]


def uris(root):
    return [mesh.get("filename", "") for mesh in root.iter("mesh")]


def placed(visual):
    """The file's vertices in the link's frame, as a reader of URDF places them."""
    origin = visual.find("origin")
    mesh = visual.find("geometry/mesh")
    assert origin is not None
    assert mesh is not None
    roll, pitch, yaw = (float(word) for word in origin.get("rpy", "").split())
    quat = np.zeros(4)
    mujoco.mju_euler2Quat(quat, np.array((roll, pitch, yaw)), "XYZ")  # about fixed axes
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, quat)
    scale = np.array(mesh.get("scale", "").split(), float)
    file = stl_vertices(Path(unquote(mesh.get("filename", "").removeprefix("file://"))))
    at = np.array(origin.get("xyz", "").split(), float)
    return np.unique((file * scale @ turn.reshape(3, 3).T + at).round(7), axis=0)


def test_a_vertex_of_a_file_is_where_mujoco_has_it(robot, tmp_path):
    path = model(tmp_path)
    root, lacking = described(path, robot)
    assert lacking == ""
    compiled = load_model(path, robot).model
    anchor = {"base_link": np.zeros(3), "arm": np.array((0.0, 0.05, 0.1))}  # of the link's frame
    for link, number, name in (
        ("base_link", 0, "seen"),
        ("arm", 0, "shared"),
        ("arm", 1, "second"),
    ):
        geom = compiled.geom(name)
        mesh = geom.dataid[0]
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, geom.quat)
        vertices = compiled.mesh_vert[compiled.mesh_vertadr[mesh] :][: compiled.mesh_vertnum[mesh]]
        vertices = vertices @ turn.reshape(3, 3).T + geom.pos - anchor[link]
        found = placed(visuals(root, link)[number])
        distances = np.linalg.norm(found[:, None] - vertices, axis=2)
        assert distances.shape == (4, 4)
        assert distances.min(axis=1).max() < 2e-6
        assert distances.min(axis=0).max() < 2e-6
    assert min(abs(compiled.mesh_pos).max(axis=1)) > 0.01  # else nothing would have been tried


def test_what_collides_alone_is_not_seen_and_collisions_stay(robot, tmp_path):
    path = model(tmp_path)
    root, _ = described(path, robot)
    assert shapes(root, "base_link") == ["mesh", "sphere"]  # one is transparent, one a collision
    assert shapes(root, "arm") == ["mesh", "mesh"]  # that collide, and are all there is to see
    assert shapes(root, "cover") == ["box"]  # MuJoCo's viewers hide it
    parts = tmp_path / "parts"
    files = [parts / "a shell é.stl", parts / "deeper" / "foot.STL", parts / "a shell é.stl"]
    assert uris(root) == [file.as_uri() for file in files]
    assert uris(root)[0].endswith("/parts/a%20shell%20%C3%A9.stl")
    colours = [each.get("rgba") for each in root.findall(".//visual/material/color")]
    assert colours == ["1 0 0 1", "0.5 0.5 0.5 1", "0 1 0 0.5", "0.5 0.5 0.5 1", "0.5 0.5 0.5 1"]
    plain = Xml.fromstring(urdf(read_tree(load_model(path, robot).model, robot), robot))
    told, untold = ([Xml.tostring(c) for c in each.iter("collision")] for each in (root, plain))
    assert told == untold


def test_a_robot_without_meshes_is_as_ever():
    robot = load_robot("go2")
    path = Path(__file__).parents[2] / "config" / "models" / "go2" / "go2.xml"
    loaded, links, lacking = dressed(path, robot)
    assert lacking == ""
    assert urdf(links, robot) == urdf(read_tree(loaded.model, robot), robot)


def test_a_robot_of_ours_wears_meshes_beside_its_primitives(tmp_path):
    root, lacking = described(go2_with_meshes(tmp_path), load_robot("go2"))
    assert lacking == ""
    assert shapes(root, "base_link").count("mesh") == 1
    assert len(shapes(root, "base_link")) > 4
    assert shapes(root, "FR_thigh")[0] == "mesh"
    assert len(uris(root)) == 2


@pytest.mark.parametrize("where", ["beside", "package", "mjcf"])
def test_only_the_models_own_files_are_named(robot, tmp_path, where):
    folder = tmp_path / "pack" / ("mjcf" if where == "mjcf" else "robots_of_mine")
    path = model(folder, '<mesh name="far" file="../../far/far.stl"/>', FAR)
    far = write_stl(folder.parent / "far" / "far.stl")
    if where == "package":
        (tmp_path / "pack" / "package.xml").touch()
    root, lacking = described(path, robot)
    if where == "beside":
        assert far.as_uri() not in uris(root)
        assert shapes(root, "arm") == ["mesh", "mesh", "box"]
        assert lacking.startswith("1 visual meshes (first: far.stl) are outside of ")
        assert lacking.endswith("; put them there, or a package.xml above both")
    else:
        assert far.as_uri() in uris(root)
        assert lacking == ""


def test_a_link_that_leads_out_of_the_models_folder_is_refused(robot, tmp_path):
    path = model(tmp_path / "mine", '<mesh name="far" file="far.stl"/>', FAR)
    link = tmp_path / "mine" / "parts" / "far.stl"
    link.symlink_to(write_stl(tmp_path / "others" / "far.stl"))
    root, lacking = described(path, robot)
    assert "far.stl" not in "".join(uris(root))
    assert "outside of" in lacking


def test_absent_and_unreadable_meshes_leave_the_primitives(robot, tmp_path):
    uneven = '<mesh name="far" file="foot.stl" refquat="0.8 0.6 0 0" scale="1 2 3"/>'
    path = model(tmp_path, uneven + '<mesh name="gone" file="gone.stl"/>', FAR)
    write_stl(tmp_path / "parts" / "foot.stl")
    root, lacking = described(path, robot)
    assert shapes(root, "arm") == ["mesh", "mesh", "box"]
    absent, turned = lacking.split("; ")
    assert absent.startswith("1 mesh files are absent (first: gone.stl)")
    assert turned.endswith("are turned by refquat and scaled unevenly, which URDF cannot say")


def test_meshes_of_an_attached_model_lie_in_its_own_folder(robot, tmp_path):
    tool = tmp_path / "tools" / "tool.xml"
    part = write_stl(tmp_path / "tools" / "meshes" / "jaw.stl")
    tool.write_text(
        '<mujoco><compiler meshdir="meshes"/><asset><mesh file="jaw.stl"/></asset><worldbody>'
        '<body name="tool"><geom type="mesh" mesh="jaw"/></body></worldbody></mujoco>'
    )
    attached = '<attach model="tool" body="tool" prefix="my_"/>'
    path = model(tmp_path, '<model name="tool" file="tools/tool.xml"/>', attached)
    root, lacking = described(path, robot)
    assert lacking == ""
    assert shapes(root, "my_tool") == ["mesh"]
    assert part.as_uri() in uris(root)


def test_thirty_meshes_make_a_small_text(robot, tmp_path):
    meshes = ""
    geoms = ""
    for number in range(30):
        write_stl(tmp_path / "parts" / f"part_{number}.stl", np.repeat(WEDGE, 500, axis=0))
        meshes += f'<mesh file="part_{number}.stl"/>'
        geoms += f'<geom type="mesh" mesh="part_{number}"/>'
    _, links, _ = dressed(model(tmp_path, meshes, geoms), robot)
    text = urdf(links, robot)
    assert text.count("<mesh ") == 33
    assert len(text) < 40_000


def test_a_trunk_in_a_base_of_nothing_is_one_link(robot, tmp_path):
    """As A1 has it, whose `base_frame` is the trunk: two links of one name, RViz refuses."""
    path = tmp_path / "robot.xml"
    path.write_text(
        '<mujoco><worldbody><body name="base"><freejoint/><body name="trunk"><geom size="0.1"/>'
        '<body name="hip" pos="1 0 0"><joint name="FR_hip_joint"/><geom size="0.1"/></body>'
        "</body></body></worldbody></mujoco>"
    )
    root, _ = described(path, replace(robot, base_frame="trunk"))
    assert [link.get("name") for link in root.iter("link")][:3] == ["trunk", "base_link", "hip"]
    assert shapes(root, "trunk") == ["sphere"]
    assert root.find("link[@name='trunk_inertia']/inertial") is not None
