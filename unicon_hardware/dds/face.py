"""DdsEndpoint: the robot's end of its topics, for faces of emulators."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from unicon_base.arrays import Array
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES, hardware_states
from unicon_hardware.dds.end import Checked, DdsEnd
from unicon_hardware.dds.maps import Arrays, arrays_of, command_arrays
from unicon_hardware.modes import EmulatedModes


class DdsEndpoint(DdsEnd):
    """The robot's end: it tells `facts.state`, and hears `facts.command`.

    Args:
        states: of the emulator; where those of hardware lack, what they begin with is told.
        robot: its file.
        facts: of its transport.
        domain: of DDS, instead of the robot file's.
        address: of this machine's network interface, or its name.
        own: what it tells besides states, by name; `modes` are those of its motors.
        heard: what commands say besides command states, by name.
        announced: see `Participant`.

    Attributes:
        rate: of its state in [Hz].
        modes: of the motors, where commands say theirs: those of the last one.
    """

    modes: EmulatedModes

    def __init__(
        self,
        states: States,
        robot: Robot,
        facts: Any,
        domain: int | None,
        address: str | None,
        own: Arrays,
        heard: Arrays,
        *,
        announced: bool = False,
    ) -> None:
        self.rate, self._facts, self._states = facts.rate, facts, states
        self._heard = {**command_arrays(robot.num_joints), **heard}
        if "modes" in own:
            self.modes = EmulatedModes(own["modes"])
        unless = States(hardware_states(robot.joint_names))
        self._arrays = {**arrays_of(unless), **arrays_of(states), **own}
        super().__init__(facts.command_topic, facts.domain, domain, address, announced=announced)
        with self.closing():
            self._open()

    @property
    def dead_man(self) -> float:
        """Infinity: what the robot does without commands is not public."""
        return math.inf

    @property
    def obeys(self) -> bool:
        """Whether commands act: always, where no program of its own must let go first."""
        return True

    def _open(self) -> None:
        """Begin to speak and to listen."""
        self.speak(self._facts.state, self._arrays)
        self._frames: Checked = self._facts.command_in(self._heard, self.counts)
        self.listen(self._facts.command, self, anyone=True)

    def hear(self) -> bool:
        """Bring the newest command that acts into the command states; True where one came."""
        return bool(self.take())

    def good(self, raw: bytes) -> bool:
        """Tell whether a command acts; count what does not."""
        return self._frames.good(raw) and self._frames.read(raw) and self._acts()

    def read(self, raw: bytes) -> bool:
        """Bring a command that acts into the command states."""
        read = self._frames.read(raw)
        if read:
            self._act()
        return read

    def _acts(self) -> bool:
        """Return whether a command acts; it is counted where it does not."""
        raise NotImplementedError

    def _act(self) -> None:
        """Bring the command that came into the command states."""
        for name in COMMAND_STATES:
            self._states[name][...] = self._heard[name]
        if "modes" in self._heard:
            self.modes.command(self._heard["modes"], self._states)

    def _right(self, reason: str, said: Array, wanted: ArrayLike) -> bool:
        """Return whether a command says what is wanted; it is counted where it does not."""
        right = bool((said == wanted).all())
        if not right:
            self.counts.refuse(reason, f"{said.tolist()}, not {np.unique(wanted).tolist()}")
        return right
