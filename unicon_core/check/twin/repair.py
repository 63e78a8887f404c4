"""Contracts as they would be without one of the usual mistakes.

The twin runs them for telling why a policy falls, and a diagnosis for telling which contract made
a record. Those that say otherwise what happens over time (clocks, filters, feedback, slew) stand
last.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, pairwise, product

import numpy as np

from unicon_base import AnyDict
from unicon_base.arrays import Float64
from unicon_core.check.joints import (
    joint_depths,
    joint_orders,
    mirror_pairs,
    other_order,
    robot_values,
)
from unicon_core.check.twin.perturb import (
    CLOCK,
    GAINS,
    GAIT,
    JOINTS,
    SIDES,
    TERMS,
    Change,
    clock_reordered,
    exchanged,
    field_changed,
    gains_of,
    permuted,
    perturbations,
    renamed,
    with_action,
    with_gains,
    with_scales,
    with_term,
    with_terms,
)
from unicon_core.models.loaded import LoadedModel
from unicon_core.policies.contract import FilterSpec, ObservationTerm, PolicyContract
from unicon_core.policies.policy_states import policy_states
from unicon_core.robots import Robot, joint_index
from unicon_core.states import standard_states

_SCALES = (0.05, 0.25, 0.5, 2.0, 4.0, 20.0)  # of legged_gym, holosoma and Unitree, and inverses
_FEW = 16  # joints of which a record tells every pair
_ISAAC = ("base_lin_vel", "base_ang_vel", "projected_gravity", "velocity_command")
_NONE = float("nan")  # size


def repairs(
    contract: PolicyContract, robot: Robot, model: LoadedModel | None, *, recorded: bool = False
) -> Iterator[Change]:
    """Yield what a policy's contract might be if it were right, the likeliest first.

    Args:
        contract: the given one.
        robot: gives an order, gains and a pose to try.
        model: of the robot, gives orders and poses; None without.
        recorded: yield what a record of the policy tells: more than a walk does, but nothing of the
            model.
    """
    poses = {"the robot file's default pose": robot.default_joint_pos.astype(np.float64)}
    depths = [0] * len(contract.joints)
    if model is not None:
        depths = joint_depths(model, robot, contract.joints)
        keys = model.key_poses().items()
        poses |= {f"the pose of the model's key frame {key!r}": pose for key, pose in keys}
    broken = perturbations(contract, depths)  # most of them undo themselves
    yield from (change for change in broken if not change.reason)
    child = contract.child
    if child is not None and child.delay > 1:  # actions as early as a child can give them
        yield field_changed(contract, "child.delay 1", "child.delay", 1)
    yield from _orders(contract, robot, depths, recorded)
    yield from _gains(contract, robot, depths, recorded)
    if not recorded:
        culprit = "passive damping of the model"
        yield Change("passive damping removed", culprit, contract, without="undamped")
    yield from _actions(contract, robot, poses)
    yield from _terms(contract, recorded)
    yield from _clocks(contract)
    yield from filter_repairs(contract)
    if recorded:
        yield from _signs(contract)
    else:
        culprit = "effort limits of the robot file"
        yield Change("no limits of effort", culprit, contract, without="unlimited")


def _orders(
    contract: PolicyContract, robot: Robot, depths: Sequence[int], recorded: bool
) -> Iterator[Change]:
    joints, pairs = contract.joints, mirror_pairs(contract.joints)
    legs = {"FL": "RL", "FR": "RR", "RL": "FL", "RR": "FR"}
    orders = joint_orders(joints, robot, depths) | {
        SIDES: exchanged(joints, pairs),
        "front and rear legs exchanged": [legs.get(n[:2], n[:2]) + n[2:] for n in joints],
    }
    others = list[tuple[str, str]]()
    if recorded:
        orders["the alphabetical joint order"] = sorted(joints)
        each = combinations(joints, 2) if len(joints) <= _FEW else pairwise(joints)
        others = [(a, b) for a, b in each if not {(a, b), (b, a)} & {*pairs}]
    names = {f"{a} and {b} exchanged": exchanged(joints, [(a, b)]) for a, b in (*pairs, *others)}
    for k, (name, order) in enumerate((orders | names).items()):
        if sorted(order) == sorted(joints) and tuple(order) != joints:
            yield Change(f"{name} (names only)", JOINTS, renamed(contract, order))
            if k < len(orders) + len(pairs):
                yield Change(name, JOINTS, permuted(contract, order))


def _signs(contract: PolicyContract) -> Iterator[Change]:
    """Yield joints of the other sign."""
    joints, action = contract.joints, contract.action
    moved = joint_index(action.joints, joints)
    for joint, signs in zip(joints, 1.0 - 2.0 * np.eye(len(joints), dtype=np.float32)):
        seen = contract
        for i, term in enumerate(contract.terms):
            if term.state in ("joint_pos", "joint_vel"):
                own = signs if term.index is None else signs[[*term.index]]
                seen = with_term(seen, i, scale=term.scale * own)
        both = with_action(seen, scale=action.scale * signs[moved])
        for how, changed in (("", both), (" in the observation", seen)):
            name = f"the other sign of {joint}{how}"
            yield Change(name, f"joint sign of {joint}", changed, size=-1.0)


def _gains(
    contract: PolicyContract, robot: Robot, depths: Sequence[int], recorded: bool
) -> Iterator[Change]:
    gains, joints = gains_of(contract), contract.joints
    known = robot_values(robot, joints, "joint_stiffness", "joint_damping")
    tried = {
        "gains brought back from another order": gains[:, np.argsort(other_order(depths))],
        "gains in the reversed order": gains[:, ::-1],
        "stiffness and damping exchanged": gains[::-1],
        "the robot file's gains": np.array(known, np.float32),
    }
    if recorded:
        sides = joint_index(exchanged(joints, mirror_pairs(joints)), joints)
        tried["gains of left and right exchanged"] = gains[:, sides]
    else:
        for name, which in {
            "stiffness": [[True], [False]],
            "stiffness and damping": [[True], [True]],
            "damping": [[False], [True]],
        }.items():
            for k in (0.25, 0.5, 2.0, 4.0) if name == "damping" else (0.1, 0.25, 4.0, 10.0):
                tried[f"{name} times {k:g}"] = gains * np.where(which, k, 1.0).astype(np.float32)
    for name, changed in tried.items():
        if np.isfinite(changed).all():  # the robot file may not say them
            yield Change(name, GAINS, with_gains(contract, changed))


def _actions(
    contract: PolicyContract, robot: Robot, poses: Mapping[str, Float64]
) -> Iterator[Change]:
    action = contract.action
    for factor in (0.25, 0.5, 2.0, 4.0, -1.0):
        scaled, name = action.scale * np.float32(factor), f"action.scale times {factor:g}"
        yield field_changed(contract, name, "action.scale", scaled, size=factor)
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
            pose[joint_index(joints, robot.joint_names)].astype(np.float32)
            for joints in (contract.joints, action.joints)
        )
        if np.isfinite(default).all():
            offset = np.where(action.of_kind("position"), offset, action.offset)
            changed = with_action(replace(contract, default_joint_pos=default), offset=offset)
            yield Change(name, "default_joint_pos", changed)


def _terms(contract: PolicyContract, recorded: bool) -> Iterator[Change]:
    """Yield other orders of the terms, each term changed, and other layouts of their histories."""
    terms, observation = contract.terms, contract.observation
    own = policy_states(with_terms(contract, ()), contract.joints)
    sizes = {name: spec.size for name, spec in (standard_states(contract.joints) | own).items()}
    # Elements of each term, 0 where its state is one of the workflow's own.
    widths = [len(t.index) if t.index is not None else sizes.get(t.state, 0) for t in terms]
    # holosoma sorts its terms by name
    orders = {"terms in alphabetical order": sorted(terms, key=lambda term: term.name)}
    if recorded:
        usual = [*_ISAAC, *(t.state for t in terms)]
        orders["the terms in Isaac Lab's order"] = sorted(terms, key=lambda t: usual.index(t.state))
    for name, order in orders.items():
        if tuple(order) != terms:
            yield Change(name, f"{TERMS}their order", with_terms(contract, order))
    for (i, a), (j, b) in combinations(enumerate(terms), 2):
        alike = 0 < widths[i] == widths[j] and a.history == b.history
        if alike or (recorded and j == i + 1):
            both, order = f"{a.name!r} and {b.name!r}", [*terms]
            order[i], order[j] = b, a
            swapped = with_terms(contract, order)
            yield Change(f"terms {both} exchanged", f"{TERMS}order of {both}", swapped)
    for i, term in enumerate(terms):
        for name, part, size, values in _of_term(term, widths[i], recorded):
            changed = with_term(contract, i, **values)
            yield Change(name, f"{TERMS}{part} {term.name!r}", changed, size=size)
    common = {"base_ang_vel": 0.25, "joint_vel": 0.05}
    yield Change(
        "the usual scales (angular velocity 0.25, joint velocity 0.05)",
        "observation scales",
        with_scales(contract, lambda t: np.full(1, common.get(t.state, 1.0), np.float32)),
    )
    lengths = {term.history for term in terms}
    others = {"first": "last", "last": "first", "frame_major": "term_major"}
    for key, name in {"newest": "the newest frame", "layout": "histories"}.items():
        if lengths - {1} and (key == "newest" or len(lengths) == 1):
            other = others.get(getattr(observation, key), "frame_major")
            yield field_changed(contract, f"{name} {other}", f"observation.{key}", other)


def _of_term(
    term: ObservationTerm, width: int, recorded: bool
) -> Iterator[tuple[str, str, float, AnyDict]]:
    """Yield changes of one term, each as its name, the part, the size and the new fields."""
    what, name = f"term {term.name!r}", repr(term.name)
    absolute = term.subtract is None
    if absolute and term.state == "joint_pos":
        posed = {"subtract": "default_joint_pos"}
        yield f"{what} relative to the default pose", "subtract of", _NONE, posed
    elif not absolute:
        how = f"{what} absolute" if term.state == "joint_pos" else f"nothing subtracted from {name}"
        yield how, "subtract of", _NONE, {"subtract": None}
    if term.state == "motion_command":
        half, places = width // 2, range(width) if term.index is None else term.index
        behind = {"index": (*places[half:], *places[:half])}
        yield f"positions and velocities of {name} exchanged", "order within", _NONE, behind
    if term.state != "projected_gravity":  # which perturbations turns over
        yield f"the other sign of {what}", "sign of", -1.0, {"scale": -term.scale}
    scales = {f"the scale of {what} times {factor:g}": factor for factor in _SCALES}
    if recorded:
        scales |= {f"{what} in degrees": 180.0 / np.pi, f"{what} in radians": np.pi / 180.0}
        least = np.abs(term.scale).min(initial=np.inf, where=term.scale != 0.0)
        yield f"no scale of {what}", "scale of", float(1.0 / least), {"scale": np.sign(term.scale)}
    for name, factor in scales.items():
        yield name, "scale of", factor, {"scale": term.scale * np.float32(factor)}
    if recorded and term.clip is not None:
        yield f"no clip of {what}", "clip of", _NONE, {"clip": None}


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
            CLOCK,
            clock_reordered(contract, [k + half for k in range(count) for half in (0, count)]),
        )
    for how, values in {
        "in turns": 2.0 * np.pi * np.array(phase.offsets),
        "in degrees": np.radians(phase.offsets),
        "spread evenly": 2.0 * np.pi * np.arange(count) / count,
        "all 0": np.zeros(count),
        "reversed": np.array(phase.offsets[::-1]),
    }.items():
        if not np.allclose(np.cos(values), np.cos(phase.offsets), atol=1e-3):
            name = f"the gait clock, its offsets {how}"
            yield field_changed(contract, name, "phase.offsets", tuple(values))
    for factor in (0.5, 2.0):
        name = f"the gait clock, its period times {factor:g}"
        yield field_changed(contract, name, GAIT, phase.period * factor, size=factor)


def filter_repairs(contract: PolicyContract) -> Iterator[Change]:
    """Yield other filters of action and terms, other feedback, and commands without a slew."""
    action, said = contract.action, contract.action.filter
    words = ("raw", "clipped", "filtered") if said else ("raw", "clipped")
    for word in words if said or action.clip is not None else ():
        if word != action.feedback:
            yield field_changed(contract, f"action.feedback {word}", "action.feedback", word)
    for name, other in _others(said):
        feedback = "clipped" if not other and action.feedback == "filtered" else action.feedback
        changed = with_action(contract, filter=other, feedback=feedback)
        yield Change(f"action.filter {name}", "action.filter", changed)
    for alpha, word in product(() if said else ALPHAS, (action.feedback, "filtered")):
        name = f"an action.filter of alpha {alpha:g}, feedback {word}"
        fed = with_action(contract, filter=FilterSpec(alpha=alpha, start="zeros"), feedback=word)
        yield Change(name, "action.filter", fed)
    for i, term in enumerate(contract.terms):
        for name, other in _others(term.filter):
            what = f"filter of term {term.name!r}"
            yield Change(f"the {what} {name}", what, with_term(contract, i, filter=other))
    if contract.command is not None:
        yield Change("a command without slew", "command.slew", replace(contract, command=None))


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
            yield f"of {name} the cut-off", replace(said, low_pass=said.low_pass * factor)
