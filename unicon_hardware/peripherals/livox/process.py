"""The process of `livox`: listens to a Mid-360, tells it where to send, and gathers clouds."""

from __future__ import annotations

import errno
import select
import socket
import struct
import time
from contextlib import suppress

import numpy as np

from unicon_base import UniconError
from unicon_hardware.peripherals.livox import protocol
from unicon_hardware.peripherals.livox.cloud import ROW, Clouds, Counter, SensorClock, livox_message
from unicon_hardware.peripherals.livox.protocol import Packet, Refused
from unicon_ros.bridge.images import CLOUD
from unicon_ros.peripheral_process import SLICE, Feed, Gone, end, serve

COMMAND_PORT, POINT_PORT, IMU_PORT = 56100, 56300, 56400
"""Of the scanner."""

GRAVITY = 9.80665
"""What the scanner means by 1 g, [m/s²]."""

ANSWER = 0.25
"""Longest wait for an answer, and for the first points after it, in [s]."""

TELL_NS = 20_000_000
"""So often it is told that the scanner is heard, in [ns]."""

PAUSE = 0.002
"""Between two looks in [s]: to wake for each datagram costs twice as much of a core."""

BUFFER = 8 << 20
"""Asked for, in [B]; the kernel counts 2304 for a datagram, so it is 1.7 s of them."""
ENOUGH = 1 << 20
FORCE = 33
"""SO_RCVBUFFORCE (asm-generic/socket.h), for who may pass the kernel's limit."""

ONCE = 256
"""Datagrams that are taken in a row."""


class Livox:
    """The device.

    Args:
        feed: whose options name the scanner.
        topic: where its clouds are published; None for nowhere.

    Raises:
        UniconError: another program has the port.
        Gone: it does not answer, or does not send.
    """

    def __init__(self, feed: Feed, topic: Topic | None = None) -> None:
        self._feed, self._options, self._topic = feed, feed.options, topic
        self._lidar: str = self._options["lidar"]
        self._commands, self._sockets = _socket(), list[socket.socket]()
        self._number = 0
        self._imu_data = memoryview(bytearray(ROW))
        self._clock, self._points_count, self._imu_count = SensorClock(), Counter(), Counter()
        ring = feed.rings["cloud"]
        self._clouds = Clouds(ring, livox_message(self._options["frame_id"]))
        self._told_ns = self._latest_ns = self._heard_ns = self._refused = 0
        self._why: set[str] = set()
        self._vectors = np.zeros((2, 3), np.float32)
        try:
            host = self._host()
            for port in (self._options["point_port"], self._options["imu_port"]):
                self._sockets.append(_listening(host, port))
            if self._options["configure"]:
                self._configure(host)
            self._first()
        except BaseException:
            self.close()
            raise
        held = min(each.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) for each in self._sockets)
        if held < ENOUGH:
            feed.tell(
                f"{feed.name}: the kernel holds only {held >> 10} KiB of datagrams; a busy machine "
                f"loses some: sudo sysctl -w net.core.rmem_max={BUFFER}"
            )

    def _host(self) -> str:
        """Return this computer's address, the one on the way to the scanner if none is given."""
        try:
            self._commands.bind((self._options["host"], 0))
            self._commands.connect((self._lidar, COMMAND_PORT))
        except OSError as error:
            way = " from ".join(filter(None, (self._lidar, self._options["host"])))
            raise Gone(f"no way to {way}: {error.strerror}") from error
        return str(self._commands.getsockname()[0])

    def _configure(self, host: str) -> None:
        """Ask for points and IMU at our ports."""
        options = self._options
        wanted = {
            0x0000: bytes([options["data_type"]]),
            0x0006: protocol.target(host, options["point_port"], POINT_PORT),
            0x0007: protocol.target(host, options["imu_port"], IMU_PORT),
            0x001A: b"\1",  # sampling
            0x001C: b"\1",  # IMU too
        }
        answer = self._ask(protocol.CONFIGURE, protocol.configuration(wanted))
        if answer is None:
            raise Gone(f"{self._lidar} does not answer at port {COMMAND_PORT}")
        why = protocol.read_answer(answer)
        if why:
            raise Gone(f"{self._lidar} refuses its configuration: {why}")

    def _ask(self, what: int, data: bytes) -> bytes | None:
        """Return the answer to a command, None for none."""
        self._number += 1
        until = time.monotonic() + ANSWER
        with suppress(ConnectionRefusedError):  # nobody is at that port
            self._commands.send(protocol.command(self._number, what, data))
            while (left := until - time.monotonic()) > 0.0:
                if not select.select([self._commands], [], [], left)[0]:
                    break
                with suppress(Refused):
                    number, heard, way, answer = protocol.read_command(self._commands.recv(2048))
                    if (number, heard, way) == (self._number, what, protocol.ACK):
                        return answer
        return None

    def _first(self) -> None:
        """Wait for the first points."""
        until = time.monotonic() + ANSWER
        while time.monotonic() < until:
            if select.select(self._sockets[:1], [], [], SLICE)[0]:
                self._take_points()
                if self._clock.set:
                    return
        why = f"{self._lidar} sends no points to port {self._options['point_port']}"
        if self._refused:
            why += f" (refused: {', '.join(sorted(self._why))})"
        elif self._options["configure"]:
            answer = self._ask(protocol.INQUIRE, struct.pack("<HHH", 1, 0, 0x8006))
            with suppress(Refused):
                told = protocol.read_values(answer or b"").get(0x8006, b"\0")
                why += f"; its state: {protocol.STATES.get(told[0], 'unknown')}" if told else ""
        raise Gone(why)

    def poll(self) -> None:
        """Take what has come."""
        time.sleep(PAUSE)
        ready = select.select(self._sockets, [], [], SLICE)[0]
        news = bool(ready) and self._sockets[0] in ready and self._take_points()
        if ready and self._sockets[-1] in ready:
            news |= self._take_imu()
        if self._topic is not None:
            self._topic.look()
        now = time.monotonic_ns()
        if now - self._heard_ns > 1e9 * self._options["silence"]:
            self._clouds.finish(self._clock)
            raise Gone(f"{self._lidar} sends no points any more")
        if news or now - self._told_ns > TELL_NS:
            self._told_ns = now
            self._publish()

    def _publish(self) -> None:
        name = self._feed.name
        told = {
            f"{name}_ang_vel": self._vectors[0],
            f"{name}_lin_acc": self._vectors[1],
            f"{name}_lost": self._points_count.lost + self._imu_count.lost,
            f"{name}_refused": self._refused,
        }
        self._feed.publish(self._clock.at(self._latest_ns), **told)

    def _take_points(self) -> bool:
        """Take datagrams of points; True where a cloud has become ready."""
        ready = False
        for _ in range(ONCE):
            head = self._received(self._sockets[0], self._clouds.row, POINT_PORT)
            if head is None:
                break
            if head.points:
                self._points_count.hear(head.number)
                self._heard_ns = time.monotonic_ns()
                if self._clouds.take(head, self._clock):
                    ready = True
                    if self._topic is not None:
                        self._topic.publish(self._clouds.newest)
        return ready

    def _take_imu(self) -> bool:
        """Take datagrams of the IMU; True where there was one."""
        found = False
        for _ in range(ONCE):
            head = self._received(self._sockets[-1], self._imu_data, IMU_PORT)
            if head is None:
                break
            if head.points:
                self._imu_count.hear(head.number)
                values = protocol.read_imu(self._imu_data)
                self._vectors[:] = np.reshape(values, (2, 3))
                self._vectors[1] *= GRAVITY
                found = True
        return found

    def _received(self, from_: socket.socket, into: memoryview, port: int) -> Packet | None:
        """Return the head of the next datagram, one without points if refused, None for none."""
        try:
            size, sender = from_.recvfrom_into(into)
        except BlockingIOError:
            return None
        try:
            if sender != (self._lidar, port):
                raise Refused("foreign sender")
            data = into[:size]
            head = protocol.packet(data, self._options["checksum"])
            if (head.kind == protocol.IMU) != (port == IMU_PORT):
                raise Refused("unknown type")
            if port == IMU_PORT:
                protocol.read_imu(data)
            elif self._clock.set and 0 <= self._latest_ns - head.stamp_ns < SECOND:
                raise Refused("late")
        except Refused as why:
            self._refused += 1
            if str(why) not in self._why:
                self._why.add(str(why))
                self._feed.tell(f"{self._feed.name}: {_refusal(str(why), sender)}")
            return NOTHING
        if port == POINT_PORT:
            self._latest_ns = head.stamp_ns
            if not self._clock.hear(head.stamp_ns, time.monotonic_ns()):
                self._clouds.finish(self._clock)
                self._feed.tell(f"{self._feed.name}: the clock of {self._lidar} was set")
        return head

    def close(self) -> None:
        """Let go of the ports; the scanner goes on turning, as other programs may want it."""
        for each in (self._commands, *self._sockets):
            each.close()


class Topic:
    """The topic of the clouds, which stays while the scanner comes and goes.

    Args:
        feed: whose options name it.

    Raises:
        UniconError: its name or a ROS argument is wrong.
        MissingDependencyError: rclpy is not installed.
    """

    def __init__(self, feed: Feed) -> None:
        from unicon_ros.bridge.images import CameraTopics

        topics = CameraTopics(feed.options["ros"], feed.tell)
        self.publish = topics.add(feed.options["topic"], CLOUD)
        self.look, self.close = topics.look, topics.close


def main() -> int:
    """Run until the parent has gone."""
    topics = list[Topic]()

    def opened(feed: Feed) -> Livox:
        if feed.options["topic"] and not topics:
            topics.append(Topic(feed))
        return Livox(feed, *topics)

    try:
        return serve(opened)
    finally:
        for topic in topics:
            topic.close()


NOTHING = Packet(0, 0, 0, -1, 0, 0)
SECOND = 1_000_000_000


def _refusal(why: str, sender: tuple[str, int]) -> str:
    line = f"a datagram of {sender[0]}:{sender[1]} was refused: {why}; all such are counted"
    if why == "wrong checksum":
        line += ", and checksum: false takes them"
    return line


def _socket() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setblocking(False)
    return made


def _listening(host: str, port: int) -> socket.socket:
    made = _socket()
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
        with suppress(OSError):
            made.setsockopt(socket.SOL_SOCKET, FORCE, BUFFER)
        made.bind((host, port))
    except OSError as error:
        made.close()
        if error.errno == errno.EADDRINUSE:
            raise UniconError(
                f"livox: another program listens at {host}:{port}; end it, or give point_port and "
                "imu_port"
            ) from error
        raise Gone(f"cannot listen at {host}:{port}: {error.strerror}") from error
    return made


if __name__ == "__main__":
    end(main())
