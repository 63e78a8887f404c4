"""Contracts as they would be without one of the usual mistakes, for telling why a policy falls."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from unicon_core.check.mirror import mirror_pairs
from unicon_core.check.twin.perturb import other_order, permuted, perturbations, renamed, with_terms
from unicon_core.policies.contract import ObservationTerm, PolicyContract
from unicon_core.robots import Robot, joint_index

__all__ = ["Repair", "repairs"]

_SCALES = (0.05, 0.25, 0.5, 2.0, 4.0, 20.0)  # of legged_gym, holosoma and Unitree, and inverses


@dataclass(frozen=True)
class Repair:
    """One mended contract.

    Attributes:
        name: what was changed, to follow "with".
        culprit: the part of the contract that it concerns.
        contract: the mended contract.
        unlimited: whether limits of effort are lifted.
    """

    name: str
    culprit: str
    contract: PolicyContract
    unlimited: bool = False


def repairs(
    contract: PolicyContract,
    robot: Robot,
    depths: Sequence[int],
    poses: Mapping[str, Mapping[str, float]],
) -> Iterator[Repair]:
    """Yield what a policy's contract might be if it were right, the likeliest first.

    Args:
        contract: the given one.
        robot: gives an order and gains to try.
        depths: of the policy's joints in the kinematic tree, shape (n,).
        poses: name to joint positions in [rad]: default poses to try.
    """
    for broken in perturbations(contract, depths):  # most of them undo themselves
        if broken.contract is not None:
            yield Repair(broken.name, broken.culprit, broken.contract)
    yield from _orders(contract, robot, depths)
    yield from _gains(contract, robot, depths)
    yield from _actions(contract, poses)
    yield from _terms(contract)
    yield Repair("no limits of effort", "effort limits of the robot file", contract, True)


def _orders(contract: PolicyContract, robot: Robot, depths: Sequence[int]) -> Iterator[Repair]:
    joints, culprit = contract.joints, "joint order"
    limb_by_limb = [name for name in robot.joint_names if name in joints]
    by_depth = dict(zip(joints, depths))
    orders = {
        "the joint order of the other kind of simulator": [
            joints[i] for i in np.argsort(other_order(depths))
        ],
        "the robot's joint order": limb_by_limb,
        "a breadth-first joint order": sorted(limb_by_limb, key=lambda name: by_depth[name]),
        "the reversed joint order": list(joints[::-1]),
        "left and right joints exchanged": _exchanged(joints, mirror_pairs(joints)),
        "front and rear legs exchanged": _front_and_rear(joints),
    }
    for left, right in mirror_pairs(joints):
        orders[f"{left} and {right} exchanged"] = _exchanged(joints, [(left, right)])
    for name, order in orders.items():
        if len(order) == len(joints) and tuple(order) != joints:
            yield Repair(f"{name} (names only)", culprit, renamed(contract, order))
            yield Repair(name, culprit, permuted(contract, order))


def _exchanged(joints: Sequence[str], pairs: Sequence[tuple[str, str]]) -> list[str]:
    other = dict(pairs) | {b: a for a, b in pairs}
    return [other.get(name, name) for name in joints]


def _front_and_rear(joints: Sequence[str]) -> list[str]:
    swaps = {"FL": "RL", "FR": "RR", "RL": "FL", "RR": "FR"}
    names = [swaps.get(name[:2], name[:2]) + name[2:] for name in joints]
    return names if set(names) == set(joints) else []


def _gains(contract: PolicyContract, robot: Robot, depths: Sequence[int]) -> Iterator[Repair]:
    culprit = "gains"
    order = other_order(depths)
    for name, index in (
        ("gains brought back from another order", np.argsort(order)),
        ("gains in the reversed order", np.arange(len(order))[::-1]),
    ):
        stiffness, damping = contract.stiffness[index], contract.damping[index]
        yield Repair(name, culprit, replace(contract, stiffness=stiffness, damping=damping))
    yield Repair(
        "stiffness and damping exchanged",
        culprit,
        replace(contract, stiffness=contract.damping, damping=contract.stiffness),
    )
    own = joint_index(contract.joints, robot.joint_names)
    stiffness, damping = robot.joint_stiffness[own], robot.joint_damping[own]
    if np.isfinite(stiffness).all() and np.isfinite(damping).all():
        yield Repair(
            "the robot file's gains",
            culprit,
            replace(contract, stiffness=stiffness, damping=damping),
        )
    for factor in (0.1, 0.25, 4.0, 10.0):
        scaled = replace(contract, stiffness=contract.stiffness * np.float32(factor))
        yield Repair(f"stiffness times {factor:g}", culprit, scaled)
        both = replace(scaled, damping=contract.damping * np.float32(factor))
        yield Repair(f"stiffness and damping times {factor:g}", culprit, both)


def _actions(
    contract: PolicyContract, poses: Mapping[str, Mapping[str, float]]
) -> Iterator[Repair]:
    action = contract.action
    for factor in (0.25, 0.5, 2.0, 4.0, -1.0):
        scaled = replace(action, scale=action.scale * np.float32(factor))
        yield Repair(
            f"action.scale times {factor:g}", "action.scale", replace(contract, action=scaled)
        )
    for name, pose in poses.items():
        default = np.array([pose[joint] for joint in contract.joints], np.float32)
        offset = np.array([pose[joint] for joint in action.joints], np.float32)
        if np.isfinite(default).all():
            moved = replace(action, offset=offset)
            changed = replace(contract, default_joint_pos=default, action=moved)
            yield Repair(name, "default_joint_pos", changed)


def _terms(contract: PolicyContract) -> Iterator[Repair]:
    culprit = "observation.terms"
    terms = contract.terms
    observation = contract.observation

    def width(term: ObservationTerm) -> int:
        if term.index is not None:
            return len(term.index)
        per_joint = term.state.startswith("joint_") or term.state == "action"
        return len(contract.joints) if per_joint else 3

    alphabetical = tuple(sorted(terms, key=lambda term: term.name))
    if alphabetical != terms:  # holosoma sorts its terms by name
        changed = replace(contract, observation=replace(observation, terms=alphabetical))
        yield Repair("terms in alphabetical order", f"{culprit}, their order", changed)
    for i, first in enumerate(terms):
        for j in range(i + 1, len(terms)):
            if width(first) == width(terms[j]) and first.history == terms[j].history:
                order = list(terms)
                order[i], order[j] = order[j], order[i]
                yield Repair(
                    f"terms {first.name!r} and {terms[j].name!r} exchanged",
                    f"{culprit}, order of {first.name!r} and {terms[j].name!r}",
                    replace(contract, observation=replace(observation, terms=tuple(order))),
                )
    for i, term in enumerate(terms):
        if term.state == "joint_pos":
            other = None if term.subtract is not None else "default_joint_pos"
            yield Repair(
                f"term {term.name!r} {'relative to the default pose' if other else 'absolute'}",
                f"{culprit}, subtract of {term.name!r}",
                _changed(contract, i, replace(term, subtract=other)),
            )
        yield Repair(
            f"the other sign of term {term.name!r}",
            f"{culprit}, sign of {term.name!r}",
            _changed(contract, i, replace(term, scale=-term.scale)),
        )
        for factor in _SCALES:
            yield Repair(
                f"the scale of term {term.name!r} times {factor:g}",
                f"{culprit}, scale of {term.name!r}",
                _changed(contract, i, replace(term, scale=term.scale * np.float32(factor))),
            )
    one = np.ones(1, np.float32)
    usual = {"base_ang_vel": 0.25, "joint_vel": 0.05}

    def usually(term: ObservationTerm) -> ObservationTerm:
        return replace(term, scale=one * np.float32(usual.get(term.state, 1.0)))

    yield Repair(
        "the usual scales (angular velocity 0.25, joint velocity 0.05)",
        "observation scales",
        with_terms(contract, usually),
    )
    if any(term.history > 1 for term in terms):
        newest: Any = "first" if observation.newest == "last" else "last"
        turned = replace(contract, observation=replace(observation, newest=newest))
        yield Repair(f"the newest frame {newest}", "observation.newest", turned)
        layout: Any = "frame_major" if observation.layout == "term_major" else "term_major"
        if len({term.history for term in terms}) == 1:
            turned = replace(contract, observation=replace(observation, layout=layout))
            yield Repair(f"histories {layout}", "observation.layout", turned)


def _changed(contract: PolicyContract, place: int, term: ObservationTerm) -> PolicyContract:
    terms = list(contract.terms)
    terms[place] = term
    return replace(contract, observation=replace(contract.observation, terms=tuple(terms)))
