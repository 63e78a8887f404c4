"""Models that lack something are mended: meshes, a floor, a floating base, motors."""

from __future__ import annotations

import pytest

from unicon_base.errors import ModelError
from unicon_core.models.load import load_model
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.mujoco import make
from unicon_core.robots import load_robot
from unicon_core.states import States

URDF = """
<robot name="toy">
  <link name="box">
    <inertial><mass value="5"/><inertia ixx=".05" iyy=".05" izz=".05" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual><geometry><mesh filename="package://toy/meshes/box.stl"/></geometry></visual>
    <collision><geometry><box size="0.4 0.3 0.1"/></geometry></collision>
  </link>
  {limbs}
</robot>
"""

LIMB = """
  <link name="{name}_link">
    <inertial><mass value="0.5"/>
      <inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 -0.1"/><geometry><sphere radius="0.03"/></geometry></collision>
  </link>
  <joint name="{name}_joint" type="revolute">
    <parent link="box"/><child link="{name}_link"/><origin xyz="{x} {y} 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="7" velocity="20"/>
  </joint>
"""

PLACES = {"shoulder": (1, 1), "elbow": (1, -1), "wrist": (-1, 1), "finger": (-1, -1)}


def stand(states, robot, platform, ticks=100):
    states.joint_pos_target = robot.default_joint_pos
    states.joint_stiffness = robot.joint_stiffness
    states.joint_damping = robot.joint_damping
    for _ in range(ticks):
        platform.send()  # type: ignore[attr-defined]
    platform.recv()  # type: ignore[attr-defined]


def test_urdf_gets_base_floor_and_motors(tmp_path, toy_robot, states_of):
    limbs = "".join(LIMB.format(name=n, x=0.2 * x, y=0.15 * y) for n, (x, y) in PLACES.items())
    path = tmp_path / "toy.urdf"
    path.write_text(URDF.format(limbs=limbs))
    robot = toy_robot()
    states = states_of(robot)
    platform = make(states, robot, 0.01, scene=Scene(model=path))
    info = platform.info()
    assert info["base"] == "box"
    assert info["effort_upper"]["wrist_joint"] == 7.0  # the URDF's, below the robot file's 9
    assert info["notes"] == [
        "a URDF has no floating base: body 'box' got a free joint",
        "the model has no surroundings: a floor was added",
        "motors were added to 4 joints without one: "
        "shoulder_joint, elbow_joint, wrist_joint, finger_joint",
    ]
    stand(states, robot, platform)
    assert states.base_pos_w[2] == pytest.approx(0.13, abs=0.02)
    assert states.projected_gravity[2] < -0.99


def with_mesh(path, geom):
    text = path.read_text()
    text = text.replace(
        "<worldbody>", '<asset><mesh name="skin" file="skin.stl"/></asset><worldbody>'
    )
    path.write_text(text.replace('<site name="imu"', geom + '<site name="imu"'))
    return path


def test_absent_meshes_are_left_out_with_one_line(toy_robot, toy_model, states_of):
    geom = '<geom type="mesh" mesh="skin" contype="0" conaffinity="0"/>'
    path = with_mesh(toy_model(), geom + '<geom type="mesh" mesh="skin"/>')
    robot = toy_robot()
    platform = make(states_of(robot), robot, 0.01, scene=Scene(model=path))
    line = "1 mesh files are absent (first: skin.stl): 2 geoms left out, 1 of them may collide"
    assert platform.info()["notes"][0] == line
    assert load_model(path, robot).absent == {path: line}
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n"
    path.with_name("skin.stl").write_text(pointer)
    line += "; 1 of the files is a Git LFS pointer: run 'git lfs pull'"
    assert load_model(path, robot).absent == {path: line}


def test_body_that_weighs_nothing_without_its_mesh_is_an_error(toy_robot, toy_model, states_of):
    geom = '<body name="hat"><joint name="hat_joint"/><geom type="mesh" mesh="skin"/></body>'
    path = with_mesh(toy_model(), geom)
    robot = toy_robot()
    lacks = pytest.raises(ModelError, match=r"mass and inertia.*'hat'")
    with lacks:
        make(states_of(robot), robot, 0.01, scene=Scene(model=path))


def test_actuator_dynamics_are_left_out(toy_robot, toy_model, states_of):
    actuators = "".join(
        f'<position name="{n}" joint="{n}_joint" kp="5" timeconst="0.1"/>' for n in PLACES
    )
    robot = toy_robot()
    states = states_of(robot)
    platform = make(states, robot, 0.002, scene=Scene(model=toy_model(actuators=actuators)))
    assert platform.model.na == 0
    states.joint_effort_ff = 1.0
    platform.send()
    platform.recv()
    assert states.joint_effort.tolist() == [1.0] * 4  # at once


def test_second_actuator_of_a_joint_is_silent(toy_robot, toy_model, states_of):
    actuators = "".join(
        f'<position joint="{n}_joint" kp="5"/><velocity joint="{n}_joint" kv="3"/>' for n in PLACES
    )
    robot = toy_robot()
    states = states_of(robot)
    platform = make(states, robot, 0.002, scene=Scene(model=toy_model(actuators=actuators)))
    platform.data.qvel[platform.model.jnt_dofadr[2:]] = 5.0
    states.joint_effort_ff = 1.0
    platform.send()
    platform.recv()
    assert states.joint_effort.tolist() == [1.0] * 4


@pytest.mark.parametrize(
    ("robot_name", "model"),
    [
        ("go2", "assets:models/go2/go2.xml"),
        ("go1", "assets:models/go1/go1.xml"),
        ("g1_29dof", "assets:models/g1_29dof/g1_29dof.xml"),
    ],
)
def test_models_of_others_load(assets, robot_name, model):
    from unicon_core.states import standard_states

    robot = load_robot(robot_name)
    states = States(standard_states(robot.joint_names))
    platform = make(states, robot, 0.02, scene=Scene(model=model))
    stand(states, robot, platform, ticks=25)
    assert states.projected_gravity[2] < -0.9  # up after half a second
