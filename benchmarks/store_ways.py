"""Ways on which `unicon bench stores` carries a group to another process: ours, and a bare socket.

Each is two ends. A `Sender` publishes the states as they are; a `Receiver` waits and puts
what has come into its states. They meet at a place: a path that nobody else uses.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar

from benchmarks.store_baselines import IceoryxReceiver, IceoryxSender, RosReceiver, RosSender
from unicon_core.errors import StateError
from unicon_core.states import States, StateSpec
from unicon_core.states.backends.shm import Segment, ShmReader, ShmWriter
from unicon_core.states.backends.zmq import ZmqReader, ZmqWriter

GROUP = "bench"
PAUSE = 50e-6  # s between two looks of a reader that polls
PATIENCE = 20.0  # s until the other end must be there

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


class _ShmReceiver:
    def __init__(self, place: Path, states: States) -> None:
        self._reader = _when_there(lambda: ShmReader(segment_name(place), GROUP, states))
        self.close = self._reader.close

    @property
    def starved(self) -> int:
        return self._reader.starved

    def receive(self, timeout: float) -> bool:
        return self._reader.wait(timeout) and self._reader.take()


class _ShmPoller(_ShmReceiver):
    def receive(self, timeout: float) -> bool:
        take, end = self._reader.take, time.monotonic() + timeout
        while not take():
            time.sleep(PAUSE)
            if time.monotonic() > end:
                return False
        return True


class _ZmqReceiver:
    starved = 0

    def __init__(self, place: Path, states: States) -> None:
        address = _when_there(place.with_suffix(".address").read_text)
        self._reader = ZmqReader(address, GROUP, states.layout, states)
        self.close = self._reader.close

    def receive(self, timeout: float) -> bool:
        return self._reader.wait(timeout) and self._reader.take()


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


@dataclass(frozen=True)
class Way:
    """Two ends, made of a place and the states.

    Attributes:
        needs: modules without which there is no such way.
    """

    sender: Callable[[Path, States], Sender]
    receiver: Callable[[Path, States], Receiver]
    needs: tuple[str, ...] = ()


WAYS: Mapping[str, Way] = {
    "shm, sleeping": Way(_shm_sender, _ShmReceiver),
    "shm, polling": Way(_shm_sender, _ShmPoller),
    "zmq ipc": Way(partial(_zmq_sender, address="ipc://{place}"), _ZmqReceiver, ("zmq",)),
    "zmq tcp": Way(partial(_zmq_sender, address="tcp://127.0.0.1:*"), _ZmqReceiver, ("zmq",)),
    "unix datagram": Way(_DatagramSender, _DatagramReceiver),
    "rclpy, raw": Way(partial(RosSender, raw=True), partial(RosReceiver, raw=True), ("rclpy",)),
    "rclpy": Way(partial(RosSender, raw=False), partial(RosReceiver, raw=False), ("rclpy",)),
    "iceoryx2": Way(IceoryxSender, IceoryxReceiver, ("iceoryx2",)),
}
"""Name of each way to its ends."""
