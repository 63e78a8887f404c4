"""Arrows of the feet for RViz, to a real subscriber: where the simulator has contacts, how hard."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from unicon_core.models.find import pick_model
from unicon_core.models.load import load_model
from unicon_core.models.loaded import about, rotate
from unicon_core.robots import load_robot
from unicon_ros.bridge.robot_frames import MARKED, ContactArrows, Feet

mujoco = pytest.importorskip(
    "mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'"
)
pytestmark = [pytest.mark.ros, pytest.mark.timeout(90)]
ROOT = Path(__file__).resolve().parents[2]


def heard(domain: int, until: Callable[[list[Any]], bool], patience: float = 20.0) -> list[Any]:
    """Return the messages of topic `contacts` until a condition holds."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    kind = pytest.importorskip("visualization_msgs.msg", reason="no visualization_msgs").MarkerArray
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("listener", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    messages: list[Any] = []
    node.create_subscription(kind, "contacts", messages.append, 10)
    end = time.monotonic() + patience
    while not until(messages):
        assert time.monotonic() < end, len(messages)
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown(context=context)
    return messages


def test_a_subscriber_gets_an_arrow_for_each_foot_that_bears(
    runs: Callable[..., Any], sway: Path, domain: int
) -> None:
    run = runs(sway, frame_prefix="r1/")
    (out,) = [out for out in run.session.outgoing if out.spec.topic == "contacts"]
    while run.alive and int(run.program.states["tick"]) < 300:
        time.sleep(0.02)
    assert out.published == 0  # nobody listens: nothing is computed
    messages = heard(domain, lambda got: len(got) >= 10)
    base = np.array(run.program.states["base_pos_w"])
    quat = np.array(run.program.states["base_quat"])
    at = {f: np.array(run.program.platform.data.body(f).xpos) for f in run.program.robot.feet}
    run.end()
    assert out.published >= 10
    for markers in (message.markers for message in messages):
        assert [each.ns for each in markers] == list(run.program.robot.feet)
        assert {(each.type, each.action, each.header.frame_id) for each in markers} == {
            (0, 0, "r1/base_link")
        }
    arrows = messages[-1].markers
    assert [each.color.a for each in arrows] == [1.0] * 4
    assert messages[0].markers[0].header.stamp != arrows[0].header.stamp
    lengths = []
    for each in arrows:
        begin, end = (np.array((p.x, p.y, p.z)) for p in each.points)
        lengths.append(float(np.linalg.norm(end - begin)))
        place = rotate(quat, begin) + base
        assert np.abs(place - at[each.ns]).max() < 0.04  # the sole of the foot
    assert sum(lengths) == pytest.approx(1.0, abs=0.1)


class Bearing(Feet):
    """Feet that bear a quarter of the weight each, whatever the torques."""

    def __call__(self, *given: Any) -> bool:
        self.force[:] = 0.25 * self.weight
        return super().__call__(*given[:-1], None)


def arrows(kind: type[Feet] = Feet) -> tuple[ContactArrows, dict[str, Any]]:
    """Return the arrows of a go2, and the states that they are made of."""
    robot = load_robot("go2")
    loaded = load_model(pick_model(robot), robot, quiet=True)
    joints = np.nan_to_num(robot.default_joint_pos)
    quat, none = np.array((1.0, 0.0, 0.0, 0.0)), np.zeros(len(joints))
    states = dict(zip(MARKED, (quat, np.zeros(3), joints, none, none.copy()), strict=True))
    states["stamp_ns"] = np.zeros((), np.int64)
    return ContactArrows(kind(loaded, robot), states, "base"), states


def test_a_robot_that_hangs_and_missing_measurements_show_nothing() -> None:
    made, states = arrows()
    made._seen[:] = 1.0
    made.update()  # no torques: the legs carry nothing
    assert not made._seen.any()
    for name in MARKED:
        made, states = arrows()
        states[name][0] = np.nan
        made._seen[:] = 1.0
        made.update()
        assert not made._seen.any(), name
        assert np.isfinite(made._ends).all()


def test_arrows_point_up_in_the_world_whatever_the_base_does() -> None:
    made, states = arrows(Bearing)
    states["base_quat"][:] = about(np.array((0.6, 0.8, 0.0)), 0.4)
    made.update()
    assert made._seen.all()
    for begin, end in made._ends:
        up = rotate(states["base_quat"], end - begin)
        np.testing.assert_allclose(up, (0.0, 0.0, 0.25), atol=1e-6)


def test_the_view_of_rviz_shows_the_topic() -> None:
    view = yaml.safe_load((ROOT / "config/rviz/unicon.rviz").read_text("utf-8"))
    shown = {
        each["Topic"]["Value"]
        for each in view["Visualization Manager"]["Displays"]
        if each["Class"] == "rviz_default_plugins/MarkerArray" and each["Enabled"]
    }
    assert shown == {"contacts"}


def test_an_arm_has_no_such_topic(runs: Callable[..., Any], tmp_path: Path) -> None:
    path = tmp_path / "arm.yaml"
    text = "schema: unicon.workflow/1\nrobot: arx_x5\nplatform: fake\nrate: 100\nflow: hold\n"
    path.write_text(text)
    run = runs(path)
    assert "contacts" not in {out.spec.topic for out in run.session.outgoing}
