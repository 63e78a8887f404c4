"""The vendor's own unitree_legged_sdk as client of our face, and its datagrams beside our driver's.

It is not part of the repository: `UNICON_UNITREE_LEGGED_SDK` names checkouts of
unitreerobotics/unitree_legged_sdk, one for each protocol, separated by colons: branch `go1`
(v3.8.6), tag `v3.3.1`, branch `Aliengo` (v3.8.4). Its libraries are for x86-64.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from legged_peer import LENGTHS, free_port, robot_of, servo_link, states_of

from unicon_core.states.standard import COMMAND_STATES
from unicon_hardware.unitree_legged.codec import CommandFrame
from unicon_hardware.unitree_legged.platform import face

CHECKOUTS = [
    Path(each) for each in os.environ.get("UNICON_UNITREE_LEGGED_SDK", "").split(":") if each
]
CLIENT = Path(__file__).with_name("legged_sdk_client.cpp")
EXCHANGES = 2000


def built(sdk: Path, folder: Path) -> Path:
    """Return the client, linked with a checkout's library."""
    if not CHECKOUTS:
        pytest.skip("UNICON_UNITREE_LEGGED_SDK names no checkout of unitree_legged_sdk")
    if shutil.which("g++") is None or platform.machine() != "x86_64":
        pytest.skip("the client of unitree_legged_sdk needs g++ on x86-64")
    libraries = [
        each for each in (sdk / "lib").rglob("libunitree_legged_sdk*") if "amd64" in str(each)
    ]
    client = folder / "client"
    # LCM, which one of the libraries wants, is not called.
    stub = ["gcc", "-shared", "-x", "c", os.devnull, "-o", folder / "liblcm.so.1"]
    subprocess.run(stub, check=True, timeout=100)
    unresolved = f"-Wl,--unresolved-symbols=ignore-in-shared-libs,-rpath,{libraries[0].parent}"
    command = ["g++", "-std=c++14", "-I", sdk / "include", CLIENT, libraries[0], "-lpthread"]
    subprocess.run([*command, unresolved, "-o", client], check=True, timeout=100)
    return client


@pytest.mark.slow
@pytest.mark.parametrize("sdk", CHECKOUTS or [Path()], ids=lambda path: path.name)
def test_the_vendors_client_and_ours_say_the_same(sdk: Path, tmp_path: Path) -> None:
    client = built(sdk, tmp_path)
    name = "go1" if "cell_vol" in (sdk / "include/unitree_legged_sdk/comm.h").read_text() else "a1"
    robot, port, local = robot_of(name), free_port(), free_port()
    states = states_of(robot)
    board = face(states, robot, port=port)
    ours = CommandFrame(servo_link(name, 12))
    arguments = [str(each) for each in (local, port, *LENGTHS[name])]
    peer = subprocess.Popen(
        [client, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        bufsize=1,
        env={**os.environ, "LD_LIBRARY_PATH": str(tmp_path)},
    )
    assert peer.stdin is not None
    assert peer.stdout is not None
    rng = np.random.default_rng(0)
    try:
        for i in range(EXCHANGES):
            command = (rng.uniform(-1.0, 1.0, (12, 5)) * (3, 20, 30, 50, 10)).astype(np.float32)
            command[:, 3:] = np.abs(command[:, 3:]) + 1.0
            peer.stdin.write(" ".join(f"{value:.9g}" for value in command.flat) + "\n")
            while not board.hear():
                assert peer.poll() is None
            theirs = bytes(board._in.buffer)
            assert theirs == ours.write(*command.T), i
            expected = np.trunc(command * (1, 1, 256, 32, 16)) / (1, 1, 256, 32, 16)
            expected[:, :2] = command[:, :2]
            for column, key in enumerate(COMMAND_STATES):
                np.testing.assert_array_equal(
                    states[key], expected[:, column], err_msg=f"{i} {key}"
                )
            told = measured(states, rng)
            board.remote[:] = rng.bytes(40)
            board.tell()
            peer.stdin.write("\n")
            words = peer.stdout.readline().split()
            while words[0] != "state":  # the library says what it does, too
                words = peer.stdout.readline().split()
            heard = np.array(words[1:], np.float32)
            assert heard[0] == (2 * (i + 1)), i
            np.testing.assert_array_equal(heard[1:61].reshape(12, 5), told, err_msg=str(i))
            imu = np.concatenate(
                [states[key] for key in ("base_quat", "base_ang_vel", "base_lin_acc")]
            )
            np.testing.assert_array_equal(heard[61:71], imu, err_msg=str(i))
            assert bytes(heard[71:111].astype(np.uint8)) == board.remote
            assert heard[111] == 0  # checksums that it found wrong
        assert (board.good, board.refused) == (EXCHANGES, 0)
    finally:
        peer.kill()
        peer.communicate()
        board.close()


def measured(states: Any, rng: np.random.Generator) -> np.typing.NDArray[np.float32]:
    """Draw what a robot measures; return mode, q, dq, torque and °C of each motor, as sent."""
    pos, vel = rng.uniform(-3.0, 3.0, 12), rng.uniform(-20.0, 20.0, 12)
    effort, heat = rng.integers(-8000, 8000, 12) / 256.0, rng.integers(-20, 90, 12)
    states["joint_pos"][...], states["joint_vel"][...] = pos, vel
    states["joint_effort"][...], states["motor_temperature"][...] = effort, heat
    quat = rng.normal(0.0, 1.0, 4)
    states["base_quat"][...] = quat / np.linalg.norm(quat)
    states["base_ang_vel"][...] = rng.normal(0.0, 1.0, 3)
    states["base_lin_acc"][...] = rng.normal(0.0, 5.0, 3)
    rows = (np.full(12, 10), states["joint_pos"], states["joint_vel"], effort, heat)
    return np.column_stack(rows).astype(np.float32)
