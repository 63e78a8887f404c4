"""Whatever raises in a build, a run, a close or a callback is told; the node damps and lives on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy")

from estop_platform import events
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from robot_host import Caller, Host, wait_for, write_workflow

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]


@pytest.fixture
def caller() -> Iterator[Caller]:
    made = Caller()
    yield made
    made.close()


@pytest.fixture
def host(tmp_path: Path) -> Iterator[Callable[..., tuple[Host, Path]]]:
    started: list[Host] = []

    def start(*parameters: str, **options: Any) -> tuple[Host, Path]:
        path, log = write_workflow(tmp_path, **options)
        given = (f"workflow:={path}", *parameters)
        arguments = [part for text in given for part in ("-p", text)]
        started.append(Host("node", "--ros-args", *arguments))
        return started[-1], log

    yield start
    for each in started:
        each.kill()


def test_a_run_that_raises_damps_and_leaves_the_node_inactive(
    host: Callable[..., tuple[Host, Path]], caller: Caller
) -> None:
    node, log = host("autostart:=false", fails="recv")
    assert caller.call("start").success
    wait_for(lambda: events(log, "close"), "the damping")
    caller.become("inactive")
    assert node.interrupt() == 0
    assert "the cable is out" in node.said
    assert "OSError" in node.said
    assert events(log, "send")[-1] < events(log, "close")[0]


def test_a_run_that_raises_is_exit_status_3_where_it_is_asked_for(
    host: Callable[..., tuple[Host, Path]],
) -> None:
    node, log = host("exit_on_fault:=true", fails="recv")
    assert node.end() == 3, node.said
    assert len(events(log, "close")) == 1


def test_a_close_that_raises_does_not_hide_the_fault(
    host: Callable[..., tuple[Host, Path]], caller: Caller
) -> None:
    node, log = host(fails="close")
    wait_for(lambda: events(log, "send"), "commands")
    assert caller.call("estop").success
    caller.become("inactive")
    assert node.interrupt() == 0
    assert "emergency stop by the service ~/estop" in node.said
    assert "the cable is out" in node.said


def test_a_build_that_raises_leaves_the_node_unconfigured(
    host: Callable[..., tuple[Host, Path]], caller: Caller
) -> None:
    node, _ = host("autostart:=false", fails="build")
    answer = caller.call("start")
    assert not answer.success
    assert "no such port" in answer.message
    assert caller.state() == "unconfigured"
    assert node.interrupt() == 0
    assert "no such port" in node.said


def test_a_service_that_raises_answers_with_the_reason() -> None:
    from std_srvs.srv import Trigger

    from unicon_ros.bridge.own_node import add_services

    made: list[Any] = []
    node = SimpleNamespace(
        create_service=lambda kind, name, callback: made.append(callback),
        get_logger=lambda: SimpleNamespace(error=lambda text: None),
    )

    def act() -> tuple[bool, str]:
        raise ValueError("mine")

    add_services(node, {"act": act}, print)
    response = made[0](Trigger.Request(), Trigger.Response())
    assert not response.success
    assert response.message == "~/act failed: ValueError: mine"


def test_a_callback_that_raises_in_an_idle_node_does_not_end_it() -> None:
    import rclpy

    from unicon_ros.node import UniconNode

    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    executor = SingleThreadedExecutor(context=context)
    mine = Node("mine", context=context)
    executor.add_node(mine)
    robot = UniconNode(context=context, parameter_overrides=[Parameter("autostart", value=False)])
    executor.add_node(robot)
    calls: list[int] = []

    def act() -> None:
        calls.append(1)
        if len(calls) == 3:
            robot.trigger_shutdown()
        raise ZeroDivisionError("mine")

    mine.create_timer(0.05, act)
    try:
        assert robot.spin(executor) == 0
        assert len(calls) >= 3
    finally:
        executor.shutdown()
        robot.destroy_node()
        mine.destroy_node()
        rclpy.try_shutdown(context=context)
