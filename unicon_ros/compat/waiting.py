"""Waiting for messages without what rclpy's executors cost."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from typing import Any

from unicon_core.errors import UniconError


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
