"""Contracts as they would be without one of the usual mistakes, for telling why a policy falls.

Those that say otherwise what happens over time (clocks, filters, feedback, slew) stand last.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from unicon_core.check.joints import joint_orders, mirror_pairs, other_order
from unicon_core.check.twin.perturb import (
    Change,
    clock_reordered,
    exchanged,
    permuted,
    perturbations,
    renamed,
    with_terms,
)
from unicon_core.policies.contract import (
    ActionKind,
    FilterSpec,
    ObservationTerm,
    PhaseSpec,
    PolicyContract,
)
from unicon_core.policies.policy_states import policy_states
from unicon_core.robots import Robot, joint_index
from unicon_core.states import standard_states

_SCALES = (0.05, 0.25, 0.5, 2.0, 4.0, 20.0)  # of legged_gym, holosoma and Unitree, and inverses


def repairs(
    contract: PolicyContract,
    robot: Robot,
    depths: Sequence[int],
    poses: Mapping[str, Mapping[str, float]],
) -> Iterator[Change]:
    """Yield what a policy's contract might be if it were right, the likeliest first.

    Args:
        contract: the given one.
        robot: gives an order and gains to try.
        depths: of the policy's joints in the kinematic tree, shape (n,).
        poses: name to joint positions in [rad]: default poses to try.
    """
    broken = perturbations(contract, depths)  # most of them undo themselves
    yield from (change for change in broken if change.contract is not None)
    yield from delay_repairs(contract)
    yield from _orders(contract, robot, depths)
    yield from _gains(contract, robot, depths)
    yield Change("passive damping removed", "passive damping of the model", contract, undamped=True)
    yield from _actions(contract, robot, poses)
    yield from _terms(contract)
    yield from clock_repairs(contract)
    yield from filter_repairs(contract)
    yield Change("no limits of effort", "effort limits of the robot file", contract, unlimited=True)


def _orders(contract: PolicyContract, robot: Robot, depths: Sequence[int]) -> Iterator[Change]:
    joints, culprit = contract.joints, "joint order"
    orders = joint_orders(joints, robot, depths) | {
        "left and right joints exchanged": exchanged(joints, mirror_pairs(joints)),
        "front and rear legs exchanged": _front_and_rear(joints),
    }
    for left, right in mirror_pairs(joints):
        orders[f"{left} and {right} exchanged"] = exchanged(joints, [(left, right)])
    for name, order in orders.items():
        if len(order) == len(joints) and tuple(order) != joints:
            yield Change(f"{name} (names only)", culprit, renamed(contract, order))
            yield Change(name, culprit, permuted(contract, order))


def _front_and_rear(joints: Sequence[str]) -> list[str]:
    swaps = {"FL": "RL", "FR": "RR", "RL": "FL", "RR": "FR"}
    names = [swaps.get(name[:2], name[:2]) + name[2:] for name in joints]
    return names if set(names) == set(joints) else []


def _gains(contract: PolicyContract, robot: Robot, depths: Sequence[int]) -> Iterator[Change]:
    gains = np.stack((contract.stiffness, contract.damping))
    own = joint_index(contract.joints, robot.joint_names)
    tried = {
        "gains brought back from another order": gains[:, np.argsort(other_order(depths))],
        "gains in the reversed order": gains[:, ::-1],
        "stiffness and damping exchanged": gains[::-1],
        "the robot file's gains": np.stack((robot.joint_stiffness[own], robot.joint_damping[own])),
    }
    for factor in (0.1, 0.25, 4.0, 10.0):
        tried[f"stiffness times {factor:g}"] = gains * np.array([[factor], [1.0]], np.float32)
        tried[f"stiffness and damping times {factor:g}"] = gains * np.float32(factor)
    for factor in (0.25, 0.5, 2.0, 4.0):
        tried[f"damping times {factor:g}"] = gains * np.array([[1.0], [factor]], np.float32)
    for name, (stiffness, damping) in tried.items():
        if np.isfinite((stiffness, damping)).all():  # the robot file may not say them
            changed = replace(contract, stiffness=stiffness, damping=damping)
            yield Change(name, "gains", changed)


def _actions(
    contract: PolicyContract, robot: Robot, poses: Mapping[str, Mapping[str, float]]
) -> Iterator[Change]:
    action = contract.action
    for factor in (0.25, 0.5, 2.0, 4.0, -1.0):
        scaled = replace(contract, action=replace(action, scale=action.scale * np.float32(factor)))
        yield Change(f"action.scale times {factor:g}", "action.scale", scaled)
    swapped: dict[ActionKind, ActionKind] = {"velocity": "torque", "torque": "velocity"}
    if action.kinds:
        kinds = tuple(swapped.get(kind, kind) for kind in action.kinds)
        if kinds != action.kinds:
            turned = replace(contract, action=replace(action, kinds=kinds))
            own = joint_index(contract.joints, robot.joint_names)
            limp = (contract.stiffness == 0.0) & (contract.damping == 0.0)
            damping = np.where(limp, robot.joint_damping[own], contract.damping)
            if np.isfinite(damping).all():  # a velocity is followed by damping alone
                turned = replace(turned, damping=damping.astype(np.float32))
            yield Change("velocities and torques exchanged", "action.kind", turned)
    for name, pose in poses.items():
        default = np.array([pose[joint] for joint in contract.joints], np.float32)
        offset = np.array([pose[joint] for joint in action.joints], np.float32)
        if np.isfinite(default).all():
            offset = np.where(action.of_kind("position"), offset, action.offset)
            moved = replace(action, offset=offset)
            changed = replace(contract, default_joint_pos=default, action=moved)
            yield Change(name, "default_joint_pos", changed)


def _terms(contract: PolicyContract) -> Iterator[Change]:
    """Yield other orders of the terms, each term changed, and other layouts of their histories."""
    terms, observation = contract.terms, contract.observation

    def changed(name: str, part: str, places: Mapping[int, ObservationTerm]) -> Change:
        new = (places.get(i, term) for i, term in enumerate(terms))
        return Change(name, f"observation.terms, {part}", with_terms(contract, new))

    own = policy_states(with_terms(contract, ()), contract.joints)
    sizes = {**standard_states(contract.joints), **own}

    def width(term: ObservationTerm) -> int:
        """Elements of a term, 0 where its state is one of the workflow's own."""
        if term.index is not None:
            return len(term.index)
        return sizes[term.state].size if term.state in sizes else 0

    alphabetical = sorted(terms, key=lambda term: term.name)
    if tuple(alphabetical) != terms:  # holosoma sorts its terms by name
        yield changed("terms in alphabetical order", "their order", dict(enumerate(alphabetical)))
    for (i, a), (j, b) in combinations(enumerate(terms), 2):
        if 0 < width(a) == width(b) and a.history == b.history:
            both = f"{a.name!r} and {b.name!r}"
            yield changed(f"terms {both} exchanged", f"order of {both}", {i: b, j: a})
    for i, term in enumerate(terms):
        name = repr(term.name)
        if term.state == "joint_pos":
            absolute = term.subtract is None
            how = "relative to the default pose" if absolute else "absolute"
            moved = replace(term, subtract="default_joint_pos" if absolute else None)
            yield changed(f"term {name} {how}", f"subtract of {name}", {i: moved})
        elif term.subtract is not None:
            bare = replace(term, subtract=None)
            yield changed(f"nothing subtracted from {name}", f"subtract of {name}", {i: bare})
        if term.state == "motion_command":
            half, size = width(term) // 2, width(term)
            places = range(size) if term.index is None else term.index
            behind = replace(term, index=(*places[half:], *places[:half]))
            what = f"positions and velocities of {name} exchanged"
            yield changed(what, f"order within {name}", {i: behind})
        if term.state != "projected_gravity":  # which perturbations turns over
            flipped = replace(term, scale=-term.scale)
            yield changed(f"the other sign of term {name}", f"sign of {name}", {i: flipped})
        for factor in _SCALES:
            scaled = replace(term, scale=term.scale * np.float32(factor))
            what = f"the scale of term {name} times {factor:g}"
            yield changed(what, f"scale of {name}", {i: scaled})
    usual = {"base_ang_vel": 0.25, "joint_vel": 0.05}
    usually = (replace(t, scale=np.full(1, usual.get(t.state, 1.0), np.float32)) for t in terms)
    yield Change(
        "the usual scales (angular velocity 0.25, joint velocity 0.05)",
        "observation scales",
        with_terms(contract, usually),
    )
    if any(term.history > 1 for term in terms):
        newest: Any = "first" if observation.newest == "last" else "last"
        turned = replace(contract, observation=replace(observation, newest=newest))
        yield Change(f"the newest frame {newest}", "observation.newest", turned)
        layout: Any = "frame_major" if observation.layout == "term_major" else "term_major"
        if len({term.history for term in terms}) == 1:
            turned = replace(contract, observation=replace(observation, layout=layout))
            yield Change(f"histories {layout}", "observation.layout", turned)


ALPHAS = (0.2, 0.5, 0.8)
"""Weights of the newest action that are tried where no filter is said: of programs' habits."""


def clock_repairs(contract: PolicyContract) -> Iterator[Change]:
    """Yield other gait clocks: their order, offsets, period and direction."""
    phase = contract.phase
    if phase is None or not any(t.state.startswith("gait_phase") for t in contract.terms):
        return
    count = len(phase.offsets)
    each = [k + half for k in range(count) for half in (0, count)]
    if count > 1:  # sine and cosine of one leg, then of the other
        yield Change(
            "sine and cosine of each leg side by side",
            "order of sines and cosines",
            clock_reordered(contract, each),
        )
    even = tuple(2.0 * np.pi * k / count for k in range(count))
    offsets = {
        "its offsets in turns": tuple(2.0 * np.pi * x for x in phase.offsets),
        "its offsets in degrees": tuple(np.radians(phase.offsets)),
        "its offsets spread evenly": even,
        "its offsets all 0": (0.0,) * count,
        "its offsets reversed": phase.offsets[::-1],
    }
    for name, values in offsets.items():
        if not np.allclose(np.cos(values), np.cos(phase.offsets), atol=1e-3):
            yield _changed(contract, name, "phase.offsets", replace(phase, offsets=values))
    for factor in (0.5, 2.0):
        changed = replace(phase, period=phase.period * factor)
        yield _changed(contract, f"its period times {factor:g}", "phase.period", changed)


def delay_repairs(contract: PolicyContract) -> Iterator[Change]:
    """Yield the contract with actions as early as a child can give them."""
    child = contract.child
    if child is not None and child.delay > 1:
        early = replace(contract, child=replace(child, delay=1))
        yield Change("child.delay 1", "child.delay", early)


def filter_repairs(contract: PolicyContract) -> Iterator[Change]:
    """Yield other filters of action and terms, other feedback, and commands without a slew."""
    action, said = contract.action, contract.action.filter
    if said is not None or action.clip is not None:
        for word in ("raw", "clipped", *(("filtered",) if said is not None else ())):
            if word != action.feedback:
                fed = replace(action, feedback=word)
                changed = replace(contract, action=fed)
                yield Change(f"action.feedback {word}", "action.feedback", changed)
    for name, other in _others(said):
        fed = replace(action, filter=other)
        if other is None and action.feedback == "filtered":
            fed = replace(fed, feedback="clipped")
        yield Change(f"action.filter {name}", "action.filter", replace(contract, action=fed))
    for alpha in ALPHAS if said is None else ():
        spec = FilterSpec(alpha=alpha, start="zeros")
        for word in (action.feedback, "filtered"):
            fed = replace(action, filter=spec, feedback=word)
            name = f"an action.filter of alpha {alpha:g}, feedback {word}"
            yield Change(name, "action.filter", replace(contract, action=fed))
    for i, term in enumerate(contract.terms):
        for name, other in _others(term.filter):
            terms = [*contract.terms[:i], replace(term, filter=other), *contract.terms[i + 1 :]]
            name = f"the filter of term {term.name!r} {name}"
            yield Change(name, f"filter of term {term.name!r}", with_terms(contract, terms))
    if contract.command is not None:
        unslewed = replace(contract, command=None)
        yield Change("a command without slew", "command.slew", unslewed)


def _others(said: FilterSpec | None) -> Sequence[tuple[str, FilterSpec | None]]:
    """Return other filters than the one that is said: how, and which."""
    if said is None:
        return []
    found: list[tuple[str, FilterSpec | None]] = [("left out", None)]
    if said.alpha is not None and said.alpha < 1.0:
        found.append(("of 1 − alpha", replace(said, alpha=1.0 - said.alpha)))
    if said.low_pass is not None:
        factors = {"a quarter": 0.25, "four times": 4.0, "1 / 2π": 0.5 / np.pi, "2π": 2.0 * np.pi}
        for name, factor in factors.items():
            frequency = said.low_pass * factor
            found.append((f"of {name} the cut-off", replace(said, low_pass=frequency)))
    return found


def _changed(contract: PolicyContract, name: str, culprit: str, phase: PhaseSpec) -> Change:
    return Change(f"the gait clock, {name}", culprit, replace(contract, phase=phase))
