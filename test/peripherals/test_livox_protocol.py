"""A Mid-360's datagrams: what is right is taken bit-exactly, and everything else refused."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator

import mid360_peer
import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from unicon_core.handles import FrameRing
from unicon_hardware.peripherals.livox import protocol
from unicon_hardware.peripherals.livox.cloud import Clouds, Counter, SensorClock, livox_message
from unicon_hardware.peripherals.livox.protocol import Refused

STORE = get_typestore(Stores.ROS2_JAZZY)
SAMPLES = mid360_peer.cartesian([(1000 * i, -500, 20, i, 3) for i in range(96)])
GOOD = mid360_peer.datagram(1, SAMPLES, 96, 7, 123_456_789_000)


def test_a_head_is_taken_apart() -> None:
    head = protocol.packet(memoryview(GOOD))
    assert head == (456_000, 96, 7, 1, 0, 123_456_789_000)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "wrong length"),
        (GOOD[:35], "wrong length"),
        (GOOD[:-1], "wrong length"),
        (GOOD + b"\0", "wrong length"),
        (b"\1" + GOOD[1:], "wrong version"),
        (GOOD[:10] + b"\4" + GOOD[11:], "unknown type"),
        (GOOD[:10] + b"\2" + GOOD[11:], "wrong length"),
        (GOOD[:-1] + b"\7", "wrong checksum"),
        (GOOD[:30] + b"\7" + GOOD[31:], "wrong checksum"),
        (mid360_peer.datagram(1, b"", 0, 0, 0), "wrong length"),
        (mid360_peer.datagram(1, SAMPLES + SAMPLES[:14], 97, 0, 0), "wrong length"),
        (mid360_peer.datagram(1, SAMPLES, 96, 0, 1 << 63), "no time"),
        (bytes(1380), "wrong length"),
    ],
)
def test_whatever_is_wrong_is_refused(data: bytes, why: str) -> None:
    with pytest.raises(Refused, match=why):
        protocol.packet(memoryview(data))


def test_garbage_never_raises_anything_else() -> None:
    rng = np.random.default_rng(3)
    for _ in range(3000):
        data = bytearray(GOOD)
        for at in rng.integers(0, 40, 3):
            data[at] = rng.integers(256)
        cut = memoryview(bytes(data))[: rng.integers(0, 1381)]
        for read in (protocol.packet, protocol.read_command, protocol.read_values):
            try:
                read(cut)  # type: ignore[operator]
            except Refused:
                continue


def test_the_imu_is_finite_or_refused() -> None:
    values = (0.1, 0.2, 0.3, 0.0, 0.0, 1.0)
    data = mid360_peer.datagram(0, struct.pack("<6f", *values), 1, 0, 0)
    protocol.packet(memoryview(data))
    assert protocol.read_imu(memoryview(data)) == pytest.approx(values)
    data = mid360_peer.datagram(0, struct.pack("<6f", *values[:5], math.nan), 1, 0, 0)
    with pytest.raises(Refused, match="not finite"):
        protocol.read_imu(memoryview(data))


def test_numbers_that_are_missing_are_counted() -> None:
    counter = Counter()
    for count in (65534, 65535, 0, 1, 4, 5, 0, 1, 3, 2):
        counter.hear(count)
    # 2 and 3; nothing where they begin again; then 2; a step back can only be a new beginning.
    assert counter.lost == 2 + 0 + 1 + 2
    counter.begin()
    counter.hear(9)
    assert counter.lost == 5


def test_the_clock_takes_the_quickest_way_and_notices_a_jump() -> None:
    clock, late = SensorClock(), [5, 3, 40, 3, 9]
    for number, ms in enumerate(late):
        assert clock.hear(number * 1_000_000, 10**12 + (number + ms) * 1_000_000)
    assert clock.at(2_000_000) == 10**12 + 5_000_000
    for second in range(1, 20):  # it drifts: 10 s later the old least is forgotten
        clock.hear(second * 10**9, 10**12 + second * (10**9 + 100_000) + 4_000_000)
    assert clock.at(19 * 10**9) - (10**12 + 19 * 10**9) > 4_900_000
    assert not clock.hear(50 * 10**9, 10**12)
    assert clock.at(50 * 10**9) == 10**12


@pytest.fixture
def ring() -> Iterator[FrameRing]:
    made = FrameRing.create(len(livox_message("livox_frame").template))
    yield made
    made.close()


def _cloud(ring: FrameRing, datagrams: list[bytes]) -> np.ndarray:
    """Return the points of a cloud of some datagrams, as rosbags reads its message."""
    message, clock = livox_message("livox_frame"), SensorClock()
    clouds = Clouds(ring, message)
    for data in datagrams:
        head = protocol.packet(memoryview(data))
        clouds.row[: len(data)] = data
        clock.hear(head.stamp_ns, head.stamp_ns + 10**9)
        clouds.take(head, clock)
    clouds.finish(clock)
    frame = ring.frame(ring.latest)
    assert frame is not None
    told = STORE.deserialize_cdr(frame.tobytes(), message.type)
    assert bytes(STORE.serialize_cdr(told, message.type)) == frame.tobytes()
    assert told.header.frame_id == "livox_frame"
    names = ["x", "y", "z", "intensity", "tag", "line", "offset_time"]
    assert [field.name for field in told.fields] == names
    assert told.point_step == 24
    fields = {field.name: (f"<{_CODES[field.datatype]}", field.offset) for field in told.fields}
    return np.frombuffer(bytes(told.data), _dtype(fields))


_CODES = {2: "u1", 6: "u4", 7: "f4"}


def _dtype(fields: dict[str, tuple[str, int]]) -> np.dtype:
    return np.dtype(
        {
            "names": list(fields),
            "formats": [kind for kind, _ in fields.values()],
            "offsets": [at for _, at in fields.values()],
            "itemsize": 24,
        }
    )


def test_a_cloud_has_every_point_where_and_when_it_was(ring: FrameRing) -> None:
    second = mid360_peer.cartesian([(0, 0, 0, 60, 0)] + [(-1500, 1, 2, 255, 0x15)] * 9)
    found = _cloud(
        ring,
        [
            mid360_peer.datagram(1, SAMPLES, 96, 0, 1_000_000),
            mid360_peer.datagram(1, second, 10, 1, 1_480_000, 900),
        ],
    )
    np.testing.assert_allclose(found["x"][:96], np.arange(96))
    assert found["y"][5] == np.float32(-0.5)
    assert found["z"][5] == np.float32(0.02)
    assert list(found["intensity"][:96]) == list(range(96))
    assert set(found["tag"][:96]) == {3}
    assert list(found["line"][:6]) == [0, 1, 2, 3, 0, 1]
    assert found["offset_time"][95] == 456_000
    # Of the short one only its ten, and a point without an echo is nowhere.
    assert np.isnan(found["x"][96])
    assert found["x"][97] == np.float32(-1.5)
    assert (found["tag"][97], found["intensity"][97]) == (0x15, 255)
    assert found["offset_time"][105] == 480_000 + 90_000
    assert np.isnan(found["x"][106:]).all()
    assert np.isnan(found["z"][106:]).all()


def test_a_cloud_in_centimetres(ring: FrameRing) -> None:
    samples = b"".join(struct.pack("<hhhBB", 150, -3, i, i, 0) for i in range(96))
    found = _cloud(ring, [mid360_peer.datagram(2, samples, 96, 0, 5)])
    assert (found["x"][4], found["y"][4], found["z"][4]) == pytest.approx((1.5, -0.03, 0.04))


def test_a_spherical_cloud(ring: FrameRing) -> None:
    rows = [(2000, 9000, 0), (2000, 9000, 9000), (2000, 0, 0), (2000, 6000, 27000), (0, 1, 1)]
    samples = b"".join(struct.pack("<IHHBB", *row, 9, 0) for row in rows)
    found = _cloud(ring, [mid360_peer.datagram(3, samples, 5, 0, 5)])[:5]
    points = np.stack([found[axis] for axis in "xyz"], axis=1)
    right = [[2, 0, 0], [0, 2, 0], [0, 0, 2], [0, -math.sqrt(3), 1], [math.nan] * 3]
    np.testing.assert_allclose(points, right, atol=1e-6)


def test_a_cloud_ends_after_a_tenth_of_a_second_and_when_the_type_changes(ring: FrameRing) -> None:
    message, clock = livox_message("livox_frame"), SensorClock()
    clouds, ready = Clouds(ring, message), []
    low = b"".join(struct.pack("<hhhBB", 1, 1, 1, 0, 0) for _ in range(96))
    for number in range(500):
        kind = 2 if number >= 450 else 1
        data = mid360_peer.datagram(kind, low if kind == 2 else SAMPLES, 96, 0, 480_000 * number)
        head = protocol.packet(memoryview(data))
        clouds.row[: len(data)] = data
        clock.hear(head.stamp_ns, head.stamp_ns)
        if clouds.take(head, clock):
            ready.append(number)
    assert ready == [209, 418, 450]
    assert ring.stamp_ns(3) == 418 * 480_000
    frame = ring.frame(3)
    assert frame is not None
    seen = np.isfinite(message.data(frame.data)["x"]).sum()
    assert seen == 32 * 96  # the first of the new type is in the next
