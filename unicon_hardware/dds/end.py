"""Both ends of a robot's topics over DDS, made of the facts of its robot file.

class MyWire(DdsWire):                          # the driver's end, a `Wire`
    label, table = "platform 'mine'", MyFacts

class MyEndpoint(DdsEndpoint):                  # the robot's end, for the emulator
    label, table, platform = "emulated mine", MyFacts, "mine"

make = factory_of(MyRobot, MyWire)

A vendor's `DdsFacts` declare messages, modes and arrays of their own; hooks do what is odd.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from unicon_base.arrays import Array
from unicon_core.blocks.controls.device import Controls
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES, hardware_states
from unicon_hardware.dds.maps import Arrays, Message, arrays_of, command_arrays
from unicon_hardware.dds.participant import Participant, Writer
from unicon_hardware.dds.service import Inlet, Procedure
from unicon_hardware.endpoint import EmulatedModes, Endpoint
from unicon_hardware.modes import UNDOCUMENTED, ModeGuard
from unicon_hardware.wire import Counts, Wire
from unicon_hardware.wired_robot import SILENCE, WiredRobot, opened

R = TypeVar("R", bound=WiredRobot)


class DdsEnd:
    """Topics that are listened to, and topics that are spoken on.

    Args:
        facts: of the robot file's transport.
        topic: for messages.
        domain: of DDS, in place of the robot file's.
        address: of this machine's network interface, or its name; None for the default.

    Attributes:
        label: stands in front of messages.
        extra: of the package, which installs cyclonedds.
        table: class of the facts.
        announced: see `Participant`.
        participant: of the domain.
        counts: of what came in.
        where: topic and domain.

    Raises:
        UniconError: it cannot be opened.
    """

    label, extra, announced = "", "hw-unitree", False
    table: ClassVar[Any]

    def _join(self, facts: Any, topic: str, domain: int | None, address: str | None) -> None:
        domain = facts.domain if domain is None else domain
        self.where, self.counts = f"{topic} of DDS domain {domain}", Counts()
        self.participant = Participant(
            domain, address, self.label, self.extra, announced=self.announced
        )
        self._inlets: list[Inlet] = []
        self._outlets: list[tuple[Writer, Callable[[], bytes]]] = []
        self._commands: list[str] = []
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def _built(self) -> None:
        """Make what has to be there before it opens."""

    def _open(self) -> None:
        """Begin to listen and to speak."""
        raise NotImplementedError

    def inlet(self, message: Message, into: Any, counts: Counts, **how: Any) -> Inlet:
        """Return what reads a message into arrays, or with what checks and reads it."""
        frames = message.frames(into, counts) if isinstance(into, Mapping) else into
        reader = self.participant.reader(message.topic, message.struct, message.name)
        return Inlet(reader, frames, counts, self.where, **how)

    def listen(self, message: Message, into: Any, **how: Any) -> None:
        """Read a message each time `take` is called; arguments as of `inlet` and `Inlet`."""
        self._inlets.append(self.inlet(message, into, self.counts, **how))

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
        """Make the states of the arrays that were read."""

    def wait(self, timeout: float) -> bool:
        """Return True once something is there on the first topic, False after `timeout` in [s]."""
        return self._inlets[0].wait(timeout)

    def put(self) -> None:
        """Write to all topics.

        Raises:
            Fault: CycloneDDS refuses it.
        """
        for writer, encode in self._outlets:
            writer.write(encode())

    def warm_up(self) -> None:
        """Do what `put` does, but send nothing to the robot."""
        for writer, encode in self._outlets:
            writer.warm_up(encode())

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


class DdsWire(DdsEnd, Wire):
    """The driver's end: it reads `facts.state`, and sends `facts.command`.

    Args:
        states: what is measured goes into these, commands come from these.
        robot: its file.
        domain: of DDS; None for the robot file's.
        address: of this machine's network interface, or its name; None for the default.
        silent: nothing is sent.
        options: of the facts.

    Attributes:
        settles: as of `ModeGuard`; infinity where no public source says what motors report.

    Raises:
        UniconError: it cannot be opened.
    """

    settles = UNDOCUMENTED
    _takeover: Procedure | None = None

    def __init__(
        self,
        states: States,
        robot: Robot,
        domain: int | None,
        address: str | None,
        *,
        silent: bool = False,
        **options: Any,
    ) -> None:
        facts = self._facts = self.table.of(robot, **options)
        self._states, self._robot, self._silent = states, robot, silent
        self._own = facts.own(robot.num_joints)
        self._controls = Controls(states) if "sticks" in states else None
        if "modes" in self._own:
            self.modes = ModeGuard(self.label, robot.joint_names, facts.modes, settles=self.settles)
            self.modes.reported = self._own["modes"]
        self._arrays = arrays_of(states) | self._own
        self._built()
        self._join(facts, facts.state_topic, domain, address)

    def _open(self) -> None:
        self._listen()
        self.watch(self._facts.command_topic)
        if not self._silent:
            self.speak(self._facts.command, self._arrays)

    def _listen(self) -> None:
        """Begin to read the state."""
        self.listen(self._facts.state, self._facts.state_in(self._arrays, self.counts))

    def prepare(self) -> str:
        """Bring the robot to where it takes commands; return what is waited for, "" at the end."""
        return "" if self._takeover is None else self._takeover()


class DdsEndpoint(DdsEnd, Endpoint):
    """The robot's end: it sends `facts.state`, and hears `facts.command`.

    What the robot does without commands is not public: it goes on with the last one.

    Args:
        states: of the emulator; where those of hardware lack, what they begin with is sent.
        robot: its file.
        address: of this machine's network interface, or its name.
        domain: of DDS, in place of the robot file's.

    Attributes:
        rate: of its state in [Hz].
        own: what it sends besides states, by name; `modes` are those of its motors.
        modes: of the motors, where commands say theirs: those of the last one.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """

    modes: EmulatedModes

    def __init__(
        self,
        states: States,
        robot: Robot,
        *,
        address: str | None = "127.0.0.1",
        domain: int | None = None,
    ) -> None:
        self._build(states, robot, self.table.of(robot), address, domain)

    def _build(
        self, states: States, robot: Robot, facts: Any, address: str | None, domain: int | None
    ) -> None:
        n = robot.num_joints
        self.rate, self._facts, self._states = facts.rate, facts, states
        self.own, heard = facts.own(n), facts.own(n)
        self._heard = command_arrays(n) | heard
        if "modes" in self.own:
            self.modes = EmulatedModes(self.own["modes"])
        self._built()
        unless = States(hardware_states(robot.joint_names))
        self._arrays = arrays_of(unless) | arrays_of(states) | self.own
        self._join(facts, facts.command_topic, domain, address)

    @property
    def reach(self) -> dict[str, object]:
        """Options `address` and `domain` of the platform."""
        at = self.participant
        where = {} if at.address is None else {"address": at.address}
        return {**where, "domain": at.domain}

    def _open(self) -> None:
        facts = self._facts
        self.speak(facts.state, self._arrays)
        self._frames = facts.command_in(self._heard, self.counts)
        self.listen(facts.command, self, anyone=True)

    def tell(self) -> None:
        """Send what the robot measures."""
        self.put()

    def hear(self) -> bool:
        """Bring the newest command that acts into the command states; True where one came."""
        return bool(self.take())

    def good(self, raw: bytes) -> bool:
        """Return whether a command acts; count what does not."""
        return bool(self._frames.good(raw) and self._frames.read(raw) and self._acts())

    def read(self, raw: bytes) -> bool:
        """Bring a command that acts into the command states."""
        read = bool(self._frames.read(raw))
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


def factory_of(kind: type[R], wire: type[DdsWire], silence: float = SILENCE) -> Callable[..., R]:
    """Return the factory of a platform, which stands as `make` in the module of its class.

    Args:
        kind: its class.
        wire: class of its wire.
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
