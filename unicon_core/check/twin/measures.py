"""What one run in the twin showed, and its score, for comparing contracts of one policy.

    score = survival · (0.7 · tracking + 0.3 · smoothness)

- survival: time until a fall or a fault as a share of the time asked for, in [0, 1].
- tracking: mean of exp(−e² / 0.25) with e² = |v_xy − v_xy*|² + (w_z − w_z*)² in [m²/s² + rad²/s²]:
  the kernel by which such policies are trained (leggedrobotics/legged_gym,
  `envs/base/legged_robot.py`, `tracking_sigma` 0.25). The first second is left out: it is the
  start from rest.
- smoothness: exp(−(rate / 15)²), rate = root mean square over time and joints of the change of the
  position targets in [rad/s]: 1.1 to 5.8 for the walks of the three policies tried.

A policy that reads no velocity command is scored by survival · smoothness; one that follows a
motion by survival · (0.7 · tracking + 0.3 · smoothness), tracking being the mean of
exp(−e² / 0.0625) with e, the root mean square of its joints' distance from the reference, in [rad].
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from unicon_base.arrays import Array, Float64
from unicon_core.blocks.approach import Monitor
from unicon_core.robots import Robot
from unicon_core.states import States

JUDGED = (
    "joint_pos", "joint_effort", "base_ang_vel", "base_lin_vel", "base_pos_w", "projected_gravity"
)  # fmt: skip
"""States of a simulator by which a run is judged."""

ROW = ("joint_pos", "joint_effort", "joint_pos_target", "velocity_command")
"""States that are kept of every tick, beside the velocity of the base."""

TRACKING_SIGMA = 0.25
"""Width of the tracking kernel in [m²/s²]."""
MOTION_SIGMA = 0.0625
"""Width of the kernel of a motion in [rad²]: 0.25 rad from the reference in all joints is far."""
SMOOTH_RATE = 15.0
"""Rate of targets in [rad/s] at which smoothness has fallen to 1/e."""
START = 1.0
"""Time from rest that tracking leaves out in [s]."""
FALL_COSINE, FALL_HEIGHT = Monitor.FALL_COSINE, Monitor.FALL_HEIGHT
"""A base that tilts further, or sinks below this share of its height when the policy took over, has
fallen."""
AT_REST = 0.1
"""Targets that change less in [rad/s], of a base that is slower in [m/s] and [rad/s], show nothing:
a tenth of the calmest walk."""
AT_LIMIT = 0.005
"""A joint within this distance of its limit in [rad] is at the limit."""

Three = tuple[float, float, float]


@dataclass(frozen=True)
class Measures:
    """One run; the figures are those of one without ticks unless they are given.

    Attributes:
        asked_s: time asked for in [s].
        fault: what stopped the run, or "".
        survived_s: until a fall, a fault or the end in [s].
        fell: whether the base tilted or sank too far.
        velocity_error: mean distance from the commanded velocity, [m/s] and [rad/s] together.
        velocity: mean velocity of the base vx, vy [m/s] and wz [rad/s].
        command: mean command.
        target_rate: root mean square of the change of targets in [rad/s].
        torque_use: largest root mean square torque of a joint as a share of its effort limit.
        torque_joint: that joint.
        saturated: share of ticks × joints at the effort limit.
        saturated_joint: that which was at its effort limit longest, with `saturated_share` of the
            ticks.
        limit_hits: joint to share of ticks that it stood at a position limit.
        tracking, smoothness, survival, score: see the module, each in [0, 1].
        tracks: whether following the command counts.
        motion_error: mean root mean square of the joints from the motion in [rad], None without.
    """

    asked_s: float
    fault: str
    survived_s: float = 0.0
    fell: bool = False
    velocity_error: float = 0.0
    velocity: Three = (0.0, 0.0, 0.0)
    command: Three = (0.0, 0.0, 0.0)
    target_rate: float = 0.0
    torque_use: float = 0.0
    torque_joint: str = ""
    saturated: float = 0.0
    saturated_joint: str = ""
    saturated_share: float = 0.0
    limit_hits: dict[str, float] = field(default_factory=dict)
    tracking: float = 0.0
    smoothness: float = 0.0
    survival: float = 0.0
    tracks: bool = True
    motion_error: float | None = None

    @property
    def score(self) -> float:
        """The score in [0, 1], greater is better."""
        if not self.tracks and self.motion_error is None:
            return self.survival * self.smoothness
        return self.survival * (0.7 * self.tracking + 0.3 * self.smoothness)

    @property
    def follows(self) -> bool:
        """Whether there is anything to follow, a command or a motion."""
        return self.tracks or self.motion_error is not None

    @property
    def stands(self) -> bool:
        """Whether the run ended neither with a fall nor with a fault."""
        return not self.fell and not self.fault

    @property
    def rests(self) -> bool:
        """Whether it stands and neither targets nor base moved worth telling."""
        return self.stands and max(self.target_rate, *map(abs, self.velocity)) < AT_REST

    def outcome(self) -> str:
        """Return in a few words how it ended."""
        if self.fell:
            return f"falls after {self.survived_s:.2f} s"
        if self.fault:
            return f"stops after {self.survived_s:.2f} s"
        return f"stays up for {self.survived_s:.1f} s"


class Recorder:
    """Looks at the states after each tick.

    Args:
        states: of the workflow.
        robot: limits and names.
        effort: torque limits in use in [N·m], shape (n,), infinite for none.
        period: of a tick in [s].
        motion_error: of a policy that follows a motion, joints first, in [rad], read in place.
    """

    def __init__(
        self,
        states: States,
        robot: Robot,
        effort: Float64,
        period: float,
        motion_error: Array | None = None,
    ) -> None:
        self._robot, self._period = robot, period
        names = {*JUDGED, *ROW}
        self._views = {name: states[name].reshape(-1, states.spec(name).size)[0] for name in names}
        self._effort = effort
        self._motion = None if motion_error is None else motion_error.reshape(-1, 2)[0, :1]
        self._standing: float | None = None
        self.fell = False
        self.rows: list[list[Float64]] = []

    def __call__(self, walking: bool) -> bool:
        """Note the tick; True once the base has fallen.

        Args:
            walking: a policy has taken over; before, the flow may lie down as it likes, and what it
                did is forgotten then.
        """
        views = self._views
        height = float(views["base_pos_w"][2])
        if walking and self._standing is None:
            self.rows.clear()
            self._standing = height
        velocity = np.array([*views["base_lin_vel"][:2], views["base_ang_vel"][2]])
        motion = np.zeros(1) if self._motion is None else self._motion
        row = (*(views[name] for name in ROW), velocity, motion)
        self.rows.append([values.astype(np.float64) for values in row])
        tilted = float(views["projected_gravity"][2]) > -FALL_COSINE
        sunk = self._standing is not None and height < FALL_HEIGHT * self._standing
        self.fell = tilted or sunk
        return self.fell

    def measures(self, asked_s: float, fault: str, tracks: bool) -> Measures:
        """Return what was seen.

        Args:
            asked_s: how long the run should have lasted in [s].
            fault: what stopped it, or "".
            tracks: whether following the command counts.
        """
        if not self.rows:
            return Measures(asked_s, fault)
        robot, period = self._robot, self._period
        columns = (np.stack(part) for part in zip(*self.rows))
        pos, effort, target, command, velocity, motion = columns
        survived = len(self.rows) * period
        error = velocity - command
        from_start = error[min(round(START / period), max(len(error) - 1, 0)) :]
        squared = (from_start**2).sum(axis=1)
        off = None if tracks or self._motion is None else motion[len(error) - len(from_start) :]
        kernel = squared / TRACKING_SIGMA if off is None else (off**2)[:, 0] / MOTION_SIGMA
        rates = np.diff(target[:, ~robot.endless], axis=0) / period
        rate = float(np.sqrt((rates**2).mean())) if rates.size else 0.0
        use = np.sqrt((effort**2).mean(axis=0)) / self._effort
        worst = int(np.argmax(use))
        hits = (pos <= robot.lower + AT_LIMIT) | (pos >= robot.upper - AT_LIMIT)
        shares = hits.mean(axis=0)
        saturated = np.abs(effort) >= 0.999 * self._effort
        longest = int(np.argmax(saturated.mean(axis=0)))
        return Measures(
            asked_s=asked_s,
            survived_s=survived,
            fell=self.fell,
            fault=fault,
            velocity_error=float(np.sqrt(squared).mean()),
            velocity=_three(velocity.mean(axis=0)),
            command=_three(command.mean(axis=0)),
            target_rate=rate,
            torque_use=float(use[worst]),
            torque_joint=robot.joint_names[worst],
            saturated=float(saturated.mean()),
            saturated_joint=robot.joint_names[longest],
            saturated_share=float(saturated.mean(axis=0)[longest]),
            limit_hits={
                robot.joint_names[i]: float(shares[i]) for i in np.argsort(-shares) if shares[i]
            },
            tracking=float(np.exp(-kernel).mean()),
            smoothness=float(np.exp(-((rate / SMOOTH_RATE) ** 2))),
            survival=min(1.0, survived / asked_s) if self.fell or fault else 1.0,
            tracks=tracks,
            motion_error=None if off is None else float(off.mean()),
        )


def _three(values: Float64) -> Three:
    return float(values[0]), float(values[1]), float(values[2])
