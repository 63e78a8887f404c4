"""ActuatorWire: a socket to each of Fourier's FSA actuators, which answer; for both versions.

One tick asks, the next one takes. A frame is complete when every joint has answered; who has not
stands in `where`, and so in the fault of a robot that is silent. `Enabling` brings actuators from
off to where they take commands, limp, step by step.
"""

from __future__ import annotations

import select
import time
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from unicon_base.arrays import Float64
from unicon_base.errors import Fault
from unicon_core.states import States
from unicon_hardware.fourier.codec import COMMAND_TYPE, DISABLE, Addressed
from unicon_hardware.wire import Answers, Counts, Udp, known

AGAIN = 0.05
"""After so long without an answer a step is sent again, [s]."""
TRIES = 20


class Enabling:
    """Each step goes to all joints, and the next one follows when all have answered.

    Behind a step that had to be repeated it waits until late answers are in, which would be taken
    for those of the next one where they have no number.

    Args:
        names: of the joints, each with its address.
        steps: what each is called, and its datagram with a count of ours.
        send: gives a joint a datagram.

    Attributes:
        count: of the step that waits for answers; 0 before the first one.
        began: whether anything has been sent.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        steps: Sequence[tuple[str, Callable[[int], bytes]]],
        send: Callable[[int, bytes], None],
    ) -> None:
        self._names, self._steps, self._send = names, list(steps), send
        self.count, self._tries, self._sent = 0, 0, 0.0
        self._pending: set[int] = set()

    @property
    def began(self) -> bool:
        """Whether anything has been sent."""
        return self.count > 0

    @property
    def done(self) -> bool:
        """Whether all steps are."""
        return not self._steps

    def __call__(self) -> str:
        """Do what is due; return "" at the end, else what is waited for.

        Raises:
            Fault: a joint does not answer.
        """
        if not self._steps:
            return ""
        due = time.monotonic() - self._sent > AGAIN
        if not self._pending and (due or self._tries < 2):
            self.count, self._tries, due = self.count + 1, 0, True
            self._pending = set(range(len(self._names)))
        word = self._steps[0][0]
        if not self._pending:
            return f"late answers before {word}"
        if due:
            self._again()
        return f"{word}: {len(self._pending)} actuators, {self._names[min(self._pending)]} first"

    def _again(self) -> None:
        word, datagram = self._steps[0]
        if self._tries >= TRIES:
            names = ", ".join(self._names[joint] for joint in sorted(self._pending)[:3])
            raise Fault(
                f"fourier: {word} was not answered by {names}"
                f"{' and others' if len(self._pending) > 3 else ''}; switch the robot off and on"
            )
        self._tries, self._sent = self._tries + 1, time.monotonic()
        for joint in self._pending:
            self._send(joint, datagram(self.count))

    def answered(self, joint: int, count: int, refusal: str) -> None:
        """Take an answer.

        Args:
            joint: of it.
            count: of the step that it answers.
            refusal: what it says, "" for success.

        Raises:
            Fault: the actuator refuses.
        """
        if joint not in self._pending or count != self.count:
            return  # of an earlier try
        if refusal:
            raise Fault(
                f"fourier: {self._names[joint]} answers {refusal} to {self._steps[0][0]}; that is "
                "not taken for success"
            )
        self._pending.discard(joint)
        if not self._pending:
            del self._steps[0]


LARGEST = 1e6
"""[deg], and of gains and currents: nothing beyond it is meant, and its float stays finite."""


class ActuatorWire:
    """What the wires of both versions share; each sorts its answers and asks its questions.

    Args:
        states: of the workflow.
        actuators: of the robot.
        command: code of a command.
    """

    def __init__(self, states: States, actuators: Addressed, command: int) -> None:
        self._states, self._rate = states, actuators.rate
        self.counts = Counts()
        self._labels = tuple(map("{} ({})".format, actuators.names, actuators.addresses))
        self._answered = Answers(self._labels)
        self._asked, self._turn = 0.0, 0
        self._sent_gains = np.full((2, len(self._labels)), np.nan)
        self._commands = np.zeros(len(self._labels), COMMAND_TYPE)
        self._commands["code"] = command
        self._hot, self._error = known(states, "motor_temperature"), known(states, "motor_error")
        self._opened: list[Udp] = []
        self._sockets = self._open(self._labels, actuators.addresses, actuators.port)

    def _open(self, labels: tuple[str, ...], addresses: tuple[str, ...], port: int) -> list[Udp]:
        """Return a socket to each address; where one fails, all of the wire are closed."""
        try:
            sockets = []
            for label, address in zip(labels, addresses):
                what = f"fourier: actuator {label}"
                sockets.append(Udp(("0.0.0.0", 0), (address, port), what, self.counts))
                self._opened.append(sockets[-1])
            return sockets
        except BaseException:
            self._let_go()
            raise

    @property
    def where(self) -> str:
        """The actuators that have not answered since all did last."""
        return str(self._answered)

    def _tell(self, joint: int, data: bytes) -> None:
        self._sockets[joint].send(data)

    def take(self) -> int:
        """See `Wire`."""
        for joint, socket in enumerate(self._sockets):
            for data in socket.received():
                self._sort(joint, data)
        self._measured()
        now = time.monotonic()
        if now - self._asked >= 0.9 / self._rate:
            self._asked, self._turn = now, (self._turn + 1) % len(self._sockets)
            self._ask()
        complete = self._complete()
        self.counts.good += complete
        return int(complete)

    def _complete(self) -> bool:
        return self._answered.complete()

    def _sort(self, joint: int, data: bytes) -> None:
        """Keep an answer, or count it as refused."""
        raise NotImplementedError

    def _measured(self) -> None:
        """Bring what was kept into the states, where it is finite."""
        raise NotImplementedError

    def _ask(self) -> None:
        """Send the questions that are due; those that are asked in turn to joint `_turn`."""
        raise NotImplementedError

    def _prepared(self, errors: dict[int, str], enabling: Enabling) -> str:
        """Go on with the enabling, unless an actuator told an error before it began."""
        if errors and not enabling.began:
            joint, words = next(iter(errors.items()))
            return (
                f"actuator {self._labels[joint]} tells an error: {words}; see the vendor's list, "
                "and switch the robot off and on"
            )
        return enabling()

    def wait(self, timeout: float) -> bool:
        """See `Wire`."""
        return bool(select.select(self._sockets, [], [], timeout)[0])

    def _tell_all(self, datagrams: Iterable[tuple[Udp, bytes]]) -> None:
        """Send datagrams, each with its socket.

        Raises:
            Fault: one could not be sent; all others were, since who damps or lets go has to reach
                the joints that still have a way.
        """
        fault: Fault | None = None
        for socket, data in datagrams:
            try:
                socket.send(data)
            except Fault as one:
                fault = fault or one
        if fault is not None:
            raise fault

    def _held(
        self, *wanted: Float64, least: float | Float64 = -LARGEST, beyond: bool = False
    ) -> Float64:
        """Return figures of a command within `least` and `LARGEST`, counted where they were not.

        Args:
            wanted: figures, each of shape (n,).
            least: in place of -`LARGEST`; one for all, or of shape (len(wanted), 1).
            beyond: it is to be counted whatever they are.
        """
        asked = np.array(wanted)
        sent = np.clip(asked, least, LARGEST)
        self.counts.clamped += beyond or not np.array_equal(asked, sent)
        return sent

    def _datagrams(self) -> list[tuple[Udp, bytes]]:
        """Return the commands, each with its socket."""
        return [(socket, row.tobytes()) for socket, row in zip(self._sockets, self._commands)]

    def _due(self, gains: Float64) -> list[int]:
        """Return the joints whose gains are to be sent: those that have changed, and one in turn.

        Datagrams get lost, and these are not repeated each tick.
        """
        changed = (gains != self._sent_gains).any(axis=0)
        changed[self._turn] = True
        self._sent_gains = gains
        due: list[int] = np.flatnonzero(changed).tolist()
        return due

    def _close(self, enabled: bool, times: int = 1) -> None:
        """Let go; switch all actuators off before, so many times, if we have enabled them."""
        try:
            if enabled and self._opened:
                off = bytes([DISABLE])
                self._tell_all((socket, off) for socket in self._sockets * times)
        finally:
            self._let_go()

    def _let_go(self) -> None:
        while self._opened:
            self._opened.pop().close()
