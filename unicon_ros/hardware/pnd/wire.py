"""PndWire: LowState in, LowCmd out, over DDS."""

from __future__ import annotations

import numpy as np

from unicon_core.blocks.controls.device import Controls
from unicon_core.blocks.controls.remotes import pnd
from unicon_core.platforms.kit.base import IMU_STATES, Mounting
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.dds.end import DdsEnd
from unicon_ros.hardware.dds.maps import arrays_of
from unicon_ros.hardware.modes import UNDOCUMENTED, ModeGuard
from unicon_ros.hardware.pnd.codec import REMOTE, STATES, LowStates, PndFacts
from unicon_ros.hardware.wire import Counts

EXTRA = "hw-pnd"


class PndWire(DdsEnd):
    """The connection to a robot, which tells one of the two LowStates: both are listened to.

    Args:
        states: what is measured goes into these, commands come from these.
        robot: its file.
        domain: of DDS; None for the robot file's.
        address: of this machine's network interface, or its name; None for the default.
        silent: nothing is sent.

    Attributes:
        modes: of the motors; no public source says which values they report.

    Raises:
        UniconError: it cannot be opened.
    """

    label, extra = "platform 'pnd'", EXTRA

    def __init__(
        self,
        states: States,
        robot: Robot,
        domain: int | None,
        address: str | None,
        *,
        silent: bool = False,
    ) -> None:
        facts, counts = PndFacts.of(robot), Counts()
        self._remote = np.zeros(REMOTE, np.float32)
        self.modes = ModeGuard(self.label, robot.joint_names, facts.mode, settles=UNDOCUMENTED)
        own = {"remote": self._remote, "tick": np.zeros((), np.uint32)}
        arrays = arrays_of(states) | own | {"modes": self.modes.reported}
        self._controls = Controls(states) if "sticks" in states else None
        self._mounting, self._imu = Mounting.of(robot), {name: states[name] for name in IMU_STATES}
        self._kinds = {
            battery: LowStates(facts, arrays, counts, battery=battery) for battery in STATES
        }
        super().__init__(facts.state_topic, facts.domain, domain, address, counts=counts)
        with self.closing():
            for battery, frames in self._kinds.items():
                self.listen(facts.told(battery=battery), frames, forget=frames.forget)
            self.watch(facts.command_topic)
            if not silent:
                self.speak(facts.command, arrays)

    def take(self) -> int:
        """Bring the newest good frame into the states; return how many good ones have come."""
        number = super().take()
        if number:
            self._choose()
            self._measured()
        return number

    def _choose(self) -> None:
        """Listen only to that kind of LowState that the robot tells."""
        if len(self._inlets) > 1:
            kept = next(k for k, frames in enumerate(self._kinds.values()) if frames.good_ones)
            self._inlets = [self._inlets[kept]]

    def _measured(self) -> None:
        if self._mounting.turned:
            self._mounting.turn(self._imu, self._imu)
        if self._controls is not None:
            pnd(self._remote, self._controls)
