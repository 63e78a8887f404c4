"""A policy over the recorded sensors of the ticks in which it ran, open loop.

Beside it stands what the maker of the record may have done otherwise than its contract says.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from unicon_base import Fault, UniconError
from unicon_base.arrays import Array, Bool, Float64
from unicon_core.check.twin.perturb import (
    GAINS,
    TERMS,
    Change,
    field_changed,
    with_action,
    with_term,
)
from unicon_core.models.find import pick_model
from unicon_core.models.load import load_model
from unicon_core.platforms.kit.base import rotation
from unicon_core.policies import Policy, PolicyContract, policy_states
from unicon_core.policies.contract import FilterSpec
from unicon_core.policies.networks import open_network
from unicon_core.robots import Robot, joint_index
from unicon_core.states import States, standard_states
from unicon_lab.recording import Record

SHORTEST = 10  # ticks of the policy
_MEMORY = 50  # ticks after which a recurrent network has forgotten how it began
LEAST = 0.01
"""Of a fitted factor beside 1, and of an angle in [rad]: what is less is rounding."""
_SECANTS = 8  # steps in which the scale of an observation is fitted
_SENSORS = ("joint_pos", "joint_vel", "base_ang_vel", "projected_gravity", "base_quat")


class OpenLoop:
    """The ticks of a record in which one policy ran.

    Args:
        record: of one robot.
        contract: of the policy, as given.
        robot: of the record.
        prefix: of the policy's own states in the record.

    Attributes:
        notes: what the record lacks.
        model: of the robot, None where it has none.
        stretches: rows of each stretch without a gap, and whether the policy began with it.
        rows: of all stretches.
        moved: names of the joints that are given positions, in the order of the action.
        joints: their places in the robot.
        target: recorded targets of these joints in [rad], shape (rows, joints).
        counts: which of them are compared, likewise.
        clamped: 1 where a target is at the robot's upper limit and may have been beyond it, −1 at
            the lower one, else 0; likewise.
        action: recorded output of the network, shape (ticks, m), or None.

    Raises:
        UniconError: the record lacks a state, or enough ticks.
    """

    def __init__(self, record: Record, contract: PolicyContract, robot: Robot, prefix: str) -> None:
        self.record, self.robot, specs = record, robot, record.layout.specs
        self.notes: list[str] = []
        self.late = 0 if contract.child is None else contract.child.delay
        if self.late > 1:
            raise UniconError("its child answers some observations only; record it with delay: 1")
        if contract.chunk is not None:
            raise UniconError("its network answers with chunks, not with an action a tick")
        self.contract = contract = replace(contract, child=None)
        self._age = f"{prefix}action_age"
        self.network, self.model = open_network(contract), None
        with suppress(UniconError):
            self.model = load_model(pick_model(robot), robot, quiet=True)
        own = policy_states(contract, robot.joint_names, specs)
        known = {name: spec for name, spec in specs.items() if name not in own}
        self._extra = {**standard_states(robot.joint_names), **known}
        reads = self._built(contract)[0].reads
        self.fed = {name: record.states(name) for name in reads if name in specs}
        if "projected_gravity" in {*reads} - {*specs} and "base_quat" in specs:
            gravity = -rotation(record.states("base_quat"))[..., 2, :]
            self.fed["projected_gravity"] = gravity.astype(np.float32)
        lacking = [n for n in ("joint_pos_target", *reads) if n not in self.fed and n not in specs]
        if lacking:
            raise UniconError(f"the record has no {', '.join(lacking)}; record it with unicon run")
        target = record.states("joint_pos_target")
        if target.ndim != 2:
            raise UniconError(f"it is of {target.shape[1]} robots; record a run of one")
        at = contract.action.of_kind("position")
        self.moved = [name for name, by in zip(contract.action.joints, at) if by]
        self.joints = joint_index(self.moved, robot.joint_names)
        self.action, self._clock = (
            record.states(prefix + name) if prefix + name in specs else None
            for name in ("action", "gait_phase")
        )
        if self.action is None or self.action.shape[1] != len(contract.action.joints):
            self.notes.append("the record has no action of the policy, which may have begun later")
            self.action = None
        self.stretches = self._stretches(target)
        self.rows = np.concatenate([np.zeros(0, int), *(rows for rows, _ in self.stretches)])
        if len(self.rows) < SHORTEST or not self.moved:
            raise UniconError(
                f"the policy ran in {len(self.rows)} ticks and gives {len(self.moved)} joints "
                f"positions; record at least {SHORTEST} ticks of a policy that gives positions"
            )
        if self.action is not None:
            self.action = np.nan_to_num(self.action)
        self.target = target[self.rows][:, self.joints].astype(np.float64)
        lower, upper = (limit[self.joints] for limit in robot.limits())
        self.clamped = (self.target >= upper).astype(np.float64) - (self.target <= lower)
        self.counts = self._compared()

    def _stretches(self, target: Array) -> list[tuple[Array, bool]]:
        """Return the rows in which the policy ran, in pieces, and whether it began with each."""
        record, stride = self.record, max(1, round(self.contract.period / self.record.period))
        seen = target if self.action is None else self.action
        finite = [np.isfinite(each.reshape(len(each), -1)).all(1)
                  for each in (target, seen, *self.fed.values())]  # fmt: skip
        good = np.logical_and.reduce([*finite, record.ended])
        if self.late and self._age in record.layout.specs:
            good &= record.states(self._age) < 1.5 * self.contract.period
        if not good.all():
            self.notes.append(
                f"{(~good).sum()} ticks hold a NaN, a fault or a late action and are left out"
            )
        moves = (np.diff(seen, axis=0, prepend=0.0 * seen[:1]) != 0.0).any(1) & good
        anew = {int(each["before"]) for each in record.memories if each.get("anew")}
        ticks, pieces = record.ticks, list[list[int]]()
        last = -99
        for row in np.flatnonzero(moves).tolist():
            whole = row - last <= 5 * stride and ticks[row] - ticks[last] == row - last
            if whole and good[last:row].all() and not anew.intersection(range(last + 1, row + 1)):
                pieces[-1] += range(last + stride, row + 1, stride)
            else:
                pieces.append([row])
            last = pieces[-1][-1]
        follows = np.diff(ticks, prepend=-1) == 1
        begun = follows & (np.roll(good, 1) | (np.arange(len(ticks)) == 0))
        return [(np.array(rows), bool(begun[rows[0]]) or rows[0] in anew) for rows in pieces]

    def _compared(self) -> Bool:
        """Return which targets count: not those of a blend, nor before a known memory."""
        contract, parts = self.contract, []
        said = self.record.facts.get("workflow_effective", "")
        blends = re.findall(r"\bblend(?:_in)?: *(\d+\.?\d*)", said)
        blend = round(max(map(float, blends), default=0.0) / contract.period)
        old = max((term.history for term in contract.terms), default=1)
        if contract.recurrent or contract.command is not None or contract.action.filter is not None:
            old = max(old, _MEMORY)
        for rows, begun in self.stretches:
            parts.append(np.arange(len(rows)) >= (blend if begun else max(blend, old)))
        counts = np.repeat(np.concatenate(parts)[:, None], len(self.joints), 1)
        if counts.sum() < SHORTEST * len(self.joints):
            raise UniconError(
                f"{counts.sum() // len(self.joints)} ticks of the policy can be compared; record "
                "it from its beginning, and longer"
            )
        return counts

    def _built(self, contract: PolicyContract) -> tuple[Policy, States]:
        """Return a policy by a contract, and the states that it reads and writes."""
        own = policy_states(contract, self.robot.joint_names, self._extra)
        states = States({**self._extra, **own})
        model = None if self.model is None else self.model.path
        return Policy(contract, states, self.robot, network=self.network, model=model), states

    @np.errstate(over="ignore", invalid="ignore")
    def run(self, tried: Change, ticks: int | None = None) -> Float64:
        """Return the targets that a contract gives over the recorded sensors in [rad].

        The network sees the recorded last action, where there is one.

        Args:
            tried: the contract, and what it sees otherwise.
            ticks: how many of the first rows; None for all.

        Returns:
            Shape (rows, joints).

        Raises:
            Fault, UniconError: the contract cannot be run over this record.
        """
        (policy, states), out = self._built(tried.contract or self.contract), list[Array]()
        fed = [(states[name], values, tried.delay * (name in _SENSORS) + self.late)
               for name, values in {**self.fed, **tried.feeds}.items()]  # fmt: skip
        target, action = states["joint_pos_target"], states["action"]
        for rows, begun in self.stretches:
            if begun or not out:  # a gap leaves it nearly as it was
                policy.reset()
            if not begun and policy.phase is not None and self._clock is not None:
                sin, cos = np.split(self._clock[max(int(rows[0]) - 1, 0)], 2)
                policy.phase.phase[...] = np.arctan2(sin, cos)
            for k, row in enumerate(rows.tolist()):
                if k and self.action is not None:
                    action[...] = self.action[rows[k - 1]]
                for view, values, late in fed:
                    view[...] = values[max(row - late, 0)]
                policy()
                out.append(target[self.joints])
                if len(out) == ticks:
                    return np.array(out, np.float64)
        return np.array(out, np.float64)

    def squares(self, target: Float64) -> Float64:
        """Return the mean square difference from the record in each tick in [rad²], shape (n,)."""
        n = len(target)
        off = target - self.target[:n]
        off[~self.counts[:n] | (off * self.clamped[:n] > 0.0)] = 0.0
        found: Float64 = (off**2).sum(1) * n / max(int(self.counts[:n].sum()), 1)
        return found

    def residual(self, tried: Change, ticks: int) -> float:
        """Return the RMS difference from the record in [rad]; infinite where it cannot be run."""
        try:
            return float(np.sqrt(self.squares(self.run(tried, ticks)).mean()))
        except (Fault, UniconError):
            return float("inf")


def hypotheses(played: OpenLoop, target: Float64, changes: Iterable[Change]) -> Iterator[Change]:
    """Yield ways in which the contract of the record may differ, the likeliest first.

    Args:
        played: the record.
        target: that the given contract gives, in [rad], shape (rows, joints).
        changes: of the given contract, of which gains move no target.
    """
    yield from _fitted(played, target)
    yield from (change for change in changes if change.culprit != GAINS)
    for late, word in ((1, "a tick"), (2, "two ticks")):
        text = f"sensors {word} late"
        yield Change(text, "delay", None, size=float(late), unit="ticks", delay=late)
    yield from _frames(played)


def _fitted(played: OpenLoop, target: Float64) -> Iterator[Change]:
    """Yield action scales, poses and a filter that are fitted to the recorded targets."""
    contract, action = played.contract, played.contract.action
    counts = played.counts & (played.clamped == 0.0)
    at = action.of_kind("position")
    x, y = target - action.offset[at], played.target - action.offset[at]
    if played.action is not None and action.filter is None:  # what the network gave is known
        low, high = (-np.inf, np.inf) if action.clip is None else action.clip
        x = (np.clip(played.action[played.rows], low, high) * action.scale)[:, at].astype(float)
    x, y = np.where(counts, x, 0.0), np.where(counts, y, 0.0)
    power, count = np.maximum((x * x).sum(0), 1e-12), np.maximum(counts.sum(0), 1)

    def rounded(figures: Float64) -> tuple[Float64, str, float, int]:
        """Return figures without what is rounding; where, by how much, and how many differ."""
        off = np.flatnonzero(abs(figures) > LEAST)
        mean = float(figures[off].mean()) if len(off) else 0.0
        if len(off) == len(figures) and np.ptp(figures) < LEAST:
            return np.full_like(figures, mean), "", mean, 1
        where = f" of {', '.join(played.moved[i] for i in off)}" if len(off) <= 3 else ""
        return np.where(abs(figures) > LEAST, figures, 0.0), where, mean, len(off)

    def spread(left: Float64, weight: Float64) -> float:
        return 1.96 * float(np.median(np.sqrt((left**2).sum(0) / count * 10.0 / weight)))

    factor, where, mean, fitted = rounded((x * y).sum(0) / power - 1.0)
    if fitted:
        scale = action.scale.copy()
        scale[at] *= (1.0 + factor).astype(np.float32)
        yield Change(
            f"action.scale times {1.0 + mean:.3g}",
            ("joint sign" if where and abs(mean + 2.0) < LEAST else "action.scale") + where,
            with_action(contract, scale=scale),
            size=1.0 + mean,
            spread=spread(y - (1.0 + factor) * x, power),
            figures=fitted,
        )
    shift, where, mean, fitted = rounded((y - x).sum(0) / count)
    if fitted:
        offset, pose = action.offset.copy(), contract.default_joint_pos.copy()
        offset[at] += shift.astype(np.float32)
        pose[joint_index(played.moved, contract.joints)] += shift.astype(np.float32)
        moved, left = with_action(contract, offset=offset), spread(y - x - shift, count)
        posed = replace(moved, default_joint_pos=pose)
        for key, changed in {"default_joint_pos": posed, "action.offset": moved}.items():
            yield Change(
                f"{key} {mean:+.3g} rad",
                key + where,
                changed,
                size=mean,
                spread=left,
                unit="rad",
                figures=fitted,
            )
    raw = np.abs(y) / np.maximum(np.abs(action.scale[at]), 1e-6)
    bound = float(raw[counts].max(initial=0.0))
    clip = np.outer([-bound, bound], np.ones(len(action.joints))).astype(np.float32)
    text = f"an action.clip of {bound:.3g}"
    yield field_changed(contract, text, "action.clip", clip, size=bound, figures=1)
    if action.clip is not None:
        yield field_changed(contract, "no action.clip", "action.clip", None)
    if action.filter is None:
        ahead, step = target[1:] - played.target[:-1], np.diff(played.target, axis=0)
        alpha = float((ahead * step).sum() / max((ahead * ahead).sum(), 1e-12))
        for start in ("first", "zeros") if 0.01 < alpha < 0.99 else ():
            text = f"an action.filter of alpha {alpha:.3g}"
            other = FilterSpec(alpha=alpha, start=start)
            yield field_changed(contract, text, "action.filter", other, size=alpha, figures=1)


def nearer(played: OpenLoop, change: Change, ticks: int) -> Change:
    """Return another scale of an observation as it fits the recorded targets best, by secants.

    Args:
        played: the record.
        change: the scale to begin with.
        ticks: how many of the first rows are compared.
    """
    contract, seen = change.contract, (played.counts & (played.clamped == 0.0))[:ticks]
    assert contract is not None
    pairs = enumerate(zip(contract.terms, played.contract.terms))
    place = next(i for i, (other, given) in pairs if other is not given)

    def scaled(factor: float) -> Change:
        scale = contract.terms[place].scale * np.float32(factor)
        size = change.size * factor
        name = f"the {change.culprit.removeprefix(TERMS)} times {size:.3g}"
        other = with_term(contract, place, scale=scale)
        return replace(change, name=name, contract=other, size=size, figures=1)

    at, last = 1.0, 1.1
    with suppress(Fault, UniconError):  # too large a scale is beyond a network's numbers
        before = played.run(scaled(last), ticks)
        for _ in range(_SECANTS):
            now = played.run(scaled(at), ticks)
            slope = (now - before)[seen] / (at - last)
            step = slope @ (played.target[:ticks] - now)[seen] / max(slope @ slope, 1e-12)
            last, before, at = at, now, at + float(np.clip(step, -0.5 * at, at))
            if abs(at - last) < 1e-4 * at:
                break
    return scaled(at)


def _frames(played: OpenLoop) -> Iterator[Change]:
    """Yield vectors that the policy saw in another frame, where the record has `base_quat`."""
    if "base_quat" not in played.record.layout.specs:
        return
    quat = played.record.states("base_quat")
    turn, swapped = rotation(quat), rotation(np.roll(quat, 1, axis=-1))
    half, none = np.arctan2(turn[:, 1, 0], turn[:, 0, 0]) / 2, np.zeros(len(quat))
    yaw = rotation(np.stack([np.cos(half), none, none, np.sin(half)], 1))
    down = np.broadcast_to([0.0, 0.0, -1.0], (len(quat), 3))
    for state, how, matrix, product in (
        ("base_ang_vel", "in the world's frame", turn, "tij,tj->ti"),
        ("base_ang_vel", "turned into the base's frame twice", turn, "tji,tj->ti"),
        ("projected_gravity", "turned the other way", turn, "tij,tj->ti"),
        ("projected_gravity", "of base_quat", turn, "tji,tj->ti"),
        ("projected_gravity", "of base_quat read as xyzw", swapped, "tji,tj->ti"),
        ("velocity_command", "in the world's frame", yaw, "tij,tj->ti"),
        ("velocity_command", "turned from the world's frame", yaw, "tji,tj->ti"),
    ):
        if state in played.fed:
            vector = down if state == "projected_gravity" else played.fed[state]
            seen = {state: np.einsum(product, matrix, vector).astype(np.float32)}
            yield Change(f"{state} {how}", f"frame of {state}", None, feeds=seen)
