"""Enabling: brings actuators from off to where they take commands, limp, step by step."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from unicon_core.errors import Fault

AGAIN = 0.05
"""After so long without an answer a step is sent again, [s]."""
TRIES = 20


class Enabling:
    """Each step goes to all joints, and the next one follows when all have answered.

    Behind a step that had to be repeated it waits until late answers are in, which would be taken
    for those of the next one where they have no number.

    Args:
        names: of the joints, each with its address.
        steps: what each is called, and its datagram with a count of ours.
        send: gives a joint a datagram.

    Attributes:
        count: of the step that waits for answers; 0 before the first one.
        began: whether anything has been sent.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        steps: Sequence[tuple[str, Callable[[int], bytes]]],
        send: Callable[[int, bytes], None],
    ) -> None:
        self._names, self._steps, self._send = names, list(steps), send
        self.count, self._tries, self._sent = 0, 0, 0.0
        self._pending: set[int] = set()

    @property
    def began(self) -> bool:
        """Whether anything has been sent."""
        return self.count > 0

    @property
    def done(self) -> bool:
        """Whether all steps are."""
        return not self._steps

    def __call__(self) -> str:
        """Do what is due; return "" at the end, else what is waited for.

        Raises:
            Fault: a joint does not answer.
        """
        if not self._steps:
            return ""
        due = time.monotonic() - self._sent > AGAIN
        if not self._pending and (due or self._tries < 2):
            self.count, self._tries, due = self.count + 1, 0, True
            self._pending = set(range(len(self._names)))
        word = self._steps[0][0]
        if not self._pending:
            return f"late answers before {word}"
        if due:
            self._again()
        return f"{word}: {len(self._pending)} actuators, {self._names[min(self._pending)]} first"

    def _again(self) -> None:
        word, datagram = self._steps[0]
        if self._tries >= TRIES:
            names = ", ".join(self._names[joint] for joint in sorted(self._pending)[:3])
            raise Fault(
                f"fourier: {word} was not answered by {names}"
                f"{' and others' if len(self._pending) > 3 else ''}; switch the robot off and on"
            )
        self._tries, self._sent = self._tries + 1, time.monotonic()
        for joint in self._pending:
            self._send(joint, datagram(self.count))

    def answered(self, joint: int, count: int, refusal: str) -> None:
        """Take an answer.

        Args:
            joint: of it.
            count: of the step that it answers.
            refusal: what it says, "" for success.

        Raises:
            Fault: the actuator refuses.
        """
        if joint not in self._pending or count != self.count:
            return  # of an earlier try
        if refusal:
            raise Fault(
                f"fourier: {self._names[joint]} answers {refusal} to {self._steps[0][0]}; that is "
                "not taken for success"
            )
        self._pending.discard(joint)
        if not self._pending:
            del self._steps[0]
