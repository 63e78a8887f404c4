"""Changed contracts of a policy, and what its contract would be after one of the usual mistakes.

The twin and the diagnosis share the changes: the twin runs them, and the diagnosis asks a record
which of them made it.

Each perturbation is a fault that users of deployment tools met: observation scales left out, left
and right exchanged, gravity upside down, the joint order of another simulator, gains in another
order. A contract that is as good when it is broken like that was probably not right before.

`rivals` are those under which a walk does not fall: a policy that was trained over varied robots
bears half and twice its damping, period and gait clock. Where one of them walks clearly better it
is a finding; where none does, the walk says nothing about them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from unicon_base import AnyDict
from unicon_base.arrays import Array, Float64
from unicon_core.check.gains import counted_twice
from unicon_core.check.joints import mirror_pairs, other_order
from unicon_core.check.subject import listed
from unicon_core.policies.contract import ObservationTerm, PolicyContract
from unicon_core.robots import Robot, joint_index

JOINTS, GAINS, CLOCK = "joint order", "gains", "order of sines and cosines"
"""Culprits of many changes."""
TERMS = "observation.terms, "
"""How those of terms begin."""
SIDES = "left and right joints exchanged"
GAIT = "phase.period"
"""Culprit of a clock that is too fast or too slow. With one too fast a policy may follow its
command as well, in more and quicker steps: the rate of its targets tells."""
_KINDS = {
    CLOCK: "clock_order",
    GAIT: "clock_period",
    "phase.offsets": "clock_offsets",
    "observation.newest": "history_order",
    "observation.layout": "history_layout",
    "default_joint_pos": "default_pose",
    "their order": "term_order",
    "sign": "observation_sign",
    "scale": "observation_scale",
    "clip": "observation_clip",
    "order": "term_order",
}


@dataclass(frozen=True)
class Change:
    """One changed contract, broken or mended: what the twin runs, and a diagnosis supposes.

    Attributes:
        name: what was changed, as a phrase to follow "with".
        culprit: the part of the contract that it concerns.
        contract: the changed contract, or None where it is as given.
        reason: why there is none where the change changes nothing.
        unlikely: nobody makes this mistake; that a policy bears it is worth a note.
        without: what the simulator does without, by the name of its method: `unlimited` lifts
            limits of effort, `undamped` takes the joints' own damping away, `locked` welds joints.
        locked: joints of the model that stand still.
        evidence: what the model shows by itself for this change; "" where only the run speaks for
            it.
        remedy: what to do, "" for comparing the culprit with the training side.
        size: factor or figure, NaN where there is none.
        spread: half of the 95 % interval of `size`.
        unit: of both.
        figures: how many were fitted to a record.
        feeds: state to what the policy saw in place of the recorded values, shape (ticks, …).
        delay: ticks by which the policy saw its sensors late.
    """

    name: str
    culprit: str
    contract: PolicyContract | None
    reason: str = ""
    unlikely: bool = False
    without: Literal["", "unlimited", "undamped", "locked"] = ""
    locked: tuple[str, ...] = ()
    evidence: str = ""
    remedy: str = ""
    size: float = float("nan")
    spread: float = 0.0
    unit: str = ""
    figures: int = 0
    feeds: Mapping[str, Array] = field(default_factory=dict)
    delay: int = 0

    @property
    def because(self) -> str:
        """The evidence, to follow a sentence; "" for none."""
        return f" ({self.evidence})" if self.evidence else ""

    @property
    def place(self) -> tuple[str, str]:
        """Kind and place of the culprit as a diagnosis names them, such as `joint_order` and ""."""
        part = self.culprit.removeprefix(TERMS)
        if part == JOINTS:
            if pair := re.match(r"(\S+ and \S+) exchanged", self.name):
                return "joint_exchange", pair[1]
            return "left_right" if self.name.startswith("left and right") else "joint_order", ""
        what, _, where = (part, "", "") if part in _KINDS else part.partition(" of ")
        return _KINDS.get(what, re.sub(r"\W+", "_", what)), re.sub("^term |'", "", where)


AS_GIVEN = Change("", "", None)
"""Nothing is changed."""


def field_changed(
    contract: PolicyContract, name: str, path: str, value: Any, **more: Any
) -> Change:
    """Return a change of one field.

    Args:
        contract: the given one.
        name: of the change.
        path: of the field, dotted, which is the culprit too.
        value: the new one.
        more: attributes of the change.
    """

    def put(part: Any, path: str) -> Any:
        key, _, rest = path.partition(".")
        return replace(part, **{key: put(getattr(part, key), rest) if rest else value})

    return Change(name, path, put(contract, path), **more)


def perturbations(contract: PolicyContract, depths: Sequence[int]) -> list[Change]:
    """Return the broken contracts of a policy.

    Args:
        contract: the given one.
        depths: how far down the kinematic tree each of the policy's joints stands, shape (n,).
    """
    joints, phase, other = contract.joints, contract.phase, other_order(depths)
    pairs, order = mirror_pairs(joints), [joints[i] for i in other]
    alike = "breadth-first and depth-first are the same for these joints"

    def unless(reason: str, name: str, culprit: str, broken: PolicyContract, **more: Any) -> Change:
        return Change(name, culprit, None if reason else broken, reason, **more)

    def unread(state: str) -> str:
        read = any(term.state.startswith(state) for term in contract.terms)
        return "" if read else f"no term reads {state}"

    def turned(term: ObservationTerm) -> Array:
        return -term.scale if term.state == "projected_gravity" else term.scale

    changes = [
        _scales(contract),
        unless(
            "" if pairs else "no joint names tell left from right",
            SIDES,
            JOINTS,
            renamed(contract, exchanged(joints, pairs)),
        ),
        unless(
            unread("projected_gravity"),
            "gravity upside down",
            "sign of projected_gravity",
            with_scales(contract, turned),
            size=-1.0,
        ),
        unless(
            alike if order == list(joints) else "",
            "joint order of the other kind of simulator",
            JOINTS,
            renamed(contract, order),
        ),
        _gains(contract, other),
    ]
    if phase is not None:
        count = len(phase.offsets)
        swapped = clock_reordered(contract, [*range(count, 2 * count), *range(count)])
        name = "sines and cosines of the gait clock exchanged"
        changes.append(unless(unread("gait_phase"), name, CLOCK, swapped))
    return changes


def _scales(contract: PolicyContract) -> Change:
    name, culprit, terms = "observation scales left out", "observation scales", contract.terms
    if not terms:
        return Change(name, culprit, None, "the network takes states one by one")
    scales = np.concatenate([np.abs(term.scale) for term in terms])
    if ((scales != 0.0) & (scales != 1.0)).any():  # 0 leaves an element out
        return Change(name, culprit, with_scales(contract, lambda term: np.sign(term.scale)))
    doubled = with_scales(contract, lambda term: 2.0 * term.scale)
    return Change("observation scales doubled (all are 1)", culprit, doubled, unlikely=True)


def _gains(contract: PolicyContract, order: Array) -> Change:
    gains, name = gains_of(contract), "gains in another order"
    for broken in (gains[:, order], gains[:, order[::-1]]):
        if not np.allclose(broken, gains, rtol=1e-3):
            return Change(name, GAINS, with_gains(contract, broken))
    return Change(name, GAINS, None, "all joints have the same gains")


def with_terms(contract: PolicyContract, terms: Iterable[ObservationTerm]) -> PolicyContract:
    """Return the contract with other observation terms."""
    return replace(contract, observation=replace(contract.observation, terms=tuple(terms)))


def with_term(contract: PolicyContract, place: int, **changes: Any) -> PolicyContract:
    """Return the contract with some fields of one observation term changed."""
    terms = [*contract.terms]
    terms[place] = replace(terms[place], **changes)
    return with_terms(contract, terms)


def with_scales(
    contract: PolicyContract, scale: Callable[[ObservationTerm], Array]
) -> PolicyContract:
    """Return the contract with other scales of its observation terms."""
    return with_terms(contract, (replace(term, scale=scale(term)) for term in contract.terms))


def with_action(contract: PolicyContract, **changes: Any) -> PolicyContract:
    """Return the contract with some fields of its action changed."""
    return replace(contract, action=replace(contract.action, **changes))


def gains_of(contract: PolicyContract) -> Array:
    """Return stiffness and damping of a contract, shape (2, n)."""
    return np.stack((contract.stiffness, contract.damping))


def with_gains(contract: PolicyContract, gains: Array) -> PolicyContract:
    """Return the contract with other gains, shape (2, n)."""
    return replace(contract, stiffness=gains[0], damping=gains[1])


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
    return with_action(replace(contract, joints=tuple(names)), joints=moved)


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
        per_joint = term.state.startswith("joint_") or term.state == "action"
        if term.index is not None or not per_joint:
            return term
        order = at if term.state == "action" else index
        each: AnyDict = {"scale": term.scale, "clip": term.clip}
        for name, values in each.items():
            if values is not None and values.shape[-1] == len(order) > 1:
                each[name] = values[..., order]
        return replace(term, **each)

    changed = with_action(
        with_terms(contract, map(reordered, contract.terms)),
        joints=tuple(moved),
        scale=action.scale[at],
        offset=action.offset[at],
        clip=None if action.clip is None else action.clip[:, at],
        kinds=tuple(action.kinds[i] for i in at) if action.kinds else (),
    )
    pose = contract.default_joint_pos[index]
    changed = replace(changed, joints=tuple(names), default_joint_pos=pose)
    return with_gains(changed, gains_of(contract)[:, index])


def clock_reordered(contract: PolicyContract, order: Sequence[int]) -> PolicyContract:
    """Return the contract with the elements of its gait clock in another order.

    Args:
        contract: with a clock of k phases.
        order: which of all sines, then all cosines stands at each place, length 2k.
    """
    count = len(order) // 2
    halves = {"gait_phase": order, "gait_phase_sin": order[:count], "gait_phase_cos": order[count:]}

    def reordered(term: ObservationTerm) -> ObservationTerm:
        if term.state not in halves:
            return term
        own = halves[term.state]
        index = tuple(own if term.index is None else (own[i] for i in term.index))
        return replace(term, state="gait_phase", index=index)

    return with_terms(contract, map(reordered, contract.terms))


USUAL = 0.02
"""Control period of nearly all published policies in [s]: any other one has to walk better."""


def rivals(contract: PolicyContract) -> Iterator[Change]:
    """Yield the contract with half and twice its damping, its period and that of its gait clock.

    Args:
        contract: the given one.
    """
    for factor in (0.5, 2.0):
        softer = contract.damping * np.float32(factor)
        yield field_changed(contract, f"damping times {factor:g}", "damping", softer)
        period = contract.period * factor
        usual = f"most policies have {USUAL:g} s" if np.isclose(period, USUAL) else ""
        name = f"a period of {period:g} s"
        yield field_changed(contract, name, "period", period, evidence=usual)
        if contract.phase is not None:
            period = contract.phase.period * factor
            yield field_changed(contract, f"a gait clock of {period:g} s", GAIT, period)


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
    if twice := counted_twice(contract, own):
        yield Change(
            "passive damping removed",
            "passive damping of the model",
            contract,
            without="undamped",
            evidence=twice,
            remedy=f"let the policy's damping replace it (platforms: {{{platform}: {{passive: "
            "replace}}), or correct <joint damping> of the model",
        )
    unseen = tuple(name for name in robot.joint_names if name not in contract.joints)
    if unseen:
        yield Change(
            "the other joints welded",
            "joints of the model that the policy does not know",
            contract,
            without="locked",
            locked=unseen,
            evidence=f"it neither moves nor sees {listed(unseen)}, {len(unseen)} of "
            f"{robot.num_joints} joints, which give way here",
            remedy="take the model that it was trained on, or hold these joints as stiffly",
        )
