"""Which of two contracts does better, and which of many changes is told.

One run of a few seconds says little, so two contracts are compared command by command, and a change
counts where its mean gain in score is more than the standard error of that mean explains. Eight
published policies of five sources under their right contracts (Go1, G1 and T1 of mujoco_playground,
G1 of holosoma and of unitree_rl_mjlab, G1 and H1 of unitree_rl_gym, our Go2) give the bounds below:
each was run with half and twice its damping, stiffness, period and gait clock, and with what
`perturb` breaks.

A policy that falls is held up by many changes of its contract, by the right one and by others that
happen to calm it. What the model says without a run, its joints' own damping and the joints that
the policy neither moves nor sees, is no guess, so it is the culprit where undoing it is enough.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from unicon_base.arrays import Float64
from unicon_core.check.gains import counted_twice
from unicon_core.check.result import PolicyResult
from unicon_core.check.subject import listed
from unicon_core.check.twin.measures import Measures
from unicon_core.check.twin.perturb import Change
from unicon_core.policies import PolicyContract
from unicon_core.robots import Robot, joint_index
from unicon_core.text_table import figure, span

CLEAR = 0.05
"""Gain in score from which a change is a finding. The greatest of a right contract was 0.039
(holosoma with half its rate; 0.06 at 0.8 m/s), the next 0.004; what breaks the reading of states
lost 0.17 and more."""
CLOSES = 0.25
"""Share of what the given contract lacks to a score of 1, which a gain has to reach besides: where
much is lacking, more is gained by chance. The greatest of a right contract was 0.21, that same
one; mistakes that were undone had 0.29 and more."""
SLIGHT = 0.008
"""Gain from which it is worth a note: twice the 0.004 by which another damping raised a right
contract."""
CALMER = 0.75
"""Rate of targets, as a share of the given contract's, from which a change of the gait clock that
follows as well is a finding: steps that nobody needs. Half the right clock has rates of 1.43 to
1.71 times, twice the right one of 0.85 or more."""
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
        before, _ = self._means
        least = max(CLEAR, CLOSES * (1.0 - before[0]), 2.0 * self.error)
        return self.gain >= least

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
        """Whether the other follows as well with targets that change much less."""
        before, after = self._means
        rates = after[2] <= CALMER * before[2]
        return bool(rates and all(m.stands for m in self.other) and after[1] >= before[1] - CLEAR)

    def __str__(self) -> str:
        """Both in numbers."""
        before, after = self._means
        walks = len(self.given)
        scores = f"score {after[0]:.2f} against {before[0]:.2f}"
        if walks > 1:
            scores += f" ± {self.error:.2f}, mean of {walks} commands"
        return (
            f"{scores}; tracking {after[1]:.2f} against {before[1]:.2f}, targets change at "
            f"{after[2]:.2f} against {before[2]:.2f} rad/s"
        )

    @property
    def _gains(self) -> Float64:
        return np.array([b.score - a.score for a, b in zip(self.given, self.other)])

    @property
    def _means(self) -> tuple[list[float], list[float]]:
        """Score, tracking and rate of targets of both."""
        before, after = (
            np.mean([[m.score, m.tracking, m.target_rate] for m in runs], axis=0).tolist()
            for runs in (self.given, self.other)
        )
        return before, after


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


def poor(measures: Measures) -> bool:
    """Whether a run ends early, or does not follow its command or motion."""
    return not measures.stands or (measures.follows and measures.tracking < POOR)


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
        if tried.measures.stands
        and tried.measures.score >= given.score + least
        and not (tried.measures.follows and tried.measures.tracking < FOLLOWS)
    ]
    best = max((tried.measures.score for tried in better), default=0.0)
    evident = [
        tried
        for tried in better
        if tried.change.evidence
        and not poor(tried.measures)
        and tried.measures.score >= best - MENDED
    ]
    good = evident or [t for t in better if t.measures.score >= best - ALIKE]
    return sorted(good, key=lambda tried: tried.number)


PRESSING = 0.2
"""Share of a walk that a joint stays at a limit. Right contracts of ten published policies keep to
0.15 (T1's hip roll, whose effort limit is 25 N·m), nine of them to 0.00."""
# A default pose within this of a position limit in [rad] is to be there.
_NEAR = 0.1


def evident_changes(
    contract: PolicyContract, robot: Robot, passive: Float64, platform: str
) -> Iterator[Change]:
    """Yield the changes of the model for which the model itself speaks.

    Args:
        contract: of the policy, as given.
        robot: the robot.
        passive: damping of the robot's joints themselves in [N·m·s/rad], shape (n,).
        platform: name of the simulator.
    """
    own = passive[joint_index(contract.joints, robot.joint_names)]
    twice = counted_twice(contract.damping, own)
    if twice.size:
        i = twice[0]
        yield Change(
            "passive damping removed",
            "passive damping of the model",
            contract,
            undamped=True,
            evidence=f"{twice.size} of {len(own)} joints damp themselves beside the policy's "
            f"damping, {contract.joints[i]} by {own[i]:g} and {contract.damping[i]:g} N·m·s/rad",
            remedy=f"let the policy's damping replace it (platforms: {{{platform}: {{passive: "
            "replace}}), or correct <joint damping> of the model",
        )
    unseen = tuple(name for name in robot.joint_names if name not in contract.joints)
    if unseen:
        yield Change(
            "the other joints welded",
            "joints of the model that the policy does not know",
            contract,
            locked=unseen,
            evidence=f"it neither moves nor sees {listed(unseen)}, {len(unseen)} of "
            f"{robot.num_joints} joints, which give way here",
            remedy="take the model that it was trained on, or hold these joints as stiffly",
        )


def find_pressing(policy: PolicyResult, robot: Robot, given: Measures) -> None:
    """Find joints that a run which stayed up kept at their limit of effort or position."""
    if given.saturated_share >= PRESSING:
        policy.find(
            "twin.saturated",
            f"effort of {given.saturated_joint}",
            f"the joint is at its effort limit for {given.saturated_share:.0%} of the time, and "
            f"targets change at {given.target_rate:.2f} rad/s: its motor does not follow",
        )
    pose = dict(zip(policy.contract.joints, policy.contract.default_joint_pos))
    for joint, share in given.limit_hits.items():
        i = robot.joint_names.index(joint)
        rest = float(pose.get(joint, robot.default_joint_pos[i]))
        if share < PRESSING or not robot.lower[i] + _NEAR < rest < robot.upper[i] - _NEAR:
            continue
        policy.find(
            "twin.saturated",
            f"position of {joint}",
            f"the joint is at its position limit for {share:.0%} of the time "
            f"({span(robot.lower[i], robot.upper[i])} rad, default {figure(rest)})",
        )
