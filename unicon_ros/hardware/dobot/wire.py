"""DobotWire: LowerState and UpperState in, LowerCmd and UpperCmd out, over DDS."""

from __future__ import annotations

import numpy as np

from unicon_core.blocks.controls.device import Controls
from unicon_core.blocks.controls.remotes import dobot
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.dds.end import DdsEnd
from unicon_ros.hardware.dobot.codec import DobotFacts, own_arrays
from unicon_ros.hardware.dobot.takeover import Takeover
from unicon_ros.hardware.modes import UNDOCUMENTED, ModeGuard
from unicon_ros.hardware.torso import IMU_STATES, turned

EXTRA = "hw-dobot"


class DobotWire(DdsEnd):
    """The connection to a robot; a frame is one of its legs with one of what is above them.

    Neither state has a number: a robot that repeats itself is not told from one that does not move.

    Args:
        states: what is measured goes into these, commands come from these.
        robot: its file.
        domain: of DDS; None for the robot file's.
        address: of this machine's network interface, or its name; None for the default.
        layout: of UpperState, `sdk` or `ros2`.
        fsm_id: state of the robot's own state machine in which joint commands act.
        silent: nothing is sent.

    Attributes:
        modes: of the motors; no public source says which values they report ("DDS接口整理.md" of
            Dobot-Arm/dobot_atom_ros2 names the field only).

    Raises:
        UniconError: it cannot be opened.
    """

    label, extra = "platform 'dobot'", EXTRA

    def __init__(
        self,
        states: States,
        robot: Robot,
        domain: int | None,
        address: str | None,
        *,
        layout: str,
        fsm_id: int,
        silent: bool = False,
    ) -> None:
        facts, own = DobotFacts.of(robot, layout), own_arrays()
        self._imu = {name: np.array(states[name]) for name in IMU_STATES}
        arrays = {name: states[name] for name in states} | own | self._imu
        self._states, self._waist, self._remote = states, facts.waist, own["remote"]
        self._controls = Controls(states) if "sticks" in states else None
        self.modes = ModeGuard(self.label, robot.joint_names, facts.mode, settles=UNDOCUMENTED)
        self.modes.reported = own["modes"]
        self._fresh = [0, 0]
        self._pairs = 0
        self._takeover: Takeover | None = None
        halves = (facts.lower, facts.upper)
        topics = " and ".join(half.state_topic for half in halves)
        super().__init__(topics, facts.domain, domain, address)
        with self.closing():
            for half in halves:
                self.listen(half.state, arrays)
                self.watch(half.command_topic)
            if not silent:
                for half in halves:
                    self.speak(half.command, arrays)
                told = own["fsm_id"], own["upper_control"]
                self._takeover = Takeover(self.participant, facts, told, fsm_id, self.label)

    def take(self) -> int:
        """Bring the newest good frames into the states; return how many pairs have come.

        Raises:
            Fault: the robot's own state machine has taken it back.
        """
        for half, inlet in enumerate(self._inlets):
            self._fresh[half] += inlet.take()
        number = min(self._fresh)
        if number:
            self._fresh = [0, 0]
            self._pairs += number
            self._measured()
        self.counts.good = self._pairs
        return number

    def _measured(self) -> None:
        states, waist = self._states, self._waist
        angle, rate = (float(states[name][waist]) for name in ("joint_pos", "joint_vel"))
        turned(self._imu, {name: states[name] for name in IMU_STATES}, angle, rate)
        if self._controls is not None:
            dobot(self._remote, self._controls)
        if self._takeover is not None:
            self._takeover.check()

    def prepare(self) -> str:
        """Let the robot's own state machine go; return what is waited for, "" at the end."""
        return "" if self._takeover is None else self._takeover()
