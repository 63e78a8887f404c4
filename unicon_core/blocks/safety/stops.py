"""Stops: `finite`, `tilt_stop`, `height_stop`, `velocity_stop`, `stale_stop`; the operator's hand.

`button_stop`: a button is pressed, or the device is gone. `remote_stop`: the buttons of the robot's
own remote that its vendor uses to damp it. And predicates: `elapsed`, `tilted`, `settled`, for
`until:` and `when:` and as waiting blocks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Annotated, cast

import numpy as np

from unicon_base.arrays import Float32
from unicon_base.errors import EmergencyStopPressed, Fault, Silence, WorkflowError
from unicon_base.schema.marks import NotEmpty, Unit, Within, Write, positive
from unicon_core.blocks.controls.device import declares_controls
from unicon_core.blocks.postures import Commands, Counting, end_of, ticks_of
from unicon_core.blocks.safety.limits import first_of, known_velocity_limits
from unicon_core.blocks.safety.ranges import RangeStop
from unicon_core.bounds import (
    BUTTONS,
    TILT,
    VELOCITY,
    VELOCITY_FACTOR,
    Button,
    Seconds,
    Speed,
    Timeout,
)
from unicon_core.flow.block import Reads, Stage
from unicon_core.platforms.kit.command import FiniteCheck
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.states import Range, Screen


class Elapsed(Counting):
    """Hold from the tick on in which a time has passed since entry.

    Args:
        seconds: counted in ticks, so that it means the same at any speed of the run.
    """

    def __init__(self, *, period: float, seconds: Seconds) -> None:
        self._ticks = ticks_of(seconds, period)

    def __call__(self) -> bool:
        self._tick += 1
        return self._tick >= self._ticks


def tilted(
    projected_gravity: Reads, *, angle: Annotated[float, positive(math.pi, "rad")] = 1.0
) -> Callable[[], bool]:
    """Hold while the base leans by more than an angle; of a batch, any of them.

    Args:
        projected_gravity: unit vector of gravity in the base frame, shape (..., 3).
        angle: between the base's z axis and the vertical in [rad].
    """
    bound = -math.cos(angle)
    most = largest(projected_gravity[..., 2])

    def is_tilted() -> bool:
        return not most() <= bound  # true for NaN: a lost IMU is not an upright robot

    return is_tilted


def largest(values: Float32) -> Callable[[], float]:
    """Return what reads the largest element; of a scalar its value, which is 8x faster."""
    return cast("Callable[[], float]", values.max if values.ndim else values.item)


class Commanded:
    """Hold while somebody commands a motion, and a while longer.

    Args:
        velocity_command: vx, vy in [m/s], wz in [rad/s], shape (..., 3).
        least: a magnitude below this is not a command, in [m/s] or [rad/s].
        hold: for how long it holds after the last command in [s].
    """

    memory = ("_left",)

    def __init__(
        self, velocity_command: Reads, *, period: float, least: float = 0.05, hold: Seconds = 1.0
    ) -> None:
        self._command = velocity_command.reshape(-1)
        self._least = least
        self._ticks = ticks_of(hold, period)
        self._left = 0

    def __call__(self) -> bool:
        if max(map(abs, self._command.tolist())) > self._least:
            self._left = self._ticks
            return True
        self._left = max(self._left - 1, 0)
        return self._left > 0

    def reset(self) -> None:
        """Forget the last command."""
        self._left = 0


class Settled:
    """Hold once every joint has been slow for some time.

    Args:
        joint_vel: in [rad/s], shape (..., n).
        velocity: what counts as slow in [rad/s].
        duration: for how long in [s].
    """

    memory = ("_slow",)

    def __init__(
        self, joint_vel: Reads, *, period: float, velocity: float = 0.1, duration: Seconds = 0.5
    ) -> None:
        self._vel = joint_vel
        self._bound = velocity
        self._ticks = ticks_of(duration, period)
        self._speed = np.zeros_like(joint_vel)
        self._slow = 0

    def __call__(self) -> bool:
        np.abs(self._vel, out=self._speed)
        self._slow = self._slow + 1 if self._speed.max() <= self._bound else 0
        return self._slow >= self._ticks

    def reset(self) -> None:
        """Wait anew."""
        self._slow = 0


PATIENT = 5
"""Ticks that a block looks at before it stops a robot, from which on it may look after `send`."""

HEIGHT = 10_000.0
"""In [m]: what stands on a mountain."""
Height = Annotated[float, Unit("m"), Within(-HEIGHT, HEIGHT, above=True)]


class Finite(FiniteCheck):
    """Stop where a command is NaN or infinite; the fault names the state and the joint."""

    memory = ()

    stage = Stage.SAFETY

    def __init__(self, command: Commands, *, robot: Robot) -> None:
        super().__init__(vars(command), robot.joint_names)
        most = np.finfo(np.float32).max
        self.ranges = [Range(view, -most, most) for view in command]


class TiltStop:
    """Stop when the base leans too far.

    Args:
        projected_gravity: unit vector of gravity in the base frame, shape (..., 3).
        angle: between the base's z axis and the vertical in [rad], at most a right angle.
    """

    memory = ()

    stage = Stage.SAFETY

    def __init__(
        self, projected_gravity: Reads, *, angle: Annotated[float, positive(TILT, "rad")] = 1.0
    ) -> None:
        self._down = projected_gravity[..., 2]
        self._angle = angle
        self._bound = -math.cos(angle)
        self.ranges = [Range(self._down, -np.inf, self._bound)]
        self._largest = largest(self._down)

    def __call__(self) -> None:
        if not self._largest() <= self._bound:  # true for NaN too
            down = np.atleast_1d(self._down)
            worst = int(np.argmax(np.nan_to_num(down, nan=np.inf)))
            who = f"robot {worst}: " if len(down) > 1 else ""
            if math.isnan(down[worst]):
                raise Fault(f"{who}projected_gravity is NaN; is the IMU there?")
            lean = math.acos(min(1.0, max(-1.0, -float(down[worst]))))
            raise Fault(f"{who}the base leans by {lean:.2f} rad, allowed are {self._angle:.2f}")


def height_stop(
    base_pos_w: Reads, *, states: States, robot: Robot, lowest: Height, highest: Height = HEIGHT
) -> RangeStop:
    """Stop where the base is too low or too high; for platforms that know where it is.

    Args:
        base_pos_w: in the world frame in [m], shape (..., 3).
        lowest: height of the base in [m].
        highest: the same.

    Raises:
        WorkflowError: the lowest is above the highest.
    """
    if lowest > highest:
        raise WorkflowError(f"lowest is {lowest:g}; write at most {highest:g} [m], the highest")
    bounds = (-np.inf, -np.inf, lowest), (np.inf, np.inf, highest)
    return RangeStop(states, robot, {"base_pos_w": bounds}, "allowed are")


class VelocityStop:
    """Stop when a joint is too fast.

    Args:
        joint_vel: in [rad/s], shape (..., n).
        factor: of the robot file's velocity limits; a body's are looked at though its hands say
            none.
        limit: of every joint in [rad/s], instead of the robot file's.

    Raises:
        RobotError: the robot file does not say its velocity limits.
    """

    memory = ()

    stage = Stage.SAFETY

    def __init__(
        self,
        joint_vel: Reads,
        *,
        states: States,
        robot: Robot,
        factor: Annotated[float, positive(VELOCITY_FACTOR)] = 1.5,
        limit: Speed | None = None,
    ) -> None:
        if limit is not None:
            bound = np.full(robot.num_joints, limit, np.float32)
        else:
            limits = known_velocity_limits(robot, "give velocity_stop a limit in [rad/s]", VELOCITY)
            bound = limits * np.float32(factor)
        self._vel = joint_vel
        self._bound = bound
        self._robot = robot
        self.ranges = [Range(joint_vel, -bound, bound)]
        self._screen = Screen(states, self.ranges)

    def __call__(self) -> None:
        if not self._screen():
            excess = np.nan_to_num(np.abs(self._vel) / self._bound, nan=np.inf)
            index, who = first_of(excess == excess.max(), self._robot)
            raise Fault(
                f"{who} moves at {self._vel[index]:.2f} rad/s, "
                f"allowed are {self._bound[index[-1]]:.2f}"
            )


class StaleStop:
    """Stop when the robot's data no longer gets newer.

    Args:
        stamp_ns: source time of the data in [ns], shape (...).
        timeout: in [s] of ticks without a newer stamp; at least one tick.
    """

    memory = ("_last", "_same")

    stage = Stage.SAFETY

    def __init__(self, stamp_ns: Reads, *, period: float, timeout: Timeout = 0.1) -> None:
        self._ticks = ticks_of(timeout, period)
        self._timeout = timeout
        self.patient = self._ticks >= PATIENT
        self._oldest = stamp_ns.min if stamp_ns.ndim else stamp_ns.item  # `min` takes 1.3 µs
        self.reset()

    def reset(self) -> None:
        """Wait anew for data."""
        self._last: int | None = None
        self._same = 0

    def __call__(self) -> None:
        stamp = int(self._oldest())
        if stamp != self._last:
            self._last = stamp
            self._same = 0
            return
        self._same += 1
        if self._same >= self._ticks:
            raise Silence(
                f"the robot's data is stale: stamp_ns has been {stamp} for {self._same} ticks "
                f"(timeout {self._timeout} s); is the link up?"
            )


Buttons = Annotated[Sequence[Button], NotEmpty, Write("a list of buttons, such as [select]")]
STEADY = 2
"""For how many ticks all buttons of an emergency stop are pressed: one frame may be garbage."""


class ButtonStop:
    """Stop where one of some buttons is pressed, or the device has not been heard for a while.

    Args:
        on: names of buttons, any of them.
        lost: how long the device may be silent in [s], from the first tick on; None for ever, where
            a robot walks on its own.
    """

    memory = ("_silent",)

    endless = True
    declares = staticmethod(declares_controls)

    def __init__(
        self,
        buttons: Reads,
        controls_alive: Reads,
        *,
        period: float,
        on: Buttons = ("select",),
        lost: Seconds | None = None,
    ) -> None:
        self._buttons = buttons
        self._alive = controls_alive
        self._lost = end_of(lost, period)
        self._places = {BUTTONS.index(name): name for name in on}
        self._silent = 0
        self.buttons_used = tuple(on)

    def __call__(self) -> None:
        for place, name in self._places.items():
            if self._buttons[place]:
                raise Fault(f"the operator pressed {name}")
        self._silent = 0 if self._alive else self._silent + 1
        if self._silent > self._lost:
            raise Fault(
                f"the operator's device was not heard for {self._silent} ticks; more than "
                f"{self._lost} are a fault (button_stop)"
            )

    def reset(self) -> None:
        """Count anew."""
        self._silent = 0


class RemoteStop:
    """Stop as by an emergency stop where all of some buttons are held for two ticks.

    A remote that is switched off presses nothing, so it is no fault.

    Args:
        on: names of buttons, all of which are held; None for `transport.stop_buttons` of the robot
            file, the vendor's combination for damping.

    Attributes:
        names: of the buttons.

    Raises:
        WorkflowError: neither the robot file nor the workflow names one.
    """

    memory = ("_ticks",)

    endless = True
    declares = staticmethod(declares_controls)

    def __init__(self, buttons: Reads, *, robot: Robot, on: Buttons | None = None) -> None:
        names = robot.transport.get("stop_buttons") if on is None else on
        if not names:
            raise WorkflowError(
                f"{robot.path.name} has no transport.stop_buttons; give on: a list of buttons, "
                "such as [L2, B]"
            )
        self.names = tuple(names)
        self._buttons = buttons
        self._places = [*map(BUTTONS.index, names)]
        self._ticks = 0

    def __call__(self) -> None:
        for place in self._places:
            if not self._buttons[place]:
                self._ticks = 0
                return
        self._ticks += 1
        if self._ticks >= STEADY:
            raise EmergencyStopPressed(
                f"the operator pressed {'+'.join(self.names)} on the remote (remote_stop)"
            )

    def reset(self) -> None:
        """Count anew."""
        self._ticks = 0
