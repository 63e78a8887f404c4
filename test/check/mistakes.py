"""Mistakes that people make in contracts: orders, gains, poses, scales, terms, metadata."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from drafts import GO2, Draft, breadth_first, swap

LEGS = 12  # the first joints of the G1: left leg, right leg


# -- mistakes that all of them can have ----------------------------------------------------------


def low_effort(draft: Draft) -> None:
    draft.effort_factor = 0.1


def two_rates(draft: Draft) -> None:
    draft.program["rate"] = 50
    if draft.policy == "mjlab":
        draft.deploy["step_dt"] = 0.01
    else:
        draft.given["period"] = 0.01


def other_network(draft: Draft) -> None:
    """The network was exported again and the contract was not."""
    digest = draft.given["sha256"]
    draft.given["sha256"] = digest[::-1]


def milliseconds(draft: Draft) -> None:
    if draft.policy == "mjlab":
        draft.deploy["step_dt"] = 20.0
    else:
        draft.given["period"] = 20.0


def no_collision(draft: Draft) -> None:
    """The feet's collision geometry is lost, as with meshes that were left out."""
    draft.model_changes['contype="0" conaffinity="1"'] = 'contype="0" conaffinity="0"'


def passive_damping(draft: Draft) -> None:
    """The model's joints have a multiple of the damping that the motors have besides."""
    old, new = {"go2": ("0.1", "6"), "go1": ("0.5", "3"), "mjlab": ("0.05", "15")}.get(
        draft.policy, ("0.05", "8")
    )
    draft.model_changes[f'damping="{old}"'] = f'damping="{new}"'


# -- Unitree's deploy.yaml -----------------------------------------------------------------------


def deploy_order(draft: Draft) -> None:
    """Every figure stays with its joint; the network has the joints in another order."""
    deploy, order = draft.deploy, breadth_first(29)
    deploy["joint_ids_map"] = order
    action = deploy["actions"]["JointPositionAction"]
    for values, key in ((deploy, "default_joint_pos"), (action, "scale"), (action, "offset")):
        values[key] = [values[key][i] for i in order]


def deploy_names_only(draft: Draft) -> None:
    draft.deploy["joint_ids_map"] = breadth_first(29)


def deploy_gains(draft: Draft) -> None:
    for key in ("stiffness", "damping"):
        values = draft.deploy[key]
        draft.deploy[key] = [values[i] for i in breadth_first(29)]


def deploy_swapped_gains(draft: Draft) -> None:
    deploy = draft.deploy
    deploy["stiffness"], deploy["damping"] = deploy["damping"], deploy["stiffness"]


def deploy_gravity(draft: Draft) -> None:
    draft.deploy["observations"]["projected_gravity"]["scale"] = [-1.0, -1.0, -1.0]


def deploy_scale(draft: Draft) -> None:
    draft.deploy["observations"]["joint_vel_rel"]["scale"] = [0.05] * 29


def deploy_pose(draft: Draft) -> None:
    for key in (draft.deploy, draft.deploy["actions"]["JointPositionAction"]):
        values = key["default_joint_pos" if "default_joint_pos" in key else "offset"]
        for hip in (0, 6):
            values[hip] -= 0.9


def deploy_action(draft: Draft) -> None:
    action = draft.deploy["actions"]["JointPositionAction"]
    action["scale"] = [4.0 * value for value in action["scale"]]


def deploy_missing_joint(draft: Draft) -> None:
    draft.deploy["joint_ids_map"].pop()


def deploy_extra_term(draft: Draft) -> None:
    term = {"params": {}, "clip": None, "scale": [1.0] * 3, "history_length": 1}
    draft.deploy["observations"]["base_lin_vel"] = term


def deploy_terms(draft: Draft) -> None:
    names = list(draft.deploy["observations"])
    swap(names, 0, 1)
    draft.deploy["observations"] = {name: draft.deploy["observations"][name] for name in names}


def deploy_no_weights(draft: Draft) -> None:
    draft.leave_out.add("policy.onnx.data")


def deploy_left_right(draft: Draft) -> None:
    draft.deploy["joint_ids_map"] = [*range(6, 12), *range(6), *range(12, 29)]


# -- facts given in the workflow -----------------------------------------------------------------


def given_order(draft: Draft) -> None:
    order = breadth_first(12)
    for key in ("joints", "default_joint_pos"):
        draft.given[key] = [draft.given[key][i] for i in order]


def given_front_rear(draft: Draft) -> None:
    joints = draft.given["joints"]
    draft.given["joints"] = joints[6:] + joints[:6]


def given_left_right(draft: Draft) -> None:
    for key in ("joints", "default_joint_pos"):
        values = draft.given[key]
        draft.given[key] = values[3:6] + values[:3] + values[9:] + values[6:9]


def given_names_only(draft: Draft) -> None:
    draft.given["joints"] = [draft.given["joints"][i] for i in breadth_first(12)]


def given_gravity(draft: Draft) -> None:
    term = next(t for t in draft.terms if t["state"] == "projected_gravity")
    term["scale"] = -1.0


def given_scale(draft: Draft) -> None:
    """Drop the scales, or give the usual ones where there are none."""
    for term in draft.terms:
        if "scale" in term:
            del term["scale"]
        elif draft.policy == "go1" and term["state"] == "joint_vel":  # it has none to drop
            term["scale"] = 0.05


def given_pose(draft: Draft) -> None:
    pose = draft.given["default_joint_pos"]
    for i in range(len(pose)):
        if draft.policy in ("go1", *GO2) and i % 3 == 2:
            pose[i] = -1.2
        elif draft.policy in ("holosoma", "dance") and i in (0, 6):
            pose[i] -= 0.9


def given_one_side(draft: Draft) -> None:
    draft.given["default_joint_pos"][3 if draft.policy in ("holosoma", "dance") else 1] += 0.3


def given_action(draft: Draft) -> None:
    if draft.policy == "holosoma":
        draft.given["action"]["scale"] *= 4.0
    else:
        draft.given["action.scale"] *= 4.0


def given_missing_joint(draft: Draft) -> None:
    draft.given["joints"].pop()


def given_misspelt(draft: Draft) -> None:
    draft.given["joints"][4] = "FL_tigh_joint"


def given_extra_term(draft: Draft) -> None:
    draft.terms.append({"name": "acceleration", "state": "base_lin_acc"})


def given_terms(draft: Draft) -> None:
    states = [term["state"] for term in draft.terms]
    if draft.policy in ("go1", *GO2):
        swap(draft.terms, states.index("base_ang_vel"), states.index("projected_gravity"))
    else:
        swap(draft.terms, states.index("joint_pos"), states.index("joint_vel"))


def given_training_order(draft: Draft) -> None:
    """The order in which holosoma's configuration lists the terms, which it then sorts."""
    names = "base_ang_vel projected_gravity command_lin_vel command_ang_vel dof_pos dof_vel actions"
    terms = {term["name"]: term for term in draft.terms}
    order = [*names.split(), "sin_phase", "cos_phase"]
    draft.given["observation.terms"] = [terms[name] for name in order]


def given_swapped_gains(draft: Draft) -> None:
    given = draft.given
    given["stiffness"], given["damping"] = given["damping"], given["stiffness"]


def given_stiff(draft: Draft) -> None:
    stiffness = draft.given["stiffness"]
    many = isinstance(stiffness, list)
    draft.given["stiffness"] = [10.0 * x for x in stiffness] if many else 10.0 * stiffness


def given_no_phase(draft: Draft) -> None:
    del draft.given["phase"]


def given_absolute(draft: Draft) -> None:
    term = next(t for t in draft.terms if t["state"] == "joint_pos")
    term["subtract"] = [0.0] * len(draft.given["default_joint_pos"])


# -- metadata in the network -----------------------------------------------------------------------


def metadata_twice(draft: Draft) -> None:
    draft.network_metadata().append(("kp", "[1.0]"))


def edit(draft: Draft, key: str, change: Callable[[list[Any]], list[Any]]) -> None:
    """Change a list in the metadata of a network."""
    pairs = draft.network_metadata() if draft.metadata is None else draft.metadata
    draft.metadata = [
        (name, json.dumps(change(json.loads(value))) if name == key else value)
        for name, value in pairs
    ]


def metadata_order(draft: Draft) -> None:
    """Names, gains and pose agree; the network has them in another order."""
    order = breadth_first(29)
    for key in ("dof_names", "kp", "kd"):
        edit(draft, key, lambda values: [values[i] for i in order])
    pose = draft.given["default_joint_pos"]
    draft.given["default_joint_pos"] = [pose[i] for i in order]


def metadata_gains(draft: Draft) -> None:
    for key in ("kp", "kd"):
        edit(draft, key, lambda values: values[::-1])


def metadata_legs_gains(draft: Draft) -> None:
    """Knee and hip pitch exchanged on both sides: symmetric, so only a run can show it."""

    def change(values: list[Any]) -> list[Any]:
        return [0.15 * value if i < LEGS else value for i, value in enumerate(values)]

    for key in ("kp", "kd"):
        edit(draft, key, change)


def metadata_no_damping(draft: Draft) -> None:
    edit(draft, "kd", lambda values: [0.0 for _ in values])


def metadata_missing_joint(draft: Draft) -> None:
    edit(draft, "dof_names", lambda values: values[:-1])
