"""Groups through ZeroMQ: processes, links that are cut, other layouts, garbage, two writers."""

from __future__ import annotations

import os
import signal
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from zmq_peers import READER, SPECS, Link, first_line, process, writing

from unicon_base.errors import MissingDependencyError, StateError
from unicon_core.states import States, StateSpec
from unicon_core.states.backends import zmq as zmq_backend
from unicon_core.states.backends.zmq import HEAD, ZmqReader, ZmqWriter
from unicon_core.states.backends.zmq_socket import is_exposed
from unicon_core.states.groups import groups_from_json, groups_hash, groups_json
from unicon_core.states.layout import Layout

zmq = pytest.importorskip("zmq")
pytestmark = pytest.mark.timeout(90)
TCP = "tcp://127.0.0.1:*"
PATIENCE = 20.0  # s


@pytest.fixture
def ipc(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    path = Path("/tmp") / f"unicon-test-{os.getpid()}.sock"  # a long path would not fit
    yield f"ipc://{path}"
    path.unlink(missing_ok=True)


def reading(address: str, states: States | None = None, **options: object) -> ZmqReader:
    here = States(SPECS) if states is None else states
    return ZmqReader(address, "measured", here.layout, here, **options)  # type: ignore[arg-type]


def take(reader: ZmqReader, *, until: Callable[[], bool] = lambda: True) -> None:
    """Take values until one is there and the condition holds."""
    end = time.monotonic() + PATIENCE
    while not (reader.wait(0.1) and reader.take() and until()):
        assert time.monotonic() < end, "nothing has come"


def nothing_comes(reader: ZmqReader, seconds: float = 0.5) -> bool:
    return not reader.wait(seconds) and not reader.take()


def drain(reader: ZmqReader) -> None:
    """Take what is still on its way from a writer that has stopped."""
    end = time.monotonic() + PATIENCE
    while reader.wait(0.3):
        reader.take()
        assert time.monotonic() < end


def soon(condition: Callable[[], bool]) -> bool:
    """Whether it holds within the patience: a machine may stand still for a while."""
    end = time.monotonic() + PATIENCE
    while not (held := condition()) and time.monotonic() < end:
        time.sleep(0.01)
    return held


@pytest.mark.parametrize("kind", ["ipc", "tcp"])
@pytest.mark.parametrize("robot_binds", [True, False])
def test_values_come_whole_and_once_whoever_binds(ipc: str, kind: str, robot_binds: bool) -> None:
    there = States(SPECS)
    wanted = ipc if kind == "ipc" else TCP
    with ExitStack() as stack:
        if robot_binds:
            _, address = stack.enter_context(writing(wanted, mark=2.5))
            reader = stack.enter_context(closing(reading(address, there)))
        else:
            reader = stack.enter_context(closing(reading(wanted, there, bind=True)))
            stack.enter_context(writing(reader.address, mark=2.5, bind=False))
        take(reader)
        before, number = reader.skipped, reader.number
        errors = []
        for _ in range(50):
            last = reader.number
            take(reader)
            assert reader.number > last
            np.testing.assert_array_equal(there.joint_pos, np.full(12, 2.5))
            errors.append(abs(reader.stamp_ns - int(there.stamp_ns)))
        # One clock here, so that its own stamp says how good ours is.
        assert np.median(errors) < 200_000_000
        assert reader.skipped - before == reader.number - number - 50
        assert soon(reader.alive)
        assert (reader.garbage, reader.refused, reader.freshness.rivals) == (0, "", 0)


def test_what_was_taken_is_not_taken_again_and_a_silent_writer_is_not_alive(ipc: str) -> None:
    there = States(SPECS)
    there.joint_pos = 7.0
    with writing(ipc) as (writer, address), closing(reading(address, there)) as reader:
        reader.restore()  # nothing yet
        assert there.joint_pos[0] == 7.0
        assert reader.number == 0
        assert reader.alive()  # nothing can have come
        take(reader)
        there.joint_pos = 9.0
        reader.restore()
        assert there.joint_pos[0] == 1.0
        writer.send_signal(signal.SIGSTOP)
        drain(reader)
        number = reader.number
        assert nothing_comes(reader, 1.0)
        assert not reader.alive()
        assert reader.number == number
        writer.send_signal(signal.SIGCONT)
        take(reader)
        assert soon(reader.alive)


def test_a_new_start_of_the_writer_is_followed(ipc: str) -> None:
    there = States(SPECS)
    with closing(reading(ipc, there)) as reader:
        for mark in (1.0, 2.0):  # the second finds what the first has left
            with writing(ipc, mark=mark):
                take(reader, until=lambda wanted=mark: bool(there.joint_pos[0] == wanted))
        drain(reader)
        assert nothing_comes(reader)
        with writing(ipc, mark=3.0):
            take(reader)
            assert there.joint_pos[0] == 3.0


def test_what_a_cut_link_has_kept_is_late_and_the_next_is_taken() -> None:
    there = States(SPECS)
    with ExitStack() as stack:
        _, address = stack.enter_context(writing(TCP))
        link = stack.enter_context(closing(Link(int(address.rsplit(":")[-1]))))
        reader = stack.enter_context(closing(reading(link.address, there, late=0.2)))
        take(reader)
        for _ in range(10):  # a newer one may replace what was kept before anybody looks
            link.cut()
            drain(reader)
            assert nothing_comes(reader, 0.6)
            # 0.2 s longer than the fastest at most, which is not slow here.
            oldest = time.monotonic_ns() - 400_000_000
            link.mend()
            for _ in range(100):
                take(reader)
                assert int(there.stamp_ns) > oldest
                assert reader.stamp_ns > oldest
            if reader.freshness.late > 0:
                break
        assert reader.freshness.late > 0


def test_a_link_that_breaks_is_made_anew_and_what_it_lost_is_counted() -> None:
    with ExitStack() as stack:
        _, address = stack.enter_context(writing(TCP))
        link = stack.enter_context(closing(Link(int(address.rsplit(":")[-1]))))
        reader = stack.enter_context(closing(reading(link.address)))
        take(reader)
        link.cut()
        link.break_connections()
        assert nothing_comes(reader) or nothing_comes(reader)
        number = reader.number
        link.mend()
        take(reader)
        assert 0 < reader.freshness.lost < reader.number - number


def test_another_layout_is_refused_by_its_first_state(ipc: str) -> None:
    with closing(reading(ipc, bind=True)) as reader:
        with writing(ipc, joints=29, bind=False):
            end = time.monotonic() + PATIENCE
            while "joint_pos" not in reader.refused:
                assert time.monotonic() < end
                assert not reader.wait(0.05)
            assert reader.refused == (
                f"store zmq, group 'measured' at {ipc}: state 'joint_pos': shape is [12] here and "
                "[29] there"
            )
            assert reader.number == 0
            with pytest.raises(StateError, match="is \\[12\\] here and \\[29\\] there"):
                reader.alive()
        with writing(ipc, bind=False):
            take(reader)
            assert reader.refused == ""
            assert soon(reader.alive)


def test_another_group_of_the_same_states_is_refused(ipc: str) -> None:
    with writing(ipc, name="command"), closing(reading(ipc)) as reader:
        end = time.monotonic() + PATIENCE
        while not reader.refused.endswith("the other end has group 'command'"):
            assert time.monotonic() < end
            assert not reader.wait(0.05)


def _frame(**wrong: object) -> bytes:
    layout = States(SPECS).layout
    fields: dict[str, object] = {
        "magic": b"UNICONZQ",
        "version": 1,
        "order": 0x01020304,
        "epoch": 77,
        "number": 1,
        "sent": time.monotonic_ns(),
        "digest": bytes.fromhex(groups_hash({"measured": layout})),
        "words": 0,
    }
    fields.update(wrong)
    return HEAD.pack(*fields.values()) + bytes(layout.nbytes)


def _told(text: bytes) -> bytes:
    """A frame whose layout, in words, is this."""
    return _frame(digest=bytes(32), words=len(text)) + text


OTHER = groups_json({"measured": States({"a": StateSpec()}).layout}).encode()
GARBAGE = {
    "nothing": lambda: b"",
    "noise": lambda: os.urandom(700),
    "half a header": lambda: _frame()[:40],
    "no body": lambda: _frame()[: HEAD.size],
    "too long": lambda: _frame() + b"x",
    "words that are not there": lambda: _frame(words=500),
    "more words than bytes": lambda: _frame(digest=bytes(32), words=1 << 60),
    "another magic": lambda: _frame(magic=b"UNICONSH"),
    "another version": lambda: _frame(version=2),
    "another byte order": lambda: _frame(order=0x04030201),
    "words that do not fit their hash": lambda: _told(OTHER),
    "words that are not JSON": lambda: _told(b"\xff\xfe{"),
    "words that nest deep": lambda: _told(b"[" * 2_000),
    "words of no group": lambda: _told(b'{"measured": 3}'),
}


def test_garbage_is_counted_and_disturbs_nobody(ipc: str) -> None:
    there = States(SPECS)
    with (
        zmq.Context() as context,
        context.socket(zmq.PUB) as raw,
        closing(reading(ipc, there, bind=True)) as reader,
    ):
        raw.linger = 0
        raw.connect(ipc)
        for name, made in GARBAGE.items():
            before, end = reader.garbage, time.monotonic() + PATIENCE
            while reader.garbage == before:
                assert time.monotonic() < end, name
                raw.send(made())
                assert not reader.wait(0.01), name
        with writing(ipc, bind=False):  # and while it goes on
            for i in range(200):
                raw.send(list(GARBAGE.values())[i % len(GARBAGE)]())
                take(reader)
            assert there.joint_pos[0] == 1.0


@pytest.mark.parametrize("long", [True, False])
def test_foreign_layouts_are_not_parsed_by_the_thread_that_ticks(
    ipc: str, monkeypatch: pytest.MonkeyPatch, long: bool
) -> None:
    parsed: list[tuple[int, float]] = []

    def parse(text: str) -> dict[str, Layout]:
        parsed.append((threading.get_ident(), time.monotonic()))
        return groups_from_json(text)

    monkeypatch.setattr(zmq_backend, "groups_from_json", parse)
    states = {f"s{i}": StateSpec() for i in range(2_000 if long else 2)}
    text = groups_json({"measured": States(states).layout}).encode()
    begun = time.monotonic()
    with (
        zmq.Context() as context,
        context.socket(zmq.PUB) as raw,
        closing(reading(ipc, bind=True)) as reader,
    ):
        raw.linger = 0
        raw.connect(ipc)
        for number in range(2**32):  # each frame has a hash of its own
            raw.send(_frame(digest=number.to_bytes(32, "big"), words=len(text)) + text)
            assert not reader.wait(0.002)
            assert time.monotonic() < begun + PATIENCE
            if reader.refused if long else len(parsed) > 2:
                break
        refused = reader.refused
    if long:
        assert f"describes its layout in {len(text)} bytes, of which at most" in refused
        assert not parsed
        return
    assert all(thread != threading.get_ident() for thread, _ in parsed)
    assert len(parsed) <= 2 * (time.monotonic() - begun) + 1


def test_a_flood_stops_neither_the_reader_nor_its_wait(ipc: str) -> None:
    flood = "import sys, zmq\ns = zmq.Context().socket(zmq.PUB)\ns.connect(sys.argv[1])\n"
    flood += "print('floods', flush=True)\nwhile True: s.send(bytes(600))\n"
    with closing(reading(ipc, bind=True)) as reader, process(flood, ipc) as peer:
        first_line(peer)
        end = time.monotonic() + PATIENCE
        while not reader.garbage:
            assert time.monotonic() < end
            assert not reader.wait(0.01)
        begin = time.monotonic()
        assert not reader.wait(0.2)
        assert time.monotonic() - begin < PATIENCE
        with writing(ipc, bind=False):
            for _ in range(20):
                take(reader)


def test_of_two_writers_one_is_followed_and_the_other_takes_over(ipc: str) -> None:
    there = States(SPECS)
    with closing(reading(ipc, there, bind=True)) as reader, writing(ipc, mark=2.0, bind=False):
        take(reader)
        with writing(ipc, mark=3.0, bind=False):
            marks = set()
            end = time.monotonic() + PATIENCE
            while reader.freshness.rivals < 20:
                assert time.monotonic() < end
                take(reader)
                marks.add(float(there.joint_pos[0]))
            assert marks == {2.0}
        with writing(ipc, mark=4.0, bind=False):
            take(reader)
            assert there.joint_pos[0] == 2.0
    with (
        closing(reading(ipc, there, bind=True)) as reader,
        writing(ipc, mark=5.0, bind=False),
        ExitStack() as stack,
    ):
        first, _ = stack.enter_context(writing(ipc, mark=6.0, bind=False))
        take(reader)
        followed = float(there.joint_pos[0])
        if followed == 6.0:
            first.kill()
            take(reader, until=lambda: bool(there.joint_pos[0] == 5.0))


def test_a_reader_that_stops_or_dies_costs_the_writer_nothing(ipc: str) -> None:
    size = 16_384  # 64 KiB each: 20,000 are 1.3 GB
    states, there = (States({"data": StateSpec((size,))}) for _ in range(2))
    with ExitStack() as stack:
        writer = stack.enter_context(closing(ZmqWriter(ipc, "bulk", states.layout, states)))
        reader = ZmqReader(ipc, "bulk", there.layout, there)
        stack.enter_context(closing(reader))
        stopped, killed = (stack.enter_context(process(READER, ipc, size)) for _ in range(2))
        ready = [False, False]
        os.set_blocking(stopped.stdout.fileno(), False)  # type: ignore[union-attr]
        os.set_blocking(killed.stdout.fileno(), False)  # type: ignore[union-attr]
        end = time.monotonic() + PATIENCE
        while not all(ready):
            assert time.monotonic() < end
            writer.publish()
            time.sleep(0.005)
            ready = [r or bool(p.stdout.readline()) for r, p in zip(ready, (stopped, killed))]
        stopped.send_signal(signal.SIGSTOP)
        killed.kill()
        before = _resident()
        taken = 0
        for i in range(20_000):
            states.data[0] = i
            writer.publish()
            if i % 100 == 0:
                taken += reader.wait(1.0) and reader.take()
        assert taken > 20
        assert _resident() - before < 32 << 20


def _resident() -> int:
    """Return this process's memory in [B]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_nan_is_passed_on(ipc: str) -> None:
    there = States(SPECS)
    with writing(ipc, mark=np.nan), closing(reading(ipc, there)) as reader:
        take(reader)
        assert np.isnan(there.joint_pos).all()


def test_an_address_is_checked(ipc: str, tmp_path: Path) -> None:
    states = States(SPECS)

    def refused(address: str, **options: object) -> str:
        with pytest.raises(StateError) as caught:
            ZmqWriter(address, "measured", states.layout, states, **options)  # type: ignore
        return str(caught.value)

    what = "store zmq, group 'measured': "
    assert refused("udp://x") == (
        f"{what}'udp://x' is not an address; give tcp://HOST:PORT or ipc://PATH"
    )
    assert "is not an address" in refused("tcp://127.0.0.1:99999")
    with writing(TCP) as (_, address):
        assert refused(address) == (
            f"{what}{address}: address already in use; end what has it, give another address, or "
            "let this end connect"
        )
    with writing(ipc):
        assert "address already in use" in refused(ipc)
    assert "give the address where the other end is bound" in refused("tcp://here", bind=False)
    long = f"ipc://{tmp_path / ('x' * 200)}"
    assert refused(long).startswith(f"{what}{long}: file name too long")
    with pytest.raises(StateError, match="late is nan; give seconds above 0"):
        reading(ipc, late=float("nan"))
    other = States(SPECS | {"joint_pos": StateSpec((29,))})
    with pytest.raises(StateError, match="the group does not fit: state 'joint_pos': shape is"):
        ZmqReader(ipc, "measured", states.layout, other)


@pytest.mark.parametrize(
    ("address", "exposed"),
    [
        ("tcp://*:7001", True),
        ("tcp://0.0.0.0:7001", True),
        ("tcp://10.0.0.1:7001", True),
        ("tcp://robot:7001", True),
        ("tcp://[::]:7001", True),
        ("tcp://eth0:*", True),
        ("tcp://127.0.0.1:7001", False),
        ("tcp://127.0.0.9:*", False),
        ("tcp://localhost:7001", False),
        ("tcp://[::1]:7001", False),
        ("ipc:///tmp/x:1", False),
    ],
)
def test_what_other_machines_reach_is_known(address: str, exposed: bool) -> None:
    assert is_exposed(address) == exposed


@pytest.mark.parametrize("kind", [ZmqWriter, ZmqReader])
def test_nothing_listens_to_other_machines_without_keys_unless_it_says_so(kind: Any) -> None:
    states = States(SPECS)
    with pytest.raises(StateError, match=r"tcp://\*:\* listens beyond this machine without keys: "):
        kind("tcp://*:*", "measured", states.layout, states, bind=True)
    kind("tcp://*:*", "measured", states.layout, states, bind=True, without_keys=True).close()
    kind("tcp://10.255.255.1:9", "measured", states.layout, states, bind=False).close()


def test_an_address_of_a_file_is_private_and_leaves_nothing(ipc: str) -> None:
    states, path = States(SPECS), Path(ipc.removeprefix("ipc://"))
    writer = ZmqWriter(ipc, "measured", states.layout, states)
    assert path.stat().st_mode & 0o777 == 0o600
    writer.close()
    writer.close()
    assert not path.exists()


def test_without_pyzmq_the_install_command_is_named(ipc: str, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "zmq", None)
    with pytest.raises(MissingDependencyError) as caught:
        reading(ipc)
    assert str(caught.value) == (
        "store zmq needs pyzmq: pip install 'unicon_ros[zmq]' (or: sudo apt install python3-zmq)"
    )


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    """Keys of a robot and of a desk, each end's folder as it would be on its machine."""
    from zmq.auth import create_certificates

    made = tmp_path / "made"
    for folder in (made, tmp_path / "robot" / "clients", tmp_path / "desk", tmp_path / "stranger"):
        folder.mkdir(parents=True)
    for who in ("server", "client", "stranger"):
        create_certificates(made, who)
    (made / "server.key_secret").rename(tmp_path / "robot" / "server.key_secret")
    (tmp_path / "robot" / "clients" / "desk.key").write_bytes((made / "client.key").read_bytes())
    for who, name in (("desk", "client"), ("stranger", "stranger")):
        (made / f"{name}.key_secret").rename(tmp_path / who / "client.key_secret")
        (tmp_path / who / "server.key").write_bytes((made / "server.key").read_bytes())
    return tmp_path


@pytest.mark.parametrize("robot_writes", [True, False])
def test_with_keys_those_that_are_known_are_heard(keys: Path, robot_writes: bool) -> None:
    with ExitStack() as stack:
        if robot_writes:
            _, address = stack.enter_context(writing(TCP, keys=keys / "robot"))
            reader = stack.enter_context(closing(reading(address, keys=keys / "desk")))
        else:
            reader = stack.enter_context(closing(reading(TCP, bind=True, keys=keys / "robot")))
            desk = writing(reader.address, bind=False, keys=keys / "desk")
            stack.enter_context(desk)
        take(reader)


@pytest.mark.parametrize(
    ("robot", "desk"), [("robot", None), (None, "desk"), ("robot", "stranger")]
)
def test_without_the_same_keys_nothing_is_received(
    keys: Path, robot: str | None, desk: str | None
) -> None:
    theirs = "" if robot is None else keys / robot
    ours = None if desk is None else keys / desk
    with (
        writing(TCP, keys=theirs) as (_, address),
        closing(reading(address, keys=ours)) as reader,
    ):
        assert nothing_comes(reader)
        assert (reader.garbage, reader.number) == (0, 0)
        if robot:  # and who is known is heard beside
            with closing(reading(address, keys=keys / "desk")) as known:
                take(known)


@pytest.mark.parametrize("robot_writes", [True, False])
def test_a_stranger_at_the_address_keeps_nobody_away_for_good(
    keys: Path, robot_writes: bool
) -> None:
    """libzmq does not try again by itself after a handshake with an end that has no keys."""
    with ExitStack() as stack:
        if robot_writes:
            with writing(TCP) as (_, address):
                reader = stack.enter_context(closing(reading(address, keys=keys / "desk")))
                assert nothing_comes(reader)
            stack.enter_context(writing(address, keys=keys / "robot"))
        else:
            with closing(reading(TCP, bind=True)) as stranger:
                stack.enter_context(writing(stranger.address, bind=False, keys=keys / "desk"))
                assert nothing_comes(stranger)
            address = stranger.address
            reader = stack.enter_context(closing(reading(address, bind=True, keys=keys / "robot")))
        take(reader)


def test_missing_and_damaged_keys_are_named(keys: Path) -> None:
    def refused(folder: Path, bind: bool) -> str:
        with pytest.raises(StateError) as caught:
            reading(TCP if bind else "tcp://127.0.0.1:9", bind=bind, keys=folder)
        return str(caught.value)

    what, remedy = "store zmq, group 'measured': ", "make keys with zmq.auth.create_certificates"
    robot, desk = keys / "robot", keys / "desk"
    assert f"{what}{robot / 'client.key_secret'} is not a key file; {remedy}" in refused(
        robot, False
    )
    assert f"no keys of peers in {desk / 'clients'}; {remedy}" in refused(desk, True)
    (desk / "server.key").write_text("metadata\n")
    assert f"{desk / 'server.key'} is not a key file" in refused(desk, False)
    (robot / "server.key_secret").write_bytes((robot / "clients" / "desk.key").read_bytes())
    assert f"{robot / 'server.key_secret'} holds no secret key" in refused(robot, True)
    (desk / "server.key").write_text('curve\n    public-key = "short"\n')
    assert f"a key in {desk} is damaged" in refused(desk, False)


def test_the_header_is_as_the_documents_say() -> None:
    assert HEAD.size == 80
    assert struct.calcsize("=8sII") == 16  # then epoch, number, time, each 8 bytes
