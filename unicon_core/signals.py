"""Signals: flags in place of exceptions, so that the holder of motors damps them; for the runner,
the node and the command line.

    with SIGNALS, SIGNALS.guard(ask=runner.stop, damp=runner.damp_now):
        ...

Every signal whose default action ends the process asks the guards to end. A second one damps at
once. Where nobody guards anything, a signal does what it does by default. An exception raised from
a handler may be swallowed by an import or a destructor that it falls into; a flag is not.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

_UNTOUCHED = {
    # Not to be caught, or their default is to go on.
    *("SIGKILL", "SIGSTOP", "SIGCONT", "SIGCHLD", "SIGCLD", "SIGURG", "SIGWINCH"),
    # A handler in Python would return into the faulty instruction, for ever.
    *("SIGSEGV", "SIGBUS", "SIGILL", "SIGFPE", "SIGTRAP", "SIGSYS"),
    # Python turns these two into errors of the call that met them.
    *("SIGPIPE", "SIGXFSZ"),
}
# A background job that writes to its terminal would be stopped, motors and all.
_BACKGROUND = ("SIGTTOU", "SIGTTIN")

BOUNCE_NS = 250_000_000
"""Signals that follow the first so closely are the same press: a terminal and `ros2 launch` both
send SIGINT."""

PATIENCE = 4
"""From the so many-th press on, a signal acts as by default: nothing else has helped."""


class Interrupted(BaseException):
    """A signal asked to end: raised at places of our own choosing, and by a second signal.

    Args:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal_name(number))
        self.number = number


@dataclass(eq=False)
class Guard:
    """What holds something that must not be dropped.

    Attributes:
        ask: called by the first signal, inside the handler: asks to end soon.
        damp: called by the second: damps at once; False where that is under way already. None
            where nothing is open yet.
    """

    ask: Callable[[], object]
    damp: Callable[[], bool] | None = None


class Signals:
    """The handlers of this process; there is one, `SIGNALS`.

    Attributes:
        asked: number of the first signal since the handlers were installed, 0 for none.
    """

    def __init__(self) -> None:
        self.asked = 0
        self._guards: list[Guard] = []
        self._before: dict[int, object] = {}
        self._depth = 0
        self._presses = 0
        self._pressed_ns = 0

    def __enter__(self) -> Signals:
        """Install the handlers; nested use does nothing, nor does that of another thread.

        Only the main thread may handle signals: a run elsewhere is guarded while it does.
        """
        if _in_main_thread():
            self._depth += 1
            if self._depth == 1:
                self.asked = self._presses = self._pressed_ns = 0
                self._install()
        return self

    def __exit__(self, *_: object) -> None:
        if not _in_main_thread():
            return
        self._depth -= 1
        if self._depth == 0:
            for number, before in self._before.items():
                signal.signal(number, before)  # type: ignore[arg-type]
            self._before.clear()

    @contextmanager
    def guard(
        self, ask: Callable[[], object] = bool, damp: Callable[[], bool] | None = None
    ) -> Iterator[Guard]:
        """Let signals ask, then damp, instead of ending the process."""
        guard = Guard(ask, damp)
        self._guards.append(guard)
        try:
            yield guard
        finally:
            self._guards.remove(guard)

    def check(self) -> None:
        """Raise where a signal has asked to end.

        Raises:
            Interrupted: it has.
        """
        if self._depth and self.asked:
            raise Interrupted(self.asked)

    def stop_process(self) -> None:
        """Stop the process as Ctrl-Z wanted it, now that the motors are damped."""
        if self._depth and self.asked == signal.SIGTSTP:
            os.kill(os.getpid(), signal.SIGSTOP)

    def _install(self) -> None:
        untouched = {getattr(signal, name) for name in _UNTOUCHED if hasattr(signal, name)}
        background = {getattr(signal, name) for name in _BACKGROUND if hasattr(signal, name)}
        for number in signal.valid_signals() - untouched:
            # What somebody else handles or ignores (nohup) stays so.
            if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                handler = signal.SIG_IGN if number in background else self._handle
                self._before[int(number)] = signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic_ns()
        bounced = self._presses > 0 and now - self._pressed_ns < BOUNCE_NS
        first = not self.asked
        self.asked = self.asked or number
        guards = list(reversed(self._guards))
        if not guards:
            self._as_by_default(number)
            return
        if bounced:
            return
        self._presses, self._pressed_ns = self._presses + 1, now
        if first:
            for guard in guards:
                guard.ask()
            return
        opened = [guard.damp for guard in guards if guard.damp is not None]
        if not opened or self._presses >= PATIENCE:
            self._as_by_default(number)
            return
        damped = [damp() for damp in opened]  # all of them
        if any(damped):
            raise Interrupted(number)

    def _as_by_default(self, number: int) -> None:
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        signal.signal(number, self._handle)  # it was a stop, and the process goes on
        self.asked = 0


SIGNALS = Signals()
"""The handlers of this process."""


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


def signal_name(number: int) -> str:
    """Return the name of a signal, such as `SIGINT`."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
