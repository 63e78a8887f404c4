"""Serving: rclpy's entities asked one by one, and what is left to the executor."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from peer import wait_for
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float32
from std_srvs.srv import Trigger

from unicon_ros import compat

pytestmark = pytest.mark.ros


class Peer:
    """A node of a context of its own, with its executor."""

    def __init__(self, name: str) -> None:
        self.context = Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(name, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def ours() -> Iterator[Peer]:
    made = Peer("ours")
    yield made
    made.close()


@pytest.fixture
def other() -> Iterator[Peer]:
    made = Peer("other")
    yield made
    made.close()


@pytest.fixture
def until(ours: Peer, other: Peer) -> Callable[[compat.Serving, Callable[[], Any], str], None]:
    """Serves rounds, and spins the other node, until something holds."""

    def turn(serving: compat.Serving, ready: Callable[[], Any], what: str) -> None:
        def served() -> bool:
            for piece in serving.round():
                piece.run()
            other.executor.spin_once(0.01)
            return bool(ready())

        wait_for(served, what)

    return turn


@pytest.fixture
def unspun(monkeypatch: pytest.MonkeyPatch, ours: Peer) -> None:
    """Our executor must not be asked: it would make a wait set."""

    def refuse(*_: Any) -> None:
        raise AssertionError("the executor was asked")

    monkeypatch.setattr(ours.executor, "wait_for_ready_callbacks", refuse)


def succeed(_: Any, response: Any) -> Any:
    response.success = True
    return response


def answer(other: Peer, name: str) -> Any:
    """Call a service, and return the future of its answer."""
    client = other.node.create_client(Trigger, name)
    assert client.wait_for_service(10.0)
    return client.call_async(Trigger.Request())


@pytest.mark.usefixtures("unspun")
def test_services_timers_and_subscriptions_are_served_without_the_executor(
    ours: Peer, other: Peer, until: Callable[..., None]
) -> None:
    heard: list[Float32] = []
    told: list[tuple[Any, Any]] = []
    ticks: list[None] = []
    alone = MutuallyExclusiveCallbackGroup()
    ours.node.create_service(Trigger, "~/go", succeed, callback_group=alone)
    ours.node.create_timer(0.01, lambda: ticks.append(None))
    ours.node.create_subscription(Float32, "heard", heard.append, 10)

    def both(message: Any, info: Any) -> None:
        told.append((message, info))

    ours.node.create_subscription(Float32, "heard", both, 10)
    serving = compat.Serving(ours.executor, lambda node: None)
    publisher = other.node.create_publisher(Float32, "heard", 10)
    other.node.create_timer(0.02, lambda: publisher.publish(Float32(data=0.5)))
    future = answer(other, "/ours/go")
    until(serving, lambda: future.done() and ticks and heard and told, "all callbacks")
    assert future.result().success
    assert heard[0].data == told[0][0].data == 0.5
    assert told[0][1]["source_timestamp"] > 0


@pytest.mark.usefixtures("unspun")
def test_a_qos_event_is_told_once_among_those_of_100_topics(
    ours: Peer, other: Peer, until: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compat.serving, "EVENTS_NS", 0)
    told: list[int] = []
    best = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    for number in range(100):

        def create(number: int = number, **options: Any) -> Any:
            return ours.node.create_publisher(Float32, f"t{number}", best, **options)

        event = {"incompatible_qos": lambda _, number=number: told.append(number)}
        compat.with_events("publisher", event, create)
    serving = compat.Serving(ours.executor, lambda node: None)
    wants = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
    other.node.create_subscription(Float32, "t77", lambda m: None, wants)
    until(serving, lambda: told, "the event")
    rounds = 0

    def again() -> bool:
        nonlocal rounds
        rounds += 1
        return rounds > 3 * compat.serving.SHARES

    until(serving, again, "more rounds")
    assert told == [77]


@pytest.mark.parametrize("what", ["client", "guard", "coroutine", "rest"])
def test_what_cannot_be_asked_alone_is_left_to_the_executor(
    ours: Peer, other: Peer, until: Callable[..., None], what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[Any] = []
    callback: Any = succeed
    if what == "client":
        other.node.create_service(Trigger, "~/asked", succeed)
        client = ours.node.create_client(Trigger, "/other/asked")
        assert client.wait_for_service(10.0)
        client.call_async(Trigger.Request()).add_done_callback(done.append)
    elif what == "guard":
        ours.node.create_guard_condition(lambda: done.append(None)).trigger()
    elif what == "coroutine":

        async def callback(_: Any, response: Any) -> Any:
            done.append(None)
            return succeed(_, response)

    else:  # a rclpy whose services have other names
        monkeypatch.setattr("unicon_ros.compat.serving._asked", lambda *_: False)
        done.append(None)
    ours.node.create_service(Trigger, "~/go", callback)
    serving = compat.Serving(ours.executor, lambda node: None)
    assert {piece.kind for piece in serving.round()} - {"events"} == {"executor"}
    future = answer(other, "/ours/go")
    until(serving, lambda: future.done() and done, "the callbacks")
    assert future.result().success


def test_a_node_beside_ours_costs_us_no_wait_set_of_ours(ours: Peer) -> None:
    beside = Node("beside", context=ours.context)
    beside.create_guard_condition(lambda: None)
    ours.executor.add_node(beside)
    ours.node.create_service(Trigger, "~/go", succeed)
    asked: list[Any] = []
    serving = compat.Serving(ours.executor, lambda node: None)
    serving._wait = lambda nodes: asked.append(nodes)  # type: ignore[assignment,func-returns-value]
    for piece in serving.round():
        piece.run()
    assert asked == [[beside]]
    ours.executor.remove_node(beside)
    beside.destroy_node()


@pytest.mark.usefixtures("unspun")
def test_a_service_that_is_destroyed_within_a_round_is_passed_over(ours: Peer) -> None:
    services = [ours.node.create_service(Trigger, f"~/go{i}", succeed) for i in range(2)]
    timer = ours.node.create_timer(0.001, lambda: None)
    pieces = list(compat.Serving(ours.executor, lambda node: None).round())
    for service in services:
        ours.node.destroy_service(service)
    ours.node.destroy_timer(timer)
    assert not any(piece.run() for piece in pieces)


def test_no_round_begins_once_the_context_is_shut_down(ours: Peer) -> None:
    serving = compat.Serving(ours.executor, lambda node: None)
    rclpy.try_shutdown(context=ours.context)
    with pytest.raises(ExternalShutdownException):
        next(serving.round())


@pytest.mark.parametrize("kind", ["asked by itself", "node with a client", "EventsExecutor"])
def test_a_round_takes_what_waits_so_that_no_rate_above_the_ticks_loses_messages(
    ours: Peer, other: Peer, until: Callable[..., None], kind: str
) -> None:
    heard: list[Float32] = []
    ours.node.create_subscription(Float32, "burst", heard.append, 10)
    executor: Any = ours.executor
    if kind == "node with a client":
        ours.node.create_client(Trigger, "nobody")
    elif kind == "EventsExecutor":
        events = pytest.importorskip("rclpy.experimental.events_executor")
        executor.remove_node(ours.node)
        executor = events.EventsExecutor(context=ours.context)
        executor.add_node(ours.node)
    serving = compat.Serving(executor, lambda node: None)
    publisher = other.node.create_publisher(Float32, "burst", 10)
    wait_for(publisher.get_subscription_count, "the subscription")

    def burst() -> bool:
        heard.clear()
        for _ in range(5):
            publisher.publish(Float32())
        time.sleep(0.1)
        for piece in serving.round():
            piece.run()
        at_once = len(heard)
        until(serving, lambda: len(heard) >= 5, "the rest")
        return at_once == 5

    wait_for(burst, "a round that takes all five")
    if executor is not ours.executor:
        executor.remove_node(ours.node)
        executor.shutdown()
