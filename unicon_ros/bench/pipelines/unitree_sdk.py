"""Process of a controller on the official unitree_sdk2_python, as its own examples are written.

It runs where the SDK runs, by its path, and imports nothing of ours. `--variant` is kind of message
and way: `go:sync` reads, computes and writes in one loop; `go:async` has a callback that keeps the
newest state, and a RecurrentThread that writes.
"""

import argparse
import os
import signal
import threading
import time
from importlib import import_module
from typing import Any

import numpy as np
from unitree_sdk2py.core.channel import (
    ChannelFactoryInitialize,
    ChannelPublisher,
    ChannelSubscriber,
)
from unitree_sdk2py.utils.crc import CRC
from unitree_sdk2py.utils.thread import RecurrentThread

WEAK, STRONG = 0x01, 0x0A
"""Modes of H1's motors (example/h1/low_level/h1_low_level_example.py)."""
ENABLED = 1
"""Mode of G1's motors (example/g1/low_level/g1_low_level_example.py)."""
H1_WEAK = (10, 11, *range(12, 20))
MOTORS = {"go": 20, "hg": 29}


class Controller:
    """Identity control: what is measured is commanded."""

    def __init__(self, kind: str, domain: int) -> None:
        default = import_module("unitree_sdk2py.idl.default")
        messages = import_module(f"unitree_sdk2py.idl.unitree_{kind}.msg.dds_")
        ChannelFactoryInitialize(domain, "lo")
        self.kind, self.count, self.crc = kind, MOTORS[kind], CRC()
        self.command = getattr(default, f"unitree_{kind}_msg_dds__LowCmd_")()
        modes = [ENABLED] * self.count
        if kind == "go":
            self.command.head[0], self.command.head[1] = 0xFE, 0xEF
            self.command.level_flag = 0xFF
            modes = [WEAK if k in H1_WEAK else STRONG for k in range(self.count)]
        for k, mode in enumerate(modes):
            self.command.motor_cmd[k].mode = mode
        self.publisher = ChannelPublisher("rt/lowcmd", messages.LowCmd_)
        self.publisher.Init()
        self.subscriber = ChannelSubscriber("rt/lowstate", messages.LowState_)
        self.position, self.velocity, self.effort = (np.zeros(self.count) for _ in range(3))
        self.quat, self.rate = np.zeros(4), np.zeros(3)
        self.rows: list[tuple[int, ...]] = []
        self.last = 0

    def parse(self, state: Any) -> int:
        """Bring a state into arrays, as a policy wants it; return when it was made, in [ns]."""
        for k in range(self.count):
            motor = state.motor_state[k]
            self.position[k], self.velocity[k] = motor.q, motor.dq
            self.effort[k] = motor.tau_est
        self.quat[:], self.rate[:] = state.imu_state.quaternion, state.imu_state.gyroscope
        if self.kind == "hg":
            self.command.mode_machine = state.mode_machine
        return int.from_bytes(bytes(state.wireless_remote[:8]), "little")

    def write(self) -> None:
        """Fill the command, and send it."""
        for k in range(self.count):
            motor = self.command.motor_cmd[k]
            motor.tau, motor.q, motor.dq = 0.0, float(self.position[k]), 0.0
            motor.kp, motor.kd = 0.0, 0.0
        self.command.crc = self.crc.Crc(self.command)
        self.publisher.Write(self.command)

    def cycle(self, state: Any, before: int = 0) -> None:
        """Answer a state, and note when what was done.

        Args:
            before: when the state was asked for, in [ns]; 0 where a callback brought it.
        """
        stamp = self.parse(state)
        seen = time.time_ns()
        self.write()
        end = time.time_ns()
        cost = end - before if before and stamp != self.last else -1
        self.rows.append((stamp, seen, seen, end, cost))
        self.last = stamp


def sync(controller: Controller, period: float, stop: threading.Event) -> None:
    """Read, compute and write in this thread, at a rate."""
    controller.subscriber.Init()
    due = time.perf_counter()
    while not stop.is_set():
        due = max(due + period, time.perf_counter())
        time.sleep(max(0.0, due - time.perf_counter()))
        before = time.time_ns()
        state = controller.subscriber.Read(1.0)
        if state is not None:
            controller.cycle(state, before)


def asynchronous(controller: Controller, period: float, stop: threading.Event) -> None:
    """Keep the newest state in a callback, and write in a thread of the SDK."""
    newest: list[Any] = []

    def heard(state: Any) -> None:
        newest[:] = [state]

    def control() -> None:
        if newest and not stop.is_set():
            controller.cycle(newest[0])

    controller.subscriber.Init(heard, 10)
    RecurrentThread(interval=period, target=control, name="control").Start()
    while not stop.is_set():
        stop.wait(0.1)
    time.sleep(2 * period)


def main() -> None:
    """Run until SIGTERM."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rate", type=float, required=True)
    parser.add_argument("--variant", required=True)
    parser.add_argument("--out", required=True)
    options, _ = parser.parse_known_args()
    kind, _, way = options.variant.partition(":")
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    controller = Controller(kind, int(os.environ["ROS_DOMAIN_ID"]))
    {"sync": sync, "async": asynchronous}[way](controller, 1.0 / options.rate, stop)
    rows = np.array(controller.rows, np.int64).reshape(-1, 5)
    columns: dict[str, Any] = dict(zip(("stamp", "seen", "begin", "end", "cost"), rows.T))
    np.savez(options.out + ".partial.npz", **columns)
    os.replace(options.out + ".partial.npz", options.out)
    os._exit(0)  # the SDK's thread does not end


if __name__ == "__main__":
    main()
