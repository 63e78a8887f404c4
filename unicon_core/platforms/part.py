"""The platform of a part that has none: what another part measures is what it receives.

`recv` takes the newest states of the other parts, `send` has nothing to do: what this part gives is
published behind its flow.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from unicon_base.errors import PlatformError
from unicon_core.platforms.platform import Facts
from unicon_core.signals import SIGNALS
from unicon_core.states.links import Incoming

START = 10.0
"""How long the first part is waited for, in [s]."""


class PartPlatform:
    """See the module.

    Args:
        part: name of this part.
        first: the part with the robot; it must be heard before this one starts.
        arrivals: bring the states of the others.
        patience: how long to wait for it in [s].

    Raises:
        PlatformError: it is not heard in time.
    """

    def __init__(
        self, part: str, first: str, arrivals: Sequence[Incoming], patience: float = START
    ) -> None:
        writes = tuple(state for arrival in arrivals for state in arrival.writes)
        self.facts = Facts(f"part {part}", simulated=True, reads=(), writes=writes)
        self._arrivals = tuple(arrivals)
        self._first = next((a for a in arrivals if a.part == first), None)
        end = time.monotonic() + patience
        while self._first is not None and not self._first.heard:
            self._first.quiet = True
            self._first()
            self._first.quiet = False
            if self._first.refused or time.monotonic() > end:
                raise PlatformError(
                    f"part {part!r}: {self._first.refused or f'part {first!r} is not heard'}; run "
                    f"it first: unicon run WORKFLOW --part {first}"
                )
            SIGNALS.check()
            if not self._first.heard:
                self._first.wait(0.02)

    def recv(self) -> None:
        """Take what has come."""
        for arrival in self._arrivals:
            arrival()

    def wait(self, timeout: float) -> bool:
        """Return True when the first part has published, False after `timeout` in [s]."""
        if self._first is None:
            time.sleep(timeout)
            return False
        return self._first.wait(timeout)

    def send(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Let go of the others."""
        for arrival in self._arrivals:
            arrival.close()
