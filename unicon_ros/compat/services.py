"""Services: responses that block no tick, and lifecycle transitions that are answered truly."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

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
