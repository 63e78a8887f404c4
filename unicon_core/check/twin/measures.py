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

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from unicon_base.arrays import Float64
from unicon_core.check.result import PolicyResult
from unicon_core.check.twin.perturb import Change
from unicon_core.robots import Robot
from unicon_core.text_table import figure, span

AT_REST = 0.1
"""Targets that change less in [rad/s], of a base that is slower in [m/s] and [rad/s], show nothing:
a tenth of the calmest walk."""


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
    velocity: Sequence[float] = (0.0, 0.0, 0.0)
    command: Sequence[float] = (0.0, 0.0, 0.0)
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
        if not self.follows:
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
    def poor(self) -> bool:
        """Whether it ended early, or did not follow its command or motion."""
        return not self.stands or (self.follows and self.tracking < POOR)

    @property
    def rests(self) -> bool:
        """Whether it stands and neither targets nor base moved worth telling."""
        return self.stands and max(self.target_rate, *map(abs, self.velocity)) < AT_REST

    def outcome(self) -> str:
        """Return in a few words how it ended."""
        if not self.stands:
            return f"{'falls' if self.fell else 'stops'} after {self.survived_s:.2f} s"
        return f"stays up for {self.survived_s:.1f} s"


CLEAR = 0.05
"""Gain in score from which a change is a finding. The greatest of a right contract was 0.039
(holosoma with half its rate; 0.06 at 0.8 m/s), the next 0.004; what breaks the reading of states
lost 0.17 and more."""
CLOSES = 0.25
"""Share of what the given contract lacks to a score of 1, which a gain has to reach besides: where
much is lacking, more is gained by chance. The greatest of a right contract was 0.21, that same
one; mistakes that were undone had 0.29 and more."""
NEARLY = 0.4
"""Share of what a good contract lacks that is clear below CLEAR, too: G1 with its damping doubled
lacks 0.10, and gains 0.045. No right contract gained more than 0.21 of what it lacked."""
LEAST = 0.03
"""A smaller gain is never clear."""
SLIGHT = 0.008
"""Gain from which it is worth a note: twice the 0.004 by which another damping raised a right
contract."""
CALMER = 0.75
"""Rate of targets, as a share of the given contract's, from which a change of the gait clock that
does as well is a finding: steps that nobody needs. Half the right clock has rates of 1.43 to 1.71
times, twice the right one of 0.84 or more."""
LIGHTER = 0.7
"""Torque of the most loaded joint, as a share of the given contract's, from which another damping
or period that does as well is a finding: 0.49 to 0.65 where those of a G1 were doubled, 0.82 or
more under right contracts. It says nothing of a gait clock: half the right one takes 0.64."""
POOR = 0.5
"""Tracking below this makes the search for a better contract worth its time."""
FOLLOWS = 0.3
"""Tracking below this is a finding even where nothing mends it."""
ALIKE = 0.02
"""Scores within this are alike."""
MENDED = 0.15
"""By how much a mended contract must do better than one that fails: three times what is clear."""


@dataclass(frozen=True)
class Compared:
    """The same walks under two contracts.

    Attributes:
        given: runs under the given contract, one for each command.
        other: runs under the changed one, in the same order.
    """

    given: tuple[Measures, ...]
    other: tuple[Measures, ...]

    @cached_property
    def _runs(self) -> Float64:
        """Score, tracking, rate of targets and torque, given and other, shape (2, walks, 4)."""
        both = self.given, self.other
        return np.array(
            [[(m.score, m.tracking, m.target_rate, m.torque_use) for m in each] for each in both]
        )

    @property
    def _gains(self) -> Float64:
        """Of each walk in score, shape (walks,)."""
        return self._runs[1, :, 0] - self._runs[0, :, 0]

    @property
    def gain(self) -> float:
        """Mean gain in score."""
        return float(self._gains.mean())

    @property
    def error(self) -> float:
        """Standard error of that mean, 0 of a single walk."""
        gains = self._gains
        return float(gains.std(ddof=1) / np.sqrt(gains.size)) if gains.size > 1 else 0.0

    @property
    def clear(self) -> bool:
        """Whether the other contract is clearly better."""
        lacking = 1.0 - float(self._runs[0, :, 0].mean())
        least = max(LEAST, CLOSES * lacking, min(CLEAR, NEARLY * lacking))
        return self.gain >= max(least, 2.0 * self.error)

    @property
    def slight(self) -> bool:
        """Whether the other contract is better by little, and that in all likelihood."""
        return len(self.given) > 1 and self.gain >= SLIGHT and self.gain > 3.0 * self.error

    @property
    def alike(self) -> bool:
        """Whether the other contract is no worse, though it should be."""
        return self.gain > -CLEAR

    @property
    def calmer(self) -> bool:
        """Whether the other does as well with targets that change much less."""
        return self._eases(2, CALMER)

    @property
    def lighter(self) -> bool:
        """Whether the other does as well with much less torque."""
        return self._eases(3, LIGHTER)

    def _eases(self, column: int, share: float) -> bool:
        before, after = self._runs[..., column].mean(axis=1)
        stands = all(m.stands for m in self.other)
        return bool(stands and self.alike and after < share * before)

    def __str__(self) -> str:
        """Both in numbers."""
        before, after = self._runs.mean(axis=1)
        walks = len(self.given)
        more = f" ± {self.error:.2f}, mean of {walks} commands" if walks > 1 else ""
        return (
            f"score {after[0]:.2f} against {before[0]:.2f}{more}; tracking {after[1]:.2f} against "
            f"{before[1]:.2f}, targets change at {after[2]:.2f} against {before[2]:.2f} rad/s, "
            f"torque {after[3]:.0%} against {before[3]:.0%} of the limit"
        )


@dataclass(frozen=True)
class Tried:
    """A change and its run.

    Attributes:
        policy: whose contract, or model, was changed.
        change: what was changed.
        measures: of the run.
        number: its place among the changes, the likeliest first.
    """

    policy: PolicyResult
    change: Change
    measures: Measures
    number: int


def chosen(finals: Sequence[Tried], given: Measures, least: float) -> list[Tried]:
    """Return the change to be told, and behind it those that do as well; none where none helps.

    A change for which the model speaks comes first where it is enough, and no other is far better.
    Of the others that score as well as the best one the likeliest is taken: exchanged sines and
    cosines are also mended by the sign of one of them.

    Args:
        finals: changes that ran as long as the given contract.
        given: its run.
        least: by how much a change must do better.
    """
    better = [
        tried
        for tried in finals
        if (run := tried.measures).stands
        and run.score >= given.score + least
        and not (run.follows and run.tracking < FOLLOWS)
    ]
    best = max((tried.measures.score for tried in better), default=0.0)

    def within(less: float) -> list[Tried]:
        return [tried for tried in better if tried.measures.score >= best - less]

    shown = [each for each in within(MENDED) if each.change.evidence and not each.measures.poor]
    return sorted(shown or within(ALIKE), key=lambda tried: tried.number)


PRESSING = 0.2
"""Share of a walk that a joint stays at a limit. Right contracts of ten published policies keep to
0.15 (T1's hip roll, whose effort limit is 25 N·m), nine of them to 0.00."""
_NEAR = 0.1  # [rad]; a default pose within this of a position limit is to be there


def find_pressing(policy: PolicyResult, robot: Robot, given: Measures) -> None:
    """Find joints that a run which stayed up kept at their limit of effort or position."""
    if given.saturated_share >= PRESSING:
        policy.find(
            "twin.saturated",
            f"effort of {given.saturated_joint}",
            f"the joint is at its effort limit for {given.saturated_share:.0%} of the time, and "
            f"targets change at {given.target_rate:.2f} rad/s: its motor does not follow",
        )
    joints = (*policy.contract.joints, *robot.joint_names)
    rest = (*policy.contract.default_joint_pos, *robot.default_joint_pos)
    for joint, share in given.limit_hits.items():
        i = robot.joint_names.index(joint)
        low, high, pose = robot.lower[i], robot.upper[i], rest[joints.index(joint)]
        if share >= PRESSING and low + _NEAR < float(pose) < high - _NEAR:
            policy.find(
                "twin.saturated",
                f"position of {joint}",
                f"the joint is at its position limit for {share:.0%} of the time "
                f"({span(low, high)} rad, default {figure(pose)})",
            )
