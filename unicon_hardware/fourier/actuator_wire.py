"""ActuatorWire: a socket to each of Fourier's FSA actuators, which answer; for both versions.

One tick asks, the next one takes. A frame is complete when every joint has answered; joints that
have not stand in `where`, and so in the fault of a robot that is silent. `Enabling` brings
actuators from off to where they take commands, limp, step by step.
"""

from __future__ import annotations

import ipaddress
import select
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, TypeVar

import numpy as np

from unicon_base import Fault, RobotError
from unicon_base.arrays import Float64
from unicon_base.schema.marks import Key
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.facts import AskingRate, Port, each, each_text, fact, facts_of, wrong_fact
from unicon_hardware.wire import Answers, Counts, Udp, Wire, frame_type, known

AGAIN = 0.05
"""After so long without an answer a step is sent again, [s]."""
TRIES = 20
LARGEST = 1e6
"""[deg], and of gains and currents: nothing beyond it is meant, and its float stays finite."""
DISABLE = 0x02
COMMAND_TYPE = frame_type("code u1, pos >f4, vel >f4, current >f4")
"""Targets: position, and feed-forward of speed and current."""

A = TypeVar("A", bound="Addressed")


@dataclass(frozen=True)
class Addressed:
    """What the robot file says of the actuators of either version; arrays of shape (n,).

    Attributes:
        names: of the joints.
        addresses: of the actuators.
        port: for codes.
        rate: at which they may be asked, [Hz].
        signs: 1 or -1: which way an actuator turns with its joint.
    """

    names: tuple[str, ...]
    addresses: tuple[str, ...]
    port: Annotated[Port, Key("port_fast")]
    rate: AskingRate
    signs: Annotated[Float64, Key("actuator_sign"), each(-1.0, 1.0)]

    @cached_property
    def degrees(self) -> Float64:
        """Of an actuator for one radian of the joint, with its sign."""
        return np.rad2deg(self.signs)


def addressed(kind: type[A], robot: Robot, network: str, **given: Any) -> A:
    """Return the facts of one version.

    Args:
        kind: class of its facts.
        robot: the file.
        network: see `addresses`.
        given: as of `facts_of`.

    Raises:
        RobotError: a fact is missing or wrong.
    """
    where = of_actuators(robot, network)
    found = facts_of(kind, robot, names=robot.joint_names, addresses=where, **given)
    if not (np.abs(found.signs) == 1.0).all():
        raise wrong_fact(robot, "actuator_sign", "1 or -1 for each joint")
    return found


def of_actuators(robot: Robot, network: str) -> tuple[str, ...]:
    """Return the addresses of the actuators; see `addresses`."""
    listed = fact(robot, "actuators", Annotated[list[str], each_text])
    return addresses(robot, "actuators", listed, network)


def complete(robot: Robot, version: int, keys: tuple[str, ...], why: str) -> None:
    """Refuse a robot file of another version of FSA, or without facts that no vendor publishes.

    Args:
        robot: the file.
        version: of FSA.
        keys: of the facts.
        why: what is not known without them.

    Raises:
        RobotError: it is such a file.
    """
    transport = robot.transport
    if transport.get("fsa") != version:
        raise RobotError(
            f"robot {robot.name}: transport.fsa is {transport.get('fsa')}; write 1 (GR-1) or 2 "
            f"(N1) into {robot.path.name}, the version of FSA that its actuators have"
        )
    missing = [f"transport.{key}" for key in keys if transport.get(key) is None]
    if missing:
        raise RobotError(
            f"robot {robot.name}: its vendor does not say {why}; measure it, and write "
            f"{', '.join(missing)} into {robot.path.name} with its source"
        )


def addresses(robot: Robot, key: str, listed: Sequence[str], network: str) -> tuple[str, ...]:
    """Return addresses, each once.

    Args:
        robot: the file.
        key: of its transport, for messages.
        listed: there.
        network: an address in another network of 256 in which they are; the last number of each
            address stays.

    Raises:
        RobotError: one is none, or stands there twice.
    """
    if network:
        start = network.rpartition(".")[0]
        listed = [f"{start}.{address.rpartition('.')[2]}" for address in listed]
    try:
        found = tuple(str(ipaddress.IPv4Address(address)) for address in listed)
    except ValueError as error:
        raise wrong_fact(robot, key, f"IPv4 addresses ({error})") from error
    if len(set(found)) < len(found):
        raise wrong_fact(robot, key, "an address of its own for each")
    return found


class Enabling:
    """Each step goes to all joints, and the next one follows when all have answered.

    Behind a step that had to be repeated it waits until late answers are in, which would be taken
    for those of the next one where they have no number.

    Args:
        names: of the joints, each with its address.
        steps: what each is called, and its datagram with a count of ours.
        send: gives a joint a datagram.

    Attributes:
        count: of the step that waits for answers; 0 before anything has been sent.
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
        pending, due = self._pending, time.monotonic() - self._sent > AGAIN
        if not pending and (due or self._tries < 2):
            self.count, self._tries, due = self.count + 1, 0, True
            pending.update(range(len(self._names)))
        word, datagram = self._steps[0]
        if not pending:
            return f"late answers before {word}"
        if due:
            if self._tries >= TRIES:
                names = ", ".join(self._names[joint] for joint in sorted(pending)[:3])
                raise Fault(
                    f"fourier: {word} was not answered by {names}"
                    f"{' and others' if len(pending) > 3 else ''}; switch the robot off and on"
                )
            self._tries, self._sent = self._tries + 1, time.monotonic()
            for joint in pending:
                self._send(joint, datagram(self.count))
        return f"{word}: {len(pending)} actuators, {self._names[min(pending)]} first"

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


class ActuatorWire(Wire):
    """What the wires of both versions share; each sorts its answers and asks its questions.

    Args:
        states: of the workflow.
        actuators: of the robot.
        command: code of a command.
        steps: see `Enabling`.
    """

    # How often `close` sends `DISABLE`, which is not acknowledged.
    off_times = 1

    def __init__(
        self,
        states: States,
        actuators: Any,
        command: int,
        steps: Sequence[tuple[str, Callable[[int], bytes]]],
    ) -> None:
        self._states, self._facts = states, actuators
        self.counts = Counts()
        self._labels = tuple(map("{} ({})".format, actuators.names, actuators.addresses))
        self._answered = Answers(self._labels)
        self._asked, self._turn = 0.0, 0
        self._sent_gains = np.full((2, len(self._labels)), np.nan)
        self._commands = np.zeros(len(self._labels), COMMAND_TYPE)
        self._commands["code"] = command
        self._hot, self._error = known(states, "motor_temperature"), known(states, "motor_error")
        self._opened: list[Udp] = []
        self._enabling = Enabling(self._labels, steps, self._step)
        self._sockets = self._open(self._labels, actuators.addresses, actuators.port)

    def _open(self, labels: tuple[str, ...], addresses: tuple[str, ...], port: int) -> list[Udp]:
        """Return a socket to each address; where one fails, all of the wire are closed."""
        first = len(self._opened)
        try:
            for label, address in zip(labels, addresses):
                what = f"fourier: actuator {label}"
                self._opened.append(Udp(("0.0.0.0", 0), (address, port), what, self.counts))
        except BaseException:
            self._let_go()
            raise
        return self._opened[first:]

    @property
    def where(self) -> str:
        """The actuators that have not answered since all did last."""
        return str(self._answered)

    def _step(self, joint: int, data: bytes) -> None:
        """Send a step of the enabling."""
        self._sockets[joint].send(data)

    def take(self) -> int:
        """Take answers, and ask again when it is due."""
        for joint, socket in enumerate(self._sockets):
            for data in socket.received():
                self._sort(joint, data)
        self._measured()
        now = time.monotonic()
        if now - self._asked >= 0.9 / self._facts.rate:
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

    def _prepared(self, errors: dict[int, str]) -> str:
        """Go on with the enabling, unless an actuator reported an error before it began."""
        if errors and not self._enabling.count:
            joint, words = next(iter(errors.items()))
            return (
                f"actuator {self._labels[joint]} tells an error: {words}; see the vendor's list, "
                "and switch the robot off and on"
            )
        return self._enabling()

    def wait(self, timeout: float) -> bool:
        """Return True once an answer is there, False after `timeout` in [s]."""
        return bool(select.select(self._sockets, [], [], timeout)[0])

    def _tell_all(self, datagrams: Iterable[tuple[Udp, bytes]]) -> None:
        """Send datagrams, each with its socket.

        Raises:
            Fault: one could not be sent; all others were: damping has to reach the joints that
                still have a way.
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
        return np.flatnonzero(changed).tolist()

    def close(self) -> None:
        """Switch off what was enabled, behind the damping, and let go."""
        try:
            if self._enabling.count and self._opened:
                off = bytes([DISABLE])
                self._tell_all((socket, off) for socket in self._sockets * self.off_times)
        finally:
            self._let_go()

    def _let_go(self) -> None:
        while self._opened:
            self._opened.pop().close()
