"""Others in the ROS graph, told once; diagnostics that tell robots and publishers apart."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from unicon_base.errors import PlatformError
from unicon_core.workflow import load_workflow

pytestmark = [pytest.mark.ros, pytest.mark.timeout(90)]


class Visitor:
    """Nodes of other people, and what /diagnostics says."""

    def __init__(self) -> None:
        self.context = Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._nodes: list[Any] = []
        self.heard: list[Any] = []

    def node(self, name: str, **options: Any) -> Any:
        made = rclpy.create_node(name, context=self.context, **options)
        self._nodes.append(made)
        self._executor.add_node(made)
        return made

    def listen(self) -> None:
        node = self.node("listener")
        node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 10)

    def _take(self, array: Any) -> None:
        self.heard += array.status

    def until(self, holds: Callable[[], Any], what: str) -> Any:
        end = time.monotonic() + 30.0
        while not (found := holds()):
            assert time.monotonic() < end, what
            self._executor.spin_once(0.1)
        return found

    def close(self) -> None:
        self._executor.shutdown()
        for node in self._nodes:
            node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def visitor() -> Iterator[Visitor]:
    made = Visitor()
    yield made
    made.close()


def values(status: Any) -> dict[str, str]:
    return {each.key: each.value for each in status.values}


@pytest.mark.slow
def test_who_harms_a_run_is_told_once(runs: Any, visitor: Visitor, sway: Path) -> None:
    run = runs(sway)
    visitor.listen()
    visitor.until(lambda: run.session.incoming and visitor.heard, "the first diagnostics")
    time.sleep(1.2)
    assert run.warnings == [line for line in run.warnings if "is left out" in line]
    before = len(run.warnings)
    stranger = visitor.node("stranger", namespace="/far")
    stranger.create_publisher(TwistStamped, "/cmd_vel", 1)
    stranger.create_publisher(Clock, "/clock", 1)
    visitor.node("unicon")
    visitor.until(lambda: len(run.warnings) >= before + 3, "three warnings")
    time.sleep(2.2)
    told = sorted(run.warnings[before:])
    assert len(told) == 3, told
    assert told[0].startswith("there are 2 nodes /unicon in this ROS domain: ")
    assert told[1].startswith("topic /clock: node /far/stranger publishes it too, ")
    assert told[2].startswith(
        "topic /cmd_vel: node /far/stranger publishes geometry_msgs/msg/TwistStamped, which nobody "
        "hears here, since the map says geometry_msgs/msg/Twist; "
    )
    visitor.until(lambda: any(s.message in told for s in visitor.heard), "a warning")


def test_a_run_tells_its_diagnostics_by_its_full_name_and_how_it_ended(
    runs: Any, visitor: Visitor, sway: Path, react: Path
) -> None:
    visitor.listen()
    for path, space in ((sway, "one"), (react, "two")):
        runs(path, namespace=space)
    names = {"/one/unicon: tick", "/two/unicon: tick"}

    def both() -> dict[str, Any]:
        last = {status.name: status for status in visitor.heard}
        return last if set(last) == names and all(map(values, last.values())) else {}

    last = visitor.until(both, "two robots")
    assert {status.hardware_id for status in last.values()} == {"one/go2", "two/go2"}
    for space in ("one", "two"):
        told = values(last[f"/{space}/unicon: tick"])
        assert f"/{space}/cmd_vel hz" in told
        assert told["workflow"] == ("sway" if space == "one" else "react")


def test_the_last_status_tells_the_fault(runs: Any, visitor: Visitor, sway: Path) -> None:
    visitor.listen()
    run = runs(sway)
    visitor.until(lambda: visitor.heard, "the first diagnostics")
    run.session.estop.press()
    run.end()
    last = visitor.until(
        lambda: next((s for s in visitor.heard if s.level == b"\x02"), None), "the end"
    )
    assert last.message == ("emergency stop by the service ~/estop; latched until ~/clear_estop")


def test_several_of_ours_at_one_topic_are_told_apart(
    runs: Any, visitor: Visitor, sway: Path, tmp_path: Path
) -> None:
    path = tmp_path / "both.yaml"
    entry = "topic: {}, type: std_msgs/msg/Float64, fields: {{data: 'velocity_command[0]'}}"
    fast, slow = (f"{{{entry.format(name)}, rate: {rate}}}" for name, rate in (("a", 50), ("b", 5)))
    heard = f"{{{entry.format('speed')}}}"
    path.write_text(f"publish: [{fast}, {slow}]\nsubscribe: [{heard}]\n")
    run = runs(sway, map=path, ros_args=["-r", "a:=speed", "-r", "b:=speed"])
    visitor.listen()

    def whole() -> dict[str, str] | None:
        told = map(values, visitor.heard)
        return next((v for v in told if float(v.get("/speed (in) hz", 0.0)) > 40.0), None)

    told = visitor.until(whole, "a whole second")
    rates = {key: float(value) for key, value in told.items() if key.startswith("/speed")}
    assert sorted(rates) == ["/speed (in) hz", "/speed (map) 2 hz", "/speed (map) hz"]
    assert 1.0 < rates["/speed (map) 2 hz"] < 10.0 < 30.0 < rates["/speed (map) hz"]
    sent = [out.published for out in run.session.outgoing if out.topic == "/speed"]
    assert len(sent) == 2
    assert sum(sent) <= run.session.counts()["topics"]["/speed"]["published"]


def test_platform_ros_names_a_publisher_of_another_type(visitor: Visitor, tmp_path: Path) -> None:
    visitor.node("driver").create_publisher(Twist, "/joint_states", 1)
    path = tmp_path / "behind.yaml"
    path.write_text(
        "{robot: go2, platform: ros, platforms: {ros: {connect: 2.0}}, rate: 50, flow: hold}"
    )
    with pytest.raises(PlatformError) as error:
        load_workflow(path)
    assert "node /driver publishes geometry_msgs/msg/Twist, which nobody hears" in str(error.value)
