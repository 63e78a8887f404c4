"""UnitreeWire: LowState in, LowCmd out, over DDS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.blocks.controls.device import Controls
from unicon_core.blocks.controls.remotes import unitree as held
from unicon_core.errors import Fault
from unicon_core.platforms.kit.base import Mounting
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import HARDWARE_STATES
from unicon_msgs_map import Decoder, Encoder
from unicon_ros.hardware.dds.frames import Frames
from unicon_ros.hardware.dds.inlet import Inlet, newer
from unicon_ros.hardware.dds.participant import Participant
from unicon_ros.hardware.torso import IMU_STATES, turned
from unicon_ros.hardware.unitree.facts import UnitreeFacts
from unicon_ros.hardware.unitree.maps import command_out, head_in, state_in
from unicon_ros.hardware.unitree.release import Release
from unicon_ros.hardware.wire import Counts

__all__ = ["LABEL", "UnitreeWire", "own_arrays"]

LABEL = "platform 'unitree'"
REMOTE = 40
"""Bytes of the wireless remote."""


def own_arrays(robot: Robot) -> dict[str, NDArray[Any]]:
    """Return the arrays of the messages that are no states, zero; for both ends of the wire."""
    n = robot.num_joints
    return {
        "tick": np.zeros((), np.uint32),
        "mode_machine": np.zeros((), np.uint8),
        "mode_pr": np.zeros((), np.uint8),
        "modes": np.zeros(n, np.uint8),
        "temperatures": np.zeros(2 * n, np.int16),
        "errors": np.zeros(n, np.uint32),
    }


class UnitreeWire:
    """The connection to a robot, or to what looks like one.

    Args:
        states: what is measured goes into these, commands come from these.
        robot: its file.
        facts: of the file.
        domain: of DDS.
        address: of this machine's network interface, or its name; None for the default.
        checked: LowState must have a right checksum and a new number.
        release: its own controller is asked to let go.
        silent: nothing is sent.

    Attributes:
        counts: of what came in.
        where: topic and domain.
        remote: the wireless remote's bytes, as they came last.
        variant: what the robot tells of itself, {} before its first frame.

    Raises:
        UniconError: it cannot be opened.
    """

    def __init__(
        self,
        states: States,
        robot: Robot,
        facts: UnitreeFacts,
        domain: int,
        address: str | None,
        *,
        checked: bool = True,
        release: bool = True,
        silent: bool = False,
    ) -> None:
        self.counts = Counts()
        self.where = f"{facts.state_topic} of DDS domain {domain}"
        self.remote = bytearray(REMOTE)
        self.variant: Mapping[str, Any] = {}
        self._facts, self._states, self._checked = facts, states, checked
        own = own_arrays(robot) | {"remote": np.frombuffer(self.remote, np.uint8)}
        arrays: dict[str, NDArray[Any]] = {name: states[name] for name in states} | own
        self._tick, self._mode = own["tick"], own["mode_machine"]
        self._imu: dict[str, NDArray[Any]] = {}
        self._mounting = Mounting.of(robot)
        if facts.waist is not None or self._mounting.turned:
            self._imu = {name: np.array(states[name]) for name in IMU_STATES}
            arrays |= self._imu
        self._hottest: NDArray[Any] | None = None
        self._errors: tuple[NDArray[Any], ...] = ()
        if not facts.go and "motor_error" in states:  # an int32, which is not 0 either
            self._errors = states["motor_error"], own["errors"].view(np.int32)
        if not facts.go and "motor_temperature" in states:
            self._hottest = states["motor_temperature"]
            self._pairs = own["temperatures"][0::2], own["temperatures"][1::2]
        told = arrays.keys() - {"tick", "mode_machine"}  # the head's
        if not checked:
            told -= set(HARDWARE_STATES)
        read = state_in(facts, told)
        self._frames = Frames(read, arrays, self.counts, checked=checked, orientation="base_quat")
        self._head = Decoder.build(head_in(facts), arrays)
        self._bytes = own["remote"]
        self._remote: NDArray[Any] | None = None
        if "wireless_remote" in states:
            self._remote = states["wireless_remote"]
        self._controls = Controls(states) if "sticks" in states else None
        self._encode = Encoder.build(command_out(facts), arrays).encode
        self._last = -1
        self.participant = Participant(domain, address, LABEL)
        try:
            self._reader = self.participant.reader(facts.state_topic, facts.message("LowState"))
            self._inlet = Inlet(
                self._reader, self._good, self._frames.read, self.counts, self.where, self._forget
            )
            self.participant.watch()
            self._writer = None
            self._release: Release | None = None
            if not silent:
                command = facts.message("LowCmd")
                self._writer = self.participant.writer(facts.command_topic, command)
                if release:
                    self._release = Release(self.participant, *facts.release, LABEL)
        except BaseException:
            self.participant.close()
            raise

    def take(self) -> int:
        """Bring the newest good frame into the states; return how many good ones have come.

        Raises:
            Fault: the robot's variant is another one than it was.
        """
        number = self._inlet.take()
        if number:
            self._measured()
        return number

    def _forget(self) -> None:
        self._last = -1

    def _good(self, raw: bytes) -> bool:
        return self._frames.good(raw) and self._new(raw)

    def _new(self, raw: bytes) -> bool:
        """Look at the number and the variant of a frame."""
        if not self._head.decode(raw):
            self.counts.refuse("impossible values", self._head.last_error)
            return False
        if self._checked:
            number = int(self._tick)
            if self._last >= 0 and not newer(number, self._last):
                self.counts.refuse("old tick", f"{number} behind {self._last}")
                return False
            self._last = number
        if not self._facts.go:
            told = {"protocol": self._facts.protocol, "mode_machine": int(self._mode)}
            if self.variant and told != self.variant:
                raise Fault(
                    f"{LABEL}: the robot's mode_machine is {told['mode_machine']}, and was "
                    f"{self.variant['mode_machine']}: it is another robot, or was configured anew; "
                    "choose its robot file"
                )
            self.variant = told
        else:
            self.variant = {"protocol": self._facts.protocol}
        return True

    def _measured(self) -> None:
        """Bring what the robot tells in another form into the states."""
        states, facts = self._states, self._facts
        if self._imu:
            imu, mounting = self._imu, self._mounting
            if mounting.turned:
                imu["base_quat"][...] = mounting.quat(imu["base_quat"])
                for name in ("base_ang_vel", "base_lin_acc"):
                    imu[name][...] = mounting.vector(imu[name])
            angle = rate = 0.0
            if facts.waist is not None:
                angle, rate = (float(states[n][facts.waist]) for n in ("joint_pos", "joint_vel"))
            turned(imu, {name: states[name] for name in IMU_STATES}, angle, rate)
        if self._hottest is not None:
            np.maximum(*self._pairs, out=self._hottest)
        if self._errors:
            self._errors[0][...] = self._errors[1]
        if self._remote is not None:
            self._remote[...] = self._bytes
        if self._controls is not None:
            held(self.remote, self._controls)

    def put(self) -> None:
        """Send the command states.

        Raises:
            Fault: CycloneDDS refuses it.
        """
        assert self._writer is not None
        self._writer.write(self._encode())

    def warm_up(self) -> None:
        """Do what `put` does up to the sending, and sum up the last frame once more."""
        self._frames.warm_up()
        self._encode()

    def prepare(self) -> str:
        """Let the robot's own controller let go; return what is waited for, "" at the end."""
        return "" if self._release is None else self._release()

    def commanders(self) -> dict[str, int]:
        """Return the topic of commands, with the number of others that write there."""
        topic = self._facts.command_topic
        return {topic: self.participant.others(topic)}

    def wait(self, timeout: float) -> bool:
        """Return True once a frame is there, False after `timeout` in [s]."""
        return self._reader.wait(timeout)

    def close(self) -> None:
        """Leave the domain."""
        self.participant.close()
