"""Diagnosis: which cause explains that a recorded robot moves unlike its simulation.

Here is what it answers with; `diagnosis.diagnose` makes it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

MOTIONS = ("drop", "wiggle", "sway", "rest")
"""Motions that `unicon excite` writes. Motors hardly act in a drop, nor the base of a robot that
hangs: of two motions the first tells more apart."""


@dataclass(frozen=True)
class Shown:
    """The signal that shows a cause most, in the window that shows it most.

    Attributes:
        signal: a joint, or one of `motion.BASE_ANSWERS`.
        unit: of the values.
        time: since the record's beginning in [s], shape (l,).
        record, without, with_it: as recorded, and replayed without and with the cause, shape (l,).
    """

    signal: str
    unit: str
    time: list[float]
    record: list[float]
    without: list[float]
    with_it: list[float]


@dataclass(frozen=True)
class Cause:
    """One cause that explains a record, or would.

    Attributes:
        kind: such as `payload`, `strength` or `joint_order`.
        where: the joint, leg or term that it is about; "" for the whole robot.
        layer: `contract`, what the policy is told and what its answer becomes, or `plant`.
        probability: of this cause, or of its group.
        size: estimated change from the simulator or the contract, in `unit`.
        low, high: the 95 % interval of `size`.
        unit: of the size; "" for a factor or none.
        evidence: which signal shows it, and how much of its error this cause explains.
        remedy: what to change, as lines of the file where there is one.
        alike: names of causes that this record cannot tell from it.
        shown: the evidence, where it is of the plant.
        next: what to record to tell it from those, of `MOTIONS` or in words; "" where none are.
    """

    kind: str
    where: str
    layer: Literal["contract", "plant"]
    probability: float
    size: float
    low: float
    high: float
    unit: str = ""
    evidence: str = ""
    remedy: str = ""
    alike: tuple[str, ...] = ()
    shown: Shown | None = None
    next: str = ""

    @property
    def name(self) -> str:
        """What it is called in tables: `strength of RL_calf_joint`, or `payload`."""
        return name_of(self.kind, self.where)

    def figures(self) -> tuple[str, str]:
        """Return the change and its interval as tables write them; "" where it has none."""

        def figure(value: float) -> str:
            if self.layer == "plant" and not self.unit:  # a part of what the simulator has
                return f"{value:+.1%}"
            return f"{value:+.3g} {self.unit}".rstrip()

        if math.isnan(self.size):
            return "", ""
        return figure(self.size), f"{figure(self.low)} to {figure(self.high)}"


def name_of(kind: str, where: str) -> str:
    """Return how a kind of cause is called at a place; `where` is "" for the whole robot."""
    what = kind.replace("_", " ")
    return f"{what} of {where}" if where else what


@dataclass(frozen=True)
class Diagnosis:
    """What a record says.

    Attributes:
        causes: ranked, the most probable first; none where the record shows nothing.
        notes: what could not be examined, and why.
        windows: stretches of the record that were replayed.
        complete: False where Ctrl-C ended it early.
        next: of `MOTIONS`, what to record where this record shows nothing of the plant, or "".
    """

    causes: tuple[Cause, ...]
    notes: tuple[str, ...] = ()
    windows: int = 0
    complete: bool = True
    next: str = ""
