"""Messages as bytes, published, waited for and taken by the tick's thread, without an executor.

And the QoS events of publishers and subscriptions, whose names differ between distributions.
"""

from __future__ import annotations

import contextlib
import importlib
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from unicon_base.errors import UniconError

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
    """Return a function that takes one request's header or None, and one that lets go.

    For services whose requests say nothing but that they came. A request is given once, here or to
    an executor. Without the private way the first function is None, as with `raw_take`. Where
    nothing came it takes 1 to 2 µs warm, 55 after caches were swept.
    """
    take, leave = _entered(service, "service_take_request")
    request = take and service.srv_type.Request
    return take and (lambda: take(request)[1]), leave


def requests_take(service: Any) -> tuple[Callable[[], Any] | None, Leave]:
    """Return a function that takes one request and its header, or None, and one that lets go.

    As `request_take`, for requests that say something.
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
