"""Driver and face of `unitree_legged` on loopback in one process, and what a face refuses."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from legged_peer import ALIENGO, Emulated, free_port, robot_of, slow_command, states_of

from unicon_core.platforms.platform import Prepares
from unicon_core.robots import load_robot
from unicon_hardware.unitree_legged.codec import link_of
from unicon_hardware.unitree_legged.platform import make
from unicon_hardware.unitree_legged.wire import LeggedWire
from unicon_hardware.wire import Udp

GENERATIONS = [("a1", None), *(("aliengo", each) for each in ALIENGO), ("go1", None)]
PERIOD = 0.002


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


def test_everybody_who_commands_is_answered() -> None:
    robot, port = load_robot("a1"), free_port()
    emulated = Emulated(robot, port)
    peers = [Udp(("127.0.0.1", 0), ("127.0.0.1", port), f"peer {k}") for k in range(2)]
    try:
        motors = [(0.0, 0.0, 0.0, 0.0, 0.0)] * 12
        for peer in (*peers, peers[0]):
            peer.send(slow_command("a1", motors))
        time.sleep(0.05)
        emulated.face.hear()
        emulated.face.tell()
        emulated.face.tell()
        time.sleep(0.05)
        assert [len(peer.received()) for peer in peers] == [1, 1]
    finally:
        for peer in peers:
            peer.close()
        emulated.close()
