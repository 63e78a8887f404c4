"""unicon_node beside a user's plain rclpy node: one process, one executor, one thread."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from unicon_core import pacing
from unicon_ros.node import UniconNode

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]


@pytest.fixture
def context() -> Iterator[Context]:
    made = Context()
    rclpy.init(context=made, signal_handler_options=SignalHandlerOptions.NO)
    yield made
    rclpy.try_shutdown(context=made)


class Teleop(Node):
    """A user's node: commands at 50 Hz, listens, and ends the show after a while."""

    def __init__(self, context: Any, seconds: float) -> None:
        super().__init__("teleop", context=context)
        self.heard: list[JointState] = []
        self.diagnostics: list[DiagnosticArray] = []
        self.ticks = 0
        self.robot: UniconNode | None = None
        self._last = seconds / 0.02
        self.create_subscription(JointState, "joint_states", self.heard.append, 10)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, 10)
        self._commands = self.create_publisher(Twist, "cmd_vel", 10)
        self.create_timer(0.02, self._tick)

    def _tick(self) -> None:
        self.ticks += 1
        message = Twist()
        message.linear.x = 0.4
        self._commands.publish(message)
        if self.ticks >= self._last and self.robot is not None:
            self.robot.trigger_shutdown()


def test_a_users_node_lives_in_the_same_executor(context: Context, react: Path) -> None:
    executor = SingleThreadedExecutor(context=context)
    teleop = Teleop(context, 2.5)
    executor.add_node(teleop)
    overrides = [Parameter("workflow", value=str(react))]
    robot = UniconNode(context=context, parameter_overrides=overrides)
    executor.add_node(robot)
    teleop.robot = robot
    assert robot.spin(executor) == 0
    hip = teleop.heard[-1].name.index("FL_hip_joint")
    assert teleop.heard[-1].position[hip] == pytest.approx(0.5, abs=1e-5)  # 0.1 + its 0.4
    assert len(teleop.heard) > 20
    executor.shutdown()
    robot.destroy_node()
    teleop.destroy_node()


@pytest.mark.slow
def test_diagnostics_tell_rate_overruns_topics_and_then_the_fault(
    context: Context, react: Path
) -> None:
    executor = SingleThreadedExecutor(context=context)
    teleop = Teleop(context, 4.0)
    executor.add_node(teleop)
    overrides = [Parameter("workflow", value=str(react))]
    robot = UniconNode(context=context, parameter_overrides=overrides)
    executor.add_node(robot)
    teleop.robot = robot

    def told() -> list[dict[str, str]]:
        statuses = [status for array in teleop.diagnostics for status in array.status]
        running = [status for status in statuses if status.message != "inactive"]
        return [{value.key: value.value for value in status.values} for status in running]

    def press() -> None:
        if any(float(each["/joint_states hz"]) > 0.0 for each in told()):  # some ticks have ended
            robot.estop.press()

    teleop.create_timer(0.1, lambda: robot.session and press())
    assert robot.spin(executor) == 0
    statuses = [status for array in teleop.diagnostics for status in array.status]
    running = [status for status in statuses if status.message != "inactive"]
    values = next(each for each in told() if float(each["/joint_states hz"]) > 0.0)
    assert running[0].name == "/unicon: tick"
    assert running[0].hardware_id == "go2"
    assert values["workflow"] == "react"
    assert float(values["tick_p50_us"]) <= float(values["tick_p99_us"])
    assert float(values["tick_p99_us"]) <= float(values["tick_max_us"])
    assert float(values["rate_hz"]) > 0.0
    assert "/cmd_vel hz" in values
    assert statuses[-1].level == b"\x02"
    assert statuses[-1].message == (
        "emergency stop by the service ~/estop; latched until ~/clear_estop"
    )
    values = {value.key: value.value for value in statuses[-1].values}
    assert values["estop"] == "latched"
    executor.shutdown()
    robot.destroy_node()
    teleop.destroy_node()


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_hundred_starts_and_stops_leave_nothing_behind(
    context: Context, react: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    psutil = pytest.importorskip("psutil")
    # The suite collects young garbage only, and a workflow of 6 MB is old once its run has ended.
    monkeypatch.setattr(pacing, "gc", gc)
    process = psutil.Process()
    executor = SingleThreadedExecutor(context=context)
    overrides = [
        Parameter("workflow", value=str(react)),
        Parameter("autostart", value=False),
    ]
    robot = UniconNode(context=context, parameter_overrides=overrides)
    executor.add_node(robot)
    sizes: list[int] = []
    programs: list[weakref.ref[Any]] = []
    starts = 0

    def act() -> None:
        nonlocal starts
        state = robot._label()
        if state == "active":
            assert robot.session is not None
            assert robot.runner is not None
            robot.session.controls.stop()
            programs.append(weakref.ref(robot.runner.program))
            sizes.append(process.memory_info().rss)
        elif starts >= 100:
            robot.trigger_shutdown()
        else:
            starts += 1
            assert robot._start()[0], robot.error

    robot.create_timer(0.1, act)
    assert robot.spin(executor) == 0
    assert starts == 100
    assert robot.fault == ""
    gc.collect()
    assert sum(program() is not None for program in programs) <= 1  # of the last record
    early, late = sizes[30], sizes[-1]
    assert late - early < 100_000_000, sizes  # 70 rounds; a leaked workflow would take 6 MB each
    executor.shutdown()
    robot.destroy_node()
