"""Models from elsewhere: robot_descriptions, public URDFs with mistakes, actuators of any kind."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from test_mujoco_load import LIMB, PLACES, URDF, stand

from unicon_base.errors import MissingDependencyError, ModelError
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.mujoco import make

LIMBS = "".join(LIMB.format(name=n, x=0.2 * x, y=0.15 * y) for n, (x, y) in PLACES.items())


@pytest.fixture
def toy_urdf(tmp_path):
    """Writes the URDF with changes, in a folder of its own below; returns its path."""

    def write(*changes: tuple[str, str], folder: str = ".") -> Path:
        text = URDF.format(limbs=LIMBS)
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / folder / "toy.urdf"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    return write


# -- robot_descriptions --------------------------------------------------------------------------


@pytest.fixture
def descriptions(tmp_path, monkeypatch):
    """A stand-in for the package: the real one downloads from the network when it is used."""
    for name in [name for name in sys.modules if name.startswith("robot_descriptions")]:
        monkeypatch.delitem(sys.modules, name)
    folder = tmp_path / "site" / "robot_descriptions"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(str(folder.parent))
    return folder


@pytest.mark.parametrize("key", ["MJCF_PATH", "URDF_PATH"])
def test_a_model_of_robot_descriptions_is_found_by_its_name(
    key, descriptions, toy_robot, toy_model, toy_urdf, states_of
):
    model = toy_model() if key == "MJCF_PATH" else toy_urdf()
    (descriptions / "toy_description.py").write_text(f"{key} = {str(model)!r}\n")
    robot = toy_robot()
    states = states_of(robot)
    platform = make(states, robot, 0.01, scene=Scene(model="robot_descriptions:toy_description"))
    assert platform.info()["model"] == str(model)
    stand(states, robot, platform, ticks=5)


@pytest.mark.parametrize(
    ("content", "name", "message"),
    [
        (
            "",
            "toy_descripton",
            "model 'robot_descriptions:toy_descripton': no such description; "
            "did you mean 'toy_description'? known: toy_description",
        ),
        (
            "XACRO_PATH = 'toy.xacro'",
            "toy_description",
            "model 'robot_descriptions:toy_description': the description has no MJCF or URDF "
            "file; choose one that has, such as go2_mj_description",
        ),
        (
            "raise ConnectionError('no route\\nto host')",
            "toy_description",
            "model 'robot_descriptions:toy_description': robot_descriptions could not fetch it: "
            "no route to host; connect to the network, or give a file by path",
        ),
    ],
)
def test_what_robot_descriptions_cannot_give_is_told(
    content, name, message, descriptions, toy_robot, states_of
):
    (descriptions / "toy_description.py").write_text(content)
    robot = toy_robot()
    with pytest.raises(ModelError) as caught:
        make(states_of(robot), robot, 0.01, scene=Scene(model=f"robot_descriptions:{name}"))
    assert str(caught.value) == message


def test_without_robot_descriptions_the_install_command_is_told(toy_robot, states_of, monkeypatch):
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    robot = toy_robot()
    with pytest.raises(MissingDependencyError) as caught:
        make(
            states_of(robot),
            robot,
            0.01,
            scene=Scene(model="robot_descriptions:go2_mj_description"),
        )
    assert str(caught.value) == (
        "model 'robot_descriptions:go2_mj_description' needs robot_descriptions: "
        "pip install robot_descriptions"
    )


# -- URDF files as they are published ------------------------------------------------------------


def test_what_stands_twice_in_a_urdf_is_read_once(toy_robot, toy_urdf, states_of):
    """Unitree's go2_description.urdf gives a visual two materials, which MuJoCo refuses."""
    material = '<material name="a"/><material name="b"/>'
    path = toy_urdf(("</geometry></visual>", f"</geometry>{material}</visual>"))
    robot = toy_robot()
    states = states_of(robot)
    platform = make(states, robot, 0.01, scene=Scene(model=path))
    assert platform.info()["notes"][0] == (
        "1 elements stand twice in the URDF (first: material of a visual)"
    )
    stand(states, robot, platform)
    assert states.projected_gravity[2] < -0.99


def test_an_inertia_that_no_body_has_is_mended(toy_robot, toy_urdf, states_of):
    """The XHand's URDF repeats one figure six times for its small links."""
    path = toy_urdf(
        (
            'ixx=".05" iyy=".05" izz=".05" ixy="0" ixz="0" iyz="0"',
            'ixx=".05" iyy=".05" izz=".05" ixy=".05" ixz=".05" iyz=".05"',
        )
    )
    robot = toy_robot()
    platform = make(states_of(robot), robot, 0.01, scene=Scene(model=path))
    assert platform.info()["notes"][0].startswith("the inertia of box is none that a body can have")
    inertia = platform.model.body_inertia[platform.model.body("box").id]
    np.testing.assert_allclose(inertia, [0.05] * 3)


def test_principal_moments_of_which_two_sum_to_less_than_the_third_are_mended(
    toy_robot, toy_urdf, states_of
):
    """A camera of ANYbotics' ANYmal C has such an inertia; every figure of it is positive."""
    path = toy_urdf(('ixx=".05" iyy=".05" izz=".05"', 'ixx=".01" iyy=".02" izz=".05"'))
    robot = toy_robot()
    platform = make(states_of(robot), robot, 0.01, scene=Scene(model=path))
    assert platform.info()["notes"][0].startswith("the inertia of box is none that a body can have")
    inertia = platform.model.body_inertia[platform.model.body("box").id]
    np.testing.assert_allclose(inertia, [0.05] * 3)


@pytest.mark.parametrize(
    ("shape", "kind"),
    [
        ('<cylinder radius="0" length="0.1"/>', "cylinder"),
        ('<sphere radius="0.0"/>', "sphere"),
        ('<box size="0.1 0 0.1"/>', "box"),
    ],
)
def test_a_shape_without_an_extent_is_left_out(shape, kind, toy_robot, toy_urdf, states_of):
    flat = f"<collision><geometry>{shape}</geometry></collision>"
    path = toy_urdf(('<link name="box">', f'<link name="box">{flat}'))
    robot = toy_robot()
    platform = make(states_of(robot), robot, 0.01, scene=Scene(model=path))
    assert platform.info()["notes"][0] == (
        f"shapes without an extent are left out: {kind} in a collision of box"
    )


def test_a_urdf_that_is_no_xml_is_told_with_its_place(toy_robot, toy_urdf, states_of):
    path = toy_urdf(("</robot>", ""))
    robot = toy_robot()
    with pytest.raises(ModelError, match=r"toy\.urdf: no element found: line \d+.*; correct the"):
        make(states_of(robot), robot, 0.01, scene=Scene(model=path))


def test_strong_damping_on_light_links_of_a_urdf_does_not_blow_up(toy_robot, toy_urdf, states_of):
    """kd · step / inertia is 33 here: an explicit step is unstable from 2 on."""
    path = toy_urdf(
        ('ixx=".01" iyy=".01" izz=".01"', 'ixx="1e-4" iyy="1e-4" izz="1e-4"'),
        ('<mass value="0.5"/>', '<mass value="0.02"/>'),
    )
    robot = toy_robot()
    states = states_of(robot)
    platform = make(states, robot, 0.01, scene=Scene(model=path))
    states.joint_damping = 5.0
    for _ in range(100):
        states.joint_pos_target = robot.default_joint_pos
        states.joint_stiffness = 20.0
        states.joint_damping = 5.0
        platform.send()
    platform.recv()
    assert np.abs(states.joint_vel).max() < 0.5
    assert states.projected_gravity[2] < -0.99


def write_box(path):
    """Write a binary STL of a tetrahedron of 0.2 m."""
    a = (0, 0, 0)
    b = (0.2, 0, 0)
    c = (0, 0.2, 0)
    d = (0, 0, 0.2)
    faces = [(a, c, b), (a, b, d), (a, d, c), (b, c, d)]
    path.parent.mkdir(parents=True, exist_ok=True)
    body = b"".join(
        struct.pack("<12fH", 0, 0, 0, *(x for v in face for x in v), 0) for face in faces
    )
    path.write_bytes(bytes(80) + struct.pack("<I", len(faces)) + body)


COLLISION = (
    '<collision><geometry><box size="0.4 0.3 0.1"/></geometry></collision>',
    '<collision><geometry><mesh filename="package://toy/meshes/{}"/></geometry></collision>',
)


def test_a_mesh_is_found_in_the_ros_package_that_it_names(tmp_path, toy_robot, toy_urdf, states_of):
    write_box(tmp_path / "toy" / "meshes" / "skin.stl")
    old, new = COLLISION
    visual = '<visual><geometry><mesh filename="package://toy/meshes/box.stl"/></geometry></visual>'
    path = toy_urdf((old, new.format("skin.stl")), (visual, ""), folder="toy/urdf")
    robot = toy_robot()
    platform = make(states_of(robot), robot, 0.01, scene=Scene(model=path))
    assert not any("mesh" in note for note in platform.info()["notes"])
    assert platform.model.nmesh == 1


def test_a_mesh_in_a_format_that_mujoco_cannot_read_is_left_out(
    tmp_path, toy_robot, toy_urdf, states_of
):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "skin.dae").write_text("<COLLADA/>")
    old, new = COLLISION
    path = toy_urdf((old, old + new.format("../meshes/skin.dae")))
    robot = toy_robot()
    platform = make(states_of(robot), robot, 0.01, scene=Scene(model=path))
    assert "1 of them may collide" in "\n".join(platform.info()["notes"])


def test_a_robot_without_anything_that_collides_is_told_to_fall(toy_robot, toy_urdf, states_of):
    old, new = COLLISION
    limb = '<geometry><sphere radius="0.03"/></geometry>'
    mesh = '<geometry><mesh filename="limb.stl"/></geometry>'
    path = toy_urdf((old, new.format("skin.stl")), (limb, mesh))
    robot = toy_robot()
    platform = make(states_of(robot), robot, 0.01, scene=Scene(model=path))
    notes = "\n".join(platform.info()["notes"])
    assert "so it falls through the floor: add the files" in notes


def test_an_absent_texture_is_left_out(toy_robot, toy_model, states_of):
    """PND's adam_lite.xml paints its torso with a picture that is not beside it."""
    path = toy_model()
    asset = (
        '<asset><texture name="logo" type="2d" file="logo.png"/>'
        '<material name="paint" texture="logo"/></asset><worldbody>'
    )
    box = '<geom type="box" size="0.2 0.1 0.05" mass="4"'
    text = path.read_text().replace("<worldbody>", asset)
    path.write_text(text.replace(box, f'{box} material="paint"'))
    robot = toy_robot()
    platform = make(states_of(robot), robot, 0.002, scene=Scene(model=path))
    assert platform.info()["notes"][0] == "1 textures are absent (logo): left out"
    assert platform.model.ntex == 0
    path.with_name("logo.png").write_text("version https://git-lfs.github.com/spec/v1\n")
    platform = make(states_of(robot), robot, 0.002, scene=Scene(model=path))
    note = platform.info()["notes"][0]
    assert note.endswith("left out; 1 of the files is a Git LFS pointer: run 'git lfs pull'")


# -- actuators of any kind -----------------------------------------------------------------------

KINDS = {
    "intvelocity": '<intvelocity joint="{}" kp="9" actrange="-2 2"/>',
    "damper": '<damper joint="{}" kv="2" ctrlrange="0 1"/>',
    "cylinder": '<cylinder joint="{}" timeconst="0.2" area="3"/>',
    "muscle": '<muscle joint="{}" lengthrange="0.1 2"/>',
    "general": '<general joint="{}" gaintype="affine" gainprm="3 1 1" biastype="affine"/>',
    "position": '<position joint="{}" kp="9" kv="1" gear="2"/>',
    "velocity": '<velocity joint="{}" kv="9"/>',
    "motor": '<motor joint="{}" gear="-3"/>',
}


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_kind_of_actuator_becomes_the_same_servo(kind, toy_robot, toy_model, states_of):
    """tau = kp (q* - q) + kd (qd* - qd) + tau_ff, whatever the model has."""
    robot = toy_robot()
    states = states_of(robot)
    model = toy_model(actuators="".join(KINDS[kind].format(n) for n in robot.joint_names))
    platform = make(states, robot, 0.002, scene=Scene(model=model))
    platform.recv()
    pos = states.joint_pos.copy()
    vel = states.joint_vel.copy()
    states.joint_pos_target = np.float32([0.2, 0.0, 0.15, 0.05])
    states.joint_vel_target = np.float32([0.5, -0.5, 0.0, 1.0])
    states.joint_effort_ff = np.float32([0.1, 0.2, -0.3, 0.0])
    states.joint_stiffness = np.float32(10.0)
    states.joint_damping = np.float32(0.3)
    platform.send()
    platform.recv()
    expected = 10.0 * (states.joint_pos_target - pos) + 0.3 * (states.joint_vel_target - vel)
    expected += states.joint_effort_ff
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(states.joint_effort, expected, atol=1e-5)


def test_joints_that_a_tendon_pulls_get_motors_of_their_own(toy_robot, toy_model, states_of):
    robot = toy_robot()
    path = toy_model(actuators='<motor tendon="string"/>')
    tendon = '<tendon><fixed name="string"><joint joint="elbow_joint" coef="1"/></fixed></tendon>'
    path.write_text(path.read_text().replace("<actuator>", f"{tendon}<actuator>"))
    states = states_of(robot)
    platform = make(states, robot, 0.002, scene=Scene(model=path))
    assert any("motors were added to 4 joints" in note for note in platform.info()["notes"])
    states.joint_effort_ff = np.float32(1.0)
    platform.send()
    platform.recv()
    assert states.joint_effort.tolist() == [1.0] * 4
