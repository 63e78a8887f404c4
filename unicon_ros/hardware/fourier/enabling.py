"""Enabling: brings actuators from off to where they take commands, limp, step by step."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable

from unicon_core.errors import Fault
from unicon_ros.hardware.fourier.codec import (
    ACKNOWLEDGED_GAINS,
    ARM_DEAD_MAN,
    CLEAR_DEAD_MAN,
    ENABLE,
    PD_MODE,
)

__all__ = ["Enabling"]

AGAIN = 0.05
"""After so long without an answer a step is sent again, [s]."""
TRIES = 20


class Enabling:
    """Each step goes to all joints, and the next one follows when all have answered.

    Gains are zero before an actuator is enabled, so that it does not jump; the dead man is armed
    last, since the first command follows at once.

    Args:
        names: of the joints, each with its address.
        send: gives a joint a datagram.
        dead_man: after so long without a command an actuator leaves for `mode`, [s].
        mode: of operation.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        send: Callable[[int, bytes], None],
        dead_man: float,
        mode: int,
    ) -> None:
        self._names, self._send = names, send
        limit = round(1e3 * dead_man)
        self._steps: list[tuple[str, int, bytes]] = [
            # Of an earlier run: it would count on while nothing is commanded.
            ("disarm the dead man", ARM_DEAD_MAN, struct.pack(">IIIII", 0, limit, mode, 0, 0)),
            ("clear a time-out", CLEAR_DEAD_MAN, struct.pack(">I", 0)),
            ("no gains", ACKNOWLEDGED_GAINS, struct.pack(">ff", 0.0, 0.0)),
            ("PD mode", PD_MODE, b""),
            ("enable", ENABLE, b""),
            ("arm the dead man", ARM_DEAD_MAN, struct.pack(">IIIII", 1, limit, mode, 0, 0)),
        ]
        self._count, self._tries, self._sent = 0, 0, 0.0
        self._pending: set[int] = set()
        self.began = False

    @property
    def done(self) -> bool:
        """Whether all steps are."""
        return not self._steps

    def __call__(self) -> str:
        """Do what is due; return "" at the end, else what is waited for.

        Raises:
            Fault: a joint does not answer.
        """
        if self._steps and not self._pending:
            self._count, self._tries, self._sent = self._count + 1, 0, 0.0
            self._pending, self.began = set(range(len(self._names))), True
        if self._steps and time.monotonic() - self._sent > AGAIN:
            self._again()
        if not self._steps:
            return ""
        first = min(self._pending)
        return f"'{self._steps[0][0]}': {len(self._pending)} actuators, {self._names[first]} first"

    def _again(self) -> None:
        word, code, payload = self._steps[0]
        if self._tries >= TRIES:
            names = ", ".join(self._names[joint] for joint in sorted(self._pending)[:3])
            raise Fault(
                f"fourier: {word!r} (code {code:#x}) was not answered by {names}"
                f"{' and others' if len(self._pending) > 3 else ''}; switch the robot off and on"
            )
        self._tries, self._sent = self._tries + 1, time.monotonic()
        for joint in self._pending:
            self._send(joint, struct.pack(">BI", code, self._count) + payload)

    def answered(self, joint: int, code: int, count: int, result: int) -> None:
        """Take an answer.

        Raises:
            Fault: the actuator refuses.
        """
        if not self._steps or code != self._steps[0][1] or count != self._count:
            return  # of an earlier try
        if result != 0:
            raise Fault(
                f"fourier: {self._names[joint]} answers {result} to {self._steps[0][0]!r} (code "
                f"{code:#x}); 0 is taken for success"
            )
        self._pending.discard(joint)
        if not self._pending:
            del self._steps[0]
