"""Face: what an emulated robot looks like on the wire, one for each vendor's protocol.

A driver's `Wire` and a vendor's `Face` are two ends of one protocol; both take their facts from the
robot file. The emulator behind a face holds the states of its own simulator, the standard ones and
those of hardware: `tell` reads what a robot measures, and `hear` writes the command states. What
all robots do alike is the emulator's (`emulator.py`): dead man, commands that are not finite, its
own controller before `obeys`.

    def face(states: States, robot: Robot, *, address: str = "127.0.0.1", …) -> MyFace: ...

Such a factory is named `module:face`, or registered under its protocol in the entry point group
`unicon.faces`. An attribute `where`, such as "127.0.0.1:8007", is told to the user. With `modes`,
an `EmulatedModes`, a motor can be let leave the commanded mode. Attributes `platform`, which drives
it, and `reach`, the options of that platform which lead here, make the command of a run that
reaches it (`emulator.py`).
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable


@runtime_checkable
class Timed(Protocol):
    """A face whose frames tell the robot's own time, which goes on where frames are left out.

    Attributes:
        now: of the frame in [s]; before the emulator sets it, frames are counted.
    """

    now: float


class Face(Protocol):
    """The robot's end of a protocol, on loopback; it is called at `rate` and never waits.

    Attributes:
        rate: of its frames in [Hz].
        dead_man: the vendor's robot damps by itself after so long without a command, in [s]; of one
            that is not known to do so, infinity.
        obeys: commands act now; until its own controller has let go they do not.
    """

    rate: float
    dead_man: float
    obeys: bool

    def tell(self) -> None:
        """Send what the robot measures."""
        ...

    def hear(self) -> bool:
        """Bring the newest good command into the command states; True where one came.

        A bad one (length, checksum, mode) is left, as the vendor's robot does.
        """
        ...

    def close(self) -> None:
        """Let go of sockets."""
        ...
