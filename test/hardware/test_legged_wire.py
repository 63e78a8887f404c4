"""Driver and face of `unitree_legged` on loopback in one process: states, commands, attacks."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from legged_peer import ALIENGO, Emulated, free_port, robot_of, slow_command, slow_state, states_of

from unicon_core import Program, block
from unicon_core.errors import Fault, PlatformError, RobotError, StateError
from unicon_core.platforms.platform import Prepares
from unicon_core.robots import load_robot
from unicon_core.states import States, StateSpec, standard_states
from unicon_ros.hardware.udp import Udp
from unicon_ros.hardware.unitree_legged.link import link_of
from unicon_ros.hardware.unitree_legged.platform import UnitreeLegged, make
from unicon_ros.hardware.unitree_legged.wire import LeggedWire

GENERATIONS = [("a1", None), *(("aliengo", each) for each in ALIENGO), ("go1", None)]
UPRIGHT = (1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3, 0.0, 0.0, 9.81)
PERIOD = 0.002


class Peer:
    """A socket that says what a test tells it to; the driver is opened against it."""

    def __init__(self, name: str = "go1", states: States | None = None, **options: Any) -> None:
        self.name, self.robot = name, robot_of(name)
        self.states = states_of(self.robot) if states is None else states
        port, self.local = free_port(), free_port()
        self.udp = Udp(("127.0.0.1", port), ("127.0.0.1", self.local), "a peer")
        self.tick = 1000
        self.good()  # nobody is there yet: it is lost
        given = {"watchdog": 5.0, "silence": 5.0, "connect": 0.5, **options}
        self._open: Callable[[], UnitreeLegged] = lambda: make(
            self.states,
            self.robot,
            PERIOD,
            address="127.0.0.1",
            port=port,
            local_port=self.local,
            **given,
        )

    def frame(self, tick: int, imu: Any = UPRIGHT, **options: Any) -> bytes:
        motors = [(10, 0.1 * i, 0.2 * i, 256 * i, 30 + i) for i in range(12)]
        return slow_state(self.name, options.pop("motors", motors), imu, tick, **options)

    def good(self) -> None:
        self.tick += 2
        self.udp.send(self.frame(self.tick))

    def opened(self) -> UnitreeLegged:
        """Open the driver; a thread answers it meanwhile."""
        done = threading.Event()

        def answer() -> None:
            while not done.wait(0.005):
                if self.udp.datagrams():
                    self.good()

        thread = threading.Thread(target=answer)
        thread.start()
        try:
            self.platform = self._open()
        finally:
            done.set()
            thread.join()
        while self.platform.wait(0.02):
            self.platform.recv()
        return self.platform

    def commands(self) -> list[bytes]:
        """Return what has come from the driver since the last call."""
        found: list[bytes] = []
        while some := self.udp.datagrams():
            found += [datagram for datagram, _ in some]
        return found

    def close(self) -> None:
        if hasattr(self, "platform"):
            self.platform.close()
        self.udp.close()


@pytest.fixture
def peers() -> Iterator[Callable[..., Peer]]:
    made: list[Peer] = []

    def build(*args: Any, **options: Any) -> Peer:
        made.append(Peer(*args, **options))
        return made[-1]

    yield build
    for peer in made:
        peer.close()


def test_states_arrive_with_battery_temperatures_errors_and_remote(
    peers: Callable[..., Peer],
) -> None:
    specs = dict(states_of(robot_of("go1")).layout.specs)
    specs["foot_force"] = StateSpec((4,))
    peer = peers(states=States(specs))
    platform = peer.opened()
    states = peer.states
    motors = [(10, 0.1 * i, -0.2 * i, -384, 40 + i) for i in range(12)]
    motors[4] = (8, *motors[4][1:])
    peer.udp.send(peer.frame(peer.tick + 2, motors=motors, soc=55))
    assert platform.wait(1.0)
    platform.recv()
    np.testing.assert_allclose(states["joint_pos"], 0.1 * np.arange(12), rtol=1e-6)
    np.testing.assert_allclose(states["joint_vel"], -0.2 * np.arange(12), rtol=1e-6)
    np.testing.assert_array_equal(states["joint_effort"], -1.5)
    np.testing.assert_array_equal(states["motor_temperature"], 40 + np.arange(12))
    assert list(np.flatnonzero(states["motor_error"])) == [4]
    assert states["motor_error"][4] == 8
    assert float(states["battery_charge"]) == pytest.approx(0.55)
    assert float(states["battery_voltage"]) == pytest.approx(32.0)
    assert list(states["foot_force"]) == [11.0, 12.0, 13.0, 14.0]
    assert list(states["base_ang_vel"]) == pytest.approx([0.1, 0.2, 0.3])
    assert states["projected_gravity"][2] == -1.0
    assert bytes(platform.wire.remote) == bytes(range(40))
    assert {"battery_charge", "foot_force"} <= set(platform.facts.writes)


def test_an_a1_tells_no_battery_and_a_sensor_that_is_turned_is_turned_back(
    peers: Callable[..., Peer],
) -> None:
    peer = peers("a1")
    imu = peer.robot.imu
    assert imu is not None
    half = np.sqrt(0.5, dtype=np.float32)
    turned = replace(imu, quat=np.array((half, 0.0, 0.0, half), np.float32))  # 90° about z
    peer.robot = replace(peer.robot, imu=turned)
    platform = peer.opened()
    assert "battery_charge" not in platform.facts.writes
    assert "motor_temperature" in platform.facts.writes
    np.testing.assert_allclose(peer.states["base_ang_vel"], (-0.2, 0.1, 0.3), atol=1e-6)


def test_commands_are_exact_and_idle_before_the_first(peers: Callable[..., Peer]) -> None:
    peer = peers("a1")
    platform = peer.opened()
    idle = slow_command("a1", [])
    time.sleep(0.02)
    before = peer.commands()
    assert before
    assert set(before) == {idle}
    rng, states = np.random.default_rng(0), peer.states
    columns = (
        ("joint_pos_target", 1.0),
        ("joint_vel_target", 2.0),
        ("joint_effort_ff", 30.0),
        ("joint_stiffness", 50.0),
        ("joint_damping", 5.0),
    )
    for _ in range(20):
        for name, scale in columns:
            states[name][...] = np.abs(rng.normal(0.0, scale, 12))
        platform.send()
        wanted = slow_command("a1", list(zip(*(states[name].tolist() for name, _ in columns))))
        assert wanted in peer.commands()
    assert platform.info()["clamped"] == 0
    states["joint_stiffness"][3] = 3000.0
    platform.send()
    assert platform.info()["clamped"] == 1


def test_a_command_is_repeated_until_the_next(peers: Callable[..., Peer]) -> None:
    peer = peers("go1")
    platform = peer.opened()
    peer.states["joint_stiffness"][...] = 20.0
    platform.send()
    time.sleep(0.1)
    sent = peer.commands()
    assert len(sent) > 10  # 50 on a machine that is not busy
    assert len(set(sent[-10:])) == 1


BAD = {
    "wrong length": [b"", b"x", bytes(806), bytes(808), bytes(771), bytes(60000)],
    "wrong CRC": [bytes(807)],
}


def test_bad_datagrams_are_counted_and_silence_is_a_fault(peers: Callable[..., Peer]) -> None:
    peer = peers("go1", silence=0.03)
    platform = peer.opened()
    before = {name: platform._states[name].copy() for name in platform.facts.writes}
    tick = peer.tick
    flipped = bytearray(peer.frame(tick + 2))
    flipped[100] ^= 1
    nan = float("nan")
    bad_motor = [(10, 0.0, 0.0, 0, 30)] * 12
    cases = [
        *((reason, data) for reason, each in BAD.items() for data in each),
        ("wrong CRC", bytes(flipped)),
        ("wrong head", peer.frame(tick + 2, level=0)),
        ("tick that stands still", peer.frame(tick)),
        ("older than the one before", peer.frame(tick - 2)),
        ("older than the one before", peer.frame((tick - 2**31) & 0xFFFFFFFF)),
        ("not finite", peer.frame(tick + 2, imu=(nan, *UPRIGHT[1:]))),
        ("not finite", peer.frame(tick + 2, imu=(*UPRIGHT[:9], float("-inf")))),
        ("not finite", peer.frame(tick + 2, motors=[*bad_motor[:5], (10, nan, 0.0, 0, 30)])),
    ]
    counted: dict[str, int] = {}
    refused = platform.wire.counts.refused
    refused.clear()
    for reason, data in cases:
        peer.udp.send(data)
        assert platform.wait(1.0)
        assert platform.wire.take() == 0
        counted[reason] = counted.get(reason, 0) + 1
        assert dict(refused) == counted
    for name, value in before.items():
        np.testing.assert_array_equal(platform._states[name], value, err_msg=name)
    assert "position of FL_calf_joint is nan" in platform.wire.counts.last
    time.sleep(0.03)
    with pytest.raises(Fault, match=r"nothing from 127\.0\.0\.1:\d+ for 0\.\d+ s \(refused: 6 wr"):
        platform.recv()


def test_a_good_datagram_between_bad_ones_counts(peers: Callable[..., Peer]) -> None:
    peer = peers("go1")
    platform = peer.opened()
    good = peer.frame(peer.tick + 2, motors=[(10, 0.7, 0.0, 0, 30)] * 12)
    for data in (bytes(807), good, good, peer.frame(peer.tick), bytes(807), b"z"):
        peer.udp.send(data)
    deadline = time.monotonic() + 2.0
    while peer.states["joint_pos"][0] != np.float32(0.7):
        platform.recv()
        assert time.monotonic() < deadline
    assert platform.wire.take() == 0
    assert peer.states["joint_pos"][0] == np.float32(0.7)


def test_the_tick_may_wrap(peers: Callable[..., Peer]) -> None:
    peer = peers("go1")
    platform = peer.opened()
    for tick in (2**30, 2**31, 2**32 - 1, 1, 2):
        peer.udp.send(peer.frame(tick))
        assert platform.wait(1.0)
        assert platform.wire.take() == 1, tick


def test_another_generation_is_named(peers: Callable[..., Peer]) -> None:
    peer = peers("go1", connect=0.1)
    peer.name = "a1"  # what answers is an A1
    with pytest.raises(PlatformError, match="771 bytes instead of 807: a robot that takes 610"):
        peer.opened()


def test_strangers_are_counted_and_a_flood_holds_nothing_up(peers: Callable[..., Peer]) -> None:
    peer = peers("go1")
    platform = peer.opened()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        datagram = peer.frame(peer.tick + 2)
        for _ in range(2000):
            stranger.sendto(datagram, ("127.0.0.1", peer.local))
    arrived = platform.arrivals()
    for _ in range(60):
        platform.recv()
    assert platform.arrivals() == arrived
    assert platform.wire.strangers > 0
    for _ in range(300):
        peer.udp.send(b"garbage")
    for _ in range(10):
        platform.recv()
    peer.good()
    assert platform.wait(1.0)
    platform.recv()
    assert platform.arrivals() == arrived + 1


def test_a_tick_that_does_not_come_is_damped_for_good(peers: Callable[..., Peer]) -> None:
    peer = peers("a1", watchdog=0.1)
    platform = peer.opened()
    states, robot = peer.states, peer.robot
    states["joint_pos_target"][...] = 0.3
    states["joint_stiffness"][...], states["joint_damping"][...] = 40.0, 1.0
    platform.send()
    limp = slow_command("a1", [(0.0, 0.0, 0.0, 0.0, kd) for kd in robot.joint_damping.tolist()])
    time.sleep(0.2)
    assert peer.commands()[-1] == limp
    with pytest.raises(Fault, match=r"no command came for 0\.1 s, the robot was damped"):
        platform.send()
    platform.send()  # as the runner's damping does, which begins with what was sent last
    platform.close()
    after = peer.commands()
    assert after
    for datagram in after:
        motors = np.frombuffer(datagram[10:550], np.uint8).reshape(20, 27)
        assert not motors[:, 9:13].any()  # torque and stiffness


def test_close_damps_and_a_second_run_finds_the_port(peers: Callable[..., Peer]) -> None:
    peer = peers("a1")
    platform = peer.opened()
    peer.states["joint_stiffness"][...] = 40.0
    with pytest.raises(PlatformError, match=r"cannot listen at 0\.0\.0\.0:\d+"):
        peer._open()
    platform.send()
    closing = threading.Thread(target=platform.close)
    closing.start()
    sent: list[bytes] = []
    while closing.is_alive():  # a socket holds less than all that it sends
        sent += peer.commands()
        time.sleep(0.005)
    sent += peer.commands()
    stiffness = [np.frombuffer(datagram, "<u2", 1, 10 + 11)[0] for datagram in sent]
    assert stiffness[-1] == 0
    assert len(set(stiffness)) > 5
    again = peer.opened()  # the same ports, after the first has let go
    assert again.arrivals() > 0


def test_close_without_a_command_sends_idle_ones_alone(peers: Callable[..., Peer]) -> None:
    peer = peers("a1")
    peer.opened().close()
    assert set(peer.commands()) <= {slow_command("a1", [])}


def test_nobody_there_is_told(peers: Callable[..., Peer]) -> None:
    peer = peers("go1", connect=0.05)
    peer.udp.close()
    with pytest.raises(PlatformError, match=r"no frame that it understands from 127\.0\.0\.1"):
        peer._open()


def test_a_robot_in_another_network_is_told_with_the_way_to_it() -> None:
    robot = load_robot("go1")
    options: dict[str, Any] = {"local_port": free_port(), "connect": 0.01}
    with pytest.raises(PlatformError, match=r"from 127\.1\.2\.3:8007 \(from 127\.0\.0\.1\) within"):
        make(states_of(robot), robot, PERIOD, address="127.1.2.3", **options)
    with pytest.raises(PlatformError, match=r"no way to 255\.255\.255\.255: Permission denied"):
        make(states_of(robot), robot, PERIOD, address="255.255.255.255", **options)


def test_a_silent_driver_asks_only_where_it_may(peers: Callable[..., Peer]) -> None:
    peer = peers("go1", silent=True)
    with pytest.raises(PlatformError, match="poll: true"):
        peer._open()
    assert peer.commands() == []
    polling = peers("go1", silent=True, poll=True)
    platform = polling.opened()
    polling.states["joint_stiffness"][...] = 50.0
    platform.send()
    platform.close()
    assert set(polling.commands()) <= {slow_command("go1", [])}


def test_a_robot_that_does_not_obey_says_what_to_do() -> None:
    port, local = free_port(), free_port()
    robot = load_robot("go1")
    emulated = Emulated(robot, port, obeys=False)
    states = states_of(robot)
    platform = None
    try:
        ended = threading.Event()
        thread = threading.Thread(
            target=lambda: [emulated.run(0.02) for _ in iter(ended.is_set, 1)]
        )
        thread.start()
        try:
            platform = make(
                states, robot, PERIOD, address="127.0.0.1", port=port, local_port=local, watchdog=5
            )
            assert isinstance(platform, Prepares)
            assert "on the remote press L2+B, then L1+L2+START" in platform.prepare()
            assert "FR_hip_joint is in mode 0x00" in platform.prepare()
            states["joint_stiffness"][...] = 20.0
            emulated.face.obeys = True
            deadline = time.monotonic() + 5.0
            while platform.prepare() and time.monotonic() < deadline:
                platform.wait(0.01)
                platform.recv()
            assert platform.prepare() == ""
        finally:
            ended.set()
            thread.join()
    finally:
        if platform is not None:
            platform.close()
        emulated.close()


@pytest.mark.parametrize(("name", "generation"), GENERATIONS)
def test_wire_and_face_are_two_ends_of_one_protocol(name: str, generation: str | None) -> None:
    robot, port, local = robot_of(name), free_port(), free_port()
    emulated = Emulated(robot, port, generation=generation)
    states = states_of(robot)
    link = link_of(robot, generation=generation, address="127.0.0.1", port=port, local_port=local)
    wire = LeggedWire(states, robot, link, 5.0)
    rng = np.random.default_rng(1)
    told, heard = emulated.states, emulated.states
    try:
        for i in range(50):
            told["joint_pos"][...] = rng.uniform(-2.0, 2.0, 12)
            told["joint_vel"][...] = rng.uniform(-20.0, 20.0, 12)
            told["base_ang_vel"][...] = rng.uniform(-5.0, 5.0, 3)
            states["joint_pos_target"][...] = rng.uniform(-2.0, 2.0, 12)
            states["joint_vel_target"][...] = rng.uniform(-2.0, 2.0, 12)
            states["joint_effort_ff"][...] = np.round(rng.uniform(-20.0, 20.0, 12) * 256) / 256
            states["joint_stiffness"][...] = np.round(rng.uniform(1.0, 90.0, 12) * 32) / 32
            states["joint_damping"][...] = np.round(rng.uniform(1.0, 9.0, 12) * 16) / 16
            wire.put()
            deadline = time.monotonic() + 2.0
            while not (
                emulated.face.hear()
                and np.array_equal(heard["joint_pos_target"], states["joint_pos_target"])
            ):
                assert time.monotonic() < deadline
            for key in ("joint_vel_target", "joint_effort_ff", "joint_stiffness", "joint_damping"):
                np.testing.assert_array_equal(heard[key], states[key], err_msg=f"{i} {key}")
            emulated.face.tell()
            assert wire.wait(2.0)
            wire.take()
            for key in ("joint_pos", "joint_vel", "base_ang_vel"):
                np.testing.assert_array_equal(states[key], told[key], err_msg=f"{i} {key}")
        assert emulated.face.refused == 0
        assert not wire.counts.refused
    finally:
        wire.close()
        emulated.close()


def test_a_face_refuses_what_the_board_would() -> None:
    robot, port = load_robot("go1"), free_port()
    emulated = Emulated(robot, port)
    us = Udp(("127.0.0.1", 0), ("127.0.0.1", port), "us")
    good = slow_command("go1", [(0.1, 0.0, 0.0, 20.0, 1.0)] * 12)
    bad = [b"", good[:-1], good + b"x", good[:-1] + b"\0", bytes(614), slow_command("a1", [])]
    bad += [slow_command("go1", [(float("nan"), 0.0, 0.0, 1.0, 1.0)] * 12)]
    bad += [slow_command("go1", [(0.0, 0.0, 0.0, 0.0, 0.0)] * 12, servo=77)]
    try:
        for data in bad:
            us.send(data)
        time.sleep(0.02)
        assert not emulated.face.hear()
        emulated.face.tell()
        assert emulated.face.refused == len(bad)
        assert not us.wait(0.02)  # none of them was answered
        us.send(good)
        time.sleep(0.02)
        assert emulated.face.hear()
        emulated.face.tell()
        emulated.face.tell()
        assert us.wait(1.0)
        assert len(us.received()) == 1  # one answer for one command
        us.send(slow_command("go1", [(0.1, 0.0, 3.0, 20.0, 1.0)] * 12, servo=0))
        time.sleep(0.02)
        assert emulated.face.hear()
        assert not emulated.states["joint_stiffness"].any()
        assert not emulated.states["joint_effort_ff"].any()
        assert (emulated.states["joint_damping"] > 0.0).all()
    finally:
        us.close()
        emulated.close()


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("aliengo", {}, r"speaks one of 3 protocols.*say the generation.*legged_sdk_3\.3\.1"),
        ("aliengo", {"generation": "aliengo_sdk_1.2.2"}, r"structs are not packed.*spoken are leg"),
        ("go1", {"generation": "legged_sdk_3.3.1"}, r"no generation 'legged_sdk_3.3.1'; did you"),
        ("go1", {"generation": 3}, "no generation 3"),
        ("go1", {"address": "go1.local"}, "address is 'go1.local'; give an IPv4"),
        ("go1", {"address": 7}, "address is 7"),
        ("go1", {"port": 0}, "port is 0; give one from 1 to 65535"),
        ("go1", {"port": True}, "port is True"),
        ("go1", {"local_port": 70000}, "local_port is 70000"),
        ("a1", {"encrypted": True}, "known of Go1's datagrams alone"),
        ("go1", {"watchdog": 0.001}, "watchdog is 0.001 s; give more than a tick of 0.002 s"),
        ("go1", {"watchdog": float("nan")}, "watchdog is nan"),
    ],
)
def test_a_wrong_option_is_told(name: str, options: dict[str, Any], message: str) -> None:
    robot = robot_of(name)
    with pytest.raises(PlatformError, match=message):
        make(states_of(robot), robot, PERIOD, connect=0.01, **options)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"motors": [0, 1, 2]}, "write 12 slots in sequence"),
        ({"motors": list(range(9, 21))}, "all below 20"),
        ({"level_flag": 256}, "level_flag is 256"),
        ({"pos_stop": None}, "pos_stop is None"),
        ({"damping_mode": "x"}, "damping_mode is 'x'"),
        ({"generations": {}}, r"generations is \{\}"),
        ({"generations": {"x": 3}}, r"generations is \{'x': 3\}; write"),
        ({"generations": {"x": {"command_bytes": [1]}}}, r"has \[1\] and None bytes"),
        (
            {"generations": {"x": {"local_port": 1, "command_bytes": 1}}},
            "has 1 and None bytes; known: 610 and 771, 614 and 807",
        ),
    ],
)
def test_a_robot_file_that_lacks_a_fact_is_told(changes: dict[str, Any], message: str) -> None:
    robot = load_robot("go1")
    robot = replace(robot, transport={**robot.transport, **changes})
    with pytest.raises(RobotError, match=message):
        make(states_of(robot), robot, PERIOD, connect=0.01)


def test_foot_forces_are_four() -> None:
    robot = load_robot("a1")
    specs = standard_states(robot.joint_names) | {"foot_force": StateSpec((2,))}
    with pytest.raises(StateError, match=r"foot_force.*writes four"):
        make(States(specs), robot, PERIOD, address="127.0.0.1", connect=0.01)


@pytest.mark.parametrize(("name", "battery"), [("a1", False), ("go1", True)])
def test_check_knows_what_a_robot_tells_without_opening_it(name: str, battery: bool) -> None:
    described: dict[str, Any] = {
        "robot": name,
        "platform": "unicon_ros.hardware.unitree_legged.platform:make",
        "rate": 50,
        "states": {"foot_force": {"shape": [4]}},
    }
    writes = Program(dry=True, flow=block("hold"), **described).platform.facts.writes
    assert ("battery_charge" in writes) is battery
    assert {"foot_force", "motor_error"} <= set(writes)
    described["robot"] = "aliengo"
    with pytest.raises(PlatformError, match="say the generation"):
        Program(dry=True, flow=block("damp"), **described)
