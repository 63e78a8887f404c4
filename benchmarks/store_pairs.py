"""Ways on which `unicon bench stores` carries a group to another process: ours, and others'.

Each is two ends. A `Sender` publishes the states as they are; a `Receiver` waits and puts
what has come into its states. They meet at a place: a path that nobody else uses.

Other people's are a bare socket, rclpy, raw and plain, and iceoryx2, written as a good engineer
would: a lean message of bytes (UInt8MultiArray), reused, keep-last-1, an executor with a callback.
iceoryx2 wakes its reader by an event and drains to the newest sample.
"""

from __future__ import annotations

import ctypes
import os
import socket
import time
from array import array
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

from unicon_base.errors import StateError
from unicon_core.states import States, StateSpec
from unicon_core.states.backends.shm import Segment, ShmReader, ShmWriter
from unicon_core.states.backends.zmq import ZmqReader, ZmqWriter

GROUP = "bench"
PAUSE = 50e-6  # s between two looks of a reader that polls
PATIENCE = 20.0  # s until the other end must be there
_CDR = bytes([0, 1, 0, 0]) + bytes(8)  # encapsulation, no dimensions, data_offset 0

_T = TypeVar("_T")


def group() -> States:
    """Return the states that are carried: 512 bytes, all of which tell the value's number."""
    specs = {"data": StateSpec((112,)), "number": StateSpec((), "int64")}
    return States(specs | {"stamp_ns": StateSpec((), "int64")})


def segment_name(place: Path) -> str:
    """Return the name of the shared memory at a place."""
    return f"{place.parent.name}-{place.name}"


class Sender(Protocol):
    """Sends the states as they are."""

    def publish(self) -> object: ...

    def close(self) -> None: ...


class Receiver(Protocol):
    """Receives into the states.

    Attributes:
        starved: how often a value could not be had whole.
    """

    @property
    def starved(self) -> int: ...

    def receive(self, timeout: float) -> bool:
        """Wait for a value; return whether one has come."""
        ...

    def close(self) -> None: ...


def _shm_sender(place: Path, states: States) -> Sender:
    segment = Segment.create(segment_name(place), {GROUP: states.layout})
    return ShmWriter(segment, GROUP, states)


def _zmq_sender(place: Path, states: States, address: str) -> Sender:
    writer = ZmqWriter(address.format(place=place), GROUP, states.layout, states)
    told = place.with_suffix(".told")
    told.write_text(writer.address, encoding="utf-8")
    os.replace(told, place.with_suffix(".address"))
    return writer


class _Waiting:
    """Waits for one of our readers, asleep."""

    def __init__(self, reader: Any) -> None:
        self._reader, self.close = reader, reader.close

    @property
    def starved(self) -> int:
        return getattr(self._reader, "starved", 0)

    def receive(self, timeout: float) -> bool:
        return bool(self._reader.wait(timeout) and self._reader.take())


class _Polling(_Waiting):
    def receive(self, timeout: float) -> bool:
        take, end = self._reader.take, time.monotonic() + timeout
        while not take():
            time.sleep(PAUSE)
            if time.monotonic() > end:
                return False
        return True


def _shm_reader(place: Path, states: States) -> ShmReader:
    return _when_there(lambda: ShmReader(segment_name(place), GROUP, states))


def _zmq_receiver(place: Path, states: States) -> _Waiting:
    address = _when_there(place.with_suffix(".address").read_text)
    return _Waiting(ZmqReader(address, GROUP, states.layout, states))


class _DatagramSender:
    def __init__(self, place: Path, states: States) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._place, self._data = str(place), states.buffer.data
        self.close = self._socket.close

    def publish(self) -> None:
        # Nobody looks, or nobody is there.
        with suppress(BlockingIOError, ConnectionRefusedError, FileNotFoundError):
            self._socket.sendto(self._data, self._place)


class _DatagramReceiver:
    starved = 0

    def __init__(self, place: Path, states: States) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(place))
        self._data = states.buffer.data
        self.close = self._socket.close

    def receive(self, timeout: float) -> bool:
        self._socket.settimeout(timeout)
        try:
            return self._socket.recv_into(self._data) > 0
        except TimeoutError:
            return False


def _when_there(attempt: Callable[[], _T]) -> _T:
    """Return what the attempt returns once the other end is there."""
    end = time.monotonic() + PATIENCE
    while True:
        try:
            return attempt()
        except (StateError, FileNotFoundError):
            if time.monotonic() > end:
                raise
            time.sleep(0.01)


class _RosNode:
    def __init__(self, name: str) -> None:
        import rclpy

        self._rclpy = rclpy
        rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        self.node = rclpy.node.Node(name)

    def close(self) -> None:
        """Let go."""
        self.node.destroy_node()
        self._rclpy.try_shutdown()


class RosSender(_RosNode):
    """Publishes the bytes, in a message or (raw) serialized by hand."""

    def __init__(self, place: Path, states: States, raw: bool) -> None:
        from std_msgs.msg import UInt8MultiArray

        from unicon_ros.bench.pipelines.plain import qos

        super().__init__("writer")
        self._send = self.node.create_publisher(UInt8MultiArray, "group", qos(False)).publish
        self._data, self._raw, self._message = states.buffer.data, raw, UInt8MultiArray()
        self._head = _CDR + len(self._data).to_bytes(4, "little")

    def publish(self) -> None:
        """Send the states as they are."""
        if self._raw:
            self._send(self._head + self._data)
        else:
            self._message.data = array("B", self._data)
            self._send(self._message)


class RosReceiver(_RosNode):
    """Receives in the callback of a single-threaded executor."""

    starved = 0

    def __init__(self, place: Path, states: States, raw: bool) -> None:
        from rclpy.executors import SingleThreadedExecutor
        from std_msgs.msg import UInt8MultiArray

        from unicon_ros.bench.pipelines.plain import qos

        super().__init__("reader")
        self._data, self._come = states.buffer.data, False
        start = len(_CDR) + 4

        def on_bytes(message: bytes) -> None:
            self._data[:] = message[start : start + len(self._data)]
            self._come = True

        def on_message(message: Any) -> None:
            self._data[:] = message.data
            self._come = True

        callback = on_bytes if raw else on_message
        self.node.create_subscription(UInt8MultiArray, "group", callback, qos(False), raw=raw)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def receive(self, timeout: float) -> bool:
        """Wait for a value; return whether one has come."""
        self._come = False
        self._executor.spin_once(timeout_sec=timeout)
        return self._come


class _Iceoryx:
    def __init__(self, place: Path, states: States) -> None:
        import iceoryx2

        iceoryx2.set_log_level(iceoryx2.LogLevel.Error)
        self.iceoryx2: Any = iceoryx2
        self.size = states.layout.nbytes
        self.address = states.buffer.ctypes.data

        class Group(ctypes.Structure):
            _fields_ = (("data", ctypes.c_uint8 * self.size),)

        builder = iceoryx2.NodeBuilder.new()
        builder = builder.signal_handling_mode(iceoryx2.SignalHandlingMode.Disabled)
        self._node = builder.create(iceoryx2.ServiceType.Ipc)
        name = iceoryx2.ServiceName.new(str(place))
        self.values = self._node.service_builder(name).publish_subscribe(Group).open_or_create()
        self.events = self._node.service_builder(name).event().open_or_create()
        self.ports: tuple[Any, ...] = ()

    def close(self) -> None:
        """Let go."""
        for port in self.ports:
            port.delete()


class IceoryxSender(_Iceoryx):
    """Loans a sample, fills it, sends it, and notifies."""

    def __init__(self, place: Path, states: States) -> None:
        super().__init__(place, states)
        self._publisher = self.values.publisher_builder().create()
        self._notifier = self.events.notifier_builder().create()
        self.ports = self._publisher, self._notifier

    def publish(self) -> None:
        """Send the states as they are."""
        sample = self._publisher.loan_uninit()
        ctypes.memmove(sample.payload_ptr, self.address, self.size)
        sample.assume_init().send()
        self._notifier.notify()


class IceoryxReceiver(_Iceoryx):
    """Waits for the event and drains to the newest sample."""

    starved = 0

    def __init__(self, place: Path, states: States) -> None:
        super().__init__(place, states)
        self._subscriber = self.values.subscriber_builder().create()
        self._listener = self.events.listener_builder().create()
        self.ports = self._subscriber, self._listener

    def receive(self, timeout: float) -> bool:
        """Wait for a value; return whether one has come."""
        end = time.monotonic() + timeout
        while True:
            newest = None
            while (sample := self._subscriber.receive()) is not None:
                newest = sample
            if newest is not None:
                ctypes.memmove(self.address, newest.payload_ptr, self.size)
                return True
            left = end - time.monotonic()
            if left <= 0.0:
                return False
            with suppress(self.iceoryx2.ListenerWaitError):  # a signal, such as SIGCONT
                self._listener.timed_wait(self.iceoryx2.Duration.from_secs_f64(left))


@dataclass(frozen=True)
class StorePair:
    """Two ends, made of a place and the states.

    Attributes:
        needs: modules without which there is no such way.
    """

    sender: Callable[[Path, States], Sender]
    receiver: Callable[[Path, States], Receiver]
    needs: tuple[str, ...] = ()


WAYS: Mapping[str, StorePair] = {
    "shm, sleeping": StorePair(_shm_sender, lambda *of: _Waiting(_shm_reader(*of))),
    "shm, polling": StorePair(_shm_sender, lambda *of: _Polling(_shm_reader(*of))),
    "zmq ipc": StorePair(partial(_zmq_sender, address="ipc://{place}"), _zmq_receiver, ("zmq",)),
    "zmq tcp": StorePair(
        partial(_zmq_sender, address="tcp://127.0.0.1:*"), _zmq_receiver, ("zmq",)
    ),
    "unix datagram": StorePair(_DatagramSender, _DatagramReceiver),
    "rclpy, raw": StorePair(
        partial(RosSender, raw=True), partial(RosReceiver, raw=True), ("rclpy",)
    ),
    "rclpy": StorePair(partial(RosSender, raw=False), partial(RosReceiver, raw=False), ("rclpy",)),
    "iceoryx2": StorePair(IceoryxSender, IceoryxReceiver, ("iceoryx2",)),
}
"""Name of each way to its ends."""
