"""DdsEnd: one end of a robot's topics, for wires of drivers and for faces of emulators.

class MyWire(DdsEnd):
    label = "platform 'mine'"

    def __init__(self, …):
        super().__init__(facts.state_topic, facts.domain, domain, address)
        with self.closing():
            self.listen(facts.state, arrays)
            self.speak(facts.command, arrays)

It has `take`, `wait`, `put`, `warm_up`, `commanders` and `close` of a `Wire`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from unicon_base.arrays import Array
from unicon_base.errors import Fault
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES, hardware_states
from unicon_hardware.dds.maps import Arrays, Message, arrays_of, command_arrays
from unicon_hardware.dds.participant import Participant, Reader, Writer
from unicon_hardware.modes import EmulatedModes
from unicon_hardware.wire import Counts
from unicon_hardware.wired_robot import SILENCE, WiredRobot, opened

R = TypeVar("R", bound=WiredRobot)


class Inlet:
    """Messages of whoever sent the first good one, until that sender has gone.

    Args:
        reader: of the topic.
        good: whether a message may be read; it counts what it refuses.
        read: reads a message; where it returns False, the one before it is read.
        counts: gets the good ones, and those of others.
        where: topic and domain, for messages.
        forget: called when the sender has gone: the next one begins anew.
        anyone: whoever sends is read, as a robot does with commands.
    """

    def __init__(
        self,
        reader: Reader,
        good: Callable[[bytes], bool],
        read: Callable[[bytes], bool],
        counts: Counts,
        where: str,
        forget: Callable[[], None] = lambda: None,
        *,
        anyone: bool = False,
    ) -> None:
        self._reader, self._good, self._read = reader, good, read
        self._counts, self._where, self._forget = counts, where, forget
        self._anyone = anyone
        self._source: int | None = None
        self._ahead = 0
        self._fault: Fault | None = None

    def wait(self, timeout: float) -> bool:
        """Return True once something is there, False after `timeout` in [s]."""
        return bool(self._ahead) or self._fault is not None or self._reader.wait(timeout)

    def read_ahead(self) -> None:
        """Do now what `take` would do; it tells of it, of a fault too, when it is called."""
        if self._fault is None:
            try:
                self._ahead += self._take()
            except Fault as fault:
                self._fault = fault

    def take(self) -> int:
        """Read the newest good message; return how many good ones have come."""
        fault, ahead = self._fault, self._ahead
        self._fault, self._ahead = None, 0
        if fault is not None:
            raise fault
        return ahead + self._take()

    def _take(self) -> int:
        good: list[bytes] = []
        for raw, info in self._reader.take():
            if not info.valid_data:
                if info.publication_handle == self._source:
                    self._anew()
            elif self._own(info.publication_handle) and self._good(raw):
                self._source = info.publication_handle
                good.append(raw)
        number = len(good)
        while good and not self._read(good.pop()):
            number -= 1
        self._counts.good += number
        return number

    def _anew(self) -> None:
        self._source = None
        self._forget()

    def _own(self, source: int) -> bool:
        if self._anyone or self._source in (None, source):
            return True
        if self._source not in self._reader.sources:  # it has gone, and another robot has come
            self._anew()
            return True
        self._counts.refuse("another sender", f"{self._where} has two")
        return False


class Checked(Protocol):
    """What looks at messages and reads them, such as `Frames`."""

    def good(self, raw: bytes) -> bool:
        """Tell whether a message may be read; count what may not."""
        ...

    def read(self, raw: bytes) -> bool:
        """Read a good one; where it is refused nothing is written."""
        ...


class DdsEnd:
    """Topics that are listened to, and topics that are spoken on.

    Args:
        topic: for messages.
        own: domain of DDS that the robot file says.
        domain: instead of it; None for that.
        address: of this machine's network interface, or its name; None for the default.
        ahead: `warm_up` reads what is there already, so that what is read into must be arrays of
            the wire's own until `take` is called.
        announced: see `Participant`.

    Attributes:
        label: stands in front of messages.
        extra: of the package, which installs cyclonedds.
        participant: of the domain.
        counts: of what came in.
        where: topic and domain.

    Raises:
        UniconError: it cannot be opened.
    """

    label, extra = "", "hw-unitree"

    def __init__(
        self,
        topic: str,
        own: int,
        domain: int | None,
        address: str | None,
        *,
        ahead: bool = False,
        announced: bool = False,
    ) -> None:
        domain = own if domain is None else domain
        self.where = f"{topic} of DDS domain {domain}"
        self.counts = Counts()
        self._ahead = ahead
        self.participant = Participant(domain, address, self.label, self.extra, announced=announced)
        self._inlets: list[Inlet] = []
        self._outlets: list[tuple[Writer, Callable[[], bytes]]] = []
        self._commands: list[str] = []

    @contextmanager
    def closing(self) -> Iterator[None]:
        """Close it where what is built inside fails."""
        try:
            yield
        except BaseException:
            self.close()
            raise

    def listen(
        self,
        message: Message,
        into: Arrays | Checked,
        *,
        forget: Callable[[], None] = lambda: None,
        anyone: bool = False,
    ) -> None:
        """Read a message into arrays, or with what checks and reads it; see `Inlet`."""
        frames = message.frames(into, self.counts) if isinstance(into, Mapping) else into
        reader = self.participant.reader(message.topic, message.struct, message.name)
        inlet = Inlet(
            reader, frames.good, frames.read, self.counts, self.where, forget, anyone=anyone
        )
        self._inlets.append(inlet)

    def speak(self, message: Message, of: Arrays | Callable[[], bytes]) -> None:
        """Write a message of arrays, or what a function returns, each time `put` is called."""
        encode = of if callable(of) else message.encoder(of).encode
        writer = self.participant.writer(message.topic, message.struct, message.name)
        self._outlets.append((writer, encode))

    def watch(self, *topics: str) -> None:
        """Begin to see who else commands on these topics, for `commanders`."""
        self.participant.watch()
        self._commands += topics

    def take(self) -> int:
        """Bring the newest good message of each topic into the arrays; return how many came.

        Raises:
            Fault: as a vendor's wire says.
        """
        number = sum(inlet.take() for inlet in self._inlets)
        if number:
            self._measured()
        return number

    def _measured(self) -> None:
        """Make what the states shall be of the arrays that were read."""

    def wait(self, timeout: float) -> bool:
        """Return True once something is there on the first topic, False after `timeout` in [s]."""
        return self._inlets[0].wait(timeout)

    def put(self) -> None:
        """Write to all topics.

        Raises:
            Fault: CycloneDDS refuses it.
        """
        for writer, encode in self._outlets:
            raw = encode()
            writer.write(raw + bytes(-len(raw) % 4))

    def warm_up(self) -> None:
        """Read ahead, and do what `put` does, but send nothing to the robot."""
        if self._ahead:
            for inlet in self._inlets:
                inlet.read_ahead()
        for writer, encode in self._outlets:
            writer.warm_up(encode())

    @property
    def reach(self) -> dict[str, object]:
        """Options `address` and `domain` of a platform for the other end; see `Face`."""
        participant = self.participant
        where = {} if participant.address is None else {"address": participant.address}
        return {**where, "domain": participant.domain}

    @property
    def matched(self) -> bool:
        """Whether somebody reads each of its topics."""
        return all(writer.matched for writer, _ in self._outlets)

    def commanders(self) -> dict[str, int]:
        """Return the topics that are watched, with the number of others that write there."""
        return {topic: self.participant.others(topic) for topic in self._commands}

    def close(self) -> None:
        """Leave the domain."""
        self.participant.close()


def factory_of(
    kind: type[R], wire: Callable[..., DdsEnd], silence: float = SILENCE
) -> Callable[..., R]:
    """Return the factory of a platform, which stands as `make` in the module of its class.

    Args:
        kind: its class.
        wire: makes the wire of states, robot, domain, address and `silent`.
        silence: default of the option, in [s].
    """
    usual = silence

    def make(
        states: States,
        robot: Robot,
        period: float,
        *,
        address: str | None = None,
        domain: int | None = None,
        connect: float = 5.0,
        silence: float = usual,
        silent: bool = False,
    ) -> R:
        """Build the platform and wait for the robot.

        Args:
            period: of a tick in [s].
            address: of this machine's network interface to the robot, or that interface's name;
                without it CYCLONEDDS_URI, or CycloneDDS itself, decides.
            domain: of DDS, instead of the robot file's.
            connect: how long to wait for the first frame in [s].
            silence: of the robot that is a fault, in [s].
            silent: receive only: nothing is sent, at the end either.

        Raises:
            MissingDependencyError: cyclonedds is not installed.
            RobotError: the robot file lacks a fact.
            PlatformError: the network cannot be used, or no frame came in time.
        """
        opening = wire(states, robot, domain, address, silent=silent)
        return opened(kind(states, robot, period, opening, silence=silence, silent=silent), connect)

    # A workflow reads the class in the annotation, and a child process imports the factory by name.
    make.__annotations__["return"] = kind
    make.__module__, make.__qualname__ = kind.__module__, "make"
    return make


class DdsEndpoint(DdsEnd):
    """The robot's end: it tells `facts.state`, and hears `facts.command`.

    Args:
        states: of the emulator; where those of hardware lack, what they begin with is told.
        robot: its file.
        facts: of its transport.
        domain: of DDS, instead of the robot file's.
        address: of this machine's network interface, or its name.
        own: what it tells besides states, by name; `modes` are those of its motors.
        heard: what commands say besides command states, by name.
        announced: see `Participant`.

    Attributes:
        rate: of its state in [Hz].
        modes: of the motors, where commands say theirs: those of the last one.
    """

    modes: EmulatedModes

    def __init__(
        self,
        states: States,
        robot: Robot,
        facts: Any,
        domain: int | None,
        address: str | None,
        own: Arrays,
        heard: Arrays,
        *,
        announced: bool = False,
    ) -> None:
        self.rate, self._facts, self._states = facts.rate, facts, states
        self._heard = {**command_arrays(robot.num_joints), **heard}
        if "modes" in own:
            self.modes = EmulatedModes(own["modes"])
        unless = States(hardware_states(robot.joint_names))
        self._arrays = {**arrays_of(unless), **arrays_of(states), **own}
        super().__init__(facts.command_topic, facts.domain, domain, address, announced=announced)
        with self.closing():
            self._open()

    @property
    def dead_man(self) -> float:
        """Infinity: what the robot does without commands is not public."""
        return math.inf

    @property
    def obeys(self) -> bool:
        """Whether commands act: always, where no program of its own must let go first."""
        return True

    def _open(self) -> None:
        """Begin to speak and to listen."""
        self.speak(self._facts.state, self._arrays)
        self._frames: Checked = self._facts.command_in(self._heard, self.counts)
        self.listen(self._facts.command, self, anyone=True)

    def hear(self) -> bool:
        """Bring the newest command that acts into the command states; True where one came."""
        return bool(self.take())

    def good(self, raw: bytes) -> bool:
        """Tell whether a command acts; count what does not."""
        return self._frames.good(raw) and self._frames.read(raw) and self._acts()

    def read(self, raw: bytes) -> bool:
        """Bring a command that acts into the command states."""
        read = self._frames.read(raw)
        if read:
            self._act()
        return read

    def _acts(self) -> bool:
        """Return whether a command acts; it is counted where it does not."""
        raise NotImplementedError

    def _act(self) -> None:
        """Bring the command that came into the command states."""
        for name in COMMAND_STATES:
            self._states[name][...] = self._heard[name]
        if "modes" in self._heard:
            self.modes.command(self._heard["modes"], self._states)

    def _right(self, reason: str, said: Array, wanted: ArrayLike) -> bool:
        """Return whether a command says what is wanted; it is counted where it does not."""
        right = bool((said == wanted).all())
        if not right:
            self.counts.refuse(reason, f"{said.tolist()}, not {np.unique(wanted).tolist()}")
        return right
