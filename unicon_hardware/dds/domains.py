"""Domains of DDS that this process is in, each configured once, for `Participant`.

An `Announcer` lets older releases of Fast DDS see a participant of CycloneDDS. Both have a
parameter 0x8007 of their own in what a participant says of itself (SPDP; RTPS 2.5, 8.5.3):
CycloneDDS its version, Fast DDS a set of network kinds, 4 bytes long. Releases of Fast DDS that do
not look at the vendor, such as that within Booster's SDK 1.6.3, take the one for the other and take
the participant for broken. CycloneDDS cannot be told to leave it out. So it is told of one more
peer, on this machine, and what arrives there is sent on without the parameter, once a second.
"""

from __future__ import annotations

import ipaddress
import select
import socket
import struct
from contextlib import suppress
from dataclasses import dataclass
from threading import Event, Lock, Thread
from typing import Any

from unicon_base import PlatformError
from unicon_core.latches import ipv4_of

FOREIGN = 0x8007
"""The parameter that is left out."""
GROUP, BASE, PER_DOMAIN = "239.255.0.1", 7400, 250
"""Where participants announce themselves (RTPS 2.5, 9.6.2.4)."""
AGAIN = 1.0
"""Between two announcements in [s]; the lease of CycloneDDS is 10 s."""
LARGEST = 65536
_DATA, _SENTINEL = 0x15, 0x01
_LITTLE, _INLINE_QOS, _PAYLOAD = 1, 2, 4
# Of the participant, in the header of a message.
_PREFIX = slice(8, 20)


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


_CONFIG = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface {word}="{value}" '
    'priority="default" multicast="default"/></Interfaces></General>{more}</Domain></CycloneDDS>'
)
# Linux calls loopback incapable of multicast, and cyclonedds 0.10.2, which vendors' SDKs use,
# believes it: then both find each other only by the ports of low participant numbers.
_INDICES = (
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>"
)
_DISCOVERY, _PEER = "<Discovery>{}<Peers>{}</Peers></Discovery>", '<Peer address="{}"/>'


@dataclass
class _Shared:
    """What participants of one domain share: a process has one configuration of it.

    Attributes:
        address: of the interface, or its name; None where the environment decides.
        made: the domain, where it is configured here.
        announcer: tells older releases of Fast DDS.
        users: participants.
    """

    address: str | None
    made: Any = None
    announcer: Announcer | None = None
    users: int = 0


_lock = Lock()
_domains: dict[int, _Shared] = {}


def enter(domain: int, address: str | None, what: str, *, announced: bool) -> None:
    """Configure a domain, once a process.

    Raises:
        PlatformError: it is configured otherwise already, or cannot be.
    """
    if announced and address is None:
        raise PlatformError(
            f"{what}: give address, the network interface of this machine to the robot (ip addr): "
            "the robot's DDS has to be told of it"
        )
    with _lock:
        shared = _domains.get(domain)
        if shared is None:
            shared = _domains[domain] = _configured(domain, address, what, announced=announced)
        elif shared.address != address:
            raise PlatformError(
                f"{what}: domain {domain} is open on "
                f"{shared.address or 'the interface by default'} in this process, and not on "
                f"{address or 'that by default'}; give both the same address, or another domain"
            )
        elif announced and shared.announcer is None:
            raise PlatformError(
                f"{what}: domain {domain} is open in this process for another platform, which "
                "older Fast DDS does not see; give one of them a process of its own: platform: "
                "{child: …}"
            )
        shared.users += 1


def _configured(domain: int, address: str | None, what: str, *, announced: bool) -> _Shared:
    from cyclonedds.core import DDSException
    from cyclonedds.domain import Domain

    if address is None:
        return _Shared(None)
    text, announcer = _config(address, what), None
    if announced:
        try:
            announcer = Announcer(domain, ipv4_of(address))
        except PlatformError as error:
            raise PlatformError(f"{what}: {error}") from error
        text = _config(address, what, announcer.peer)
    try:
        return _Shared(address, Domain(domain, text), announcer)
    except DDSException as error:
        if announcer is not None:
            announcer.close()
        raise PlatformError(
            f"{what}: cannot use address {address!r} for DDS domain {domain}; give name "
            f"or address of this machine's network interface to the robot (ip addr)"
        ) from error


def _config(address: str, what: str, *peers: str) -> str:
    word, loopback = "address", False
    try:
        loopback = ipaddress.ip_address(address).is_loopback
    except ValueError:
        word, loopback = "name", address == "lo"
        if not address.isascii() or not address.replace("-", "").replace("_", "").isalnum():
            raise PlatformError(
                f"{what}: address {address!r} is neither an address nor the name of a network "
                "interface; write 192.168.123.51 or eth0"
            ) from None
    indices = ""
    if loopback:
        indices, peers = _INDICES, ("127.0.0.1", *peers)
    more = _DISCOVERY.format(indices, "".join(map(_PEER.format, peers))) if peers else ""
    return _CONFIG.format(word=word, value=address, more=more)


def leave(domain: int) -> None:
    """Forget a domain that nobody of this process is in any more."""
    with _lock:
        shared = _domains[domain]
        shared.users -= 1
        if shared.users:
            return
        del _domains[domain]
        if shared.made is not None:
            shared.made.__del__()
        if shared.announcer is not None:
            shared.announcer.close()
