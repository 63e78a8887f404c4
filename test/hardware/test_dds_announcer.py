"""Announcer: what is sent on of an announcement, garbage, and its end."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from unitree_helpers import until

from unicon_base.errors import PlatformError
from unicon_core.latches import ipv4_of
from unicon_hardware.dds.domains import FOREIGN, Announcer, without

PREFIX = bytes(range(12))
SENTINEL = struct.pack("<HH", 1, 0)


def parameter(number: int, *words: int) -> bytes:
    return struct.pack(f"<HH{len(words)}I", number, 4 * len(words), *words)


def announcement(*parameters: bytes, flags: int = 0x05, length: int | None = None) -> bytes:
    body = struct.pack("<HHIIII", 0, 16, 0, 0xC2000100, 0, 1) + b"\0\3\0\0"
    body += b"".join(parameters) + SENTINEL
    time = struct.pack("<BBHII", 0x09, 1, 8, 5, 6)
    said = len(body) if length is None else length
    head = b"RTPS\2\5\1\x10" + PREFIX
    return head + time + struct.pack("<BBH", 0x15, flags, said) + body


LEASE, VERSION = parameter(2, 10, 0), parameter(FOREIGN, 0, 0, 0, 0, 0, 7)
OWN = parameter(0x50, 1, 2, 3, 0xC1010000)


def test_the_one_parameter_is_left_out_and_nothing_else() -> None:
    assert without(announcement(LEASE, VERSION, OWN)) == announcement(LEASE, OWN)
    assert without(announcement(LEASE, OWN)) == announcement(LEASE, OWN)
    # The length of a message's last part may be 0, which is up to its end.
    assert without(announcement(LEASE, VERSION, length=0)) == announcement(LEASE)


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b"RTPS",
        b"SPDP" + announcement(LEASE)[4:],
        announcement(LEASE)[:20],  # no part at all
        announcement(LEASE)[:32],  # a time, and no announcement
        announcement(LEASE, flags=0x09),  # it goes: a key alone
        announcement(LEASE, flags=0x04),  # big endian
        announcement(LEASE, flags=0x07),  # with parameters in front
        announcement(LEASE, length=4000),
        announcement(LEASE, length=8),
    ],
)
def test_what_is_no_announcement_is_not_sent_on(raw: bytes) -> None:
    assert without(raw) is None


@settings(max_examples=50, deadline=None)
@given(noise=st.binary(max_size=300), at=st.integers(0, 120), value=st.binary(min_size=1))
def test_garbage_never_raises(noise: bytes, at: int, value: bytes) -> None:
    good = announcement(LEASE, VERSION, OWN)
    for raw in (noise, b"RTPS" + noise, good[:at], good[:at] + value + good[at + len(value) :]):
        without(raw)


@pytest.fixture
def announcer() -> Iterator[tuple[Announcer, socket.socket]]:
    made = Announcer(7, "127.0.0.1")
    assert made._to == ("239.255.0.1", 7400 + 250 * 7)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as heard:
        heard.bind(("127.0.0.1", 0))
        heard.settimeout(10.0)
        made._to = heard.getsockname()
        yield made, heard
        made.close()


def test_an_announcement_is_sent_on_at_once_and_again(
    announcer: tuple[Announcer, socket.socket],
) -> None:
    made, heard = announcer
    host, port = made.peer.split(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as told:
        told.sendto(b"garbage", (host, int(port)))
        told.sendto(announcement(LEASE, VERSION), (host, int(port)))
        for _ in range(2):
            assert heard.recv(2000) == announcement(LEASE)
        told.sendto(announcement(LEASE, flags=0x0B), (host, int(port)))
    until(lambda: not made._told)  # who goes is not announced any more
    made.close()
    assert not made._thread.is_alive()
    made.close()


def test_interfaces_by_name_and_by_address() -> None:
    assert ipv4_of("lo") == ipv4_of("127.0.0.1") == "127.0.0.1"
    with pytest.raises(PlatformError, match="'nowhere0' has no IPv4 address"):
        ipv4_of("nowhere0")
    with pytest.raises(PlatformError, match=r"cannot announce from address 203\.0\.113\.7"):
        Announcer(7, "203.0.113.7")
