"""Broken contracts: what a policy's contract would be after one of the usual mistakes.

Each is a fault that users of deployment tools met: observation scales left out, left and right
exchanged, gravity upside down, the joint order of another simulator, gains in another order. A
contract that is as good when it is broken like that was probably not right before.

`rivals` are those under which a walk does not fall: a policy that was trained over varied robots
bears half and twice its damping, period and gait clock. Where one of them walks clearly better it
is a finding; where none does, the walk says nothing about them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from unicon_core.check.joints import mirror_pairs, other_order
from unicon_core.policies.contract import ObservationTerm, PolicyContract
from unicon_core.robots import joint_index


@dataclass(frozen=True)
class Change:
    """One changed contract, broken or mended.

    Attributes:
        name: what was changed, as a phrase to follow "with".
        culprit: the part of the contract that it concerns.
        contract: the changed contract, or None where the change changes nothing.
        reason: why there is none.
        unlikely: nobody makes this mistake; that a policy bears it is worth a note.
        unlimited: whether limits of effort are lifted.
        undamped: whether the joints of the model do without their own damping.
        locked: joints of the model that stand still as if they were welded.
        varied: trained policies bear it, as training varies it: only a gain tells.
        evidence: what the model shows by itself for this change; "" where only the run speaks for
            it.
        remedy: what to do, "" for comparing the culprit with the training side.
    """

    name: str
    culprit: str
    contract: PolicyContract | None
    reason: str = ""
    unlikely: bool = False
    unlimited: bool = False
    undamped: bool = False
    locked: tuple[str, ...] = ()
    varied: bool = False
    evidence: str = ""
    remedy: str = ""


AS_GIVEN = Change("", "", None)
"""Nothing is changed."""


def perturbations(contract: PolicyContract, depths: Sequence[int]) -> list[Change]:
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
        *([_clock(contract)] if contract.phase is not None else []),
    ]


def with_terms(contract: PolicyContract, terms: Iterable[ObservationTerm]) -> PolicyContract:
    """Return the contract with other observation terms."""
    return replace(contract, observation=replace(contract.observation, terms=tuple(terms)))


def per_joint(term: ObservationTerm) -> bool:
    """Return whether a term has one element for each joint, where it takes no elements by index."""
    return term.state.startswith("joint_") or term.state == "action"


def exchanged(joints: Sequence[str], pairs: Sequence[tuple[str, str]]) -> list[str]:
    """Return joint names with those of each pair in each other's place."""
    other = dict(pairs) | {b: a for a, b in pairs}
    return [other.get(joint, joint) for joint in joints]


def renamed(contract: PolicyContract, names: Sequence[str]) -> PolicyContract:
    """Return the contract with other joint names on the same places of network and figures.

    Args:
        contract: the given one.
        names: the new names of `contract.joints`, one by one.
    """
    renamed = dict(zip(contract.joints, names))
    moved = tuple(renamed[name] for name in contract.action.joints)
    action = replace(contract.action, joints=moved)
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

    def reordered(term: ObservationTerm) -> ObservationTerm:
        if term.index is not None or not per_joint(term):
            return term
        order = at if term.state == "action" else index
        scale = term.scale[order] if term.scale.size == len(order) > 1 else term.scale
        clip = term.clip
        if clip is not None and clip.shape[1] == len(order) > 1:
            clip = clip[:, order]
        return replace(term, scale=scale, clip=clip)

    clip = None if action.clip is None else action.clip[:, at]
    changed = replace(
        action,
        joints=tuple(moved),
        scale=action.scale[at],
        offset=action.offset[at],
        clip=clip,
        kinds=tuple(action.kinds[i] for i in at) if action.kinds else (),
    )
    return replace(
        with_terms(contract, map(reordered, contract.terms)),
        joints=tuple(names),
        default_joint_pos=contract.default_joint_pos[index],
        stiffness=contract.stiffness[index],
        damping=contract.damping[index],
        action=changed,
    )


def _scales(contract: PolicyContract) -> Change:
    name, culprit, terms = "observation scales left out", "observation scales", contract.terms
    if not terms:
        return Change(name, culprit, None, "the network takes states one by one")
    scales = np.concatenate([np.abs(term.scale) for term in terms])
    if ((scales != 0.0) & (scales != 1.0)).any():  # 0 leaves an element out
        plain = (replace(term, scale=np.sign(term.scale)) for term in terms)
        return Change(name, culprit, with_terms(contract, plain))
    name = "observation scales doubled (all are 1)"
    doubled = (replace(term, scale=2.0 * term.scale) for term in terms)
    return Change(name, culprit, with_terms(contract, doubled), unlikely=True)


def _left_right(contract: PolicyContract) -> Change:
    pairs = mirror_pairs(contract.joints)
    name, culprit = "left and right joints exchanged", "joint order"
    if not pairs:
        return Change(name, culprit, None, "no joint names tell left from right")
    return Change(name, culprit, renamed(contract, exchanged(contract.joints, pairs)))


def _gravity(contract: PolicyContract) -> Change:
    name, culprit = "gravity upside down", "sign of projected_gravity"
    if not any(term.state == "projected_gravity" for term in contract.terms):
        return Change(name, culprit, None, "no term reads projected_gravity")
    flipped = (
        replace(term, scale=-term.scale) if term.state == "projected_gravity" else term
        for term in contract.terms
    )
    return Change(name, culprit, with_terms(contract, flipped))


def clock_reordered(contract: PolicyContract, order: Sequence[int]) -> PolicyContract:
    """Return the contract with the elements of its gait clock in another order.

    Args:
        contract: with a clock of k phases.
        order: which of all sines, then all cosines stands at each place, length 2k.
    """
    count = len(order) // 2
    halves = {"gait_phase": (0, 2 * count), "gait_phase_sin": (0, count)}
    halves["gait_phase_cos"] = (count, count)

    def reordered(term: ObservationTerm) -> ObservationTerm:
        if term.state not in halves:
            return term
        start, size = halves[term.state]
        places = range(size) if term.index is None else term.index
        index = tuple(order[start + i] for i in places)
        return replace(term, state="gait_phase", index=index)

    return with_terms(contract, map(reordered, contract.terms))


def _clock(contract: PolicyContract) -> Change:
    name, culprit = "sines and cosines of the gait clock exchanged", "order of sines and cosines"
    count = len(contract.phase.offsets) if contract.phase is not None else 0
    if not any(term.state.startswith("gait_phase") for term in contract.terms):
        return Change(name, culprit, None, "no term reads gait_phase")
    order = [*range(count, 2 * count), *range(count)]
    return Change(name, culprit, clock_reordered(contract, order))


def _order(contract: PolicyContract, depths: Sequence[int]) -> Change:
    name, culprit = "joint order of the other kind of simulator", "joint order"
    other = other_order(depths)
    names = [contract.joints[i] for i in other]
    if names == list(contract.joints):
        why = "breadth-first and depth-first are the same for these joints"
        return Change(name, culprit, None, why)
    return Change(name, culprit, renamed(contract, names))


def _gains(contract: PolicyContract, depths: Sequence[int]) -> Change:
    name, culprit = "gains in another order", "gains"
    gains = np.stack((contract.stiffness, contract.damping))
    order = other_order(depths)
    for stiffness, damping in (gains[:, order], gains[:, order[::-1]]):
        if not np.allclose((stiffness, damping), gains, rtol=1e-3):
            broken = replace(contract, stiffness=stiffness, damping=damping)
            return Change(name, culprit, broken, varied=True)
    return Change(name, culprit, None, "all joints have the same gains")


GAIT = "phase.period"
"""Culprit of a clock that is too fast or too slow. With one too fast a policy may follow its
command as well, in more and quicker steps: the rate of its targets tells."""


def rivals(contract: PolicyContract) -> Iterator[Change]:
    """Yield the contract with half and twice its damping, its period and that of its gait clock.

    Args:
        contract: the given one.
    """
    for factor in (0.5, 2.0):
        softer = replace(contract, damping=contract.damping * np.float32(factor))
        yield Change(f"damping times {factor:g}", "damping", softer)
        slower = replace(contract, period=contract.period * factor)
        yield Change(f"a period of {slower.period:g} s", "period", slower)
        if contract.phase is not None:
            clock = replace(contract.phase, period=contract.phase.period * factor)
            what = f"a gait clock of {clock.period:g} s"
            yield Change(what, GAIT, replace(contract, phase=clock))
