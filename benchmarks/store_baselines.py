"""Other people's ways of the comparison of stores: rclpy, raw and plain, and iceoryx2.

Written as a good engineer would: a lean message of bytes (UInt8MultiArray), reused, keep-last-1, an
executor with a callback. iceoryx2 wakes its reader by an event and drains to the newest sample.
"""

from __future__ import annotations

import ctypes
import time
from array import array
from contextlib import suppress
from pathlib import Path
from typing import Any

from unicon_core.states import States

_CDR = bytes([0, 1, 0, 0]) + bytes(8)  # encapsulation, no dimensions, data_offset 0


class _RosNode:
    def __init__(self, name: str) -> None:
        import rclpy

        self._rclpy = rclpy
        rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        self.node = rclpy.node.Node(name)

    def close(self) -> None:
        """Let go."""
        self.node.destroy_node()
        self._rclpy.try_shutdown()


class RosSender(_RosNode):
    """Publishes the bytes, in a message or (raw) serialized by hand."""

    def __init__(self, place: Path, states: States, raw: bool) -> None:
        from std_msgs.msg import UInt8MultiArray

        from unicon_ros.bench.pipelines.plain_nodes import qos

        super().__init__("writer")
        self._send = self.node.create_publisher(UInt8MultiArray, "group", qos(False)).publish
        self._data, self._raw, self._message = states.buffer.data, raw, UInt8MultiArray()
        self._head = _CDR + len(self._data).to_bytes(4, "little")

    def publish(self) -> None:
        """Send the states as they are."""
        if self._raw:
            self._send(self._head + self._data)
        else:
            self._message.data = array("B", self._data)
            self._send(self._message)


class RosReceiver(_RosNode):
    """Receives in the callback of a single-threaded executor."""

    starved = 0

    def __init__(self, place: Path, states: States, raw: bool) -> None:
        from rclpy.executors import SingleThreadedExecutor
        from std_msgs.msg import UInt8MultiArray

        from unicon_ros.bench.pipelines.plain_nodes import qos

        super().__init__("reader")
        self._data, self._come = states.buffer.data, False
        start = len(_CDR) + 4

        def on_bytes(message: bytes) -> None:
            self._data[:] = message[start : start + len(self._data)]
            self._come = True

        def on_message(message: Any) -> None:
            self._data[:] = message.data
            self._come = True

        callback: Any = on_bytes if raw else on_message
        self.node.create_subscription(UInt8MultiArray, "group", callback, qos(False), raw=raw)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def receive(self, timeout: float) -> bool:
        """Wait for a value; return whether one has come."""
        self._come = False
        self._executor.spin_once(timeout_sec=timeout)
        return self._come


class _Iceoryx:
    def __init__(self, place: Path, states: States) -> None:
        import iceoryx2

        iceoryx2.set_log_level(iceoryx2.LogLevel.Error)
        self.iceoryx2: Any = iceoryx2
        self.size = states.layout.nbytes
        self.address = states.buffer.ctypes.data

        class Group(ctypes.Structure):
            _fields_ = (("data", ctypes.c_uint8 * self.size),)

        builder = iceoryx2.NodeBuilder.new()
        builder = builder.signal_handling_mode(iceoryx2.SignalHandlingMode.Disabled)
        self._node = builder.create(iceoryx2.ServiceType.Ipc)
        name = iceoryx2.ServiceName.new(str(place))
        self.values = self._node.service_builder(name).publish_subscribe(Group).open_or_create()
        self.events = self._node.service_builder(name).event().open_or_create()
        self.ports: tuple[Any, ...] = ()

    def close(self) -> None:
        """Let go."""
        for port in self.ports:
            port.delete()


class IceoryxSender(_Iceoryx):
    """Loans a sample, fills it, sends it, and notifies."""

    def __init__(self, place: Path, states: States) -> None:
        super().__init__(place, states)
        self._publisher = self.values.publisher_builder().create()
        self._notifier = self.events.notifier_builder().create()
        self.ports = self._publisher, self._notifier

    def publish(self) -> None:
        """Send the states as they are."""
        sample = self._publisher.loan_uninit()
        ctypes.memmove(sample.payload_ptr, self.address, self.size)
        sample.assume_init().send()
        self._notifier.notify()


class IceoryxReceiver(_Iceoryx):
    """Waits for the event and drains to the newest sample."""

    starved = 0

    def __init__(self, place: Path, states: States) -> None:
        super().__init__(place, states)
        self._subscriber = self.values.subscriber_builder().create()
        self._listener = self.events.listener_builder().create()
        self.ports = self._subscriber, self._listener

    def receive(self, timeout: float) -> bool:
        """Wait for a value; return whether one has come."""
        end = time.monotonic() + timeout
        while True:
            newest = None
            while (sample := self._subscriber.receive()) is not None:
                newest = sample
            if newest is not None:
                ctypes.memmove(self.address, newest.payload_ptr, self.size)
                return True
            left = end - time.monotonic()
            if left <= 0.0:
                return False
            with suppress(self.iceoryx2.ListenerWaitError):  # a signal, such as SIGCONT
                self._listener.timed_wait(self.iceoryx2.Duration.from_secs_f64(left))
