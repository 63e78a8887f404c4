"""The driver of `unitree_legged` against a socket that a test drives: states and attacks."""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from legged_peer import free_port, robot_of, slow_command, slow_state, states_of

from unicon_base.errors import Fault, PlatformError
from unicon_core.robots import load_robot
from unicon_core.states import States, StateSpec
from unicon_core.states.standard import BUTTONS, control_states
from unicon_hardware.unitree_legged.platform import UnitreeLegged, make
from unicon_hardware.unitree_legged.wire import Repeater
from unicon_hardware.wire import Udp

UPRIGHT = (1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3, 0.0, 0.0, 9.81)
PERIOD = 0.002


class Peer:
    """A socket that says what a test tells it to; the driver is opened against it."""

    def __init__(self, name: str = "go1", states: States | None = None, **options: Any) -> None:
        self.name, self.robot = name, robot_of(name)
        self.states = states_of(self.robot) if states is None else states
        port, self.local = free_port(), free_port()
        self.udp = Udp(("127.0.0.1", port), ("127.0.0.1", self.local), "a peer")
        self.tick, self.began = 1000, time.monotonic()
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

    def later(self) -> int:
        """Return the tick of the next frame, [ms]: at least 2 ms later, by the real clock, too."""
        early = self.began + 1e-3 * (self.tick + 2 - 1000) - time.monotonic()
        time.sleep(max(early, 0.0))
        self.tick = 1000 + round(1e3 * (time.monotonic() - self.began))
        return self.tick

    def good(self) -> None:
        self.later()
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
    specs |= {"foot_force": StateSpec((4,)), **control_states()}
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
    assert bytes(platform._wire.remote) == bytes(range(40))  # 0x0302 are its buttons
    pressed = [name for name, value in zip(BUTTONS, states["buttons"]) if value]
    assert (pressed, int(states["controls_alive"])) == (["L1", "A", "B"], 1)
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
    refused = platform._wire.counts.refused
    refused.clear()
    for reason, data in cases:
        peer.udp.send(data)
        assert platform.wait(1.0)
        assert platform._wire.take() == 0
        counted[reason] = counted.get(reason, 0) + 1
        assert dict(refused) == counted
    for name, value in before.items():
        np.testing.assert_array_equal(platform._states[name], value, err_msg=name)
    assert "position of FL_calf_joint is nan" in platform._wire.counts.last
    with pytest.raises(Fault, match=r"nothing from 127\.0\.0\.1:\d+ for .* s \(refused: 6 wr"):
        listened(platform, 5.0)


def listened(platform: UnitreeLegged, seconds: float) -> None:
    """Take what comes for some time: a pause between two looks counts as two ticks at most."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
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
    assert platform._wire.take() == 0
    assert peer.states["joint_pos"][0] == np.float32(0.7)


def test_the_tick_may_wrap(peers: Callable[..., Peer]) -> None:
    peer = peers("go1")
    platform = peer.opened()
    for tick in (2**30, 2**31, 2**32 - 1, 1, 2):
        peer.udp.send(peer.frame(tick))
        assert platform.wait(1.0)
        assert platform._wire.take() == 1, tick


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
    assert platform._wire.strangers > 0
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


@pytest.mark.parametrize("name", ["go1", "a1"])
@pytest.mark.parametrize("mode", [0x00, 8, 0xFF])
def test_a_motor_that_leaves_servo_mode_is_a_fault_in_the_next_tick(
    peers: Callable[..., Peer], name: str, mode: int
) -> None:
    peer = peers(name)
    platform = peer.opened()
    states = peer.states

    def tick(mode: int) -> None:
        peer.tick += 2
        motors = [(mode if i == 4 else 10, 0.0, 0.0, 0, 30) for i in range(12)]
        peer.udp.send(peer.frame(peer.tick, motors=motors))
        assert platform.wait(5.0)
        platform.recv()
        platform.send()

    tick(mode)  # nothing stiff has left: `prepare` waits for that motor
    tick(10)
    states["joint_stiffness"][...], states["joint_damping"][...] = 40.0, 1.0
    tick(10)
    joint = peer.robot.joint_names[4]
    with pytest.raises(
        Fault, match=f"motor {joint} is in mode {mode:#04x}, not in servo mode 0x0a"
    ):
        tick(mode)
    peer.commands()
    tick(10)  # it comes back, and must not jump
    platform.close()
    after = peer.commands()
    assert after
    offset = 22 if name == "go1" else 10
    for datagram in after:
        motors = np.frombuffer(datagram[offset : offset + 540], np.uint8).reshape(20, 27)
        assert not motors[:, 9:13].any()  # torque and stiffness


def test_a_process_that_was_stopped_sends_nothing_stiff_when_it_goes_on() -> None:
    """Its tick may come before the thread that damps: who is late is seen by both."""
    sent: list[bytes] = []
    repeater = Repeater(sent.append, 500.0, 0.02, b"idle", b"limp")  # the thread does not run yet
    assert not repeater.late  # nobody has to renew the idle command
    repeater.put(b"stiff")
    assert not repeater.late
    time.sleep(0.03)
    assert repeater.late
    repeater.put(b"limp too")
    assert repeater.late  # for good


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


@pytest.mark.parametrize(("torque", "count"), [(2.0, 0), (20.0, 1)])
def test_motors_that_hold_while_nothing_is_asked_of_them_obey_somebody_else(
    peers: Callable[..., Peer], torque: float, count: int
) -> None:
    peer = peers()
    platform = peer.opened()
    motors = [(10, 0.1, 0.0, -round(256 * torque) * (i == 3), 30) for i in range(12)]
    end = time.monotonic() + 5.0
    while list(platform.commanders().values()) != [count]:
        assert time.monotonic() < end
        peer.udp.send(peer.frame(peer.later(), motors=motors))
        platform.wait(0.05)
        platform.recv()
    assert all(where.startswith("127.0.0.1:") for where in platform.commanders())
    platform.send()  # from now on they may obey us
    platform._wire._held = -math.inf  # long ago
    peer.udp.send(peer.frame(peer.later(), motors=motors))
    platform.wait(0.5)
    platform.recv()
    assert list(platform.commanders().values()) == [0]


def test_all_datagrams_of_a_look_are_counted(peers: Callable[..., Peer]) -> None:
    peer = peers()
    platform = peer.opened()
    count = platform.arrivals()
    for _ in range(5):
        peer.good()
    peer.udp.send(b"too short")
    time.sleep(0.05)
    platform.recv()
    assert platform.arrivals() == count + 5
    assert sum(platform.info()["refused"].values()) == 1
