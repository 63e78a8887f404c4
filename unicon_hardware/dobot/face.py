"""Face of an Atom: both states, both commands, its state machine's number and the arms' switch.

Not emulated, as it is not public: what its state machine does, and what the robot does when
commands stop.
"""

from __future__ import annotations

import numpy as np

from unicon_base.arrays import Array
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.dds.face import DdsEndpoint
from unicon_hardware.dobot.codec import DobotFacts, own_arrays
from unicon_hardware.dobot.platform import EXTRA
from unicon_hardware.torso import IMU_STATES, turned
from unicon_hardware.wire import Counts


class DobotEndpoint(DdsEndpoint):
    """What a driver sees of an emulated Atom.

    Args:
        states: of the emulator.
        robot: its file.
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.
        layout: of UpperState, `sdk` or `ros2`.
        acts_in: state of its state machine in which joint commands act; it begins in 0.

    Attributes:
        obeys: its state machine is where joint commands act, and the arms are switched over.
        own: what it tells besides states: `fsm_id`, `upper_control` and `remote`.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """

    label, extra, platform = "emulated dobot", EXTRA, "dobot"

    def __init__(
        self,
        states: States,
        robot: Robot,
        *,
        address: str | None = "127.0.0.1",
        domain: int | None = None,
        layout: str = "sdk",
        acts_in: int = 2,
    ) -> None:
        facts = DobotFacts.of(robot, layout)
        self.own, self._acts_in = own_arrays(), acts_in
        self._imu = {name: np.array(states[name]) for name in IMU_STATES}
        self._asked: dict[str, Array] = {
            "id": np.zeros((), np.uint16),
            "flag": np.zeros((), np.uint8),
        }
        self._came = (False, False)
        heard = {"modes": np.zeros(robot.num_joints, np.uint8)}
        super().__init__(states, robot, facts, domain, address, self.own | self._imu, heard)

    def _open(self) -> None:
        facts = self._facts
        for half in (facts.lower, facts.upper):
            self.speak(half.state, self._arrays)
            self.listen(half.command, self._heard, anyone=True)
        for message in (facts.fsm, facts.switch):
            self.listen(message, message.frames(self._asked, Counts()), anyone=True)

    @property
    def reach(self) -> dict[str, object]:
        """See `Face`."""
        return {**super().reach, "layout": self._facts.layout, "fsm_id": self._acts_in}

    @property
    def obeys(self) -> bool:
        """Whether commands act."""
        return int(self.own["fsm_id"]) == self._acts_in and bool(self.own["upper_control"])

    def tell(self) -> None:
        """Send what the robot measures."""
        states, waist = self._states, self._facts.waist
        angle, rate = (-float(states[name][waist]) for name in ("joint_pos", "joint_vel"))
        turned({name: states[name] for name in IMU_STATES}, self._imu, angle, rate)
        self.put()

    def hear(self) -> bool:
        """Answer requests, and bring the newest good commands into the command states."""
        lower, upper, fsm, switch = self._inlets
        if fsm.take():
            self.own["fsm_id"][...] = self._asked["id"]
        if switch.take():
            self.own["upper_control"][...] = self._asked["flag"]
        lower_came, upper_came = lower.take(), upper.take()
        self._came = self._came[0] or bool(lower_came), self._came[1] or bool(upper_came)
        if not lower_came + upper_came or not all(self._came) or not self._acts():
            return False
        self._act()
        return True

    def _acts(self) -> bool:
        if not self.obeys:
            self.counts.refuse("its own controller commands", f"state {int(self.own['fsm_id'])}")
            return False
        return self._right("motor mode", self._heard["modes"], self._facts.mode)


face = DobotEndpoint
