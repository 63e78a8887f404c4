"""Broken contracts: what a policy's contract would be after one of the usual mistakes.

Each is a fault that users of deployment tools met: observation scales left out, left and right
exchanged, gravity upside down, the joint order of another simulator, gains in another order. A
contract that is as good when it is broken like that was probably not right before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from unicon_core.check.mirror import mirror_pairs
from unicon_core.policies.contract import ActionSpec, ObservationTerm, PolicyContract
from unicon_core.robots import joint_index

__all__ = [
    "Perturbation",
    "other_order",
    "permuted",
    "perturbations",
    "renamed",
    "with_terms",
]


@dataclass(frozen=True)
class Perturbation:
    """One broken contract.

    Attributes:
        name: the mistake, as a phrase.
        culprit: the part of the contract that it concerns.
        contract: the broken contract, or None where the mistake changes nothing.
        reason: why there is none.
        unlikely: nobody makes it; that a policy bears it is worth a note.
    """

    name: str
    culprit: str
    contract: PolicyContract | None
    reason: str = ""
    unlikely: bool = False


def perturbations(contract: PolicyContract, depths: Sequence[int]) -> list[Perturbation]:
    """Return the broken contracts of a policy.

    Args:
        contract: the given one.
        depths: how far down the kinematic tree each of the policy's joints stands, shape (n,).
    """
    return [
        _scales(contract),
        _left_right(contract),
        _gravity(contract),
        _order(contract, depths),
        _gains(contract, depths),
    ]


def with_terms(
    contract: PolicyContract, change: Callable[[ObservationTerm], ObservationTerm]
) -> PolicyContract:
    """Return the contract with every observation term changed."""
    terms = tuple(change(term) for term in contract.terms)
    return replace(contract, observation=replace(contract.observation, terms=terms))


def renamed(contract: PolicyContract, names: Sequence[str]) -> PolicyContract:
    """Return the contract with other joint names on the same places of network and figures.

    Args:
        contract: the given one.
        names: the new names of `contract.joints`, one by one.
    """
    renamed = dict(zip(contract.joints, names))
    action: ActionSpec = replace(
        contract.action, joints=tuple(renamed[name] for name in contract.action.joints)
    )
    return replace(contract, joints=tuple(names), action=action)


def permuted(contract: PolicyContract, names: Sequence[str]) -> PolicyContract:
    """Return the contract with the joints in another order, every figure staying with its joint.

    Args:
        contract: the given one.
        names: the same joints in another order.
    """
    joints, action = contract.joints, contract.action
    index = joint_index(names, joints)
    moved = [name for name in names if name in action.joints]
    at = joint_index(moved, action.joints)

    def per_joint(term: ObservationTerm) -> ObservationTerm:
        if term.index is not None or not (
            term.state.startswith("joint_") or term.state == "action"
        ):
            return term
        order = at if term.state == "action" else index
        scale = term.scale[order] if term.scale.size == len(order) > 1 else term.scale
        clip = term.clip
        if clip is not None and clip.shape[1] == len(order) > 1:
            clip = clip[:, order]
        return replace(term, scale=scale, clip=clip)

    clip = None if action.clip is None else action.clip[:, at]
    changed = replace(
        action, joints=tuple(moved), scale=action.scale[at], offset=action.offset[at], clip=clip
    )
    return replace(
        with_terms(contract, per_joint),
        joints=tuple(names),
        default_joint_pos=contract.default_joint_pos[index],
        stiffness=contract.stiffness[index],
        damping=contract.damping[index],
        action=changed,
    )


def _scales(contract: PolicyContract) -> Perturbation:
    scaled = [term.name for term in contract.terms if (np.abs(term.scale) != 1.0).any()]
    if scaled:
        broken = with_terms(contract, lambda term: replace(term, scale=np.sign(term.scale)))
        return Perturbation("observation scales left out", "observation scales", broken)
    if not contract.terms:
        why = "the network takes states one by one"
        return Perturbation("observation scales left out", "observation scales", None, why)
    broken = with_terms(contract, lambda term: replace(term, scale=2.0 * term.scale))
    name = "observation scales doubled (all are 1)"
    return Perturbation(name, "observation scales", broken, unlikely=True)


def _left_right(contract: PolicyContract) -> Perturbation:
    pairs = mirror_pairs(contract.joints)
    name, culprit = "left and right joints exchanged", "joint order"
    if not pairs:
        return Perturbation(name, culprit, None, "no joint names tell left from right")
    other = dict(pairs) | {b: a for a, b in pairs}
    names = [other.get(joint, joint) for joint in contract.joints]
    return Perturbation(name, culprit, renamed(contract, names))


def _gravity(contract: PolicyContract) -> Perturbation:
    name, culprit = "gravity upside down", "sign of projected_gravity"
    if not any(term.state == "projected_gravity" for term in contract.terms):
        return Perturbation(name, culprit, None, "no term reads projected_gravity")

    def flip(term: ObservationTerm) -> ObservationTerm:
        if term.state != "projected_gravity":
            return term
        return replace(term, scale=-term.scale)

    return Perturbation(name, culprit, with_terms(contract, flip))


def _order(contract: PolicyContract, depths: Sequence[int]) -> Perturbation:
    name, culprit = "joint order of the other kind of simulator", "joint order"
    other = other_order(depths)
    names = [contract.joints[i] for i in other]
    if names == list(contract.joints):
        why = "breadth-first and depth-first are the same for these joints"
        return Perturbation(name, culprit, None, why)
    return Perturbation(name, culprit, renamed(contract, names))


def other_order(depths: Sequence[int]) -> NDArray[np.intp]:
    """Return the breadth-first order of joints given depth-first, and the inverse otherwise.

    Isaac Sim lists joints breadth-first (all hips, then all knees), MuJoCo and the vendors
    depth-first (leg by leg).

    Args:
        depths: in the kinematic tree, in the given order, shape (n,).
    """
    order = np.argsort(np.asarray(depths), kind="stable")
    if (np.diff(depths) >= 0).all():  # breadth-first already: back to a limb at a time
        count = max(1, int((np.asarray(depths) == depths[0]).sum()))
        order = np.concatenate([np.arange(limb, len(depths), count) for limb in range(count)])
    return order.astype(np.intp)


def _gains(contract: PolicyContract, depths: Sequence[int]) -> Perturbation:
    name, culprit = "gains in another order", "gains"
    order = other_order(depths)
    stiffness, damping = contract.stiffness[order], contract.damping[order]
    if _same(stiffness, contract.stiffness) and _same(damping, contract.damping):
        order = order[::-1]
        stiffness, damping = contract.stiffness[order], contract.damping[order]
    if _same(stiffness, contract.stiffness) and _same(damping, contract.damping):
        return Perturbation(name, culprit, None, "all joints have the same gains")
    return Perturbation(name, culprit, replace(contract, stiffness=stiffness, damping=damping))


def _same(a: NDArray[np.float32], b: NDArray[np.float32]) -> bool:
    return bool(np.allclose(a, b, rtol=1e-3))
