"""WiredRobot around a wire that the test drives: silence, refusals, damping, silent, prepare."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from unicon_base.errors import Fault, PlatformError
from unicon_core.platforms.platform import Facts, Prepares
from unicon_core.robots import Robot, load_robot
from unicon_core.runtime.startup_sequence import Waiting
from unicon_core.states import States, standard_states
from unicon_hardware.wire import Counts, Udp, Wire
from unicon_hardware.wired_robot import WiredRobot, opened

WRITES = ("joint_pos", "joint_vel", "base_quat", "projected_gravity", "stamp_ns")


class Scripted(Wire):
    """A wire whose frames are numbers: the position of all joints."""

    where = "a script"

    def __init__(self, states: States, frames: list[float]) -> None:
        self.counts = Counts()
        self._states, self.frames = states, frames
        self.sent: list[tuple[float, float]] = []
        self.closed = False

    def take(self) -> int:
        good = 0
        while self.frames:
            value = self.frames.pop(0)
            if not np.isfinite(value):
                self.counts.refuse("not a number", str(value))
                continue
            self._states["joint_pos"][...] = value
            self._states["base_quat"][...] = (0.0, 1.0, 0.0, 0.0)
            good += 1
        self.counts.good += good
        return good

    def put(self) -> None:
        states = self._states
        self.sent.append((states["joint_pos_target"][0], states["joint_stiffness"][0]))

    def wait(self, timeout: float) -> bool:
        return bool(self.frames)

    def close(self) -> None:
        self.closed = True


class Wired(WiredRobot):
    facts = Facts("scripted", writes=WRITES)


@pytest.fixture
def robot() -> Robot:
    return load_robot("go2")


@pytest.fixture
def states(robot: Robot) -> States:
    return States(standard_states(robot.joint_names))


def test_frames_become_states_and_gravity_follows(robot: Robot, states: States) -> None:
    wire = Scripted(states, [0.1, 0.2])
    platform = opened(Wired(states, robot, 0.02, wire), connect=1.0)
    assert states["joint_pos"][0] == np.float32(0.2)
    assert states["projected_gravity"][2] == pytest.approx(1.0)  # it lies on its back
    assert states["stamp_ns"] > 0
    stamp = int(states["stamp_ns"])
    assert platform.arrivals() == 2
    assert platform.recv() is None
    assert int(states["stamp_ns"]) == stamp  # nothing new came
    assert platform.info()["frames"] == 2


def test_silence_and_garbage_are_a_fault_that_tells_what_was_refused(
    robot: Robot, states: States
) -> None:
    wire = Scripted(states, [0.1])
    platform = opened(Wired(states, robot, 0.02, wire, silence=0.001), connect=1.0)
    wire.frames += [np.nan]
    time.sleep(0.002)
    with pytest.raises(Fault, match=r"nothing from a script for 0\.\d+ s \(refused: 1 not a n"):
        platform.recv()
    assert states["joint_pos"][0] == np.float32(0.1)


def test_silence_counts_while_somebody_listens(robot: Robot, states: States) -> None:
    wire = Scripted(states, [0.1])
    platform = opened(Wired(states, robot, 0.001, wire, silence=0.01), connect=1.0)
    for _ in range(3):  # each pause of ours is longer than its silence may be, and counts 2 ms
        time.sleep(0.02)
        assert platform.recv() is None
    end = time.monotonic() + 5.0
    with pytest.raises(Fault, match="the robot is silent"):  # noqa: PT012
        while time.monotonic() < end:
            time.sleep(0.001)
            platform.recv()


def test_who_never_hears_the_robot_is_told_and_closed(robot: Robot, states: States) -> None:
    wire = Scripted(states, [np.inf])
    with pytest.raises(PlatformError, match=r"no frame that it understands.*last one.*inf"):
        opened(Wired(states, robot, 0.02, wire), connect=0.01)
    assert wire.closed
    assert wire.sent == []
    with pytest.raises(PlatformError, match="connect is nan"):
        opened(Wired(states, robot, 0.02, Scripted(states, [])), connect=float("nan"))
    wire = Scripted(states, [])
    with pytest.raises(PlatformError, match="silence is 0"):
        Wired(states, robot, 0.02, wire, silence=0.0)
    assert wire.closed


def test_a_connection_that_fails_before_the_run_is_an_error_and_no_fault(
    robot: Robot, states: States
) -> None:
    class Unplugged(Scripted):
        def take(self) -> int:
            raise Fault("the cable is out")

    wire = Unplugged(states, [])
    with pytest.raises(PlatformError, match="platform 'scripted': the cable is out"):
        opened(Wired(states, robot, 0.02, wire), connect=1.0)
    assert wire.closed


@pytest.mark.usefixtures("time_passes")
def test_close_damps_what_was_driven_and_nothing_else(robot: Robot, states: States) -> None:
    states["joint_pos_target"][...], states["joint_stiffness"][...] = robot.default_joint_pos, 20.0
    wire = Scripted(states, [0.1])
    untouched = opened(Wired(states, robot, 0.1, wire), connect=1.0)
    untouched.close()
    assert (wire.sent, wire.closed) == ([], True)
    silent = Scripted(states, [0.1])
    platform = opened(Wired(states, robot, 0.1, silent, silent=True), connect=1.0)
    platform.send()
    platform.close()
    assert silent.sent == []
    driven = Scripted(states, [0.1])
    platform = opened(Wired(states, robot, 0.1, driven), connect=1.0)
    platform.send()
    states["joint_stiffness"][...] = 1e6  # whatever had happened since
    platform.close()
    platform.close()
    stiffness = [gain for _, gain in driven.sent]
    assert stiffness[0] == 20.0
    assert stiffness == sorted(stiffness, reverse=True)
    assert stiffness[-1] == 0.0
    assert len(stiffness) > 4


def test_a_command_that_is_not_finite_does_not_leave(robot: Robot, states: States) -> None:
    wire = Scripted(states, [0.1])
    platform = opened(Wired(states, robot, 0.02, wire), connect=1.0)
    states["joint_effort_ff"][3] = np.nan
    with pytest.raises(Fault, match="joint_effort_ff of joint FL_hip_joint is nan"):
        platform.send()
    assert wire.sent == []


def test_a_robot_is_prepared_behind_the_go(robot: Robot, states: States) -> None:
    steps = ["its own controller lets go", ""]
    asked = []

    class Slow(Scripted):
        def prepare(self) -> str:
            asked.append(len(steps))
            return steps.pop(0)

    platform = opened(Wired(states, robot, 0.02, Slow(states, [0.1])), connect=1.0)
    assert isinstance(platform, Prepares)
    told: list[str] = []
    gate = ["a gate does not hold", "", ""]
    waiting = Waiting([lambda: gate.pop(0)], True, told.append, platform.prepare)
    assert not waiting()
    assert asked == []
    gate += [""] * 3
    assert not waiting()
    assert not asked  # nobody has said go
    assert waiting.go()
    assert not waiting()
    assert waiting.reason == "robot: its own controller lets go"
    assert waiting()
    quiet = opened(Wired(states, robot, 0.02, Slow(states, [0.1]), silent=True), connect=1.0)
    assert quiet.prepare() == ""
    assert len(asked) == 2


def test_a_socket_gives_its_peers_datagrams_alone(tmp_path: Path) -> None:
    peer = Udp(("127.0.0.1", 0), ("127.0.0.1", 9), "a peer")
    ours = Udp(("127.0.0.1", 0), ("127.0.0.1", peer.port), "ours")
    peer.peer = ("127.0.0.1", ours.port)
    stranger = Udp(("127.0.0.1", 0), ("127.0.0.1", ours.port), "a stranger")
    try:
        stranger.send(b"mine")
        peer.send(b"one")
        peer.send(b"two")
        assert ours.wait(1.0)
        found = ours.received()
        while len(found) < 2:
            found += ours.received()
        assert (found, ours.strangers) == ([b"one", b"two"], 1)
        assert not ours.wait(0.0)
        with pytest.raises(PlatformError, match=r"cannot listen at 127\.0\.0\.1:\d+"):
            Udp(("127.0.0.1", ours.port), ("127.0.0.1", 9), "another")
        peer.close()
        for _ in range(3):  # nobody is there: told by silence, not by an exception in the tick
            ours.send(b"x")
            assert ours.received() == []
        with pytest.raises(Fault, match="ours: cannot send"):
            ours.send(bytes(70_000))
    finally:
        for socket in (ours, stranger):
            socket.close()
