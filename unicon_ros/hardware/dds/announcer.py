"""Announcer: lets older releases of Fast DDS see a participant of CycloneDDS, for `Participant`.

Both have a parameter 0x8007 of their own in what a participant says of itself (SPDP; RTPS 2.5,
8.5.3): CycloneDDS its version, Fast DDS a set of network kinds, 4 bytes long. Releases of Fast DDS
that do not look at the vendor, such as that within Booster's SDK 1.6.3, take the one for the other
and take the participant for broken. CycloneDDS cannot be told to leave it out. So it is told of
one more peer, on this machine, and what arrives there is sent on without the parameter, once a
second.
"""

from __future__ import annotations

import select
import socket
import struct
from contextlib import suppress
from threading import Event, Thread

from unicon_core.errors import PlatformError

FOREIGN = 0x8007
"""The parameter that is left out."""
GROUP, BASE, PER_DOMAIN = "239.255.0.1", 7400, 250
"""Where participants announce themselves (RTPS 2.5, 9.6.2.4)."""
AGAIN = 1.0
"""Between two announcements in [s]; the lease of CycloneDDS is 10 s."""
LARGEST = 65536
_DATA, _SENTINEL = 0x15, 0x01
_LITTLE, _INLINE_QOS, _PAYLOAD = 1, 2, 4
_PREFIX = slice(8, 20)
"""Of the participant, in the header of a message."""


def without(raw: bytes, unwanted: int = FOREIGN) -> bytes | None:
    """Return an announcement without a parameter; None where it is not an announcement.

    Args:
        raw: an RTPS message of little-endian submessages.
        unwanted: number of the parameter.
    """
    if raw[:4] != b"RTPS" or len(raw) < 20:
        return None
    made, at, announces = bytearray(raw[:20]), 20, False
    while at + 4 <= len(raw):
        kind, flags, length = struct.unpack_from("<BBH", raw, at)
        body = raw[at + 4 : at + 4 + length] if length else raw[at + 4 :]
        at += 4 + len(body)
        if not flags & _LITTLE or (length and len(body) != length):
            return None
        if kind == _DATA:
            if flags & (_INLINE_QOS | _PAYLOAD) != _PAYLOAD or len(body) < 24:
                return None
            body, announces = body[:24] + _listed(body[24:], unwanted), True
        made += struct.pack("<BBH", kind, flags, len(body)) + body
    return bytes(made) if announces else None


def _listed(parameters: bytes, unwanted: int) -> bytes:
    """Return a list of parameters without one of them, up to its end."""
    kept, at = bytearray(), 0
    while at + 4 <= len(parameters):
        number, length = struct.unpack_from("<HH", parameters, at)
        if number != unwanted:
            kept += parameters[at : at + 4 + length]
        if number == _SENTINEL:
            break
        at += 4 + length
    return bytes(kept)


class Announcer:
    """A thread that tells of this machine's participants in a domain; see the module.

    Args:
        domain: of DDS.
        address: of the network interface, IPv4.

    Attributes:
        peer: address and port that CycloneDDS has to be told as a peer.

    Raises:
        PlatformError: the address cannot be used.
    """

    def __init__(self, domain: int, address: str) -> None:
        self._to = (GROUP, BASE + PER_DOMAIN * domain)
        self._address = address
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((address, 0))
            own = socket.inet_aton(address)
            self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, own)
        except OSError as error:
            self._socket.close()
            raise PlatformError(
                f"cannot announce from address {address} ({error.strerror}); give that of this "
                "machine's network interface to the robot (ip addr)"
            ) from error
        self._socket.setblocking(False)
        self.peer = f"{address}:{self._socket.getsockname()[1]}"
        self._told: dict[bytes, bytes] = {}
        self._ended = Event()
        self._thread = Thread(target=self._run, name="dds announcer", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ended.is_set():
            ready, _, _ = select.select([self._socket], [], [], AGAIN)
            fresh = [self._heard()] if ready else list(self._told.values())
            for message in filter(None, fresh):
                with suppress(OSError):  # a cable is unplugged: said again later
                    self._socket.sendto(message, self._to)

    def _heard(self) -> bytes | None:
        """Return what is to be sent on of what has come."""
        try:
            raw, source = self._socket.recvfrom(LARGEST)
        except OSError:
            return None
        if source[0] != self._address:
            return None
        message = without(raw)
        if message is None:
            self._told.pop(raw[_PREFIX], None)  # it says that it goes
        else:
            self._told[message[_PREFIX]] = message
        return message

    def close(self) -> None:
        """Announce nothing any more."""
        self._ended.set()
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as waking:
            waking.sendto(b"", self._socket.getsockname())
        self._thread.join(2.0 * AGAIN)
        self._socket.close()
