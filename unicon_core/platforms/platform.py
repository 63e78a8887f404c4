"""Platform: the contract between the graph and a robot or simulator, for adapter writers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

__all__ = ["Binding", "Platform"]


@dataclass(frozen=True)
class Binding:
    """What a platform would do with the states, told by `FACTORY.examine` without opening it.

    Attributes:
        writes: states that `recv` would write.
        reads: states that `send` would read.
        notes: what could not be looked at, one line each.
        require: refuses states that it would write in part only, as of `Platform.require`.
    """

    writes: tuple[str, ...]
    reads: tuple[str, ...]
    notes: tuple[str, ...] = ()
    require: Callable[[Mapping[str, str]], None] | None = None


class Platform(Protocol):
    """A robot or a simulator behind three blocks.

    Built by a factory `make(states, robot, period, **options)` that is registered by name (entry
    point group `unicon.platforms`). It aligns joints by name at build, pushes gains and limits by
    name, and imports what it needs inside the factory.

    Two further methods make it fit for `pacing.trigger: state`: `wait(timeout_s) -> bool`, True
    when new data are there, and `arrivals() -> int`, how many have come so far. A method
    `warm_up()` is called shortly before a tick and does what `send` does, but for the sending: to
    have code and data in the caches. A method `require(states)` is called once when the workflow is
    built, with each state that a block on the critical path reads and that block's name: their
    silence is then a fault. What leaves at the end is written by `platforms/damping.py`.

    Attributes:
        name: word that the workflow uses for it.
        simulated: True where `stamp_ns` is simulated time (then `/clock` is published).
        writes: states that `recv` writes (`joint_pos`, `base_quat`, `stamp_ns`, …).
        reads: states that `send` reads (`joint_pos_target`, `joint_stiffness`, …).
    """

    name: str
    simulated: bool
    writes: tuple[str, ...]
    reads: tuple[str, ...]

    def recv(self) -> bool | None:
        """Bring the latest data of the robot into the states; True when it has gone for good."""
        ...

    def send(self) -> bool | None:
        """Send the command states to the motors; a simulator then steps one tick period."""
        ...

    def close(self) -> None:
        """Damp the motors first, then release everything; safe to call twice."""
        ...

    def reset(self) -> None:
        """Return a simulator to its initial state; a real robot does nothing."""
        ...

    def info(self) -> Mapping[str, Any]:
        """Return facts for `unicon show` and the report: model file, physics step, gains…"""
        ...
