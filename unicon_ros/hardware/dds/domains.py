"""Domains of DDS that this process is in, each configured once, for `Participant`."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from threading import Lock
from typing import Any

from unicon_core.errors import PlatformError
from unicon_core.interfaces import ipv4_of
from unicon_ros.hardware.dds.announcer import Announcer

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
    users: int = 1


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
        if domain in _domains:
            _share(_domains[domain], domain, address, what, announced=announced)
        else:
            _domains[domain] = _configured(domain, address, what, announced=announced)


def _share(
    shared: _Shared, domain: int, address: str | None, what: str, *, announced: bool
) -> None:
    if shared.address != address:
        raise PlatformError(
            f"{what}: domain {domain} is open on {shared.address or 'the interface by default'} in "
            f"this process, and not on {address or 'that by default'}; give both the same "
            "address, or another domain"
        )
    if announced and shared.announcer is None:
        raise PlatformError(
            f"{what}: domain {domain} is open in this process for another platform, which older "
            f"Fast DDS does not see; give one of them a process of its own: platform: {{child: …}}"
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
