"""QoS events of publishers and subscriptions, whose names differ between distributions."""

from __future__ import annotations

import contextlib
import importlib
import itertools
from collections.abc import Callable, Mapping
from typing import Any


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
