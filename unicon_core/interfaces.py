"""Network interfaces of this machine, for whoever is given one by its name or by its address."""

from __future__ import annotations

import fcntl
import ipaddress
import socket
import struct
from contextlib import suppress

from unicon_base.errors import PlatformError

_SIOCGIFADDR, _SIOCGIFFLAGS = 0x8915, 0x8913


def flags_of(interface: str) -> int:
    """Return the flags of a network interface, such as IFF_UP, of netdevice(7); 0 without it."""
    with suppress(OSError):
        return int(struct.unpack_from("H", _asked(interface, _SIOCGIFFLAGS), 16)[0])
    return 0


def ipv4_of(interface: str) -> str:
    """Return the IPv4 address of a network interface, which is given by it or by its name.

    Raises:
        PlatformError: it has none.
    """
    with suppress(ValueError):
        return str(ipaddress.IPv4Address(interface))
    try:
        found = _asked(interface, _SIOCGIFADDR)
    except OSError as error:
        raise PlatformError(
            f"network interface {interface!r} has no IPv4 address ({error.strerror}); see ip addr"
        ) from error
    return socket.inet_ntoa(found[20:24])


def _asked(interface: str, what: int) -> bytes:
    """Return the kernel's `ifreq` of an interface."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        request = struct.pack("256s", interface.encode()[:15])
        return fcntl.ioctl(asked.fileno(), what, request)
