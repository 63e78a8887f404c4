"""Services: responses that block no tick, and lifecycle transitions that end no node."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Any

from unicon_ros.compat.loading import is_fast_dds

__all__ = ["Responses", "answer_refused_transitions"]


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
        self._wrapped: dict[int, Any] = {}
        self._kept: list[tuple[int, Callable[[], bool], Callable[[], object]]] = []

    def watch(self, node: Any) -> None:
        """Wrap the services of a node that are not wrapped yet."""
        for service in node.services:
            if id(service) not in self._wrapped:
                self._wrapped[id(service)] = service
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
        for service in self._wrapped.values():
            service.__dict__.pop("send_response", None)
        self._wrapped = {}


def _service_name(node: Any, service: Any) -> str:
    name = getattr(service, "service_name", None) or service.srv_name
    return name if name.startswith("/") else str(node.resolve_service_name(name))
