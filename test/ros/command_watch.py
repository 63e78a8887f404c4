"""Listens beside a robot to what it is commanded, for tests that go on when it is killed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from sensor_msgs.msg import JointState


@dataclass(frozen=True)
class Heard:
    """A command.

    Attributes:
        at: when it was heard, on the clock of `time.monotonic`, [s].
        target: of the joints in [rad], shape (n,).
    """

    at: float
    target: NDArray[np.float64]


class CommandWatch:
    """Subscribes to `joint_commands`, in a thread and a ROS context of its own.

    Args:
        joints: names, in the order of what is kept.

    Attributes:
        commands: all that were heard.
        stiffness: largest of each message of `joint_gains`, with its time.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        self._names = list(joints)
        self.commands: list[Heard] = []
        self.stiffness: list[tuple[float, float]] = []
        self._context = rclpy.Context()
        self._context.init()
        self._node: Any = rclpy.create_node("command_watch", context=self._context)
        topics: dict[str, Callable[[Any], None]] = {
            "joint_commands": self._commanded,
            "joint_gains": self._gained,
        }
        for topic, callback in topics.items():
            self._node.create_subscription(JointState, topic, callback, 100)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            self._executor.spin()

    def _commanded(self, message: Any) -> None:
        told = dict(zip(message.name, message.position))
        target = np.array([told[name] for name in self._names])
        self.commands.append(Heard(time.monotonic(), target))

    def _gained(self, message: Any) -> None:
        self.stiffness.append((time.monotonic(), max(message.effort)))

    def first(self, since: float, holds: Callable[[Heard], bool], timeout: float) -> float:
        """Return when the first command came for which something holds, from a time on.

        Args:
            since: on the clock of `time.monotonic`, [s].
            holds: looks at a command.
            timeout: in [s] from `since` on.

        Returns:
            Time since `since` in [s]; NaN where none came in time.
        """
        index = len(self.commands)
        while index and self.commands[index - 1].at >= since:
            index -= 1
        while time.monotonic() < since + timeout:
            while index < len(self.commands):
                command = self.commands[index]
                if holds(command):
                    return command.at - since
                index += 1
            time.sleep(0.01)
        return float("nan")

    def close(self) -> None:
        """End thread and node."""
        self._executor.shutdown()
        self._thread.join(10.0)
        self._node.destroy_node()
        self._context.try_shutdown()
