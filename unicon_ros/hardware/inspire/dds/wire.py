"""InspireDdsWire: angles of a hand in, targets out, over DDS."""

from __future__ import annotations

import time

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.dds.end import DdsEnd
from unicon_ros.hardware.inspire.dds.both import Both
from unicon_ros.hardware.inspire.dds.codec import HandFacts
from unicon_ros.hardware.speed import Speed
from unicon_ros.hardware.wire import Counts

EXTRA = "hw-inspire"
OVER = 0.05
"""Over which the speed is taken, [s]: a step of 1/1000 within 10 ms would be up to 0.17 rad/s."""


class InspireDdsWire(DdsEnd):
    """The connection to one hand.

    Neither interface has a number in its state: a hand that repeats itself is not told from one
    that does not move.

    Args:
        states: what is measured goes into these, commands come from these.
        robot: its file.
        domain: of DDS; None for the robot file's.
        address: of this machine's network interface, or its name; None for the default.
        silent: nothing is sent.

    Raises:
        UniconError: it cannot be opened.
    """

    label, extra = "platform 'inspire'", EXTRA

    def __init__(
        self,
        states: States,
        robot: Robot,
        domain: int | None,
        address: str | None,
        *,
        silent: bool = False,
    ) -> None:
        facts, counts = HandFacts.of(robot), Counts()
        self._facts, self._told, self._targets = facts, facts.zeros(), facts.zeros()
        self._both: Both | None = None
        self._states = states
        self._speed = Speed(OVER)
        arrays = {name: states[name] for name in states} | {"told": self._told}
        frames = facts.state_in(arrays, counts)
        super().__init__(facts.state_topic, facts.domain, domain, address, counts=counts)
        self._key = self.participant.domain, facts.command_topic
        with self.closing():
            self.listen(facts.state, frames)
            self.watch(facts.command_topic)
            if not silent:
                if facts.both:
                    self._both = Both.of(*self._key, len(self._told))
                    self._targets = self._both.targets
                self.speak(facts.command, {"targets": self._targets})

    def take(self) -> int:
        """Bring the newest good frame into the states; return how many good ones have come."""
        number = super().take()
        if number:
            angles = self._facts.to_angles(self._told[self._facts.slots])
            self._states["joint_vel"][...] = self._speed(time.monotonic_ns(), angles)
            self._states["joint_pos"][...] = angles
            if self._both is not None:
                self._both.found(self._told)
        return number

    def put(self) -> None:
        """Send the target positions; what is beyond open or closed is clamped.

        Raises:
            Fault: CycloneDDS refuses it.
        """
        sent, beyond = self._facts.to_wire(self._states["joint_pos_target"])
        self.counts.clamped += beyond
        self._targets[self._facts.slots] = sent
        super().put()

    def commanders(self) -> dict[str, int]:
        """Return the topic of commands, with the number of others that write there."""
        ours = 0 if self._both is None else self._both.users - 1  # the other hand's wire
        return {topic: max(number - ours, 0) for topic, number in super().commanders().items()}

    def close(self) -> None:
        """Leave the domain."""
        if self._both is not None:
            self._both.leave(*self._key)
            self._both = None
        super().close()
