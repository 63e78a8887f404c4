"""Stops where states leave bounds: measurements, commands, hardware, observations and actions.

They are `range_stop`, `command_stop`, `hardware_stop`, `observation_stop` and `action_stop`;
`observation_range` learns the bounds of `observation_stop` in a good run:

deferred: [{observation_range: {file: good.npz}}]        # in a good run
safety: [finite, {observation_stop: {file: good.npz}}]   # in those that follow
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from unicon_base.arrays import Array, Float32
from unicon_base.errors import Fault, WorkflowError
from unicon_base.schema.marks import Matches, Within, positive
from unicon_core.blocks.postures import Commands
from unicon_core.bounds import DAMPING, EFFORT, POSITION, STIFFNESS, VELOCITY
from unicon_core.flow.block import Reads, Stage
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES, HARDWARE_STATES
from unicon_core.states.states import Range, Screen
from unicon_core.workflow.autowire import BuildContext

ANGULAR_VELOCITY = 70.0
"""Of a base in [rad/s]: MEMS gyroscopes end at 2000 or 4000 °/s, 35 or 70 rad/s."""
QUATERNION = 1.01
"""Of a component: those of a unit quaternion end at 1."""
DIRECTION = 1.25
"""Of a component of `projected_gravity`: that of a unit vector ends at 1, and noise as policies are
trained with (0.05 on each axis) adds some. In [m/s²] it would be 9.81."""
UNBOUNDED = 1e6
"""Of what has no plausible bound, such as an acceleration at an impact: it has to be finite."""

MEASURED = (
    "joint_pos",
    "joint_vel",
    "joint_effort",
    "base_quat",
    "base_ang_vel",
    "base_lin_acc",
    "projected_gravity",
)
"""What `range_stop` looks at, as far as the platform measures it."""


def range_stop(
    context: BuildContext,
    *,
    margin: Annotated[float, Within(0.0, POSITION, "rad")] = 0.5,
    factor: Annotated[float, Within(1.0, 10.0)] = 3.0,
) -> RangeStop:
    """Stop where what was measured is NaN, infinite, or more than any robot of this kind does.

    Args:
        context: the platform says what is measured.
        margin: beyond the position limits in [rad]: 0.5 unless given; an encoder is off by more.
        factor: of the robot file's velocity limits.

    Raises:
        WorkflowError: nothing is measured.
    """
    robot = context.robot
    states = context.states
    platform = context.platform
    told = MEASURED if platform is None else platform.facts.writes
    names = [name for name in MEASURED if name in told and name in states]
    if not names:
        raise WorkflowError("the platform measures nothing that it looks at; leave it out")
    lower, upper = robot.limits(POSITION)
    lower -= np.float32(margin)
    upper += np.float32(margin)
    speed = np.nan_to_num(robot.velocity_limit * factor, nan=VELOCITY)
    bounds: dict[str, tuple[Any, Any]] = {
        "joint_pos": (lower, upper),
        "joint_vel": (-speed, speed),
        "base_quat": (-QUATERNION, QUATERNION),
        "base_ang_vel": (-ANGULAR_VELOCITY, ANGULAR_VELOCITY),
        "projected_gravity": (-DIRECTION, DIRECTION),
    }
    made = RangeStop(states, robot, {n: bounds.get(n, (-UNBOUNDED, UNBOUNDED)) for n in names})
    made.needs = False  # it looks at what is there: who else reads an optional topic needs it
    return made


def command_stop(
    command: Commands,
    *,
    states: States,
    robot: Robot,
    stiffness: Annotated[float, positive(STIFFNESS, "N·m/rad")] = STIFFNESS,
    damping: Annotated[float, positive(DAMPING, "N·m·s/rad")] = DAMPING,
    factor: Annotated[float, positive(10.0)] = 2.0,
) -> RangeStop:
    """Stop where a command is NaN, infinite, or one that nobody can mean.

    A gain below 0 drives a joint away from its target; one beyond the bound is a slip of a decimal.

    Args:
        stiffness: the highest in [N·m/rad].
        damping: the highest in [N·m·s/rad].
        factor: of the robot file's limits of velocity and effort, for the velocity target and the
            feed-forward effort.
    """
    speed = np.nan_to_num(robot.velocity_limit * factor, nan=VELOCITY)
    effort = np.nan_to_num(robot.effort_limit * factor, nan=EFFORT)
    # A wheel without stiffness has its own position as target, and that grows and grows.
    target = np.where(robot.endless, np.float32(UNBOUNDED), np.float32(2.0 * POSITION))
    gains = (0.0, stiffness), (0.0, damping)
    bounds = (-target, target), (-speed, speed), (-effort, effort), *gains
    return RangeStop(states, robot, dict(zip(COMMAND_STATES, bounds)))


class RangeStop:
    """The tick of blocks that trip where states leave their bounds; neighbours are asked at once.

    Attributes:
        needs: what it reads has to come, whatever a message map calls optional.

    Args:
        states: of the workflow.
        robot: names the joints.
        bounds: state to its lowest and highest value, numbers or of its shape.
        said: what a value beyond them is not: "plausible", unless given.
    """

    memory = ()

    stage = Stage.SAFETY
    needs = True

    def __init__(
        self,
        states: States,
        robot: Robot,
        bounds: Mapping[str, tuple[Any, Any]],
        said: str = "which is not plausible:",
    ) -> None:
        self.reads = tuple(bounds)
        self.ranges = [
            Range(states[name], *(np.broadcast_to(each, states[name].shape) for each in pair))
            for name, pair in bounds.items()
        ]
        self._states = states
        self._joints = robot.joint_names
        self._said = said
        self._screen = Screen(states, self.ranges)

    def __call__(self) -> None:
        """Look.

        Raises:
            Fault: a value is out of range; with state, element, value and range.
        """
        if not self._screen():
            self._raise()

    def _raise(self) -> None:
        for name, (view, lower, upper) in zip(self.reads, self.ranges):
            within = (view >= lower.astype(view.dtype)) & (view <= upper.astype(view.dtype))
            wrong = np.argwhere(~within)
            if not len(wrong):
                continue
            index = tuple(int(i) for i in wrong[0])
            who = f"robot {index[0]}: " if self._states.num_robots is not None else ""
            names: Sequence[str] = self._states.spec(name).names or self._joints
            shape = self._states.spec(name).shape
            named = bool(shape) and len(names) == shape[-1]
            which = f" of {names[index[-1]]}" if named else ""
            unit = f" {self._states.spec(name).unit}".rstrip()
            raise Fault(
                f"{who}{name}{which} is {view[index]:g}{unit}, {self._said} "
                f"{lower[index]:.4g} to {upper[index]:.4g}"
            )


HOTTEST = 150.0
"""In [°C]: magnets and windings of class F end there."""
COLDEST = -40.0
"""In [°C]: a sensor that tells less is broken."""
HIGHEST_VOLTAGE = 1000.0
"""In [V]: legged robots have 20 to 60."""


def hardware_stop(
    context: BuildContext,
    *,
    temperature: Annotated[float, positive(HOTTEST, "°C")] = 90.0,
    charge: Annotated[float, Within(0.0, 1.0)] = 0.05,
    voltage: Annotated[float | None, positive(HIGHEST_VOLTAGE, "V")] = None,
) -> RangeStop:
    """Stop where a motor is too hot or tells an error, or where the battery is empty.

    It looks at those of the hardware states that the platform writes: `motor_temperature`,
    `motor_error`, `battery_charge` and, where a bound is given, `battery_voltage`.

    Args:
        temperature: highest of a motor in [°C].
        charge: lowest of the battery, as a share of 1.
        voltage: lowest of the battery in [V]; None does not look.

    Raises:
        WorkflowError: the platform tells nothing of this.
    """
    bounds: dict[str, tuple[Any, Any]] = {
        "motor_temperature": (COLDEST, temperature),
        "motor_error": (0, 0),
        "battery_charge": (charge, 1.0),
    }
    if voltage is not None:
        bounds["battery_voltage"] = (voltage, HIGHEST_VOLTAGE)
    states = context.states
    platform = context.platform
    told = HARDWARE_STATES if platform is None else platform.facts.writes
    seen = {name: pair for name, pair in bounds.items() if name in states and name in told}
    if not seen:
        raise WorkflowError("the platform tells nothing of motors and battery; leave it out")
    return RangeStop(states, context.robot, seen, "allowed are")


MARGIN = 10.0
"""Largest margin: beyond ten times of what was seen nothing is unusual."""
ACTION = 1000.0
"""Largest limit of an action: published policies give up to some 10."""
LEAST = 1e-3
"""What an entry that never changed may change by."""
LARGEST_FILE = 16 * 2**20
"""In bytes, of a file of bounds."""
File = Annotated[str, Matches(r".*\.npz", "a path that ends in .npz")]


class ObservationStop(RangeStop):
    """Stop where a policy gets to see what no good run has shown.

    Before a policy has made one, an observation is all zeros.

    Args:
        observation: of the policy, shape (..., m).
        file: .npz with `lower` and `upper`, shape (m,), as `observation_range` writes it; beside
            the workflow.
        margin: beyond both, as a share of what lies between them.

    Raises:
        WorkflowError: the file does not fit.
    """

    def __init__(
        self,
        observation: Reads,
        *,
        states: States,
        robot: Robot,
        file: File,
        margin: Annotated[float, Within(0.0, MARGIN)] = 0.5,
        relative_to: Path | None = None,
    ) -> None:
        lower, upper = _bounds_of(_path(file, relative_to), observation.shape[-1])
        more = np.maximum(margin * (upper - lower), LEAST)
        bounds = {_label(observation, states): (lower - more, upper + more)}
        super().__init__(states, robot, bounds, "which no good run has shown:")

    def _raise(self) -> None:
        if self.ranges[0].view.any():
            super()._raise()


def action_stop(
    action: Reads, *, states: States, robot: Robot, limit: Annotated[float, positive(ACTION)] = 50.0
) -> RangeStop:
    """Stop where a network's output is NaN or larger than any that moves a robot.

    Args:
        action: of the policy before scale and offset, shape (..., k).
        limit: of each entry.
    """
    return RangeStop(states, robot, {_label(action, states): (-limit, limit)}, "allowed are")


class ObservationRange:
    """Note the lowest and highest value of each entry, and write them when the run ends.

    Args:
        observation: of the policy, shape (..., m).
        file: .npz to write, beside the workflow; one that is there counts too, so that several
            runs add up.
    """

    memory = ("_lower", "_upper")
    pure = False  # it writes a file

    def __init__(self, observation: Reads, *, file: File, relative_to: Path | None = None) -> None:
        path = self._path = _path(file, relative_to)
        size = observation.shape[-1]
        self._seen = observation.reshape(-1, size)
        self._lower, self._upper = (np.full(size, end, np.float32) for end in (np.inf, -np.inf))
        if path.exists():
            self._lower, self._upper = _bounds_of(path, size)

    def __call__(self) -> None:
        for row in self._seen:
            if not row.any():  # no policy has made it yet
                continue
            np.fmin(self._lower, row, out=self._lower)
            np.fmax(self._upper, row, out=self._upper)

    def close(self) -> None:
        """Write what was seen, all of it or nothing."""
        if not np.isfinite(self._lower).all():
            return  # no tick
        part = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as stream:
            np.savez(stream, lower=self._lower, upper=self._upper)
        part.replace(self._path)


def _path(file: str, relative_to: Path | None) -> Path:
    return Path(file) if relative_to is None else relative_to / file


def _bounds_of(path: Path, size: int) -> tuple[Float32, Float32]:
    """Return `lower` and `upper` of a file, shape (m,)."""
    remedy = "write it with observation_range in a good run"
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise ValueError("it is too large")
        with np.load(path, allow_pickle=False) as values:
            if sum(entry.file_size for entry in values.zip.infolist()) > LARGEST_FILE:
                raise ValueError("it is too large")
            lower, upper = (np.asarray(values[key], np.float32) for key in ("lower", "upper"))
    except Exception as error:  # what np.load raises of garbage is of many kinds
        said = "no such file" if isinstance(error, FileNotFoundError) else str(error)
        raise WorkflowError(f"file {path}: {said}; {remedy}") from error
    if lower.shape != (size,) or upper.shape != (size,):
        raise WorkflowError(
            f"file {path}: it has bounds for {lower.size} values and the observation has {size}; "
            f"{remedy}"
        )
    if not (np.isfinite(lower).all() and np.isfinite(upper).all() and (lower <= upper).all()):
        raise WorkflowError(f"file {path}: its bounds are not finite and in order; {remedy}")
    return lower, upper


def _label(view: Array, states: States) -> str:
    """Return the name of the state that a parameter got, which a workflow may have renamed."""
    start = view.__array_interface__["data"][0]
    return next(n for n in states if states[n].__array_interface__["data"][0] == start)
