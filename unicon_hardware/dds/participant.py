"""Raw bytes over CycloneDDS, for drivers and emulators: no Python object per message.

    participant = Participant(0, "eth0", "platform 'unitree'")
    reader = participant.reader("rt/lowstate", struct)     # reader.take(): [(bytes, writer), …]
    writer = participant.writer("rt/lowcmd", struct)       # writer.write(raw)
    participant.close()

The calls that pass bytes are private ones of the package, so that it is asked for by its version.

Types are made of the message definitions that `unicon_msgs_map` has. The names on the wire are
those of ROS 2, which Unitree, PND and Dobot keep to in their IDL: `unitree_go/msg/LowCmd` is
`unitree_go.msg.dds_.LowCmd_`, final, with sequential member ids (unitree_sdk2py/idl of
unitreerobotics/unitree_sdk2_python). All octets are `byte`: declared as `uint8`, cyclonedds 11
describes them by a type that 0.10.2, which is on the robots, does not know, so that it crashes.
"""

from __future__ import annotations

import socket
from collections.abc import Callable
from contextlib import suppress
from importlib import metadata
from typing import Any

from unicon_base import Fault, MissingDependencyError, PlatformError
from unicon_hardware.dds.domains import enter, leave
from unicon_msgs_map.layout.messages import Array, Primitive, String, Struct, TypeRef

OCTETS = ("uint8", "int8", "byte")
"""What Unitree's IDL has as octet; their .msg files call temperatures of octets signed."""


def dds_type(message: Struct, name: str = "") -> Any:
    """Return the class that CycloneDDS wants of a topic, an `IdlStruct`.

    Args:
        message: its layout.
        name: in DDS, where it does not follow from the message's.

    Only its description is used: what is sent and received are raw bytes.
    """
    from cyclonedds.idl import annotations, make_idl_struct

    fields = {key: _member(kind) for key, kind in message.fields.items()}
    if not name:
        package, _, own = message.name.split("/")
        name = f"{package}.msg.dds_.{own}_"
    made = make_idl_struct(name.split(".")[-1], name, fields)
    annotations.final(made)
    annotations.autoid("sequential")(made)
    return made


def _member(kind: TypeRef) -> Any:
    from cyclonedds.idl import types

    if isinstance(kind, Primitive):
        if kind.name == "bool":
            return bool
        return getattr(types, "byte" if kind.name in OCTETS else kind.name)
    if isinstance(kind, String):
        return str
    if isinstance(kind, Array):
        item = _member(kind.item)
        if kind.length is None:
            return types.sequence[item, kind.bound] if kind.bound else types.sequence[item]
        return types.array[item, kind.length]
    return dds_type(kind)


VERSION = "11.0.1"
"""Of cyclonedds: another one may pass bytes otherwise, or none."""
LARGEST_DOMAIN = 230
"""The ports of higher ones lie beyond 65,535 (RTPS 2.5, 9.6.2.3), with room for participants."""
DEPTH = 8
"""Frames that are kept for the next look: a tick at 50 Hz sees 500 Hz only in part, and who sends
garbage beside the robot does not hide its good frames."""
# Mask of samples in any state.
_ANY = 0x7F
# For header, destination and submessage in front of a message (RTPS 2.5, 9.4).
_RTPS = bytes(44)
Echo = tuple[socket.socket, tuple[str, int]]


def _load(what: str, extra: str) -> None:
    """Look whether the package is there, in the version that is known.

    Raises:
        MissingDependencyError: it is not installed.
        PlatformError: it is another version.
    """
    install = f"pip install 'unicon_ros[{extra}]'"
    try:
        found = metadata.version("cyclonedds")
        import cyclonedds  # noqa: F401
    except ImportError as error:
        raise MissingDependencyError(what, "cyclonedds", install) from error
    if found != VERSION:
        raise PlatformError(
            f"{what}: cyclonedds is {found}, and only {VERSION} is known to pass raw bytes; "
            f"{install}"
        )


class Participant:
    """This process on a DDS domain.

    Args:
        domain: its number; most robots have 0.
        address: of this machine's network interface to the robot, or its name; None leaves the
            choice to CYCLONEDDS_URI, and without it to CycloneDDS.
        what: in front of messages.
        extra: of the package, which installs cyclonedds.
        announced: older releases of Fast DDS have to see it (`Announcer`); wants an address.

    Attributes:
        domain: as given.
        address: as given.

    Raises:
        MissingDependencyError: cyclonedds is not installed.
        PlatformError: another version of it is, or the interface or domain cannot be used.
    """

    def __init__(
        self,
        domain: int,
        address: str | None,
        what: str,
        extra: str = "hw-unitree",
        *,
        announced: bool = False,
    ) -> None:
        _load(what, extra)
        if type(domain) is not int or not 0 <= domain <= LARGEST_DOMAIN:
            raise PlatformError(f"{what}: domain is {domain}; give 0 to {LARGEST_DOMAIN}")
        self.domain, self.address, self._what = domain, address, what
        self._entities: list[Any] = []
        self._others: Any = None
        self._echo: Echo | None = None
        self._open = False
        enter(domain, address, what, announced=announced)
        self._open = True
        from cyclonedds.core import DDSException
        from cyclonedds.domain import DomainParticipant

        try:
            self._participant = DomainParticipant(domain)
        except DDSException as error:
            self.close()
            raise PlatformError(
                f"{what}: cannot join DDS domain {domain}: {error.msg}; see CYCLONEDDS_URI and "
                "the network interface (ip addr)"
            ) from error

    def _made(self, make: Any, *arguments: Any) -> Any:
        from cyclonedds.core import DDSException

        try:
            entity = make(self._participant, *arguments)
        except DDSException as error:
            raise PlatformError(f"{self._what}: {make.__name__}: {error.msg}") from error
        self._entities.append(entity)
        return entity

    def reader(self, topic: str, message: Struct, name: str = "") -> Reader:
        """Return a reader: best effort, which fits writers of either kind.

        Args:
            name: of the type in DDS, where it does not follow from the message's.
        """
        from cyclonedds.core import Policy, Qos
        from cyclonedds.sub import DataReader

        qos = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(DEPTH))
        reader = Reader(self._made(DataReader, self._topic(topic, message, name), qos))
        self._entities += reader.waits
        return reader

    def writer(self, topic: str, message: Struct, name: str = "") -> Writer:
        """Return a writer: reliable, which fits readers of either kind, and never waits.

        Args:
            name: of the type in DDS, where it does not follow from the message's.
        """
        from cyclonedds.core import Policy, Qos
        from cyclonedds.pub import DataWriter

        qos = Qos(Policy.Reliability.Reliable(max_blocking_time=0), Policy.History.KeepLast(1))

        def idle() -> tuple[Any, Echo]:
            self._echo = self._echo or _echo()
            unread = self._topic(f"unicon/{topic}", message, name)
            return self._made(DataWriter, unread, qos)._ref, self._echo

        made = self._made(DataWriter, self._topic(topic, message, name), qos)
        return Writer(made, idle, f"{self._what}: {topic}")

    def _topic(self, topic: str, message: Struct, name: str) -> Any:
        from cyclonedds.topic import Topic

        return self._made(Topic, topic, dds_type(message, name))

    def watch(self) -> None:
        """Begin to see who else writes, for `others`; discovery takes part of a second."""
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication

        self._others = self._made(BuiltinDataReader, BuiltinTopicDcpsPublication)

    def others(self, topic: str) -> int:
        """Return how many writers a topic has besides those of this participant."""
        alive = 16  # of DDS instance states: those that have gone are still told of
        return sum(
            1
            for found in self._others.read(N=1000)
            if found.sample_info.valid_data and found.sample_info.instance_state == alive
            if found.topic_name == topic and found.participant_key != self._participant.guid
        )

    def close(self) -> None:
        """Let go of everything that it made; safe to call twice."""
        if not self._open:
            return
        self._open = False
        for entity in reversed(self._entities):
            with suppress(Exception):
                entity.__del__()  # deletes it now, with other references to it left
        self._entities.clear()
        with suppress(AttributeError):  # it could not be made
            self._participant.__del__()
        if self._echo is not None:
            self._echo[0].close()
        leave(self.domain)


class Reader:
    """Takes raw messages of a topic; made by `Participant`.

    Attributes:
        waits: what it waits with, to be deleted before it.
    """

    def __init__(self, reader: Any) -> None:
        from cyclonedds._clayer import ddspy_take
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet

        self._reader, self._ref, self._take = reader, reader._ref, ddspy_take
        any_state = SampleState.Any | ViewState.Any | InstanceState.Any
        condition = ReadCondition(reader, any_state)
        self._waiting = WaitSet(reader.participant)
        self._waiting.attach(condition)
        self.waits = [condition, self._waiting]

    def take(self) -> list[tuple[bytes, Any]]:
        """Return what came since the last call, the oldest first: payload and its DDS info.

        A payload whose info says `valid_data` False tells that a writer has gone.
        """
        found = self._take(self._ref, _ANY, DEPTH)
        return found if isinstance(found, list) else []

    def wait(self, timeout: float) -> bool:
        """Return True once something is there, False after `timeout` in [s]."""
        return bool(self._waiting.wait(max(round(timeout * 1e9), 0)))

    @property
    def sources(self) -> list[int]:
        """Who writes to the topic, by the `publication_handle` of what they send."""
        # Said with a sign here, and without one there.
        return [handle % (1 << 64) for handle in self._reader.get_matched_publications()]


class Writer:
    """Writes raw messages to a topic; made by `Participant`.

    Args:
        writer: of the topic.
        idle: makes one of another topic, which nobody reads, and a socket that sends to itself; of
            a writer that is never warmed up, as in an emulator, there is neither.
        what: in front of messages.
    """

    def __init__(self, writer: Any, idle: Callable[[], tuple[Any, Echo]], what: str) -> None:
        from cyclonedds._clayer import ddspy_write

        self._writer, self._ref, self._write, self._what = writer, writer._ref, ddspy_write, what
        self._make_idle = idle
        self._idle: tuple[Any, Echo] | None = None

    def write(self, raw: bytes) -> None:
        """Send encapsulation header and body, with zeros behind to a multiple of 4 bytes.

        Raises:
            Fault: CycloneDDS refuses it.
        """
        code = self._write(self._ref, raw + bytes(-len(raw) % 4))
        if code < 0:
            raise Fault(f"{self._what} cannot be sent: CycloneDDS error {code}")

    def warm_up(self, raw: bytes) -> None:
        """Bring the code that sends a message into the caches, and send none.

        It is written where nobody reads, and goes to this process itself: measured at 500 Hz, cold
        79 µs, behind the first of both 47, behind both 31.
        """
        if self._idle is None:  # in the first tick that waits, long before anything is sent
            self._idle = self._make_idle()
        reference, (echo, itself) = self._idle
        self._write(reference, raw)
        with suppress(OSError):
            # In pieces, to an address, as CycloneDDS does.
            echo.sendmsg((_RTPS, raw), (), 0, itself)
            echo.recv(1)

    @property
    def matched(self) -> bool:
        """Whether somebody reads the topic."""
        return bool(self._writer.get_matched_subscriptions())


def _echo() -> Echo:
    """Return a socket that may send datagrams to itself, and its address.

    It is not connected, as CycloneDDS's are not: the kernel then looks the way up each time, which
    cold takes 8 µs.
    """
    echo = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    echo.setblocking(False)
    echo.bind(("127.0.0.1", 0))
    return echo, echo.getsockname()
