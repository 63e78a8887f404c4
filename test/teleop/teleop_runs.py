"""Runs of `g1_vr` by their users' commands, an emulated headset, and a network that can be cut."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_lab.recording import open_record

ROOT = Path(__file__).resolve().parents[2]
HEADSET = ROOT / "examples" / "emulated_headset.py"
SIDES = ("left_hand", "right_hand")
WITH_DATA = ("--set", "pacing.trigger=state")
"""A workstation that ticks when the robot's states come is never two ticks behind."""
HOME = 1.0
"""Of an arm on its way home in [rad/s]."""


def free_ports(count: int) -> int:
    """Return the first of some ports of this machine in a row that nobody has."""
    for base in range(20_000 + os.getpid() % 20_000, 60_000, count):
        with ExitStack() as stack:
            try:
                for port in range(base, base + count):
                    stack.enter_context(socket.socket()).bind(("127.0.0.1", port))
            except OSError:
                continue
            return base
    raise AssertionError("no ports")


def workflow(folder: Path, port: int, store: int = 0, name: str = "g1_vr") -> Path:
    """Write the workflow with ports of its own; with a store its one word is `workstation`."""
    text = (ROOT / "config" / "workflows" / f"{name}.yaml").read_text("utf-8")
    text = text.replace("webxr: {}", f"webxr: {{port: {port}}}")
    if store:
        text = text.replace("&where robot", "&where workstation").replace("5600", str(store))
    path = folder / f"{name}_{store}.yaml"
    path.write_text(text, "utf-8")
    return path


def start(path: Path, seconds: float, *more: str) -> subprocess.Popen[str]:
    """Run a workflow."""
    command = [sys.executable, "-m", "unicon_ros", "run", str(path), "--no-ros", "--quiet"]
    return subprocess.Popen(
        [*command, "--duration", str(seconds), *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def put_on(port: int, seconds: float, *more: str) -> subprocess.Popen[str]:
    """Show up with a headset, and take hold after 5 s: ticks have begun by then."""
    command = [sys.executable, str(HEADSET), "--address", f"http://127.0.0.1:{port}/"]
    command += ["--begin", "5"]
    return subprocess.Popen([*command, "--seconds", str(seconds), *more], start_new_session=True)


def end(process: subprocess.Popen[Any]) -> None:
    """End a process and all that it started; it may stand still."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


class Wire:
    """Ports of loopback that lead to others, until they are cut.

    Args:
        begin: first port that is listened at.
        there: first port that is led to.
        count: of ports.
    """

    def __init__(self, begin: int, there: int, count: int) -> None:
        self._cut, self._ends = threading.Event(), threading.Event()
        self._open: list[socket.socket] = []
        self._listening = []
        for k in range(count):
            door = socket.create_server(("127.0.0.1", begin + k))
            door.settimeout(0.1)
            self._listening.append(door)
            threading.Thread(target=self._serve, args=(door, there + k), daemon=True).start()

    def _serve(self, door: socket.socket, there: int) -> None:
        while not self._ends.is_set():
            with suppress(OSError):
                one, _ = door.accept()
                if self._cut.is_set():
                    one.close()
                    continue
                other = socket.create_connection(("127.0.0.1", there), timeout=1.0)
                for end in (one, other):
                    end.settimeout(None)
                self._open += [one, other]
                for pair in ((one, other), (other, one)):
                    threading.Thread(target=_carry, args=pair, daemon=True).start()

    def cut(self) -> None:
        """Let nothing through any more."""
        self._cut.set()
        for each in self._open:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()
        self._open.clear()

    def mend(self) -> None:
        """Lead through again."""
        self._cut.clear()

    def close(self) -> None:
        """Let go of all."""
        self._ends.set()
        self.cut()
        for door in self._listening:
            door.close()


def _carry(one: socket.socket, other: socket.socket) -> None:
    with suppress(OSError):
        while data := one.recv(65536):
            other.sendall(data)
    for each in (one, other):
        with suppress(OSError):
            each.shutdown(socket.SHUT_RDWR)


@contextmanager
def divided(
    folder: Path, seconds: float, wire: bool = False
) -> Iterator[tuple[subprocess.Popen[str], list[subprocess.Popen[str]], Wire | None]]:
    """Run robot, workstation and headset; yield robot, [workstation, headset] and the network."""
    ports = free_ports(12)
    robot = workflow(folder, ports, ports + 1)
    network = Wire(ports + 6, ports + 1, 4) if wire else None
    desk = folder / "desk"
    desk.mkdir()
    at_desk = workflow(desk, ports, ports + (6 if wire else 1))
    at_desk.rename(desk / robot.name)
    processes = [
        start(robot, seconds, "--part", "robot", "--record", str(folder / "robot.mcap")),
        start(desk / robot.name, seconds + 60.0, "--part", "workstation", *WITH_DATA),
        put_on(ports, seconds + 60.0, "--forward", "0.6"),
    ]
    try:
        yield processes[0], processes[1:], network
    finally:
        for process in processes:
            end(process)
        if network is not None:
            network.close()


class Seen:
    """What a recording tells of the hands.

    Args:
        path: of the recording.

    Attributes:
        now: time of each tick of the run in [s], shape (ticks,).
        engaged: whether the left hand had a target, shape (ticks,).
        rate: largest of the arms' targets from the tick before in [rad/s], shape (ticks,).
    """

    def __init__(self, path: Path) -> None:
        self._record = open_record(path)
        self._run = np.array([phase == "run" for phase in self._record.phases])
        self.now = 1e-9 * self.states("stamp_ns")
        self.engaged = np.isfinite(self.states("left_hand_target")).all(axis=1)
        arms = self.states("joint_pos_target")[:, 15:29]
        steps = np.abs(np.diff(arms, axis=0, prepend=arms[:1])).max(axis=1)
        self.rate = steps / np.diff(self.now, prepend=self.now[0] - 0.02)

    def states(self, name: str) -> NDArray[Any]:
        """Return a state of each tick of the run."""
        return np.asarray(self._record.states(name))[self._run]

    def errors(self) -> NDArray[np.float64]:
        """Return how far each hand is from where it is wanted then in [m], both in a row."""
        found = []
        for side in SIDES:
            age = self.now - 1e-9 * self.states(f"{side}_target_stamp_ns")
            target, velocity = (self.states(f"{side}_{w}") for w in ("target", "target_velocity"))
            wanted = target[:, :3] + velocity[:, :3] * age[:, None]
            far = np.linalg.norm(self.states(f"{side}_pose")[:, :3] - wanted, axis=1)
            began = int(np.flatnonzero(self.engaged)[0]) + 100  # circles have their size by then
            found.append(far[began:][self.engaged[began:]])
        return np.concatenate(found)

    def latency(self) -> float:
        """Return how old the headset's frames are in the median, in [s]."""
        return float(np.median(self.states("teleop_latency")[self.engaged]))

    def ages(self) -> NDArray[np.float64]:
        """Return how old what came from the workstation is, in [s]; without the headset's age."""
        stamp = 1e-9 * self.states("left_hand_target_stamp_ns")
        age = self.now - stamp - self.states("teleop_latency")
        return age[self.engaged]


def wait(seconds: float) -> None:
    """Let time go by."""
    time.sleep(seconds)
