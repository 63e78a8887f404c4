"""Hands over Modbus against their faces: TCP and a pty, and what a bad line brings."""

from __future__ import annotations

import os
import select
import socket
import struct
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_peers import Pumped, free_port, hand_states, pty_pair, pumped, until

from unicon_base.errors import Fault, PlatformError, RobotError
from unicon_core.platforms.platform import CountsArrivals, Platform, Prepares, WaitsForData
from unicon_core.robots import Robot, load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States
from unicon_core.workflow import Program
from unicon_hardware.inspire.platform import Inspire
from unicon_hardware.inspire.platform import face as inspire_face
from unicon_hardware.inspire.platform import make as inspire
from unicon_hardware.modbus.link import (
    Frame,
    ModbusConnection,
    Refused,
    Rtu,
    Tcp,
    open_serial,
    read_request,
    write_request,
)
from unicon_hardware.modbus.served import HandEndpoint, PtyServer, _Served
from unicon_hardware.rohand.platform import face as rohand_face
from unicon_hardware.rohand.platform import make as rohand

LEFT = load_robot("inspire_rh56_left")
PERIOD = 0.01


class Hand:
    """A hand behind its face, and what reaches it."""

    def __init__(self, kind: str) -> None:
        self.robot: Robot = load_robot("rohand" if kind == "rohand" else "inspire_rh56_left")
        self.there, self.here = hand_states(self.robot), hand_states(self.robot)
        self.there["joint_pos"][...] = 0.5 * (self.robot.lower + self.robot.upper)
        if kind == "rohand":
            self.face: HandEndpoint = rohand_face(self.there, self.robot)
        else:
            self.face = inspire_face(self.there, self.robot, port=0, serial=kind == "rtu")
        server = self.face.server
        options: dict[str, Any] = {}
        if isinstance(server, PtyServer):
            options["device"] = server.where
        else:
            options |= {"address": "127.0.0.1", "port": server.port}
        factory = rohand if kind == "rohand" else inspire
        self.open = partial(factory, self.here, self.robot, PERIOD, **options)


@pytest.fixture(params=["tcp", "rtu", "rohand"])
def hand(request: pytest.FixtureRequest) -> Hand:
    return Hand(request.param)


@pytest.fixture
def tcp() -> Iterator[tuple[Hand, Pumped]]:
    made = Hand("tcp")
    with pumped(made.face) as pump:
        yield made, pump


def ticked(platform: Platform, condition: Callable[[], bool], seconds: float = 3.0) -> None:
    """Receive until something holds."""

    def tick() -> bool:
        platform.recv()
        return condition()

    until(tick, seconds)


def test_positions_come_and_targets_go(hand: Hand) -> None:
    with pumped(hand.face) as pump:
        platform = hand.open()
        here, there, robot = hand.here, hand.there, hand.robot
        step = 0.002
        np.testing.assert_allclose(here["joint_pos"], there["joint_pos"], atol=step)
        assert here["stamp_ns"] > 0
        assert isinstance(platform, (WaitsForData, CountsArrivals))
        assert pump.heard == 0  # nothing is sent unasked
        goal = robot.lower + 0.25 * (robot.upper - robot.lower)
        here["joint_pos_target"][...] = goal
        platform.send()
        until(lambda: np.allclose(there["joint_pos_target"], goal, atol=step))
        there["joint_pos"][...] = goal
        ticked(platform, lambda: bool(np.allclose(here["joint_pos"], goal, atol=step)))
        ticked(platform, lambda: not here["joint_vel"].any())
        here["joint_pos_target"][...] = robot.upper + 5.0  # clamped, never wrapped
        assert platform.info()["clamped"] == 0
        platform.send()
        assert platform.info()["clamped"] == 1
        until(lambda: np.allclose(there["joint_pos_target"], robot.upper, atol=step))
        platform.close()
        platform.close()


def test_the_last_target_leaves_before_it_closes(hand: Hand) -> None:
    with pumped(hand.face):
        for share in (0.3, 0.7):  # and a second run finds the hand again
            platform = hand.open()
            goal = hand.robot.lower + share * (hand.robot.upper - hand.robot.lower)
            hand.here["joint_stiffness"][...] = 0.0  # limp: `close` sends it once
            hand.here["joint_pos_target"][...] = goal
            platform.send()
            platform.close()
            there = hand.there["joint_pos_target"]
            until(lambda goal=goal, there=there: np.allclose(there, goal, atol=0.002))


def test_a_silent_one_never_writes(hand: Hand) -> None:
    with pumped(hand.face) as pump:
        platform = hand.open(silent=True)
        for _ in range(5):
            platform.recv()
            platform.send()
            time.sleep(0.01)
        platform.close()
        assert pump.heard == 0
        assert hand.face.cleared == 0


def test_velocity_is_the_difference_of_two_angles(tcp: tuple[Hand, Pumped]) -> None:
    hand, _ = tcp
    platform = hand.open()
    begun = time.monotonic()
    seen: list[float] = []
    while time.monotonic() - begun < 0.4:
        hand.there["joint_pos"][...] = 0.2 + 0.5 * (time.monotonic() - begun)
        platform.recv()
        seen.append(float(hand.here["joint_vel"][3]))
        time.sleep(0.02)
    assert np.median(seen[2:]) == pytest.approx(0.5, abs=0.2)
    platform.close()


def test_errors_of_before_are_cleared_by_prepare_and_later_ones_are_told(
    tcp: tuple[Hand, Pumped],
) -> None:
    hand, _ = tcp
    hand.there["motor_error"][...] = (0, 4, 0, 0, 0, 0)
    hand.there["motor_status"][...] = 2
    hand.there["motor_temperature"][...] = (31, 32, 33, 34, 35, 36)
    platform = hand.open()
    here = hand.here
    ticked(platform, lambda: float(here["motor_temperature"][5]) == 36.0)
    ticked(platform, lambda: bool((here["motor_status"] == 2).all()))
    assert not here["motor_error"].any()
    assert isinstance(platform, Prepares)
    assert hand.face.cleared == 0
    assert "cleared" in platform.prepare()
    until(lambda: platform.prepare() == "")
    assert hand.face.cleared == 1
    hand.there["motor_error"][...] = (0, 0, 1, 0, 0, 0)
    ticked(platform, lambda: int(here["motor_error"][2]) == 1)
    platform.close()
    listening = hand.open(silent=True)  # one that is only looked at tells them at once
    ticked(listening, lambda: int(here["motor_error"][2]) == 1)
    assert listening.prepare() == ""
    listening.close()


def test_the_tick_waits_for_nothing(tcp: tuple[Hand, Pumped]) -> None:
    """A hand that does not answer costs the thread 50 ms, and the tick nothing like it."""
    hand, pump = tcp
    platform = hand.open(silence=5.0)
    pump.pause = True
    took = []
    for _ in range(50):
        begun = time.perf_counter()
        platform.recv()
        platform.send()
        took.append(time.perf_counter() - begun)
        time.sleep(0.001)
    assert sorted(took)[len(took) // 2] < 0.02
    pump.pause = False
    platform.close()


# -- a bad line ------------------------------------------------------------------------------------


def test_a_hand_that_falls_silent_is_a_fault_and_comes_back(tcp: tuple[Hand, Pumped]) -> None:
    hand, pump = tcp
    platform = hand.open()
    pump.pause = True

    def tick() -> bool:
        platform.recv()
        return False

    with pytest.raises(Fault, match=r"platform 'inspire': nothing from 127.0.0.1:\d+ for 0"):
        until(tick)
    pump.pause = False
    time.sleep(0.1)
    ticked(platform, lambda: True)
    assert platform.info()["refused"].get("no answer", 0) >= 1
    platform.close()


def test_a_hand_that_dies_and_returns_is_found_again() -> None:
    hand = Hand("tcp")
    first = Pumped(hand.face)
    server: Any = hand.face.server
    platform = hand.open(silence=10.0)
    first.close()
    ticked(platform, lambda: platform.info()["refused"].get("connection lost", 0) >= 1)
    again = inspire_face(hand.there, hand.robot, port=server.port)
    hand.there["joint_pos"][...] = hand.robot.upper
    with pumped(again):
        upper = hand.robot.upper
        ticked(platform, lambda: bool(np.allclose(hand.here["joint_pos"], upper, atol=0.002)))
        platform.close()


class Odd:
    """The other end of a pty, which answers as a test says."""

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        self.master, self.slave, self.device = pty_pair()
        tty.setraw(self.slave)
        self._answer, self._ending = answer, False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ending:
            if select.select([self.master], [], [], 0.01)[0]:
                request = os.read(self.master, 256)
                if len(request) >= 8:
                    os.write(self.master, self._answer(request))

    def close(self) -> None:
        """End it."""
        self._ending = True
        self._thread.join(1.0)
        os.close(self.master)
        os.close(self.slave)


def good(request: bytes) -> bytes:
    """Answer a read with zeros, the closed hand, and a write as it should be."""
    if request[1] == 3:
        count = int.from_bytes(request[4:6], "big")
        return Rtu().pack(Frame(0, request[0], bytes((3, 2 * count)) + bytes(2 * count)))
    return Rtu().pack(Frame(0, request[0], request[1:6]))


BAD: dict[str, Callable[[bytes], bytes]] = {
    "wrong CRC": lambda r: good(r)[:-1] + bytes([good(r)[-1] ^ 1]),
    "short": lambda r: good(r)[:-3],
    "no answer": lambda r: b"",
    "answer of another unit": lambda r: Rtu().pack(Frame(0, 9, good(r)[1:-2])),
    "exception 4": lambda r: Rtu().pack(Frame(0, r[0], bytes((r[1] | 0x80, 4)))),
    "wrong length": lambda r: Rtu().pack(Frame(0, r[0], bytes((3, 4, 0, 0, 0, 0)))),
    "not a Modbus frame": lambda r: b"\x01\x55" + bytes(40),
    "angle out of range": lambda r: Rtu().pack(Frame(0, r[0], bytes((3, 12)) + b"\x7f" * 12)),
    "wrong function": lambda r: Rtu().pack(Frame(0, r[0], r[1:6])),
}


@pytest.mark.parametrize("reason", BAD)
def test_a_bad_answer_is_counted_and_left(reason: str) -> None:
    """The first answers are bad, then come good ones: the hand is there after all."""
    left = [3]

    def answer(request: bytes) -> bytes:
        left[0] -= 1
        if left[0] >= 0:
            if reason == "wrong function" and request[1] == 3:
                return Rtu().pack(Frame(0, request[0], b"\x10" + request[2:6]))
            return BAD[reason](request)
        return good(request)

    odd = Odd(answer)
    states = hand_states(LEFT)
    platform = inspire(states, LEFT, PERIOD, device=odd.device, connect=5.0)
    np.testing.assert_allclose(states["joint_pos"], LEFT.upper, atol=1e-6)
    assert platform.info()["refused"][reason] == 3
    platform.close()
    odd.close()


def test_floods_and_late_answers_are_no_answers() -> None:
    """Every answer comes twice, behind noise of an earlier one: each exchange begins anew."""
    odd = Odd(lambda request: good(request) * 2)
    states = hand_states(LEFT)
    platform = inspire(states, LEFT, PERIOD, device=odd.device, connect=5.0)
    before = platform.arrivals()
    ticked(platform, lambda: platform.arrivals() > before + 20)
    np.testing.assert_allclose(states["joint_pos"], LEFT.upper, atol=1e-6)
    platform.close()
    odd.close()


def test_a_stranger_at_the_face_is_left(tcp: tuple[Hand, Pumped]) -> None:
    """Garbage, silence and somebody else's unit do not keep the driver from its hand."""
    hand, _ = tcp
    server: Any = hand.face.server
    platform = hand.open(silence=2.0)
    strangers = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(2)]
    strangers[0].sendall(os.urandom(3000))
    strangers[1].sendall(bytes.fromhex("0001000000060903060a0006"))
    for _ in range(20):
        platform.recv()
        time.sleep(0.005)
    before = platform.arrivals()
    ticked(platform, lambda: platform.arrivals() > before + 5)
    for stranger in strangers:
        stranger.close()
    platform.close()


def test_who_takes_nothing_holds_no_exchange_up() -> None:
    """A peer that was stopped: what is sent to it piles up, and a write would wait for ever."""
    ours, theirs = socket.socketpair()
    link = ModbusConnection(ours.fileno(), Tcp(), ours.close)
    began = time.monotonic()
    with pytest.raises(TimeoutError, match="takes nothing"):  # noqa: PT012
        while time.monotonic() < began + 20.0:
            with suppress(Refused):
                link.exchange(1, read_request(0, 1), timeout=0.0)
    link.close()
    theirs.close()


def test_a_link_that_is_closed_again_lets_go_of_nothing_else() -> None:
    master, slave, device = pty_pair()
    link = open_serial(device, 115200)
    link.close()
    others = [os.open(os.devnull, os.O_RDONLY) for _ in range(3)]  # one takes its number
    link.close()
    for file in (*others, master, slave):
        os.close(file)


def test_a_client_that_reads_nothing_holds_no_hand_up() -> None:
    """What is answered to it piles up, and a write would wait for ever: it is let go of."""
    ours, theirs = socket.socketpair()
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
    served = _Served(ours.fileno(), Tcp())
    ask = Tcp().pack(Frame(1, 1, read_request(0, 100)))
    for _ in range(200):
        theirs.send(ask)
        if not served.serve(lambda _: bytes(202)):
            break
    else:
        raise AssertionError("it was answered for ever")
    ours.close()
    theirs.close()


def test_one_finger_alone_is_heard(tcp: tuple[Hand, Pumped]) -> None:
    hand, _ = tcp
    face = hand.face
    start = face._registers.target + 2
    answer = face._answer(Frame(0, face._registers.unit, write_request(start, np.array([500]))))
    assert answer == struct.pack(">BHH", 16, start, 1)
    assert face._heard


# -- wrong options ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "options", "told"),
    [
        (inspire, {"address": "127.0.0.1", "device": "/dev/null"}, "give one of them"),
        (inspire, {"port": 0}, "port is 0; give one from 1 to 65535"),
        (inspire, {"port": 70000}, "port is 70000; give one from 1 to 65535"),
        (inspire, {"device": "/dev/null"}, "is not a serial line"),
        (inspire, {"device": "/dev/there_is_none"}, "No such file or directory"),
        (inspire, {"domain": 1}, "domain is an option of hands over DDS, and robot inspire_rh56_l"),
        (rohand, {}, "give its serial line: platforms: {rohand: {device: /dev/ttyUSB0}}"),
    ],
)
def test_a_wrong_option_is_told(make: Any, options: dict[str, Any], told: str) -> None:
    robot = LEFT if make is inspire else load_robot("rohand")
    with pytest.raises(PlatformError) as raised:
        make(hand_states(robot), robot, PERIOD, **options)
    assert told in str(raised.value)


def test_modbus_needs_no_package(tcp: tuple[Hand, Pumped], monkeypatch: pytest.MonkeyPatch) -> None:
    for package in ("cyclonedds", "rosbags", "pymodbus", "serial"):
        monkeypatch.setitem(sys.modules, package, None)
    hand, _ = tcp
    platform = hand.open()
    assert {"motor_error", "motor_status"} <= set(platform.facts.writes)
    platform.close()


def test_nobody_at_the_port_is_told() -> None:
    with pytest.raises(
        PlatformError, match=r"cannot reach a hand at 127.0.0.1:\d+: Connection ref"
    ):
        inspire(hand_states(LEFT), LEFT, PERIOD, address="127.0.0.1", port=free_port())


def test_a_line_that_another_one_has_is_refused() -> None:
    master, slave, device = pty_pair()
    first = open_serial(device, 115200)
    with pytest.raises(PlatformError, match="no other program has it"):
        inspire(hand_states(LEFT), LEFT, PERIOD, device=device)
    first.close()
    os.close(master)
    os.close(slave)


def test_a_hand_that_says_nothing_is_told_with_what_was_refused() -> None:
    odd = Odd(BAD["wrong CRC"])
    with pytest.raises(
        PlatformError, match=r"refused: \d+ wrong CRC.*; the last one: (wrong CRC \(|no answer)"
    ):
        inspire(hand_states(LEFT), LEFT, PERIOD, device=odd.device, connect=0.3)
    odd.close()


def test_another_version_of_the_protocol_is_refused() -> None:
    robot = load_robot("rohand")
    face = rohand_face(hand_states(robot), robot, version=0x0203)
    device = face.where
    with pumped(face), pytest.raises(PlatformError, match=r"version 2\.3 of its protocol"):
        rohand(hand_states(robot), robot, PERIOD, device=device)


def test_a_robot_file_without_a_register_is_refused() -> None:
    robot = replace(LEFT, transport={k: v for k, v in LEFT.transport.items() if "clear" not in k})
    with pytest.raises(RobotError, match=r"transport\.register_clear_error is None"):
        inspire(hand_states(robot), robot, PERIOD)


def test_a_link_gives_up_in_time_though_old_answers_keep_coming() -> None:
    ours, theirs = socket.socketpair()
    stale = Tcp().pack(Frame(999, 1, bytes((3, 2, 0, 0))))
    ending = threading.Event()

    def flood() -> None:
        while not ending.is_set():
            try:
                theirs.send(stale)
            except OSError:
                return

    thread = threading.Thread(target=flood, daemon=True)
    thread.start()
    link = ModbusConnection(ours.fileno(), Tcp(), ours.close)
    with pytest.raises(Refused, match=r"no answer|short"):
        link.exchange(1, read_request(1546, 1), timeout=0.1)
    ending.set()
    ours.close()
    thread.join(1.0)
    theirs.close()


# -- a whole run -----------------------------------------------------------------------------------


def test_a_body_and_a_hand_run_together(tcp: tuple[Hand, Pumped]) -> None:
    hand, _ = tcp
    server: Any = hand.face.server
    program = Program(
        robot={"body": "go2", "left_hand": "inspire_rh56_left"},
        platform={
            "body": "fake_robot",
            "left_hand": "unicon_hardware.inspire.platform:make",
        },
        platforms={"left_hand": {"address": "127.0.0.1", "port": server.port}},
        start={"operator": False, "fade_in": 0.1},
        rate=100,
        duration=0.5,
        flow={
            "zip": [
                {"hold": None, "of": "body"},
                {
                    "chain": [
                        {"pose": {"to": {"L_index_proximal_joint": 1.0}, "duration": 0.2}},
                        {"hold": None},
                    ],
                    "of": "left_hand",
                },
            ]
        },
    )
    platform: Any = program.platform
    assert isinstance(platform.members["left_hand"], Inspire)
    assert "hardware_stop" in program.safety
    report = Runner(program, RunOptions(speed="real")).run()
    assert not report.faults, report.faults
    assert hand.face.cleared == 1
    assert hand.there["joint_pos_target"][3] == pytest.approx(1.0, abs=0.005)


def test_states_of_a_run_are_those_of_the_platform(tmp_path: Path) -> None:
    """`motor_status` is a state only where a platform tells it."""
    del tmp_path
    program = Program(robot="go2", platform="fake", rate=50, flow="hold")
    assert "motor_status" not in program.states
    assert isinstance(program.states, States)
    program.close()
