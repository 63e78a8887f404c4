"""Serving: callbacks of an executor's nodes in small pieces, each of which costs alike.

An rclpy executor makes a wait set of all that its nodes have whenever it looks: 1.1 ms warm and 2.6
after caches were swept, with 15 services and 100 topics. Asked by itself a service takes 4 µs, cold
17, and eight QoS events 15, cold 100. What cannot be asked so is left to the executor: a node with
clients, guard conditions, actions or coroutines.
"""

from __future__ import annotations

import importlib
import inspect
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple, TypeAlias

EVENTS = 8
"""QoS events asked in one piece."""
EVENTS_NS = 1_000_000_000
"""All of them are asked so often, and nodes looked at for what they have; services and timers that
came are asked in the next round already."""
SHARES = 16
"""Of the pieces of QoS events a round has a part of so many: a second has more rounds."""
QUEUED = 8
"""Messages of one subscription in a round at most, and callbacks that the executor runs itself. One
a round would lose messages of 100 Hz at a tick of 50 Hz."""

# Subscriptions that are polled; QoS events, each with its handle.
_Parts: TypeAlias = tuple[list[Any], list[tuple[Any, Any]]]


class Piece(NamedTuple):
    """A part of a round.

    Attributes:
        kind: pieces of one kind take about the same time.
        run: does it; True where a callback was run.
    """

    kind: str
    run: Callable[[], bool]


class Serving:
    """Serves an executor, piece by piece.

    Args:
        executor: rclpy executor; nobody else spins it meanwhile.
        watch: called with each node in each round, before its services are asked.
    """

    def __init__(self, executor: Any, watch: Callable[[Any], None]) -> None:
        self._executor, self._watch = executor, watch
        self._wait = _waiting(executor)
        self._apart = hasattr(executor, "wait_for_ready_callbacks")
        self._gone: type[Exception] = importlib.import_module("rclpy.exceptions").InvalidHandle
        self._looked_ns = 0
        self._known: list[tuple[Any, list[Any], _Parts | None]] = []
        self._nodes: list[tuple[Any, list[Any]]] = []
        self._whole: list[Any] = []
        self._events: deque[list[tuple[Any, Any]]] = deque()  # those of this second's still to ask
        self._share, self._ran = 1, False
        self._found: deque[Callable[[], bool]] = deque()
        self.look()

    def round(self) -> Iterator[Piece]:
        """Return the pieces in which services and timers are asked once, subscriptions until empty.

        What one finds is called in a piece of its own, since that takes longer.

        Raises:
            ExternalShutdownException: the ROS context was shut down.
        """
        if not self._executor.context.ok():
            raise importlib.import_module("rclpy.executors").ExternalShutdownException
        if not self._events and time.perf_counter_ns() - self._looked_ns >= EVENTS_NS:
            self.look()
        whole = list(self._whole)
        for node, subscriptions in self._nodes:
            self._watch(node)
            if next(iter(node.clients), None) is not None:
                whole.append(node)
                continue
            for service in list(node.services):
                yield Piece("service", partial(self._request, service))
                yield from self.callbacks()
            for timer in list(node.timers):
                yield Piece("timer", partial(self._timer, timer))
                yield from self.callbacks()
            for subscription in subscriptions:
                for _ in range(QUEUED):
                    yield Piece("subscription", partial(self._message, subscription))
                    if not self._found:
                        break
                    yield from self.callbacks()
        for _ in range(min(self._share, len(self._events))):
            yield Piece("events", partial(self._changes, self._events.popleft()))
            yield from self.callbacks()
        if self._unfinished():  # tasks go on where they were begun, of whichever node they are
            yield from self._others(None)
        elif whole:
            for node in whole:
                self._watch(node)
            yield from self._others(whole)

    def _others(self, nodes: list[Any] | None) -> Iterator[Piece]:
        """Return pieces in which the executor runs a callback each, until it finds none.

        It says that a round of its own has ended as if nothing were there, and is asked once more.
        """
        found, before = 0, False
        while found < QUEUED:
            yield Piece("executor", partial(self._waited, nodes))
            if not self._ran and not before:
                return
            found, before = found + self._ran, self._ran

    def look(self) -> None:
        """See what nodes have. It takes 1 ms for 100 topics, where something came or went."""
        self._looked_ns = time.perf_counter_ns()
        events: list[tuple[Any, Any]] = []
        self._nodes, self._whole, before, self._known = [], [], self._known, []
        for node in self._executor.get_nodes():
            has = [*node.guards, *node.services, *node.timers, *node.subscriptions, *node.waitables]
            same = [parts for other, had, parts in before if other is node and had == has]
            found = same[0] if same else self._parts(node) if self._apart else None
            self._known.append((node, has, found))
            if found is None:
                self._whole.append(node)
            else:
                self._nodes.append((node, found[0]))
                events += found[1]
        batches = [events[i : i + EVENTS] for i in range(0, len(events), EVENTS)]
        self._events, self._share = deque(batches), 1 + len(batches) // SHARES

    def _unfinished(self) -> bool:
        tasks = getattr(self._executor, "_tasks", None)
        return tasks is None or any(not task.done() for task, *_ in tasks)

    def _parts(self, node: Any) -> _Parts | None:
        """Return subscriptions to be polled and QoS events of a node; None where it has others."""
        if next(iter(node.guards), None) is not None:
            return None
        if not all(_asked(each, "service_take_request") for each in node.services):
            return None
        # Newer timers hand their callback what call_timer does not tell.
        if not all(
            _asked(each, "call_timer") and not hasattr(each.handle, "call_timer_with_info")
            for each in node.timers
        ):
            return None
        # What a group never lets run is polled by the tick.
        heard = [each for each in node.subscriptions if each.callback_group.can_execute(each)]
        if not all(_asked(e, "take_message") and hasattr(e, "_callback_type") for e in heard):
            return None
        events = []
        for each in node.waitables:
            handle = getattr(each, "_EventHandler__event", None)
            if not hasattr(handle, "take_event") or inspect.iscoroutinefunction(each.callback):
                return None
            events.append((each, handle))
        return heard, events

    def callbacks(self) -> Iterator[Piece]:
        """Return what was found and is not called yet, one callback a piece."""
        while self._found:
            yield Piece("callback", self._found.popleft())

    # -- pieces ---------------------------------------------------------------------------------

    def _find(self, entity: Any, call: Callable[[], object]) -> None:
        self._found.append(partial(_run, entity, call))

    def _waited(self, nodes: list[Any] | None) -> bool:
        self._ran = False  # also where the callback raises
        self._ran = self._wait(nodes)
        return self._ran

    def _request(self, service: Any) -> bool:
        kind = service.srv_type
        taken = self._taken(service, "service_take_request", kind.Request)
        if taken is None or taken[1] is None:
            return False
        request, header = taken

        def answer() -> None:
            service.send_response(service.callback(request, kind.Response()), header)

        self._find(service, answer)
        return False

    def _timer(self, timer: Any) -> bool:
        with suppress(self._gone):
            if timer.is_ready() and timer.callback_group.can_execute(timer):
                with timer.handle:
                    timer.handle.call_timer()
                self._find(timer, timer.callback)
        return False

    def _message(self, subscription: Any) -> bool:
        kind, raw = subscription.msg_type, subscription.raw
        taken = self._taken(subscription, "take_message", kind, raw)
        if taken is not None:
            alone = subscription._callback_type.name == "MessageOnly"
            self._find(subscription, partial(subscription.callback, *taken[: 1 if alone else 2]))
        return False

    def _taken(self, entity: Any, method: str, *arguments: Any) -> Any:
        if entity.callback_group.can_execute(entity):
            handle = entity.handle
            with suppress(self._gone), handle:
                return getattr(handle, method)(*arguments)
        return None

    def _changes(self, events: list[tuple[Any, Any]]) -> bool:
        for event, handle in events:
            with suppress(self._gone), handle:
                told = handle.take_event()
                # A status can be had at any time; it is an event where it has changed since.
                if told is not None and any(getattr(told, name) for name in _changing(type(told))):
                    self._find(event, partial(event.callback, told))
        return False


def _asked(entity: Any, method: str) -> bool:
    """Tell whether an entity can be asked by itself, and its callback be called."""
    handle = getattr(entity, "handle", None)
    able = hasattr(handle, method) and hasattr(handle, "__enter__")
    return able and not inspect.iscoroutinefunction(entity.callback)


def _run(entity: Any, call: Callable[[], object]) -> bool:
    """Run a callback within the entity's callback group."""
    group = entity.callback_group
    if not group.beginning_execution(entity):
        return False
    try:
        call()
    finally:
        group.ending_execution(entity)
    return True


_CHANGING: dict[type, list[str]] = {}


def _changing(kind: type) -> list[str]:
    """Return the names of a status that say by how much it has changed."""
    if kind not in _CHANGING:
        _CHANGING[kind] = [name for name in dir(kind) if name.endswith("_change")]
    return _CHANGING[kind]


def _waiting(executor: Any) -> Callable[[list[Any] | None], bool]:
    """Return a function that runs one ready callback of some nodes; False if there was none.

    `spin_once(0)` does the same but does not tell whether there was something to do; where the
    way to know is missing, as in EventsExecutor, it is called and the answer is always True: more
    may wait.
    """
    wait = getattr(executor, "wait_for_ready_callbacks", None)
    if wait is None:

        def spin(_: list[Any] | None) -> bool:
            executor.spin_once(0.0)
            return True

        return spin
    executors = importlib.import_module("rclpy.executors")
    names = ("TimeoutException", "ShutdownException", "ConditionReachedException")
    nothing = tuple(getattr(executors, name) for name in names if hasattr(executors, name))

    def serve(nodes: list[Any] | None) -> bool:
        try:
            handler, _, _ = wait(0.0, nodes, bool)
        except nothing:
            return False
        handler()
        error = handler.exception()
        if error is not None:
            raise error
        return True

    return serve
