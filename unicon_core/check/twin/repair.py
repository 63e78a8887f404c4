"""Contracts as they would be without one of the usual mistakes, for telling why a policy falls.

Those that say otherwise what happens over time (clocks, filters, feedback, slew) stand last.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from unicon_core.check.joints import joint_orders, mirror_pairs, other_order, robot_values
from unicon_core.check.twin.perturb import (
    Change,
    clock_reordered,
    exchanged,
    gains_of,
    permuted,
    perturbations,
    renamed,
    with_action,
    with_gains,
    with_scales,
    with_terms,
)
from unicon_core.policies.contract import FilterSpec, ObservationTerm, PolicyContract
from unicon_core.policies.policy_states import policy_states
from unicon_core.robots import Robot
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
    child = contract.child
    if child is not None and child.delay > 1:  # actions as early as a child can give them
        early = replace(contract, child=replace(child, delay=1))
        yield Change("child.delay 1", "child.delay", early)
    yield from _orders(contract, robot, depths)
    yield from _gains(contract, robot, depths)
    yield Change("passive damping removed", "passive damping of the model", contract, undamped=True)
    yield from _actions(contract, robot, poses)
    yield from _terms(contract)
    yield from _clocks(contract)
    yield from filter_repairs(contract)
    yield Change("no limits of effort", "effort limits of the robot file", contract, unlimited=True)


def _orders(contract: PolicyContract, robot: Robot, depths: Sequence[int]) -> Iterator[Change]:
    joints, pairs = contract.joints, mirror_pairs(contract.joints)
    legs = {"FL": "RL", "FR": "RR", "RL": "FL", "RR": "FR"}
    orders = joint_orders(joints, robot, depths) | {
        "left and right joints exchanged": exchanged(joints, pairs),
        "front and rear legs exchanged": [legs.get(n[:2], n[:2]) + n[2:] for n in joints],
    }
    orders |= {f"{a} and {b} exchanged": exchanged(joints, [(a, b)]) for a, b in pairs}
    for name, order in orders.items():
        if sorted(order) == sorted(joints) and tuple(order) != joints:
            yield Change(f"{name} (names only)", "joint order", renamed(contract, order))
            yield Change(name, "joint order", permuted(contract, order))


def _gains(contract: PolicyContract, robot: Robot, depths: Sequence[int]) -> Iterator[Change]:
    gains = gains_of(contract)
    known = robot_values(robot, contract.joints, "joint_stiffness", "joint_damping")
    tried = {
        "gains brought back from another order": gains[:, np.argsort(other_order(depths))],
        "gains in the reversed order": gains[:, ::-1],
        "stiffness and damping exchanged": gains[::-1],
        "the robot file's gains": np.array(known, np.float32),
    }
    stiffer, softer = np.array([[[1.0], [0.0]], [[0.0], [1.0]]], np.float32)
    for k in (0.1, 0.25, 4.0, 10.0):
        tried[f"stiffness times {k:g}"] = gains * (np.float32(k) * stiffer + softer)
        tried[f"stiffness and damping times {k:g}"] = gains * np.float32(k)
    for k in (0.25, 0.5, 2.0, 4.0):
        tried[f"damping times {k:g}"] = gains * (stiffer + np.float32(k) * softer)
    for name, changed in tried.items():
        if np.isfinite(changed).all():  # the robot file may not say them
            yield Change(name, "gains", with_gains(contract, changed))


def _actions(
    contract: PolicyContract, robot: Robot, poses: Mapping[str, Mapping[str, float]]
) -> Iterator[Change]:
    action = contract.action
    for factor in (0.25, 0.5, 2.0, 4.0, -1.0):
        scaled = with_action(contract, scale=action.scale * np.float32(factor))
        yield Change(f"action.scale times {factor:g}", "action.scale", scaled)
    swapped = {"velocity": "torque", "torque": "velocity", "position": "position"}
    kinds = tuple(swapped[kind] for kind in action.kinds)
    if kinds != action.kinds:
        turned = with_action(contract, kinds=kinds)
        limp = (contract.stiffness == 0.0) & (contract.damping == 0.0)
        (known,) = robot_values(robot, contract.joints, "joint_damping")
        damping = np.where(limp, known, contract.damping)
        if np.isfinite(damping).all():  # a velocity is followed by damping alone
            turned = replace(turned, damping=damping.astype(np.float32))
        yield Change("velocities and torques exchanged", "action.kind", turned)
    for name, pose in poses.items():
        default, offset = (
            np.array([pose[joint] for joint in joints], np.float32)
            for joints in (contract.joints, action.joints)
        )
        if np.isfinite(default).all():
            offset = np.where(action.of_kind("position"), offset, action.offset)
            changed = with_action(replace(contract, default_joint_pos=default), offset=offset)
            yield Change(name, "default_joint_pos", changed)


def _terms(contract: PolicyContract) -> Iterator[Change]:
    """Yield other orders of the terms, each term changed, and other layouts of their histories."""
    terms, observation = contract.terms, contract.observation

    def changed(name: str, part: str, places: Mapping[int, ObservationTerm]) -> Change:
        new = (places.get(i, term) for i, term in enumerate(terms))
        return Change(name, f"observation.terms, {part}", with_terms(contract, new))

    own = policy_states(with_terms(contract, ()), contract.joints)
    sizes = {name: spec.size for name, spec in (standard_states(contract.joints) | own).items()}
    # Elements of each term, 0 where its state is one of the workflow's own.
    widths = [len(t.index) if t.index is not None else sizes.get(t.state, 0) for t in terms]
    alphabetical = sorted(terms, key=lambda term: term.name)
    if tuple(alphabetical) != terms:  # holosoma sorts its terms by name
        yield changed("terms in alphabetical order", "their order", dict(enumerate(alphabetical)))
    for (i, a), (j, b) in combinations(enumerate(terms), 2):
        if 0 < widths[i] == widths[j] and a.history == b.history:
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
            half = widths[i] // 2
            places = range(widths[i]) if term.index is None else term.index
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
    yield Change(
        "the usual scales (angular velocity 0.25, joint velocity 0.05)",
        "observation scales",
        with_scales(contract, lambda t: np.full(1, usual.get(t.state, 1.0), np.float32)),
    )
    lengths = {term.history for term in terms}
    others = {"newest": ("first", "last"), "layout": ("frame_major", "term_major")}
    names = {"newest": "the newest frame", "layout": "histories"}
    for key, choices in others.items() if lengths - {1} else ():
        if key == "newest" or len(lengths) == 1:
            other = next(word for word in choices if word != getattr(observation, key))
            turned = replace(contract, observation=replace(observation, **{key: other}))  # type: ignore[arg-type]
            yield Change(f"{names[key]} {other}", f"observation.{key}", turned)


ALPHAS = (0.2, 0.5, 0.8)
"""Weights of the newest action that are tried where no filter is said: of programs' habits."""


def _clocks(contract: PolicyContract) -> Iterator[Change]:
    """Yield other gait clocks: their order, offsets, period and direction."""
    phase = contract.phase
    if phase is None or not any(t.state.startswith("gait_phase") for t in contract.terms):
        return
    count = len(phase.offsets)
    if count > 1:  # sine and cosine of one leg, then of the other
        yield Change(
            "sine and cosine of each leg side by side",
            "order of sines and cosines",
            clock_reordered(contract, [k + half for k in range(count) for half in (0, count)]),
        )
    clocks = {
        f"its offsets {how}": replace(phase, offsets=tuple(values))
        for how, values in {
            "in turns": 2.0 * np.pi * np.array(phase.offsets),
            "in degrees": np.radians(phase.offsets),
            "spread evenly": 2.0 * np.pi * np.arange(count) / count,
            "all 0": np.zeros(count),
            "reversed": np.array(phase.offsets[::-1]),
        }.items()
        if not np.allclose(np.cos(values), np.cos(phase.offsets), atol=1e-3)
    }
    for factor in (0.5, 2.0):
        clocks[f"its period times {factor:g}"] = replace(phase, period=phase.period * factor)
    for name, clock in clocks.items():
        culprit = "phase.period" if "period" in name else "phase.offsets"
        yield Change(f"the gait clock, {name}", culprit, replace(contract, phase=clock))


def filter_repairs(contract: PolicyContract) -> Iterator[Change]:
    """Yield other filters of action and terms, other feedback, and commands without a slew."""
    action, said = contract.action, contract.action.filter
    words = ["raw", "clipped"] if said is not None or action.clip is not None else []
    for word in (*words, *(["filtered"] if said is not None else [])):
        if word != action.feedback:
            fed = with_action(contract, feedback=word)
            yield Change(f"action.feedback {word}", "action.feedback", fed)
    for name, other in _others(said):
        unfed = other is None and action.feedback == "filtered"
        feedback = "clipped" if unfed else action.feedback
        changed = with_action(contract, filter=other, feedback=feedback)
        yield Change(f"action.filter {name}", "action.filter", changed)
    for alpha in ALPHAS if said is None else ():
        spec = FilterSpec(alpha=alpha, start="zeros")
        for word in (action.feedback, "filtered"):
            name = f"an action.filter of alpha {alpha:g}, feedback {word}"
            fed = with_action(contract, filter=spec, feedback=word)
            yield Change(name, "action.filter", fed)
    for i, term in enumerate(contract.terms):
        for name, other in _others(term.filter):
            terms = [*contract.terms[:i], replace(term, filter=other), *contract.terms[i + 1 :]]
            what = f"filter of term {term.name!r}"
            yield Change(f"the {what} {name}", what, with_terms(contract, terms))
    if contract.command is not None:
        unslewed = replace(contract, command=None)
        yield Change("a command without slew", "command.slew", unslewed)


def _others(said: FilterSpec | None) -> Iterator[tuple[str, FilterSpec | None]]:
    """Yield other filters than the one that is said: how, and which."""
    if said is None:
        return
    yield "left out", None
    if said.alpha is not None and said.alpha < 1.0:
        yield "of 1 − alpha", replace(said, alpha=1.0 - said.alpha)
    if said.low_pass is not None:
        factors = {"a quarter": 0.25, "four times": 4.0, "1 / 2π": 0.5 / np.pi, "2π": 2.0 * np.pi}
        for name, factor in factors.items():
            changed = replace(said, low_pass=said.low_pass * factor)
            yield f"of {name} the cut-off", changed
