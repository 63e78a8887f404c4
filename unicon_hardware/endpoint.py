"""Endpoint: what an emulated robot looks like on the wire, one for each vendor's protocol.

A driver's `Wire` and a vendor's `Endpoint` are two ends of one protocol; both take their facts from
the robot file. The emulator behind an endpoint holds the states of its own simulator, the standard
ones and those of hardware: `tell` reads what a robot measures, and `hear` writes the command
states. What all robots do alike is the emulator's (`emulate/emulator.py`): command timeout,
commands that are not finite, its own controller before `obeys`.

    def face(states: States, robot: Robot, *, address: str = "127.0.0.1", …) -> MyEndpoint: ...

Such a factory is named `module:face`, or registered under its protocol in the entry point group
`unicon.faces`.
"""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import Any

from unicon_base import AnyMapping
from unicon_base.arrays import UInt8
from unicon_core.states import States


class Endpoint:
    """The robot's end of a protocol, on loopback; it is called at `rate` and never waits.

    Attributes:
        rate: of its frames in [Hz].
        dead_man: the vendor's robot damps by itself after so long without a command, in [s]; of one
            that is not known to do so, infinity.
        obeys: commands act now; until its own controller has let go they do not.
        where: for the user, such as "127.0.0.1:8007".
        platform: drives it; "" where no command of a run reaches it.
        reach: options of that platform which lead here.
        modes: of the motors, where they report one.
        now: of the frame in [s], the robot's own time, which goes on where frames are left out;
            before the emulator sets it, frames are counted.
    """

    rate: Any
    dead_man: Any = math.inf
    obeys: Any = True
    where: Any = ""
    platform = ""
    reach: Any = MappingProxyType({})
    now = math.nan

    def tell(self) -> None:
        """Send what the robot measures."""
        raise NotImplementedError

    def hear(self) -> bool:
        """Bring the newest good command into the command states; True where one came.

        A bad one (length, checksum, mode) is left, as the vendor's robot does.
        """
        raise NotImplementedError

    def close(self) -> None:
        """Let go of sockets."""
        raise NotImplementedError


class EmulatedModes:
    """Modes of emulated motors: the commanded ones, except of motors that were let leave theirs.

    Args:
        reported: what the emulated robot reports, shape (n,); this writes it.
    """

    def __init__(self, reported: UInt8) -> None:
        self.reported = reported
        self._away: dict[int, int] = {}

    def leave(self, joint: int, mode: int = 0) -> None:
        """Let a motor be in another mode from now on, whatever is commanded."""
        self._away[joint] = self.reported[joint] = mode

    def command(self, modes: UInt8, states: States | AnyMapping) -> None:
        """Go into the commanded modes; a motor that is away has neither stiffness nor torque.

        Args:
            modes: that are commanded, shape (n,).
            states: of the emulated robot, with the command in them.
        """
        self.reported[...] = modes
        for joint, mode in self._away.items():
            self.reported[joint] = mode
            for name in ("joint_stiffness", "joint_effort_ff", "joint_damping"):
                states[name][joint] = 0.0


class Milliseconds:
    """The clock of an emulated robot: of 1 ms, and newer with each frame.

    Args:
        period: of its frames, [ms].

    Attributes:
        count: of the last frame, [ms].
    """

    def __init__(self, period: float) -> None:
        self._period, self.count, self._began = period, 0.0, math.nan

    def __call__(self, now: float) -> int:
        """Return the count of the next frame, 32 bits.

        Args:
            now: its time in [s]; where it is NaN frames are counted.
        """
        if math.isnan(now):
            self.count += self._period
        else:
            if math.isnan(self._began):
                self._began = now - self.count * 1e-3
            self.count = max(self.count + 1.0, (now - self._began) * 1e3)
        return round(self.count) % (1 << 32)
