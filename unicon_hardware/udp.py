"""Udp: a socket that gives the newest datagrams and never waits; for robots that speak UDP."""

from __future__ import annotations

import select
import socket

from unicon_base.errors import Fault, PlatformError
from unicon_hardware.wire import Counts

LARGEST = 65536
"""Bytes of a datagram."""
MOST = 64
"""Datagrams that are looked at in a tick: a flood must not hold it up."""


class Udp:
    """A bound socket whose peer is fixed.

    Datagrams of others are counted in `strangers` and left.

    Args:
        local: address and port to bind; port 0 for any.
        peer: address and port of the robot.
        what: in front of messages.
        counts: count those of others, too.

    Raises:
        PlatformError: it cannot be bound.
    """

    def __init__(
        self,
        local: tuple[str, int],
        peer: tuple[str, int],
        what: str,
        counts: Counts | None = None,
    ) -> None:
        self._what, self.peer, self._counts = what, peer, counts
        self.strangers = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.bind(local)
        except OSError as error:
            self._socket.close()
            raise PlatformError(
                f"{what}: cannot listen at {local[0]}:{local[1]}: {error.strerror}; end the "
                "program that does, or check the network interface (ip addr)"
            ) from error
        self._buffer = bytearray(LARGEST)

    @property
    def port(self) -> int:
        """The port that it is bound to."""
        return int(self._socket.getsockname()[1])

    def fileno(self) -> int:
        """Return the socket's, for `select` over several."""
        return self._socket.fileno()

    @property
    def source(self) -> str:
        """The address of this machine from which the peer is reached, as the routes are now.

        Raises:
            PlatformError: there is no way to it.
        """
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect(self.peer)  # sends nothing
            except OSError as error:
                raise PlatformError(
                    f"{self._what}: no way to {self.peer[0]}: {error.strerror}; plug the cable in, "
                    "and give this machine an address in the robot's network (ip addr)"
                ) from error
            return str(probe.getsockname()[0])

    def received(self) -> list[bytes]:
        """Return what the peer has sent since the last call, the oldest first."""
        found: list[bytes] = []
        for datagram, sender in self.datagrams():
            if sender == self.peer:
                found.append(datagram)
            else:
                self.strangers += 1
                if self._counts is not None:
                    self._counts.refused["of a stranger"] += 1
        return found

    def datagrams(self) -> list[tuple[bytes, tuple[str, int]]]:
        """Return what anybody has sent since the last call, with the senders, the oldest first.

        For a robot's end, which answers to whoever commands it: set `peer`.
        """
        found: list[tuple[bytes, tuple[str, int]]] = []
        for _ in range(MOST):
            try:
                size, sender = self._socket.recvfrom_into(self._buffer)
            except BlockingIOError:
                break
            except OSError:  # such as a refused port, told by an earlier datagram of ours
                continue
            found.append((bytes(self._buffer[:size]), sender))
        return found

    def send(self, data: bytes | bytearray | memoryview) -> None:
        """Send a datagram to the peer.

        Raises:
            Fault: the network does not take it.
        """
        try:
            self._socket.sendto(data, self.peer)
        except ConnectionRefusedError:  # told of an earlier one: the peer is not there (yet)
            pass
        except OSError as error:
            raise Fault(
                f"{self._what}: cannot send to {self.peer[0]}:{self.peer[1]}: {error.strerror}"
            ) from error

    def wait(self, timeout: float) -> bool:
        """Return True once a datagram is there, False after `timeout` in [s]."""
        return bool(select.select([self._socket], [], [], timeout)[0])

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
