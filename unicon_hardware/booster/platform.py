"""Platform `booster`: T1 over DDS, for workflows.

    platform: {child: booster}
    platforms:
      booster: {address: eth0}        # of this machine, towards the robot

Topics, domain and motor slots stand in the robot file. It needs the extra `hw-booster`, and nothing
of the vendor's.
"""

from __future__ import annotations

import time

import numpy as np

from unicon_base import Fault
from unicon_base.arrays import Array
from unicon_core.blocks.controls.device import REMOTES, Controls
from unicon_core.platforms.kit.base import IMU_STATES, Mounting, quat_of_rpy
from unicon_core.platforms.platform import Facts
from unicon_core.states.standard import COMMAND_STATES, CONTROL_STATES, JOINT_STATES
from unicon_hardware.booster.codec import BoosterFacts
from unicon_hardware.booster.takeover import Client, Takeover
from unicon_hardware.dds.end import DdsWire, factory_of
from unicon_hardware.dds.maps import HEADER, command_arrays
from unicon_hardware.dds.service import Inlet
from unicon_hardware.wire import Counts
from unicon_hardware.wired_robot import WiredRobot

LAST = 5
"""Times that the last words are sent, 2 ms apart."""


class BoosterWire(DdsWire):
    """The connection to a robot.

    LowState has no number: a robot that repeats itself is not distinguished from one that does not
    move.
    """

    label, extra, announced = "platform 'booster'", "hw-booster", True
    table = BoosterFacts

    def _built(self) -> None:
        states, robot = self._states, self._robot
        self._mounting = Mounting.of(robot)
        self._given = {name: states[name] for name in COMMAND_STATES}
        self._sent = command_arrays(robot.num_joints)
        self._arrays |= self._sent
        self._own["mode"][...] = -1
        self._was_custom = False
        self._effort = robot.effort_limit[self._facts.servo].astype(np.float32)
        self._held: dict[str, Array] | None = None
        self._put = False

    def _open(self) -> None:
        super()._open()
        facts, arrays, counts = self._facts, self._arrays, Counts()
        # A robot need not send any of these, and none of them counts as a sign of life.
        self._modes = self.inlet(facts.mode, self._own, counts)
        self._others: list[Inlet] = []
        if {"battery_charge", "battery_voltage"} <= set(arrays):
            self._others.append(self.inlet(facts.battery, arrays, counts))
        if self._controls is not None:
            remote, let_go = Remote(self._controls), self._controls.let_go
            self._others.append(self.inlet(facts.remote, remote, counts, forget=let_go))
        if not self._silent:
            self._client = Client(self.participant, facts.rpc_topic)
            self._takeover = Takeover(
                self._client, facts, lambda: self.matched, self._hold, self.label
            )

    def take(self) -> int:
        """Bring the newest good frame into the states; return how many good ones have come.

        Raises:
            Fault: the robot has left custom mode.
        """
        number = super().take()
        for inlet in self._others:
            inlet.take()
        self._modes.take()
        custom = bool(self._own["mode"] == self._facts.modes["custom"])
        self._was_custom |= custom
        # Before custom mode older messages may still be on their way.
        left = self._was_custom and not custom
        if left and self._takeover is not None and self._takeover.done:
            raise Fault(
                f"{self.label}: the robot has left custom mode (it is in {self.mode}): the "
                "remote or another program has taken it"
            )
        return number

    @property
    def mode(self) -> str:
        """Name of the mode that the robot reported last, "-1" before."""
        return str(self._facts.mode_name(int(self._own["mode"])))

    def _measured(self) -> None:
        states, mounting = self._states, self._mounting
        states["base_quat"][...] = mounting.quat(quat_of_rpy(self._own["rpy"]))
        if mounting.turned:
            for name in ("base_ang_vel", "base_lin_acc"):
                states[name][...] = mounting.vector(states[name])

    def put(self) -> None:
        """Send the command states; the ankles' stiffness becomes a torque.

        tau = clip(kp (target - q) + tau_ff, ±effort), with kp 0 and the measured q for the motor,
        which adds the damping (BoosterRobotics/booster_gym deploy/deploy.py: _publish_cmd).

        Raises:
            Fault: CycloneDDS refuses it.
        """
        self._put = True
        self._send(self._given)

    def warm_up(self) -> None:
        """Do what `put` does up to the sending."""
        self._made(self._given)
        super().warm_up()

    def _send(self, commands: dict[str, Array]) -> None:
        self.counts.clamped += self._made(commands)
        super().put()

    def _made(self, commands: dict[str, Array]) -> bool:
        """Bring commands into what is sent; True where a torque was limited."""
        sent, servo = self._sent, self._facts.servo
        for name, values in commands.items():
            sent[name][...] = values
        measured = self._states["joint_pos"][servo]
        torque = sent["joint_stiffness"][servo] * (sent["joint_pos_target"][servo] - measured)
        torque += sent["joint_effort_ff"][servo]
        limited = np.clip(torque, -self._effort, self._effort)
        sent["joint_pos_target"][servo] = measured
        sent["joint_effort_ff"][servo] = limited
        sent["joint_stiffness"][servo] = 0.0
        return bool((limited != torque).any())

    def _hold(self) -> None:
        """Send a command that holds the posture of the first call."""
        if self._held is None:
            self._held = command_arrays(self._robot.num_joints)
            self._held["joint_pos_target"][...] = self._states["joint_pos"]
            self._held["joint_stiffness"][...] = self._robot.joint_stiffness
            self._held["joint_damping"][...] = self._robot.joint_damping
        self._send(self._held)

    def close(self) -> None:
        """Leave the robot in its own damping mode, where it was taken, and the domain."""
        try:
            if self._held is not None:
                self._let_go(self._held)
        finally:
            self._held = None
            super().close()

    def _let_go(self, held: dict[str, Array]) -> None:
        if not self._put:  # else the damping command has been sent
            held["joint_stiffness"][...] = 0.0
            for _ in range(LAST):
                self._send(held)
                time.sleep(0.002)
        self._client.ask(self._facts.requests["change_mode"], mode=self._facts.modes["damping"])
        time.sleep(0.002 * LAST)  # for it to leave this machine


class Remote:
    """Checks and reads the gamepad's message, for `Inlet`."""

    def __init__(self, controls: Controls) -> None:
        self._controls = controls
        self._size, self._taken = REMOTES["booster"]

    def good(self, raw: bytes) -> bool:
        """Return whether a message is whole."""
        return raw[:2] == HEADER and 0 <= len(raw) - len(HEADER) - 2 - self._size < 4

    def read(self, raw: bytes) -> bool:
        """Bring what is held into the controls."""
        self._taken(raw[4 : 4 + self._size], self._controls)
        return True


class Booster(WiredRobot):
    """A T1; build it with `make`."""

    facts = Facts(
        "booster",
        writes=(
            *JOINT_STATES,
            *IMU_STATES,
            "projected_gravity",
            "stamp_ns",
            "motor_temperature",
            "motor_error",
            "battery_charge",
            "battery_voltage",
            *CONTROL_STATES,
        ),
        protocols=("booster",),
    )


make = factory_of(Booster, BoosterWire)
