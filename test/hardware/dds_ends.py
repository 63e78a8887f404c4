"""What tests of drivers over DDS share: both ends of a wire on one domain, in one process."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from stepping import stepping
from unitree_helpers import DOMAIN, LOOPBACK, PATIENCE, states_of, until

from unicon_core.robots import Robot
from unicon_core.states import States, standard_states
from unicon_core.states.standard import control_states, hardware_states

__all__ = ["DOMAIN", "LOOPBACK", "PATIENCE", "Ends", "golden_frame", "states_of", "until"]


def whole_states(robot: Robot) -> States:
    """Return the states of a robot with all of hardware and controls."""
    names = robot.joint_names
    return States(standard_states(names) | hardware_states(names) | control_states())


@contextmanager
def ticking(face: Any) -> Iterator[Event]:
    """Be the robot in a thread; the event that is given lets it fall silent."""
    mute = Event()

    def tick() -> None:
        if not mute.is_set():
            face.tell()
        face.hear()
        time.sleep(0.002)

    with stepping(tick, face.close):
        yield mute


def golden_frame(assets: Path, name: str) -> bytes:
    """Return a frame of a vendor's own library."""
    text = (assets / "frames" / f"dds_{name}.hex").read_text()
    return bytes.fromhex("".join(text.split()))


class Ends:
    """A robot's face and our wire.

    Args:
        robot: its file.
        wire: class of the wire.
        face: makes the robot's end.
        states: makes the states of each end.
        options: of the face.
    """

    def __init__(
        self,
        robot: Robot,
        wire: Any,
        face: Any,
        *,
        states: Callable[[Robot], States] = states_of,
        **options: Any,
    ) -> None:
        self.robot, self.theirs, self.ours = robot, states(robot), states(robot)
        self.face = face(self.theirs, robot, domain=DOMAIN, **options)
        self.wire = wire(self.ours, robot, DOMAIN, LOOPBACK)
        try:
            until(self.wire.take, self.face.tell)
            until(lambda: self.wire.matched)
        except BaseException:
            self.close()
            raise

    def told(self) -> int:
        """Let the robot tell once, and take it."""
        self.face.tell()
        assert self.wire.wait(PATIENCE)
        return int(self.wire.take())

    def sent(self, raw: bytes) -> int:
        """Let the robot's own writer send something else, and take it."""
        self.face._outlets[0][0].write(raw)
        assert self.wire.wait(PATIENCE)
        return int(self.wire.take())

    def heard(self) -> None:
        """Send a command, and let the robot take it."""
        self.wire.put()
        until(self.face.hear)

    def drawn(self, names: tuple[str, ...], seed: int) -> None:
        """Fill states of the robot's end with numbers."""
        rng = np.random.default_rng(seed)
        for name in names:
            self.theirs[name][...] = rng.normal(size=self.theirs[name].shape)

    def close(self) -> None:
        """Close both ends."""
        self.wire.close()
        self.face.close()
