"""What differs between ROS 2 distributions and what touches rclpy's private names, in one place.

Everything here has a public way to fall back to, so that a changed rclpy costs speed, not function.
Tried on Jazzy (rclpy 7.1); Humble's (3.3) and Kilted's (9.1) names are taken from their sources.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import itertools
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from unicon_core.errors import MissingDependencyError, UniconError

__all__ = [
    "Responses",
    "ReusedWaitSet",
    "answer_refused_transitions",
    "fast_dds_profiles",
    "import_rclpy",
    "imported_first",
    "incompatible_policy",
    "message_class",
    "polled_group",
    "raw_publish",
    "raw_take",
    "request_take",
    "serve_one",
    "wait_for_readers",
    "with_events",
]

_WHEELS = "pip install 'ros-rclpy[fastrtps]==7.1.6' ros-jazzy-common-interfaces"
_SOURCE = "source /opt/ros/<distro>/setup.bash"

_first: bool | None = None  # whether nobody had imported rclpy before us


def import_rclpy(what: str = "the ROS 2 bridge") -> Any:
    """Return rclpy.

    Raises:
        MissingDependencyError: it is not installed; the message names the command that installs it.
    """
    # Asynchronous writers delay the tick by up to 5.5 ms at p99; writing in the caller
    # is the default of rmw_fastrtps, held here against a profile that says otherwise.
    global _first
    os.environ.setdefault("RMW_FASTRTPS_PUBLICATION_MODE", "SYNCHRONOUS")
    if _first is None:
        _first = "rclpy" not in sys.modules
    try:
        rclpy = importlib.import_module("rclpy")
        for module in ("executors", "node", "qos", "callback_groups", "signals"):
            importlib.import_module(f"rclpy.{module}")
    except ImportError as error:
        wheels = platform.machine() == "x86_64" and platform.system() == "Linux"
        install = f"{_SOURCE}, or {_WHEELS}" if wheels else _SOURCE
        raise MissingDependencyError(what, "rclpy", install) from error
    return rclpy


def imported_first() -> bool:
    """Tell whether nobody in this process can have used rclpy before us."""
    return bool(_first)


def fast_dds_profiles() -> str | None:
    """Return the variable that names Fast DDS's profile file; None for other middlewares.

    Kilted's Fast DDS 3 warns of the name that is the only one for Jazzy's 2.14.
    """
    if not _is_fast_dds():
        return None
    try:
        with open("/proc/self/maps", encoding="utf-8") as libraries:
            newer = any("/libfastdds.so" in line for line in libraries)
    except OSError:  # not Linux
        newer = False
    return "FASTDDS_DEFAULT_PROFILES_FILE" if newer else "FASTRTPS_DEFAULT_PROFILES_FILE"


def answer_refused_transitions(node: Any, told: Callable[[Exception], None]) -> None:
    """Let a lifecycle node answer `success=False` where rclpy raises at a transition.

    rclpy answers so for a label that it does not know, and raises for every other transition that
    is not registered or not allowed in the present state: an idle node ends, an active one never
    answers.

    Args:
        node: lifecycle node.
        told: takes what was raised.
    """
    from lifecycle_msgs.srv import ChangeState

    def guarded(callback: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        def answer(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except Exception as error:  # rclpy's RCLError
                told(error)
                response.success = False
                return response

        return answer

    for service in node.services:
        if service.srv_type is ChangeState:
            service.callback = guarded(service.callback)


def message_class(name: str) -> Any:
    """Return the Python class of a type `pkg/msg/Name` or `pkg/srv/Name`, or None if absent."""
    package, kind, short = name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), short, None)
    except ImportError:
        return None


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


def raw_publish(publisher: Any) -> tuple[Callable[[bytes], object], Callable[[], None]]:
    """Return a function that publishes serialized bytes, and one that lets the publisher go.

    `handle.publish_raw` with the handle entered once takes 3 µs where `publish(bytes)`, which
    enters it and looks at types each time, takes 5 (warm, 20 joints). Call the second function
    before the publisher is destroyed.
    """
    handle = getattr(publisher, "handle", None)
    fast = getattr(handle, "publish_raw", None)
    enter, leave = getattr(handle, "__enter__", None), getattr(handle, "__exit__", None)
    if not (callable(fast) and callable(enter) and callable(leave)):
        return publisher.publish, lambda: None
    enter()
    return fast, lambda: leave(None, None, None)


def wait_for_readers(publisher: Any, timeout: float) -> None:
    """Wait until reliable readers have what was published, at most `timeout` in [s]."""
    wait = getattr(publisher, "wait_for_all_acked", None)
    if wait is None:
        return
    from rclpy.duration import Duration

    # A middleware without acknowledgements refuses: there is nothing to wait for.
    with contextlib.suppress(Exception):
        wait(Duration(nanoseconds=round(timeout * 1e9)))


def raw_take(subscription: Any) -> tuple[Callable[[], bytes | None] | None, Callable[[], None]]:
    """Return a function that takes one serialized message or None, and one that lets go.

    There is no public way to poll: where the private one is missing the first function is None,
    and the caller lets an executor call it back.
    """
    handle = getattr(subscription, "handle", None)
    take = getattr(handle, "take_message", None)
    enter, leave = getattr(handle, "__enter__", None), getattr(handle, "__exit__", None)
    if not (callable(take) and callable(enter) and callable(leave)):
        return None, lambda: None
    enter()
    message = subscription.msg_type

    def poll() -> bytes | None:
        taken = take(message, True)
        return None if taken is None else taken[0]

    return poll, lambda: leave(None, None, None)


def request_take(service: Any) -> tuple[Callable[[], Any] | None, Callable[[], None]]:
    """Return a function that takes one request's header or None, and one that lets go.

    For services whose requests say nothing but that they came. A request is given once, here or to
    an executor. Without the private way the first function is None, as with `raw_take`. Where
    nothing came it takes 1 to 2 µs warm, 55 after caches were swept.
    """
    handle = getattr(service, "handle", None)
    take = getattr(handle, "service_take_request", None)
    enter, leave = getattr(handle, "__enter__", None), getattr(handle, "__exit__", None)
    if not (callable(take) and callable(enter) and callable(leave)):
        return None, lambda: None
    enter()
    request = service.srv_type.Request

    def poll() -> Any:
        return take(request)[1]

    return poll, lambda: leave(None, None, None)


def serve_one(executor: Any) -> Callable[[], bool]:
    """Return a function that runs one ready callback without waiting; False if there was none.

    `spin_once(0)` does the same but does not tell whether there was something to do; where the
    way to know is missing, it is called and the answer is always False.
    """
    wait = getattr(executor, "wait_for_ready_callbacks", None)
    if wait is None:

        def spin() -> bool:
            executor.spin_once(0.0)
            return False

        return spin
    executors = importlib.import_module("rclpy.executors")
    names = ("TimeoutException", "ShutdownException", "ConditionReachedException")
    nothing = tuple(getattr(executors, name) for name in names if hasattr(executors, name))

    def serve() -> bool:
        try:
            handler, _, _ = wait(0.0, None, _never)
        except nothing:
            return False
        handler()
        error = handler.exception()
        if error is not None:
            raise error
        return True

    return serve


def _never() -> bool:
    return False


class Responses:
    """Keeps a service's response back until its client can hear it, and drops it if it left.

    rmw_fastrtps blocks `send_response` for 100 ms, holding Python's lock, where the client's
    reader is not matched yet or no more (`failed to send response (timeout)`): one client that
    leaves without waiting would delay a tick. So a response goes out once the reader that the
    request names is in the ROS graph. Other middlewares do not block; nothing is kept back there.
    """

    PATIENCE_NS = 500_000_000

    def __init__(self) -> None:
        self.dropped = 0
        self._wrapped: dict[int, Any] = {}
        self._kept: list[tuple[int, Callable[[], bool], Callable[[], object]]] = []

    def watch(self, node: Any) -> None:
        """Wrap the services of a node that are not wrapped yet."""
        for service in node.services:
            if id(service) not in self._wrapped:
                self._wrapped[id(service)] = service
                if _is_fast_dds():
                    self._wrap(node, service)

    def _wrap(self, node: Any, service: Any) -> None:
        send = service.send_response
        topic = f"rr{_service_name(node, service)}Reply"

        def send_response(response: Any, header: Any) -> None:
            client = _client_of(header)

            def hears() -> bool:
                try:
                    readers = node.get_subscriptions_info_by_topic(topic, no_mangle=True)
                except Exception:  # the node is going away
                    return False
                if client is None:
                    return bool(readers)
                return any(bytes(reader.endpoint_gid)[:16] == client for reader in readers)

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
        for service in self._wrapped.values():
            service.__dict__.pop("send_response", None)
        self._wrapped = {}


def _is_fast_dds() -> bool:
    try:
        from rclpy.utilities import get_rmw_implementation_identifier
    except ImportError:
        return False
    return str(get_rmw_implementation_identifier()).startswith("rmw_fastrtps")


def _client_of(header: Any) -> bytes | None:
    """Return the GUID of the reader that waits for the response; None where it cannot be told.

    rclpy hides it: it is the first field of rmw_request_id_t (rmw/types.h), 16 bytes, followed by
    the sequence number, which rclpy shows. Reading the latter right is the guard of this reading.
    """
    request = getattr(header, "request_id", header)
    number = getattr(request, "sequence_number", None)
    if number is None or not type(request).__module__.startswith("rclpy."):
        return None
    # A pybind11 instance is the object's head and then the pointer to its value.
    address = ctypes.c_void_p.from_address(id(request) + object.__basicsize__).value
    if not address:
        return None
    raw = ctypes.string_at(address, 24)
    return raw[:16] if int.from_bytes(raw[16:], sys.byteorder, signed=True) == number else None


def _service_name(node: Any, service: Any) -> str:
    name = getattr(service, "service_name", None) or service.srv_name
    return name if name.startswith("/") else str(node.resolve_service_name(name))


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
