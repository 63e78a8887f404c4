"""base_footprint below the feet, the switches of frames, and covariances of the default map."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu

from unicon_core.models.find import pick_model
from unicon_core.models.load import load_model
from unicon_core.models.loaded import about, multiply, rotate
from unicon_core.models.posed import Footprint, PosedModel, foot_geoms
from unicon_core.robots import load_robot

pytestmark = [pytest.mark.ros, pytest.mark.timeout(90)]


def footprint(robot: Any) -> tuple[Footprint, Any, Any]:
    joint_pos, quat = np.nan_to_num(robot.rest_joint_pos.copy()), np.array((1.0, 0.0, 0.0, 0.0))
    loaded = load_model(pick_model(robot), robot, quiet=True)
    found = Footprint.of(loaded, robot, joint_pos, quat)
    assert found is not None
    return found, joint_pos, quat


def test_it_is_level_on_the_floor_below_the_feet_and_points_as_the_base() -> None:
    pytest.importorskip("mujoco")
    found, joint_pos, quat = footprint(load_robot("go2"))
    found.update()
    upright = found.position.copy()
    assert upright[2] < -0.1
    assert abs(upright[1]) < 1e-6
    assert np.allclose(found.quat, (1.0, 0.0, 0.0, 0.0))
    yaw, pitch = about(np.array((0.0, 0.0, 1.0)), 0.7), about(np.array((0.0, 1.0, 0.0)), 0.2)
    roll = about(np.array((1.0, 0.0, 0.0)), -0.1)
    quat[:] = yaw
    found.update()
    np.testing.assert_allclose(found.position, upright, atol=1e-9)
    quat[:] = multiply(multiply(yaw, pitch), roll)
    found.update()
    # Footprint to world is the yaw alone.
    np.testing.assert_allclose(multiply(quat, found.quat), yaw, atol=1e-9)
    level = rotate(quat, found.position)
    assert level[2] < upright[2]  # it leans on fewer feet, and the base is above the lowest
    joint_pos[:] = np.nan
    before = found.position.copy()
    found.update()
    np.testing.assert_array_equal(found.position, before)


@pytest.mark.parametrize("name", ["go2", "g1_29dof", "t1"])
def test_a_robot_that_stands_in_the_simulator_stands_on_it(name: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    robot = load_robot(name)
    try:
        found, joint_pos, quat = footprint(robot)
    except Exception as error:  # assets that are not at hand
        pytest.skip(str(error))
    turned = about(np.array((0.6, 0.8, 0.0)), 0.05)
    quat[:] = turned
    joint_pos += 0.01 * np.arange(len(joint_pos)) % 0.05
    found.update()
    posed = PosedModel(load_model(pick_model(robot), robot, quiet=True))
    posed.put(joint_pos, (0.0, 0.0, 10.0, *turned))
    floor = rotate(turned, found.position)[2] + 10.0
    model, data = posed.loaded.model, posed.data
    geoms = [g for group in foot_geoms(model, robot.feet).values() for g in group]
    lowest = min(_lowest(mujoco, model, data, g) for g in geoms)
    assert floor == pytest.approx(lowest, abs=2e-3)


def _lowest(mujoco: Any, model: Any, data: Any, geom: int) -> float:
    """The support of a geom's box downwards, by its corners; a sphere's is its radius."""
    if model.geom_type[geom] == int(mujoco.mjtGeom.mjGEOM_SPHERE):
        return float(data.geom_xpos[geom][2] - model.geom_size[geom][0])
    corners = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T * model.geom_aabb[geom, 3:]
    turn = data.geom_xmat[geom].reshape(3, 3)
    return float(
        (data.geom_xpos[geom] + (corners + model.geom_aabb[geom, :3]) @ turn.T)[:, 2].min()
    )


def test_an_arm_has_none() -> None:
    pytest.importorskip("mujoco")
    robot = load_robot("go2")
    loaded = load_model(pick_model(robot), robot, quiet=True)
    hand: Any = SimpleNamespace(kind="hand", feet=robot.feet)
    assert Footprint.of(loaded, hand, np.zeros(12), np.zeros(4)) is None
    footless: Any = SimpleNamespace(kind="arm", feet=())
    assert Footprint.of(loaded, footless, np.zeros(12), np.zeros(4)) is None


@pytest.mark.parametrize(
    ("off", "frames", "static", "description"),
    [
        ((), {"base_footprint", "FL_thigh"}, True, True),
        (("link_tf",), {"base_footprint"}, False, True),
        (("base_footprint",), {"FL_thigh"}, True, True),
        (("robot_description",), {"base_footprint", "FL_thigh"}, True, False),
        (("link_tf", "base_footprint", "robot_description"), set(), False, False),
    ],
)
def test_each_is_switched_off_by_a_parameter(
    runs: Callable[..., Any],
    sway: Path,
    off: tuple[str, ...],
    frames: set[str],
    static: bool,
    description: bool,
) -> None:
    switches = [part for name in off for part in ("-p", f"publish_{name}:=false")]
    run = runs(sway, frame_prefix="r1/", ros_args=switches)
    said = b"".join(out._encode() for out in run.session.outgoing if out.part == "links")
    for name in ("base_footprint", "FL_thigh"):
        assert (f"r1/{name}\0".encode() in said) is (name in frames)
    node = run.session.node
    count = {name: node.count_publishers(name) for name in ("/tf_static", "/robot_description")}
    assert count == {"/tf_static": int(static), "/robot_description": int(description)}
    assert any(out.topic == "/tf" and out.part == "map" for out in run.session.outgoing)


def test_the_default_map_tells_covariances(runs: Callable[..., Any], sway: Path) -> None:
    run = runs(sway)
    said = {out.spec.topic: out._encode() for out in run.session.outgoing}
    odom = deserialize_message(said["odom"], Odometry)
    for covariance in (odom.pose.covariance, odom.twist.covariance):
        np.testing.assert_array_equal(covariance.reshape(6, 6), np.diag([1e-6] * 6))
    imu = deserialize_message(said["imu/data"], Imu)
    for got, diagonal in (
        (imu.orientation_covariance, (1e-4, 1e-4, 1e-2)),
        (imu.angular_velocity_covariance, (4e-4,) * 3),
        (imu.linear_acceleration_covariance, (9e-2,) * 3),
    ):
        np.testing.assert_array_equal(got.reshape(3, 3), np.diag(diagonal))
