"""Platform `dobot`: Atom over CycloneDDS, for workflows.

    platform: dobot
    platforms:
      dobot: {address: eth0, layout: sdk, fsm_id: 2}

What the vendor's sources contradict each other in, or do not say, must be said: `layout` of
UpperState, and `fsm_id`, in which joint commands act. It needs the extra `hw-dobot`.

Joint commands act in some states of the robot's own state machine only, whose numbers are not
public, and the arms must be switched over besides (Dobot-Arm/dobot_atom_ros2 "DDS接口整理.md").
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, Literal

import numpy as np

from unicon_base import Fault, PlatformError
from unicon_base.arrays import Array
from unicon_core.blocks.controls.device import dobot
from unicon_core.platforms.kit.base import IMU_STATES
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import CONTROL_STATES, JOINT_STATES
from unicon_hardware.dds.end import DdsWire
from unicon_hardware.dds.maps import Message
from unicon_hardware.dds.participant import Participant
from unicon_hardware.dds.service import Procedure
from unicon_hardware.dobot.codec import DobotFacts
from unicon_hardware.wire import turned
from unicon_hardware.wired_robot import SILENCE, WiredRobot, opened

AGAIN = 0.2
"""Between two requests, in [s]."""


class Takeover(Procedure):
    """Lets joint commands act, behind the operator's go.

    Args:
        participant: of the robot's domain.
        facts: of the robot file.
        told: `fsm_id` and `upper_control`, as the robot told them last.
        wanted: number of the state in which joint commands act.
        what: in front of messages.
    """

    def __init__(
        self,
        participant: Participant,
        facts: DobotFacts,
        told: tuple[Array, Array],
        wanted: int,
        what: str,
    ) -> None:
        super().__init__(what)
        self._fsm, self._arms = told
        self._wanted = wanted
        self._ask_fsm = _asking(participant, facts.fsm, wanted)
        self._ask_arms = _asking(participant, facts.switch, 1)

    def check(self) -> None:
        """Look whether the robot is still ours, once it was.

        Raises:
            Fault: it is not.
        """
        if not self.done:
            return
        if int(self._fsm) != self._wanted:
            raise Fault(
                f"{self._what}: the robot's own state machine is in {int(self._fsm)}, and no "
                f"longer in {self._wanted}: the remote or another program has taken the robot"
            )
        if not self._arms:
            raise Fault(f"{self._what}: the arms were switched back to the robot's own controller")

    def _procedure(self) -> Generator[str, None, None]:
        doing = f"its own state machine to go to {self._wanted}"
        yield from self._told(lambda: int(self._fsm) == self._wanted, self._ask_fsm, doing)
        yield from self._told(lambda: bool(self._arms), self._ask_arms, "the arms to be ours")

    def _told(
        self, reached: Callable[[], bool], ask: Callable[[], None], doing: str
    ) -> Generator[str, None, bool]:
        def otherwise() -> str:
            return (
                f"waited {self.timeout:g} s for {doing}; it is in {int(self._fsm)}: use the "
                "remote, and check the option fsm_id"
            )

        return self._until(reached, doing, otherwise, ask, AGAIN)


def _asking(participant: Participant, message: Message, value: int) -> Callable[[], None]:
    writer = participant.writer(message.topic, message.struct)
    wanted = np.array(value, np.uint16)
    raw = message.encoder(dict.fromkeys(message.fields, wanted)).encode()
    return lambda: writer.write(raw)


class DobotWire(DdsWire):
    """The connection to a robot; a frame is one of its legs with one of what is above them.

    Neither state has a number: a robot that repeats itself is not distinguished from one that does
    not move. No public source says which modes motors report ("DDS接口整理.md" of
    Dobot-Arm/dobot_atom_ros2 names the field only).

    Args:
        states: what is measured goes into these, commands come from these.
        robot: its file.
        domain: of DDS; None for the robot file's.
        address: of this machine's network interface, or its name; None for the default.
        layout: of UpperState, `sdk` or `ros2`.
        fsm_id: state of the robot's own state machine in which joint commands act.
        silent: nothing is sent.

    Raises:
        UniconError: it cannot be opened.
    """

    label, extra, table = "platform 'dobot'", "hw-dobot", DobotFacts
    _takeover: Takeover | None

    def __init__(self, *given: Any, fsm_id: int, **options: Any) -> None:
        self._fsm_id, self._fresh, self._pairs = fsm_id, [0, 0], 0
        super().__init__(*given, **options)

    def _built(self) -> None:
        self._imu = {name: np.array(self._states[name]) for name in IMU_STATES}
        self._arrays |= self._imu

    def _open(self) -> None:
        facts, own = self._facts, self._own
        for half in facts.halves:
            self.listen(half.state, self._arrays)
            self.watch(half.command_topic)
            if not self._silent:
                self.speak(half.command, self._arrays)
        if not self._silent:
            told = own["fsm_id"], own["upper_control"]
            self._takeover = Takeover(self.participant, facts, told, self._fsm_id, self.label)

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
        turned(self._imu, self._states, self._states, self._facts.waist)
        if self._controls is not None:
            dobot(self._own["remote"], self._controls)
        if self._takeover is not None:
            self._takeover.check()


LARGEST = 65535


class Dobot(WiredRobot):
    """An Atom; build it with `make`."""

    facts = Facts(
        "dobot",
        writes=(
            *JOINT_STATES,
            *IMU_STATES,
            "projected_gravity",
            "stamp_ns",
            "motor_temperature",
            "battery_charge",
            *CONTROL_STATES,
        ),
        protocols=("dobot_atom",),
    )


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    address: str | None = None,
    domain: int | None = None,
    layout: Literal["", "sdk", "ros2"] = "",
    fsm_id: int | None = None,
    connect: float = 5.0,
    silence: float = SILENCE,
    silent: bool = False,
) -> Dobot:
    """Build the platform and wait for the robot.

    Args:
        period: of a tick in [s].
        address: of this machine's network interface to the robot, or that interface's name;
            without it CYCLONEDDS_URI, or CycloneDDS itself, decides.
        domain: of DDS, instead of the robot file's.
        layout: of UpperState: `sdk` has no IMU in it, `ros2` has one.
        fsm_id: state of the robot's own state machine in which joint commands act; not public.
        connect: how long to wait for the first frames in [s].
        silence: of the robot that is a fault, in [s].
        silent: receive only: nothing is sent, at the end either.

    Raises:
        MissingDependencyError: cyclonedds is not installed.
        RobotError: the robot file lacks a fact.
        PlatformError: an option lacks, the network cannot be used, or no frame came in time.
    """
    if fsm_id is None and silent:
        fsm_id = 0
    if type(fsm_id) is not int or not 0 <= fsm_id <= LARGEST:
        raise PlatformError(
            f"platform 'dobot': fsm_id is {fsm_id}; give the number (0 to {LARGEST}) of the state "
            "of the robot's own state machine in which joint commands act; it is not public, ask "
            "Dobot"
        )
    wire = DobotWire(states, robot, domain, address, layout=layout, fsm_id=fsm_id, silent=silent)
    return opened(Dobot(states, robot, period, wire, silence=silence, silent=silent), connect)
