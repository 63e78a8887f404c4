"""Where a policy's network runs beside the ticks: in a process of its own, or at a server."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from unicon_base.schema.marks import Core, Matches, Within
from unicon_core.states import StateSpec

TIMES = {
    "action_round_trip": StateSpec(
        (), "float32", "s", "", (), "from the newest question to its answer, seen once a tick"
    ),
    "action_inference": StateSpec(
        (), "float32", "s", "", (), "of that, time of the network by the server's clock"
    ),
}
"""States of the policy that hold wall-clock times; no replay repeats them."""


@dataclass(frozen=True, kw_only=True)
class LateSpec:
    """How late the actions of a network may be that runs beside the ticks.

    Attributes:
        delay: ticks of the workflow from an observation to its action, at least 1; where the
            network is late at real rate, more.
        timeout: an action whose observation is older than this ends the run, in [s]; None: the
            longer of a quarter of a second and twice the age that actions have by their delay.
    """

    delay: Annotated[int, Within(1, 1000, "ticks")] = 1
    timeout: Annotated[float | None, Within(0.001, 60.0, "s")] = None


@dataclass(frozen=True, kw_only=True)
class ChildSpec(LateSpec):
    """How a network runs in a process of its own, which the workflow says.

    Attributes:
        cpu: core that the process stays on, or None.
        threads: of the network.
    """

    cpu: Core | None = None
    threads: Annotated[int, Within(1, 64)] = 1


@dataclass(frozen=True)
class RemoteSpec(LateSpec):
    """How a server runs a network (`unicon serve`).

    Attributes:
        address: of the server.
        keys: folder with its CURVE key and ours, from the workflow's folder on; None: without.
    """

    address: Annotated[
        str, Matches(r"tcp://[^\s/*]+:[0-9]{1,5}|ipc://\S+", "tcp://HOST:PORT, or ipc://PATH")
    ]
    keys: Annotated[Path | None, Matches(r".+", "the folder of its keys")] = None

    threads = 1  # of a network that a tool opens here

    def within(self, folder: Path) -> RemoteSpec:
        """Return it with keys reckoned from a folder."""
        keys = self.keys
        return self if keys is None else replace(self, keys=(folder / keys).expanduser().resolve())
