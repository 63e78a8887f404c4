"""Contracts as they would be without one of the usual mistakes, for telling why a policy falls."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from unicon_core.check.mirror import mirror_pairs
from unicon_core.check.order import joint_orders, other_order
from unicon_core.check.twin.over_time import clock_repairs, delay_repairs, filter_repairs
from unicon_core.check.twin.perturb import (
    Change,
    exchanged,
    permuted,
    perturbations,
    renamed,
    with_terms,
)
from unicon_core.policies.contract import ActionKind, ObservationTerm, PolicyContract
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
