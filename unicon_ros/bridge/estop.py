"""EmergencyStop: ~/estop and its latch, for the ticks of a session and for the node around them.

Ticks take its requests directly from the middleware, right before `send` and once more after it,
about 2 µs each, so that no load of the executor and no length of a tick stands between a press and
the motors. An executor may serve it as well, while nothing runs or in the slack: a request is taken
once, by the first to come, and either way it latches. Only `~/clear_estop` lets go.

The latch is kept in files, the node's and those of the robots that it drives, where `keep` asks for
it, so that a process that is started anew has it too; see `unicon_core.latches`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from unicon_base import EmergencyStopPressed, TextSink, UniconError
from unicon_core.flow import Block
from unicon_core.latches import ESTOP, PATIENCE, Latch, clearing
from unicon_ros import compat
from unicon_ros.bridge.own_node import Answer, add_services, explained

STOP_SERVICES = ("estop", "clear_estop")
"""Names of the services, each `~/<name>` of type std_srvs/srv/Trigger."""

FAULT = "emergency stop by the service ~/estop"
REFUSAL = "the emergency stop is latched; call ~/clear_estop when it is safe to start again"
PRESSED = "emergency stop: the platform damps; latched until ~/clear_estop"

DELIBERATE_S = 0.5
"""So long after a press nothing clears it: of two requests that came together, the stop wins."""
SLACK_S = 0.05
"""How long an answer in a run waits for the medium of the latch: the tick waits with it."""
LINGER_S = 0.2
"""So long after an answer the service stays, for the middleware to repeat what was lost."""
QUEUED = 100
"""Requests taken at once at most, more than a queue holds."""


class EmergencyStop:
    """The services `~/estop` and `~/clear_estop` of one node, alive as long as the node.

    Args:
        node: rclpy node.
        running: tells whether a run is on; until it has ended nothing is cleared.
        warn: takes warnings, one line each.

    Attributes:
        latched: it was pressed and not cleared: nothing may start, what runs must end.
        polled: ticks can look by themselves; else an executor has to.
        restored: when it was pressed, where an earlier process left it latched; else "".
    """

    def __init__(self, node: Any, running: Callable[[], bool], warn: TextSink = print) -> None:
        self.latched = False
        self.restored = ""
        self._node = node
        self._kept: Latch | None = None
        self._robots: Sequence[Latch] = ()
        self._running, self._warn = running, warn
        self._failed = False
        self._pressed_at = self._answered_at = -math.inf
        self._unanswered: list[Any] = []
        handlers = dict(zip(STOP_SERVICES, (self.press, self.clear)))
        self._service = add_services(node, handlers, warn)[0]
        taking, self._let_go = compat.request_take(self._service)
        self.polled = taking is not None
        self._take = taking or _nothing

    def keep(self, robots: Sequence[Latch] = ()) -> None:
        """Keep the latch until the machine boots, and take over what an earlier process left.

        Args:
            robots: the latches of the robots that are driven, which a press sets as well.
        """
        self._robots, names = robots, ",".join(latch.robot for latch in robots)
        if self._kept is not None:
            self._kept.robot = names
            return
        kept = self._kept = latch_of(self._node, ESTOP, self._warn)
        kept.robot = names
        found = kept.read()
        if self.latched:
            kept.set(FAULT)
        elif found is not None:
            self.latched, self.restored = True, found.at or found.reason

    def refuse_start(self) -> None:
        """Refuse a start while it is latched.

        Raises:
            UniconError: it is latched; the error has the command that lets go.
        """
        if self.latched:
            name = self._node.get_fully_qualified_name()
            raise UniconError(
                f"the emergency stop of {name} is latched (pressed {self.restored}); when "
                f"it is safe to start again: {clearing(name)}"
            )

    # -- in ticks -------------------------------------------------------------------------------

    def holds(self, faulted: Latch) -> str:
        """Return why a node is not to start by itself; "" where it may.

        Args:
            faulted: latch that a process left which ended by a fault.
        """
        if self.restored:
            return f"the emergency stop was pressed ({self.restored}); call ~/clear_estop"
        found = faulted.read()
        if found is None:
            return ""
        return f"the process before ended by a fault ({found.at}: {found.reason})"

    def before_send(self) -> Block:
        """Return the look right before `send`; it answers once the platform is closed."""
        # The warm-up, shortly before the tick, hears it as well and need not wait for that tick; it
        # also keeps the look warm.
        return Block("estop", self.look, close=self.answer, warm_up=self.look, endless=True)

    def after_send(self) -> Block:
        """Return the look at the end of a tick: the next one begins at once where ticks overrun."""
        return Block("estop after send", self.look, endless=True)

    def look(self) -> None:
        """Hear a request, if there is one.

        Raises:
            EmergencyStopPressed: it is pressed.
        """
        if self._take is not _nothing:
            self.hear()
        if self.latched:
            raise EmergencyStopPressed(FAULT)

    def hear(self) -> None:
        """Take a request, if there is one, and latch; it is answered later."""
        try:
            taken = self._take()
        except Exception as error:  # garbage in the queue, or the middleware is gone: listen on
            if not self._failed:
                self._failed = True
                self._warn(
                    f"~/estop could not be looked at ({explained(error)}); it is tried "
                    "again in every tick, but a signal such as Ctrl-C is a surer way to stop"
                )
            return
        if taken is not None:
            self._unanswered.append(taken[1])
            self._latch()

    # -- between runs ---------------------------------------------------------------------------

    def refusal(self) -> str:
        """Return why nothing may start, or ""; a press that waits is heard and answered first."""
        self.answer()
        return REFUSAL if self.latched else ""

    def answer(self) -> None:
        """Hear what waits and answer it all; may block, so never while the motors wait."""
        for _ in range(QUEUED):
            heard = len(self._unanswered)
            self.hear()
            if len(self._unanswered) == heard:
                break
        headers, self._unanswered = self._unanswered, []
        message = PRESSED + self._not_kept() if headers else ""
        for header in headers:
            response = self._service.srv_type.Response(success=True, message=message)
            try:
                self._service.send_response(response, header)
            except Exception as error:  # the client or the middleware is gone
                self._warn(f"~/estop acts, but could not be answered ({explained(error)})")
            self._answered_at = time.monotonic()

    def press(self) -> Answer:
        """Stop before the next command is sent; counts as a fault; nothing starts until cleared."""
        running = self._running()
        self._latch()
        said = PRESSED if running else "nothing runs; latched until ~/clear_estop"
        # An executor that takes the request in the slack answers at once: a process that is killed
        # on that answer must have left its latch, or the next one would drive.
        return True, said + self._not_kept(SLACK_S if running else PATIENCE)

    def clear(self) -> Answer:
        """Let go of the latch, once the run has ended."""
        if not self.latched:
            return True, "the emergency stop was not latched"
        if self._running():
            return False, "the run has not ended yet; call ~/clear_estop again"
        if time.monotonic() - self._pressed_at < DELIBERATE_S:
            return False, "it was pressed just now; if it is safe, call ~/clear_estop again"
        for latch in self._latches():
            if stays := latch.release():
                return False, stays
        self.latched, self.restored = False, ""
        return True, "cleared: ~/start may start again"

    def close(self) -> None:
        """Let the service go, before its node is destroyed; an answer may have to be sent again."""
        self._take = _nothing
        if self._kept is not None:
            self._kept.close()
        time.sleep(max(0.0, self._answered_at + LINGER_S - time.monotonic()))
        self._let_go()

    def _latch(self) -> None:
        for latch in (self._kept, *self._robots):
            if latch is not None:
                latch.set(FAULT)
        self.latched, self.restored = True, ""
        self._pressed_at = time.monotonic()

    def _latches(self) -> Iterator[Latch]:
        """The robots' and the node's own latch, with those of robots that it drove before."""
        yield from self._robots
        if self._kept is None:
            return
        found = self._kept.read()
        for name in found.robots if found is not None else ():
            yield Latch("", 0, ESTOP, self._warn, name)
        yield self._kept

    def _not_kept(self, patience: float = PATIENCE) -> str:
        """Return what to add to an answer where the latch ends with this process.

        Args:
            patience: how long all media together may take in [s].
        """
        end = time.monotonic() + patience
        troubles = [
            latch.trouble
            for latch in (self._kept, *self._robots)
            if latch and not latch.kept(max(0.0, end - time.monotonic()))
        ]
        return f"; for this process only ({troubles[0]})" if troubles else ""


def latch_of(node: Any, kind: str, warn: TextSink) -> Latch:
    """Return a latch of an rclpy node, by its name and domain."""
    return Latch(node.get_fully_qualified_name(), node.context.get_domain_id(), kind, warn)


def _nothing() -> None:
    return None
