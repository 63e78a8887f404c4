"""StartGate: the contract of a gate; those that ask another's stop, and those on how things stand.

For runner, preflight and authors of gates. How things stand is the robot's variant,
who else commands it, and whether a command would move it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from unicon_base import AnyMapping, Fault
from unicon_base.arrays import Array
from unicon_core.robots import Robot
from unicon_core.text_table import figure


class StartGate(Protocol):
    """Asked once a tick before anything is sent, behind recv and estimate.

    Attributes:
        name: one word, for tables.
    """

    name: str

    def __call__(self) -> str:
        """Return "" where it holds, else one line: what is missing, and how to go on.

        Raises:
            Fault: waiting does not help; the run is refused.
        """
        ...


class Heeding:
    """A gate that asks a stop of the safety stage: what would trip it then must not start.

    Args:
        name: of the gate.
        about: what it looks at, in a few words.
        stop: raises a Fault.
        remedy: ends the line.
        reset: makes the stop fresh once it has tripped, or None.
        lasting: so many ticks the reason stays: a stop that was made fresh counts anew before it
            trips again.
    """

    def __init__(
        self,
        name: str,
        about: str,
        stop: Callable[[], object],
        remedy: str,
        reset: Callable[[], object] | None = None,
        lasting: int = 0,
    ) -> None:
        self.name, self.about = name, about
        self._stop, self._remedy, self._reset = stop, remedy, reset
        self._lasting, self._left, self._reason = lasting, 0, ""

    def __call__(self) -> str:
        """Return what the stop raised, with the remedy."""
        try:
            self._stop()
        except Fault as fault:
            if self._reset is not None:
                self._reset()
            self._reason, self._left = f"{fault}; {self._remedy}", self._lasting
            return self._reason
        self._left = max(self._left - 1, 0)
        return self._reason if self._left else ""


class Passing:
    """A gate of a simulator: it is shown and holds.

    Attributes:
        gate: what a robot would be asked.
    """

    def __init__(self, gate: StartGate) -> None:
        self.gate, self.name = gate, gate.name
        self.about = f"{getattr(gate, 'about', '')} (passes by itself in a simulator)"

    def __call__(self) -> str:
        """Hold."""
        return ""


class Variant:
    """Gate `variant`: the robot says of itself what the robot file says of it.

    Args:
        told: what the robot reports, as of `ReportsVariant`.
        robot: the robot file.
    """

    name = "variant"

    def __init__(self, told: Callable[[], AnyMapping], robot: Robot) -> None:
        self._told, self._robot = told, robot
        self.about = f"what the robot reports of itself is what {robot.path.name} says"

    def __call__(self) -> str:
        """Compare.

        Raises:
            Fault: it is another variant.
        """
        told = self._told()
        if not told:
            return "the robot has not reported its variant yet; see whether its driver is on"
        for key, value in told.items():
            expected = self._robot.transport.get(key)
            if expected is not None and value != expected:
                raise Fault(
                    f"the robot reports {key} {value!r}, and {self._robot.path.name} is of "
                    f"{key} {expected!r}: limits, gains and joints may be others; choose the "
                    "robot file of this variant"
                )
        return ""


class SoleCommander:
    """Gate `commanders`: nobody else sends where the robot takes its commands.

    Args:
        commanders: where that is, and how many others send there, as of `SeesCommanders`.
    """

    name = "commanders"

    def __init__(self, commanders: Callable[[], Mapping[str, int]]) -> None:
        self._commanders = commanders
        self.about = f"nobody else sends to {', '.join(commanders())}"

    def __call__(self) -> str:
        """Count them."""
        for where, count in self._commanders().items():
            if count:
                return f"{count} others send to {where}; end them, one alone may command a robot"
        return ""


class NoCommand:
    """Gate `command`: the velocity command is zero.

    Args:
        command: vx, vy [m/s] and wz [rad/s], shape (..., 3).
    """

    name = "command"
    about = "velocity_command is zero"

    def __init__(self, command: Array) -> None:
        self._command = command

    def __call__(self) -> str:
        """Look."""
        if not self._command.any():
            return ""
        vx, vy, wz = (figure(v, ".3g") for v in self._command.reshape(-1, 3)[0])
        return (
            f"velocity_command is vx {vx} m/s, vy {vy} m/s, wz {wz} rad/s, and a robot "
            "begins at zero; let go of the stick, or stop its publisher"
        )
