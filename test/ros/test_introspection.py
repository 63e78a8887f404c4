"""What any ROS tool learns of the states: the latched layout, ~/list_states and ~/debug."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from peer import wait_for
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from std_srvs.srv import Trigger

from unicon_base.errors import UniconError
from unicon_core.states import Layout
from unicon_core.workflow import load_workflow
from unicon_ros.bridge import RosSession
from unicon_ros.bridge.bindings import arrays_of
from unicon_ros.bridge.introspection import debug_encoder

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STATES = """\
schema: unicon.workflow/1
robot: go2
platform: fake
rate: 50
states:
  extremes: {shape: [4], dtype: float64}
  whole: {shape: [2], dtype: int64}
  flag: {dtype: bool}
flow: {hold: {}}
"""


@pytest.fixture
def tool() -> Iterator[Any]:
    """A plain node that listens: `tool.hear(type, topic, qos)` returns a list that grows."""
    context = rclpy.context.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("tool", context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def hear(kind: Any, topic: str, qos: Any = 10) -> list[Any]:
        heard: list[Any] = []
        node.create_subscription(kind, topic, heard.append, qos)
        return heard

    def until(ready: Callable[[], object], what: str) -> None:
        def spun() -> bool:
            executor.spin_once(0.02)
            return bool(ready())

        wait_for(spun, what)

    yield SimpleNamespace(node=node, hear=hear, until=until)
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown(context=context)


def debugged(*chosen: str, rate: str = "50.0") -> list[str]:
    """Return the ROS arguments that ask for these states."""
    return ["-p", f"debug_states:={json.dumps(chosen)}", "-p", f"debug_rate:={rate}"]


def test_a_late_joiner_learns_every_state_and_the_service_says_the_same(
    runs: Callable[..., Any], react: Path, tool: Any
) -> None:
    run = runs(react, namespace="/robot1", ros_args=["-r", "joint_states:=legs"])
    wait_for(lambda: int(run.program.states["tick"]) > 20, "ticks")
    heard = tool.hear(String, "/robot1/unicon/layout", LATCHED)
    tool.until(lambda: heard, "the layout")
    client = tool.node.create_client(Trigger, "/robot1/unicon/list_states")
    tool.until(client.service_is_ready, "the service")
    asked = client.call_async(Trigger.Request())
    tool.until(asked.done, "an answer")
    assert asked.result().success
    assert asked.result().message == heard[0].data
    layout = Layout.from_json(heard[0].data)
    assert layout == run.program.states.layout
    told = json.loads(heard[0].data)
    assert told["schema"] == "unicon.layout/1"
    assert (told["robot"], told["platform"], told["period_s"]) == ("go2", "fake", 0.005)
    assert told["layout_hash"] == layout.hash
    assert "recv" in told["writers"]["joint_pos"]
    assert "ros inputs" in told["writers"]["velocity_command"]
    assert told["topics"]["/robot1/legs"]["direction"] == "out"
    assert told["topics"]["/robot1/cmd_vel"] == {
        "type": "geometry_msgs/msg/Twist",
        "direction": "in",
        "states": ["velocity_command"],
    }
    lines = heard[0].data.splitlines()  # what people read
    (of_joint_pos,) = (line for line in lines if line.startswith('{"name": "joint_pos"'))
    assert '"unit": "rad"' in of_joint_pos


def test_chosen_states_are_shown_by_name_with_their_units(
    runs: Callable[..., Any], react: Path, tool: Any
) -> None:
    chosen = ("joint_pos_*", "base_quat[1:3]", "joint_vel[FL_calf_joint]", "tick")
    run = runs(react, ros_args=debugged(*chosen))
    heard = tool.hear(DiagnosticArray, "/unicon/debug")
    tool.until(lambda: len(heard) > 5, "messages")
    run.end()
    status = {each.name: each for each in heard[-1].status}
    assert list(status) == ["joint_pos_target", "base_quat[1:3]", chosen[2], "tick"]
    targets = status["joint_pos_target"]
    assert (targets.message, targets.hardware_id) == ("rad", "go2")
    wanted = dict(zip(run.program.robot.joint_names, run.program.states["joint_pos_target"]))
    values = {each.key: float(each.value) for each in targets.values}
    assert values.keys() == wanted.keys()
    assert np.allclose(list(values.values()), list(wanted.values()), atol=1e-4)
    assert [each.key for each in status["base_quat[1:3]"].values] == ["x", "y"]
    assert [each.key for each in status[chosen[2]].values] == ["FL_calf_joint"]
    ticks = [int(message.status[-1].values[0].value) for message in heard]
    assert ticks == sorted(set(ticks))
    stamps = [(each.header.stamp.sec, each.header.stamp.nanosec) for each in heard]
    assert stamps == sorted(set(stamps))


def test_ticks_pay_nothing_for_it_and_nobody_is_told_where_nobody_listens(
    runs: Callable[..., Any], react: Path
) -> None:
    plain = runs(react)
    run = runs(react, ros_args=debugged("joint_pos"))
    assert [b.name for b in run.program.blocks] == [b.name for b in plain.program.blocks]
    said: list[bytes] = []
    run.session.introspection._debug._publish = said.append
    wait_for(lambda: int(run.program.states["tick"]) > 100, "half a second")
    assert said == []


def test_a_paused_simulator_and_an_ended_run_are_quiet_or_alive(
    runs: Callable[..., Any], sway: Path, tool: Any
) -> None:
    run = runs(sway, ros_args=debugged("tick"))
    heard = tool.hear(DiagnosticArray, "/unicon/debug")
    tool.until(lambda: len(heard) > 2, "messages")
    assert run.session.controls.pause()[0]
    tool.until(lambda: run.session.controls.paused and len(heard) > 10, "messages of a pause")
    run.runner.stop()
    run.session.controls.paused = False
    wait_for(lambda: not run.alive, "the end")


@pytest.mark.parametrize(
    ("arguments", "wrong"),
    [
        (debugged("joint_posi"), "no state 'joint_posi'; did you mean 'joint_pos'"),
        (debugged("joint_q*"), "no state is like 'joint_q*'"),
        (debugged("joint_pos[40]"), "joint_pos[40] is out of range"),
        (debugged("joint_pos[FR]"), "has no element 'FR'"),
        (debugged("joint_pos["), "does not parse"),
        (debugged("=joint_pos"), "is not a state"),
        (debugged(*["joint_pos"] * 3, rate="0.0"), "debug_rate is 0.0"),
        (debugged("joint_pos", rate=".nan"), "debug_rate is nan"),
        (debugged("joint_pos", rate="often"), "debug_rate is 'often'"),
        (["-p", "debug_states:=true"], "debug_states is True; give"),
        (["-p", "debug_states:=[1, 2]"], "debug_states is [1, 2]; give"),
    ],
)
def test_a_wrong_choice_is_one_line(react: Path, arguments: list[str], wrong: str) -> None:
    def attached() -> None:
        with ExitStack() as rest:
            session = rest.enter_context(closing(RosSession(ros_args=arguments, warn=print)))
            program = rest.enter_context(closing(load_workflow(react, hooks=[session.hook])))
            session.introspection.attach(program, [], session.arrays)

    with pytest.raises(UniconError) as told:
        attached()
    assert wrong in str(told.value)
    assert "debug" in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("value", ["[]", "['']", "['joint_pos']"])
def test_nothing_chosen_is_nothing(react: Path, value: str) -> None:
    arguments = ["-p", f"debug_states:={value}"]
    with ExitStack() as rest:
        session = rest.enter_context(closing(RosSession(ros_args=arguments, warn=print)))
        program = rest.enter_context(closing(load_workflow(react, hooks=[session.hook])))
        session.introspection.attach(program, [], session.arrays)
        publishers = session.node.count_publishers("/unicon/debug")
        assert publishers == (value == "['joint_pos']")


def test_numbers_of_any_size_have_room(tmp_path: Path) -> None:
    path = tmp_path / "states.yaml"
    path.write_text(STATES)
    program = load_workflow(path)
    states = program.states
    states["extremes"][...] = (-1.23456789e-308, math.nan, -math.inf, 0.1)
    states["whole"][...] = (-(2**63), 2**63 - 1)
    states["flag"][...] = True
    raw = debug_encoder(["extremes", "whole", "flag"], program, arrays_of(program)).encode()
    program.close()
    message = deserialize_message(raw, DiagnosticArray)
    values = [[each.value.strip() for each in status.values] for status in message.status]
    assert values == [
        ["-1.2346e-308", "nan", "-inf", "0.1"],
        [str(-(2**63)), str(2**63 - 1)],
        ["1"],
    ]


def test_more_numbers_than_the_slack_has_room_for_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "states.yaml"
    path.write_text(STATES.replace("shape: [4]", "shape: [257]"))
    program = load_workflow(path)
    with pytest.raises(UniconError, match="257 numbers are asked for, 256 at most"):
        debug_encoder(["extremes"], program, arrays_of(program))
    program.close()


def test_a_node_tells_its_states_once_it_is_configured(
    nodes: Callable[..., Any], peers: Callable[..., Any], react: Path
) -> None:
    nodes("--ros-args", "-p", f"workflow:={react}", "-p", "autostart:=false")
    words = ("list_states", "+configure", "list_states", "+cleanup", "list_states")
    caller = peers("caller", "/unicon", *words)
    assert caller.end()[0] == 0
    answers = [line for line in caller.lines if line["word"] == "list_states"]
    assert [each["success"] for each in answers] == [False, True, False]
    assert "no workflow is built" in answers[0]["message"]
