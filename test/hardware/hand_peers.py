"""Peers of hands for tests: a face that is pumped, and pymodbus as hand and as client."""

from __future__ import annotations

import asyncio
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from unicon_core.robots import Robot, load_robot
from unicon_core.states import States, standard_states
from unicon_core.states.standard import hardware_states
from unicon_hardware.modbus.served import HandEndpoint


def hand_states(robot: Robot | str) -> States:
    """Return the states of a hand and of its hardware."""
    robot = load_robot(robot) if isinstance(robot, str) else robot
    return States(standard_states(robot.joint_names) | hardware_states(robot.joint_names))


class Pumped:
    """A face that is called as an emulator does, in a thread; `pause` lets it fall silent."""

    def __init__(self, face: HandEndpoint) -> None:
        self.face, self.heard, self.pause = face, 0, False
        self._ending = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ending:
            if not self.pause:
                self.face.tell()
                self.heard += self.face.hear()
            time.sleep(0.0005)

    def close(self) -> None:
        """End it."""
        self._ending = True
        self._thread.join(2.0)
        self.face.close()


@contextmanager
def pumped(face: HandEndpoint) -> Iterator[Pumped]:
    """Pump a face."""
    made = Pumped(face)
    try:
        yield made
    finally:
        made.close()


@contextmanager
def pymodbus_hand(blocks: dict[int, list[int]], unit: int, port: int | str) -> Iterator[Any]:
    """Serve registers with pymodbus; yield a list of (function, address, values) that were written.

    Args:
        blocks: first register to values.
        unit: of the device.
        port: of TCP on loopback, or a serial device.
    """
    from pymodbus.framer import FramerType
    from pymodbus.server import ModbusSerialServer, ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    written: list[Any] = []

    def note(sending: bool, pdu: Any) -> Any:
        if not sending and pdu.function_code in (6, 16):
            written.append((pdu.function_code, pdu.address, list(pdu.registers)))
        return pdu

    device = SimDevice(
        id=unit,
        simdata=[
            SimData(start, values=values, datatype=DataType.REGISTERS)
            for start, values in sorted(blocks.items())
        ],
    )
    loop = asyncio.new_event_loop()
    started = threading.Event()
    server: Any = None

    async def serve() -> None:
        nonlocal server
        if isinstance(port, int):
            server = ModbusTcpServer(device, address=("127.0.0.1", port), trace_pdu=note)
        else:
            server = ModbusSerialServer(
                device, port=port, baudrate=115200, framer=FramerType.RTU, trace_pdu=note
            )
        await server.serve_forever(background=True)
        started.set()
        with suppress(asyncio.CancelledError):
            await asyncio.Event().wait()

    def run() -> None:
        asyncio.set_event_loop(loop)
        with suppress(asyncio.CancelledError):
            loop.run_until_complete(serve())

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    assert started.wait(5.0)
    try:
        yield written
    finally:
        future = asyncio.run_coroutine_threadsafe(server.shutdown(), loop)
        with suppress(Exception):
            future.result(2.0)
        loop.call_soon_threadsafe(lambda: [task.cancel() for task in asyncio.all_tasks(loop)])
        thread.join(2.0)


def free_port() -> int:
    """Return a port that nobody listens at."""
    import socket

    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def until(condition: Any, seconds: float = 3.0) -> None:
    """Wait until something holds."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come true"
        time.sleep(0.002)


def pty_pair() -> tuple[int, int, str]:
    """Return two ends of a serial line, and the name of the second."""
    master, slave = os.openpty()
    return master, slave, os.ttyname(slave)
