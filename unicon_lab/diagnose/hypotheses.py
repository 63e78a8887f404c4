"""What the maker of a record may have done otherwise than its contract says."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np

from unicon_base.arrays import Array, Float32, Float64
from unicon_core.check.joints import joint_depths, mirror_pairs
from unicon_core.check.twin.perturb import (
    Change,
    exchanged,
    permuted,
    renamed,
    with_action,
    with_terms,
)
from unicon_core.check.twin.repair import repairs
from unicon_core.platforms.kit.base import rotation
from unicon_core.policies import PolicyContract
from unicon_core.policies.contract import FilterSpec
from unicon_core.robots import joint_index
from unicon_lab.diagnose.open_loop import Hypothesis, OpenLoop

LEAST = 0.01
"""Of a fitted factor beside 1, and of an angle in [rad]: what is less is rounding."""
_FEW = 16  # joints of which every pair is exchanged
_ORDER = ("base_lin_vel", "base_ang_vel", "projected_gravity", "velocity_command")
_KINDS = {
    "order of sines and cosines": "clock_order",
    "phase.period": "clock_period",
    "phase.offsets": "clock_offsets",
    "observation.newest": "history_order",
    "observation.layout": "history_layout",
    "default_joint_pos": "default_pose",
    "their order": "term_order",
    "sign": "observation_sign",
    "scale": "observation_scale",
    "order": "term_order",
}
_DEGREES = np.float32(180.0 / np.pi)
_SEEN = ("joint_pos", "joint_vel")


def changes_of(played: OpenLoop) -> list[Change]:
    """Return the usual mistakes as changed contracts, gains among them."""
    contract, robot, model = played.contract, played.robot, played.model
    poses = {"the robot file's default pose": robot.default_joint_pos.astype(np.float64)}
    depths: Sequence[int] = [0] * len(contract.joints)
    if model is not None:
        depths = joint_depths(model, robot, contract.joints)
        poses |= {f"the pose of key frame {k!r}": pose for k, pose in model.key_poses().items()}
    named = {name: dict(zip(robot.joint_names, pose.tolist())) for name, pose in poses.items()}
    return [
        change
        for change in repairs(contract, robot, depths, named)
        if change.contract is not None and not (change.undamped or change.unlimited)
    ]


def hypotheses(
    played: OpenLoop, target: Float64, changes: Iterable[Change]
) -> Iterator[Hypothesis]:
    """Yield ways in which the contract of the record may differ, the likeliest first.

    Args:
        played: the record.
        target: that the given contract gives, in [rad], shape (rows, joints).
        changes: of the given contract.
    """
    contract = played.contract
    yield from _fitted(played, target)
    for change in changes:
        if change.contract is None or change.culprit == "gains":
            continue
        kind, where = _kind(change.culprit, change.name, contract)
        factor = re.search(r"times (-?[\d.]+)$", change.name)
        size = -1.0 if kind == "observation_sign" else float(factor[1]) if factor else float("nan")
        yield Hypothesis(kind, where, change.name, change.contract, size=size)
    yield from _joints(contract)
    yield from _terms(contract)
    for late, word in ((1, "a tick"), (2, "two ticks")):
        text = f"sensors {word} late"
        size = float(late)
        yield Hypothesis("delay", "", text, contract, {}, late, size=size, unit="ticks")
    yield from _frames(played)


def _kind(culprit: str, name: str, contract: PolicyContract) -> tuple[str, str]:
    """Return kind and place of a changed part of a contract."""
    part = culprit.removeprefix("observation.terms, ")
    if part == "joint order":
        a, _, b = name.split(" (")[0].removesuffix(" exchanged").partition(" and ")
        if {a, b} <= {*contract.joints}:
            return "joint_exchange", f"{a} and {b}"
        return "left_right" if name.startswith("left and right") else "joint_order", ""
    if part in _KINDS:
        return _KINDS[part], ""
    what, _, where = part.partition(" of ")
    where = where.removeprefix("term ").replace("'", "")
    return _KINDS.get(what, re.sub(r"\W+", "_", what)), where


def _fitted(played: OpenLoop, target: Float64) -> Iterator[Hypothesis]:
    """Yield action scales, poses and a filter that are fitted to the recorded targets."""
    contract, action = played.contract, played.contract.action
    counts = played.counts & (played.clamped == 0.0)
    at = action.of_kind("position")
    names = [name for name, by in zip(action.joints, at) if by]
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
        where = ", ".join(names[i] for i in off) if len(off) <= 3 else ""
        return np.where(abs(figures) > LEAST, figures, 0.0), where, mean, len(off)

    def spread(left: Float64, weight: Float64) -> float:
        return 1.96 * float(np.median(np.sqrt((left**2).sum(0) / count * 10.0 / weight)))

    factor, where, mean, fitted = rounded((x * y).sum(0) / power - 1.0)
    if fitted:
        scale = action.scale.copy()
        scale[at] *= (1.0 + factor).astype(np.float32)
        yield Hypothesis(
            "joint_sign" if where and abs(mean + 2.0) < LEAST else "action_scale",
            where,
            f"action.scale times {1.0 + mean:.3g}",
            with_action(contract, scale=scale),
            size=1.0 + mean,
            spread=spread(y - (1.0 + factor) * x, power),
            figures=fitted,
        )
    shift, where, mean, fitted = rounded((y - x).sum(0) / count)
    if fitted:
        offset, pose = action.offset.copy(), contract.default_joint_pos.copy()
        offset[at] += shift.astype(np.float32)
        pose[joint_index(names, contract.joints)] += shift.astype(np.float32)
        moved = with_action(contract, offset=offset)
        for kind, key, changed in (
            ("default_pose", "default_joint_pos", replace(moved, default_joint_pos=pose)),
            ("action_offset", "action.offset", moved),
        ):
            text = f"{key} {mean:+.3g} rad"
            left = spread(y - x - shift, count)
            yield Hypothesis(
                kind, where, text, changed, {}, 0, mean, left, unit="rad", figures=fitted
            )
    raw = np.abs(y) / np.maximum(np.abs(action.scale[at]), 1e-6)
    bound = float(raw[counts].max(initial=0.0))
    clip = np.outer([-bound, bound], np.ones(len(action.joints))).astype(np.float32)
    text = f"an action.clip of {bound:.3g}"
    held = with_action(contract, clip=clip)
    yield Hypothesis("action_clip", "", text, held, size=bound, figures=1)
    if action.filter is None:
        ahead, step = target[1:] - played.target[:-1], np.diff(played.target, axis=0)
        alpha = float((ahead * step).sum() / max((ahead * ahead).sum(), 1e-12))
        for start in ("first", "zeros") if 0.01 < alpha < 0.99 else ():
            changed = with_action(contract, filter=FilterSpec(alpha=alpha, start=start))
            text = f"an action.filter of alpha {alpha:.3g}"
            yield Hypothesis("action_filter", "", text, changed, size=alpha, figures=1)


def _joints(contract: PolicyContract) -> Iterator[Hypothesis]:
    """Yield exchanged joints, and joints of the other sign."""
    joints, action, known = contract.joints, contract.action, mirror_pairs(contract.joints)
    pairs = combinations(joints, 2) if len(joints) <= _FEW else pairwise(joints)
    text = "the alphabetical joint order"
    yield Hypothesis("joint_order", "", text, permuted(contract, sorted(joints)))
    yield Hypothesis("joint_order", "", f"{text} (names only)", renamed(contract, sorted(joints)))
    for a, b in pairs:
        if (a, b) not in known and (b, a) not in known:
            pair, text = renamed(contract, exchanged(joints, [(a, b)])), f"{a} and {b} exchanged"
            yield Hypothesis("joint_exchange", f"{a} and {b}", f"{text} (names only)", pair)

    def turned(scale: Float32, names: Sequence[str], joint: str) -> Float32:
        return scale * np.where(np.array(names) == joint, -1.0, 1.0).astype(np.float32)

    for joint in joints:
        seen = with_terms(
            contract,
            (
                replace(t, scale=turned(t.scale, [joints[i] for i in places], joint))
                if t.state in _SEEN
                else t
                for t in contract.terms
                for places in [range(len(joints)) if t.index is None else t.index]
            ),
        )
        both = with_action(seen, scale=turned(action.scale, action.joints, joint))
        for how, changed in (("", both), (" in the observation", seen)):
            text = f"the other sign of {joint}{how}"
            yield Hypothesis("joint_sign", joint, text, changed, size=-1.0)


def _terms(contract: PolicyContract) -> Iterator[Hypothesis]:
    """Yield scales and clips left out, and further orders of the terms."""
    terms = contract.terms
    for i, term in enumerate(terms):
        scale, clip, name = "observation_scale", "observation_clip", f"term {term.name!r}"
        others = [(scale, f"no scale of {name}", replace(term, scale=np.sign(term.scale)))]
        for text, unit in ((f"{name} in degrees", _DEGREES), (f"{name} in radians", 1 / _DEGREES)):
            others.append((scale, text, replace(term, scale=term.scale * unit)))
        if term.clip is not None:
            others.append((clip, f"no clip of {name}", replace(term, clip=None)))
        for kind, text, other in others:
            changed = with_terms(contract, [*terms[:i], other, *terms[i + 1 :]])
            size = float((other.scale / np.where(term.scale == 0.0, 1.0, term.scale)).max())
            yield Hypothesis(kind, term.name, text, changed, size=size)
    for i, (a, b) in enumerate(pairwise(terms)):
        changed = with_terms(contract, [*terms[:i], b, a, *terms[i + 2 :]])
        text = f"term {b.name!r} before {a.name!r}"
        yield Hypothesis("term_order", f"{a.name} and {b.name}", text, changed)
    usual = sorted(terms, key=lambda t: _ORDER.index(t.state) if t.state in _ORDER else len(_ORDER))
    text = "the terms in Isaac Lab's order"
    yield Hypothesis("term_order", "", text, with_terms(contract, usual))
    if contract.action.clip is not None:
        text = "no action.clip"
        yield Hypothesis("action_clip", "", text, with_action(contract, clip=None))


def _frames(played: OpenLoop) -> Iterator[Hypothesis]:
    """Yield vectors that the policy saw in another frame, where the record has `base_quat`."""
    if "base_quat" not in played.record.layout.specs:
        return
    quat = played.record.states("base_quat")
    turn, swapped = rotation(quat), rotation(np.roll(quat, 1, axis=-1))
    heading = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
    half = np.stack([np.cos(heading / 2), *np.zeros((2, len(quat))), np.sin(heading / 2)], 1)
    yaw, down = rotation(half), np.broadcast_to([0.0, 0.0, -1.0], (len(quat), 3))

    def inverse(matrix: Array) -> Array:
        return matrix.transpose(0, 2, 1)

    for state, how, matrix in (
        ("base_ang_vel", "in the world's frame", turn),
        ("base_ang_vel", "turned into the base's frame twice", inverse(turn)),
        ("projected_gravity", "turned the other way", turn),
        ("projected_gravity", "of base_quat", inverse(turn)),
        ("projected_gravity", "of base_quat read as xyzw", inverse(swapped)),
        ("velocity_command", "in the world's frame", yaw),
        ("velocity_command", "turned from the world's frame", inverse(yaw)),
    ):
        if state in played.fed:
            vector = down if state == "projected_gravity" else played.fed[state]
            seen = {state: np.einsum("tij,tj->ti", matrix, vector).astype(np.float32)}
            yield Hypothesis("frame", state, f"{state} {how}", played.contract, seen)
