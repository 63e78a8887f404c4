"""Platform: the contract between the graph and a robot or simulator, for adapter writers.

    class MyRobot:
        facts = Facts("my_robot", reads=COMMAND_STATES, writes=("joint_pos", "joint_vel"))

        def recv(self): ...     # the latest data into the states
        def send(self): ...     # the command states to the motors
        def close(self): ...    # damp, then let go

    def make(states, robot, period, **options) -> MyRobot: ...

Such a factory is named `module:make`, or registered in the entry point group `unicon.platforms`.
It aligns joints by name at build, and imports what it needs inside. A robot's factory with a
parameter `silent` can be opened to receive only (`unicon preflight`, `unicon run --dry`): it then
sends nothing, in `close` either. What a platform can do besides is said by methods, one protocol
each, below.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from unicon_base import AnyMapping
from unicon_base.arrays import Array, Float64
from unicon_core.states.standard import BASE_STATES, COMMAND_STATES, JOINT_STATES

if TYPE_CHECKING:
    from unicon_core.platforms.kit.scene import Scene

SIMULATED = (*JOINT_STATES, *BASE_STATES, "stamp_ns")
"""What `recv` of a simulator writes."""


@dataclass(frozen=True)
class Facts:
    """What a platform declares of itself, as `facts` of its class or of its factory.

    It is known before anything is opened; a built platform may narrow `reads` and `writes` down.

    Attributes:
        name: in messages and reports; the word of the workflow where it is empty.
        simulated: moves no motors and keeps a time of its own: `stamp_ns` and `/clock`. Nothing
            else says so.
        batch: takes states of several robots.
        reads: states that `send` reads.
        writes: states that `recv` writes; what is not named here is not there for policies.
        physics: what it can be told of joints, of `robots/poses.py`, of bodies, of
            `kit/scene.py`, and `terrain`.
        protocols: of robot files (`transport.protocol`), those that it speaks; empty for any.
        notes: what could not be looked at, one line each.
        examine: takes what the factory takes and tells, without opening anything, how it would be
            bound; for `unicon check`.
    """

    name: str = ""
    simulated: bool = False
    batch: bool = False
    reads: tuple[str, ...] = COMMAND_STATES
    writes: tuple[str, ...] = ("joint_pos", "joint_vel")
    physics: tuple[str, ...] = ()
    protocols: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    examine: Callable[..., Binding] | None = None


@dataclass(frozen=True)
class Binding:
    """What a platform would do with the states, told by `Facts.examine` without opening it.

    Attributes:
        facts: as the built platform would declare them.
        require: refuses states that it would write in part only, as of `RequiresStates`.
    """

    facts: Facts
    require: Callable[[Mapping[str, str]], None] | None = None


class Platform(Protocol):
    """A robot or a simulator behind three blocks; a factory returns it."""

    facts: Facts

    def recv(self) -> bool | None:
        """Bring the latest data of the robot into the states; True when it has gone for good."""
        ...

    def send(self) -> bool | None:
        """Send the command states to the motors; a simulator then steps one tick period."""
        ...

    def close(self) -> None:
        """Damp the motors first, then release everything; safe to call twice."""
        ...


@runtime_checkable
class WaitsForData(Protocol):
    """Tells when data arrive, for `pacing.trigger: state`."""

    def wait(self, timeout: float) -> bool:
        """Return True when new data are there, False after `timeout` in [s]."""
        ...


@runtime_checkable
class CountsArrivals(Protocol):
    """Counts its data too, so that ticks can be timed between arrivals."""

    def arrivals(self) -> int:
        """Return how many data have come so far."""
        ...


@runtime_checkable
class WarmsUp(Protocol):
    """Does shortly before a tick what `send` does but the sending: caches are warm then."""

    def warm_up(self) -> None:
        """Do it; nobody else sees it."""
        ...


@runtime_checkable
class RequiresStates(Protocol):
    """Is told, once, what the critical path reads: the silence of those states is then a fault."""

    def require(self, states: Mapping[str, str]) -> None:
        """Take each state that a block on the critical path reads, and that block's name."""
        ...


@runtime_checkable
class SeesCommanders(Protocol):
    """A robot on a network, where others may command it too."""

    def commanders(self) -> Mapping[str, int]:
        """Return where it takes commands, with the number of others that send there."""
        ...


@runtime_checkable
class Prepares(Protocol):
    """A robot that takes no commands at once: its own controller lets go, or a mode is entered.

    It is asked once a tick behind the gates and the operator's go, before anything is sent, and
    asked again where something else is still waited for: what is done stays done.
    """

    def prepare(self) -> str:
        """Do the next step, without waiting; "" once it takes commands, else what is missing.

        Raises:
            Fault: the robot refuses.
        """
        ...


@runtime_checkable
class ReportsVariant(Protocol):
    """A robot that says which variant it is, for the gate that compares it with the robot file."""

    def variant(self) -> AnyMapping:
        """Return what it reports, under the keys of `transport` in the robot file.

        Such as {"mode_machine": 5}; {} as long as it has not reported.
        """
        ...


@runtime_checkable
class Resettable(Protocol):
    """A simulator that can begin anew."""

    def reset(self) -> None:
        """Return to the initial state and time 0."""
        ...


@runtime_checkable
class Changeable(Protocol):
    """A simulator that can begin anew in another scene, for thousands of runs of one program."""

    def change(self, scene: Scene) -> None:
        """Be as one that was built with this scene, of the same model.

        Raises:
            ModelError: no such key frame or body.
            PlatformError: the scene is wrong, or it has to be built anew.
        """
        ...


@runtime_checkable
class DefersPhysics(Protocol):
    """A simulator whose physics may wait behind `send`, for rollouts side by side in one thread."""

    def postpone(self) -> Callable[[], None] | None:
        """From now on only take the commands in `send`.

        Returns:
            What simulates the tick, to be called once behind each `send`; it raises what `send`
            would. None where it cannot be put off.
        """
        ...


@runtime_checkable
class Pushable(Protocol):
    """A simulator whose bases can be pushed, for `scene.push`."""

    def push(self, velocity: Float64) -> None:
        """Add to the bases' horizontal velocity [m/s] in the world, shape (..., 2)."""
        ...


@runtime_checkable
class TakesForces(Protocol):
    """A simulator that applies `external_force` where its states have it.

    Attributes:
        bodies: names of the model's bodies by their numbers; the first is the world.
        weight: of the (first) robot in [N].
    """

    bodies: tuple[str, ...]
    weight: float

    def point(self, body: int, place: Float64) -> Float64:
        """Return where a point [m] of a body of the (first) robot is in the world, shape (3,)."""
        ...


@runtime_checkable
class Placeable(Protocol):
    """A simulator that can be put where a robot was measured, for twins and identification."""

    def put(self, measured: Mapping[str, Array]) -> None:
        """Take positions and velocities of joints and base; what is not measured stays.

        Without `base_pos_w` the base keeps its place, at a height at which the lowest point touches
        the floor.

        Args:
            measured: state to value, of `joint_pos`, `joint_vel`, `base_quat`, `base_ang_vel`,
                `base_pos_w` and `base_lin_vel`; others are not looked at.
        """
        ...


@runtime_checkable
class Pausable(Protocol):
    """A simulator that minds how long no command comes, unless it is told why."""

    def pause(self) -> None:
        """Mind it again from the next command on."""
        ...


@runtime_checkable
class Viewable(Protocol):
    """A simulator with a window, for `unicon run --view=window`."""

    def viewer(self) -> Callable[[], bool | None]:
        """Return a block that shows it, True when its window was closed."""
        ...


@runtime_checkable
class Informative(Protocol):
    """Tells about itself once it is built."""

    def info(self) -> AnyMapping:
        """Return facts for `unicon show` and the report: model file, physics step, gains…"""
        ...


def info_of(platform: Platform) -> AnyMapping:
    """Return what a platform tells about itself; of one that tells nothing, nothing."""
    return platform.info() if isinstance(platform, Informative) else {}
