"""A hand that is not there, on the other end of Modbus: registers served on loopback, for faces.

It never waits: `hear` answers what has come since, over TCP to several at once or over a pty.
"""

from __future__ import annotations

import os
import socket
import tty
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from unicon_core.states import States
from unicon_hardware.endpoint import Endpoint
from unicon_hardware.modbus.hand import HandRegisters
from unicon_hardware.modbus.link import (
    READ,
    WRITE,
    WRITE_ONE,
    Frame,
    Framing,
    Line,
    Refused,
    Rtu,
    Tcp,
    refusal,
)

MOST = 4
"""Clients at once, of a hand over TCP."""

Answer = Callable[[Frame], bytes | None]


class _Served(Line):
    """One client; over a pty it may come and go."""

    def __init__(self, file: int, framing: Framing) -> None:
        super().__init__(file, framing, answers=False)

    def serve(self, answer: Answer) -> bool:
        """Answer what has come; False once the client has gone."""
        try:
            if not self._readable(0.0):
                return True
            self._receive()
            while (frame := self._next()) is not None:
                told = answer(frame)
                if told is None:
                    continue
                data = self._framing.pack(frame._replace(pdu=told))
                if os.write(self._file, data) < len(data):
                    raise BlockingIOError  # the client takes nothing any more: nobody waits
        except Refused:  # as the vendor's: no answer
            self._data.clear()
        except OSError:  # of a pty: nobody has opened the other side
            return isinstance(self._framing, Rtu)
        return True


class TcpServer:
    """Listens on loopback.

    Args:
        port: 0 for any.

    Attributes:
        where: address and port.
        reach: options of a platform that lead here.
    """

    def __init__(self, port: int = 0) -> None:
        address = "127.0.0.1"
        self._listening = socket.create_server((address, port))
        self._listening.setblocking(False)
        self.port = int(self._listening.getsockname()[1])
        self.where = f"{address}:{self.port}"
        self.reach = {"address": address, "port": self.port}
        self._clients: list[tuple[socket.socket, _Served]] = []

    def serve(self, answer: Answer) -> None:
        """Take who comes, and answer everybody."""
        with suppress(BlockingIOError):
            while len(self._clients) < MOST:
                client, _ = self._listening.accept()
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._clients.append((client, _Served(client.fileno(), Tcp())))
        for pair in list(self._clients):
            if not pair[1].serve(answer):
                self._clients.remove(pair)
                pair[0].close()

    def close(self) -> None:
        """Let go."""
        for client, _ in self._clients:
            client.close()
        self._listening.close()


class PtyServer:
    """A serial line to nobody.

    Attributes:
        where: the device, to be opened by the driver.
        reach: options of a platform that lead here.
    """

    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.where = os.ttyname(self._slave)
        self.reach = {"device": self.where}
        self._served = _Served(self._master, Rtu())

    def serve(self, answer: Answer) -> None:
        """Answer what has come."""
        self._served.serve(answer)

    def close(self) -> None:
        """Let go."""
        os.close(self._slave)
        os.close(self._master)


class HandEndpoint(Endpoint):
    """The hand behind a server, which holds its last target for ever.

    Args:
        states: of its simulator.
        registers: as the driver has them.
        server: what it is reached through.
        platform: that drives it.
        extra: further registers and what they hold.

    Attributes:
        where: address and port, or the serial line's device.
        memory: all registers.
        known: which of them there are.
        cleared: how often errors were cleared.
    """

    rate = 500.0

    def __init__(
        self,
        states: States,
        registers: HandRegisters,
        server: TcpServer | PtyServer,
        platform: str,
        extra: dict[int, int] | None = None,
    ) -> None:
        self._states, self._registers, self.server = states, registers, server
        self.where, self.platform, self.reach = server.where, platform, server.reach
        self.memory = np.zeros(0x10000, np.uint16)
        self.known = np.zeros(0x10000, np.bool_)
        self._joints = len(registers.at_zero)
        blocks = [(registers.target, self._joints), (registers.angle, self._joints)]
        blocks += [(told.start, told.count(self._joints)) for told in registers.slow.values()]
        blocks += [(registers.clear[0], 1)] if registers.clear else []
        for start, count in blocks:
            self.known[start : start + count] = True
        for register, value in (extra or {}).items():
            self.memory[register], self.known[register] = value, True
        self.cleared = 0
        self._heard = False

    def tell(self) -> None:
        """Bring what the simulator measures into the registers."""
        raw, _ = self._registers.raw(self._states["joint_pos"])
        self.memory[self._registers.angle :][: self._joints] = raw
        for name, told in self._registers.slow.items():
            if name in self._states:
                values = np.asarray(self._states[name], np.int64)
                self.memory[told.start :][: told.count(self._joints)] = told.registers(values)
        self.server.serve(self._answer)

    def hear(self) -> bool:
        """Answer, and bring a target that came into the command states."""
        self.server.serve(self._answer)
        heard, self._heard = self._heard, False
        if heard:
            raw = self.memory[self._registers.target :][: self._joints].copy()
            keep = raw.view(np.int16) == -1  # leaves a finger as it is
            with suppress(Refused):
                wanted = self._registers.angles(np.where(keep, 0, raw).astype(np.uint16))
                np.copyto(self._states["joint_pos_target"], wanted, "same_kind", ~keep)
            self._states["joint_stiffness"][...] = 1.0
            self._states["joint_damping"][...] = 1.0
        return heard

    def close(self) -> None:
        """Let go."""
        self.server.close()

    def _answer(self, frame: Frame) -> bytes | None:
        pdu = frame.pdu
        if frame.unit != self._registers.unit or len(pdu) < 5:
            return None
        function, start = pdu[0], int.from_bytes(pdu[1:3], "big")
        count = 1 if function == WRITE_ONE else int.from_bytes(pdu[3:5], "big")
        if function not in (READ, WRITE, WRITE_ONE):
            return refusal(function, 1)
        if not 1 <= count <= 125 or not self.known[start : start + count].all():
            return refusal(function, 2)
        if function == READ:
            data = self.memory[start : start + count].astype(">u2").tobytes()
            return bytes((READ, len(data))) + data
        data = pdu[3:5] if function == WRITE_ONE else pdu[6:]
        if len(data) != 2 * count:
            return refusal(function, 3)
        self.memory[start : start + count] = np.frombuffer(data, ">u2")
        target = self._registers.target
        self._heard |= start < target + self._joints and target < start + count
        if self._registers.clear and start == self._registers.clear[0]:
            self.cleared += 1
            if "motor_error" in self._states:
                self._states["motor_error"][...] = 0
        return pdu[:5]
