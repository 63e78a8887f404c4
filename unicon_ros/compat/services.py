"""Messages as bytes, services and lifecycle transitions, by the tick's thread without an executor.

Responses block no tick, transitions are answered truly, and the QoS events of publishers and
subscriptions bear one set of names on all distributions.
"""

from __future__ import annotations

import contextlib
import importlib
import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from unicon_base import UniconError
from unicon_ros.compat.loading import is_fast_dds


class Transitions:
    """A lifecycle node's `change_state`, whose answers are true and never missing.

    rclpy answers `success=False` for a label that it does not know, and raises for every other
    transition that is not registered or not allowed in the present state: an idle node ends, an
    active one never answers. Here each is answered.

    A transition that the node brings about only later is kept back; until then the node is in the
    state before. `settle` lets rclpy make it, and answers. The executor goes on meanwhile.

    Args:
        node: lifecycle node.
        refused: takes what rclpy raised.
        later: takes a transition's label; True where `settle` will follow. Each keeps it back.
    """

    def __init__(
        self, node: Any, refused: Callable[[Exception], None], later: Callable[[str], bool]
    ) -> None:
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        self._node, self._refused, self._later = node, refused, later
        self._labels = {
            Transition.TRANSITION_DEACTIVATE: "deactivate",
            Transition.TRANSITION_ACTIVE_SHUTDOWN: "shutdown",
        }
        self._kept: list[_Kept] = []
        for service in node.services:
            if service.srv_type is ChangeState:
                self._wrap(service)

    def _wrap(self, service: Any) -> None:
        change, self._send = service.callback, service.send_response

        def guarded(request: Any, response: Any) -> Any:
            try:
                return change(request, response)
            except Exception as error:  # rclpy's RCLError
                self._refused(error)
                response.success = False
                return response

        def answer(request: Any, response: Any) -> Any:
            label = request.transition.label or self._labels.get(request.transition.id, "")
            if not self._later(label):
                return guarded(request, response)
            request.transition.label = label  # holds in any state, an id of shutdown in one
            self._kept.append(_Kept(request, response))
            return response

        def send_response(response: Any, header: Any) -> None:
            for kept in self._kept:
                if kept.response is response:
                    kept.header = header
                    return
            self._send(response, header)

        self._change = guarded
        service.callback, service.send_response = answer, send_response

    def settle(self) -> None:
        """Make the transitions that were kept back, and answer them."""
        kept, self._kept = self._kept, []
        for each in kept:
            state = self._node._state_machine.current_state[1]
            if (each.request.transition.label, state) == ("deactivate", "inactive"):
                each.response.success = True  # two have asked for it
            else:
                self._change(each.request, each.response)
            if each.header is not None:
                with contextlib.suppress(Exception):  # the client is gone, or the middleware
                    self._send(each.response, each.header)


@dataclass
class _Kept:
    """A request whose answer is not true yet."""

    request: Any
    response: Any
    header: Any = None


class Responses:
    """Keeps a service's response back until its client can hear it, and drops it if it left.

    rmw_fastrtps blocks `send_response` for 100 ms, holding Python's lock, where the client's
    reader is not matched yet or no more (`failed to send response (timeout)`): one client that
    leaves without waiting would delay a tick. So a response goes out once a reader of it is in the
    ROS graph: rclpy does not tell which client asked, so another client of the same service may
    stand in for it. Other middlewares do not block; nothing is kept back there.
    """

    PATIENCE_NS = 500_000_000

    def __init__(self) -> None:
        self.dropped = 0
        self._wrapped: dict[int, tuple[Any, Any]] = {}
        self._kept: list[tuple[int, Callable[[], bool], Callable[[], object]]] = []

    def watch(self, node: Any) -> None:
        """Wrap the services of a node that are not wrapped yet."""
        for service in node.services:
            if id(service) not in self._wrapped:
                self._wrapped[id(service)] = service, service.send_response
                if is_fast_dds():
                    self._wrap(node, service)

    def _wrap(self, node: Any, service: Any) -> None:
        send = service.send_response
        topic = f"rr{_service_name(node, service)}Reply"

        def send_response(response: Any, header: Any) -> None:
            def hears() -> bool:
                try:
                    return bool(node.get_subscriptions_info_by_topic(topic, no_mangle=True))
                except Exception:  # the node is going away
                    return False

            if hears():
                send(response, header)
            else:
                late = time.perf_counter_ns() + self.PATIENCE_NS
                self._kept.append((late, hears, lambda: send(response, header)))

        service.send_response = send_response

    def retry(self) -> None:
        """Send what can be heard by now; drop what nobody came to hear."""
        if not self._kept:
            return
        kept, self._kept = self._kept, []
        for late, hears, send in kept:
            if hears():
                with contextlib.suppress(Exception):  # the middleware is gone, or the client
                    send()
            elif time.perf_counter_ns() < late:
                self._kept.append((late, hears, send))
            else:
                self.dropped += 1

    def release(self) -> None:
        """Let services answer by themselves again: no ticks are in the way any more.

        What is still kept is waited for, at most as long as in ticks.
        """
        self.retry()
        while self._kept:
            time.sleep(0.005)
            self.retry()
        for service, send in self._wrapped.values():
            service.send_response = send
        self._wrapped = {}


def _service_name(node: Any, service: Any) -> str:
    name = getattr(service, "service_name", None) or service.srv_name
    return name if name.startswith("/") else str(node.resolve_service_name(name))


Leave = Callable[[], None]
"""Lets an entity go, before it is destroyed."""


def polled_group() -> Any:
    """Return a callback group that keeps executors from taking messages that the tick polls.

    Events of the same subscriptions (deadlines, liveliness, …) are served as usual. A public
    interface: `rclpy.callback_groups.CallbackGroup` is made to be derived from.
    """
    from rclpy.callback_groups import ReentrantCallbackGroup
    from rclpy.subscription import Subscription

    class PolledGroup(ReentrantCallbackGroup):
        """Lets everything run but subscriptions."""

        def can_execute(self, entity: Any) -> bool:
            return not isinstance(entity, Subscription)

        def beginning_execution(self, entity: Any) -> bool:
            return not isinstance(entity, Subscription)

    return PolledGroup()


def raw_publish(publisher: Any) -> tuple[Callable[[bytes], object], Leave]:
    """Return a function that publishes serialized bytes, and one that lets the publisher go.

    `handle.publish_raw` with the handle entered once takes 3 µs where `publish(bytes)`, which
    enters it and looks at types each time, takes 5 (warm, 20 joints). Call the second function
    before the publisher is destroyed.
    """
    fast, leave = _entered(publisher, "publish_raw")
    return fast or publisher.publish, leave


def wait_for_readers(publisher: Any, timeout: float) -> None:
    """Wait until reliable readers have what was published, at most `timeout` in [s]."""
    wait = getattr(publisher, "wait_for_all_acked", None)
    if wait is None:
        return
    from rclpy.duration import Duration

    # A middleware without acknowledgements refuses: there is nothing to wait for.
    with contextlib.suppress(Exception):
        wait(Duration(nanoseconds=round(timeout * 1e9)))


def raw_take(subscription: Any) -> tuple[Callable[[], bytes | None] | None, Leave]:
    """Return a function that takes one serialized message or None, and one that lets go.

    There is no public way to poll: where the private one is missing the first function is None,
    and the caller lets an executor call it back.
    """
    take, leave = _entered(subscription, "take_message")
    message = take and subscription.msg_type

    def poll() -> bytes | None:
        taken = take(message, True)
        return None if taken is None else taken[0]

    return take and poll, leave


def request_take(service: Any) -> tuple[Callable[[], Any] | None, Leave]:
    """Return a function that takes one request and its header, or None, and one that lets go.

    A request is given once, here or to an executor. Without the private way the first function is
    None, as with `raw_take`. Where nothing came it takes 1 to 2 µs warm, 55 with caches swept.
    """
    take, leave = _entered(service, "service_take_request")
    request = take and service.srv_type.Request

    def poll() -> Any:
        taken = take(request)
        return None if taken is None or taken[1] is None else taken

    return take and poll, leave


def _entered(entity: Any, method: str) -> tuple[Any, Leave]:
    """Enter an entity's handle once; return a private method of it, or None, and the way out."""
    handle = getattr(entity, "handle", None)
    found = getattr(handle, method, None)
    enter, leave = getattr(handle, "__enter__", None), getattr(handle, "__exit__", None)
    if not (callable(found) and callable(enter) and callable(leave)):
        return None, lambda: None
    enter()
    return found, lambda: leave(None, None, None)


class ReusedWaitSet:
    """Waits for any of some subscriptions with one wait set, made once.

    rclpy's executors make a wait set for every wait, which was most of a controller's 28 % of a
    core at 500 Hz (6 % with one reused).

    Args:
        subscriptions: rclpy subscriptions.
        context: their rclpy context.

    Raises:
        UniconError: this rclpy has no such wait set.
    """

    def __init__(self, subscriptions: Sequence[Any], context: Any) -> None:
        try:
            singleton = importlib.import_module("rclpy.impl.implementation_singleton")
            make = singleton.rclpy_implementation.WaitSet
            self._handles = [subscription.handle for subscription in subscriptions]
            for handle in self._handles:
                handle.__enter__()
            self._set = make(len(self._handles), 0, 0, 0, 0, 0, context.handle)
            self._clear, self._add = self._set.clear_entities, self._set.add_subscription
            self._wait = self._set.wait
            self._ready = self._set.get_ready_entities
        except (ImportError, AttributeError, TypeError) as error:
            raise UniconError(
                f"this rclpy has no reusable wait set ({error}); set pacing.trigger: deadline"
            ) from error

    def sleep(self, timeout: float) -> None:
        """Return when a message is there, or after `timeout` in [s]."""
        self._clear()
        for handle in self._handles:
            self._add(handle)
        self._wait(round(timeout * 1e9))

    def wait(self, timeout: float) -> bool:
        """Return True when a message is there, False after `timeout` in [s]."""
        self.sleep(timeout)
        return bool(self._ready("subscription"))

    def close(self) -> None:
        """Let the subscriptions go."""
        for handle in self._handles:
            handle.__exit__(None, None, None)
        self._handles = []


def steady_timer(node: Any, period_s: float, call: Callable[[], object], group: Any = None) -> Any:
    """Return a timer of a node that goes on where nobody publishes /clock.

    Args:
        node: rclpy node.
        period_s: time between two calls in [s], of the steady clock.
        call: what is called.
        group: its callback group; None for the node's own.
    """
    from rclpy.clock import Clock, ClockType

    return node.create_timer(period_s, call, group, Clock(clock_type=ClockType.STEADY_TIME))


def with_events(
    kind: str, callbacks: Mapping[str, Callable[[Any], None]], create: Callable[..., Any]
) -> tuple[Any, list[str]]:
    """Return what `create(**options)` makes with event callbacks, and the names of those left out.

    A middleware that lacks an event refuses the whole entity, without telling which event it was.
    Humble has the classes in `rclpy.qos_event`, newer ones in `rclpy.event_handler`.

    Args:
        kind: `publisher` or `subscription`.
        callbacks: by rclpy's names: `deadline`, `incompatible_qos`, `liveliness`, `message_lost`.
        create: makes the entity; called anew with fewer events where it raises that one is lacked.
    """
    module = _event_module()
    make = getattr(module, f"{kind.capitalize()}EventCallbacks", None)
    lacked = getattr(module, "UnsupportedEventTypeError", ())
    if make is None:
        return create(), list(callbacks)
    for number in range(len(callbacks), 0, -1):
        for kept in itertools.combinations(callbacks, number):
            try:
                made = create(event_callbacks=make(**{name: callbacks[name] for name in kept}))
            except lacked:
                continue
            return made, [name for name in callbacks if name not in kept]
    return create(), list(callbacks)


def _event_module() -> Any:
    for name in ("rclpy.event_handler", "rclpy.qos_event"):
        with contextlib.suppress(ImportError):
            return importlib.import_module(name)
    return None


def incompatible_policy(event: Any) -> str:
    """Return the name of the last incompatible QoS policy of an event, in lower case."""
    try:
        from rclpy.qos import qos_policy_name_from_kind

        return str(qos_policy_name_from_kind(event.last_policy_kind)).lower()
    except (ImportError, AttributeError, ValueError, TypeError):
        return "quality of service"
