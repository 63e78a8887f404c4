"""Makes broken variants of the assets' policies and of our own, for the tests of `unicon check`.

Each variant is the good workflow with one mistake that people make; `python broken_variants.py DIR`
writes them all. `culprit` must be named by the first finding; `twin` says that only a run in MuJoCo
can show the mistake.
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
WORKFLOWS = {
    "mjlab": "g1_walk",
    "go1": "go1_walk",
    "holosoma": "g1_holosoma",
    "go2": "go2_walk",
    "bare": "go2_walk",  # exported again without metadata
    "filtered": "go2_walk",  # exported again for a program that filters actions
    "rover": "rover_drive",
    "dance": "g1_dance",  # by itself
}
GO2 = ("go2", "bare", "filtered")
ALPHA = 0.25
"""Weight of the newest action in the filter of `filtered`."""
LEGS = 12  # the first joints of the G1: left leg, right leg


@dataclass(frozen=True)
class Variant:
    """One mistake.

    Attributes:
        policy: `mjlab`, `go1`, `holosoma` or `go2`.
        name: of the mistake, also of the file.
        culprit: what must be named.
        twin: whether it takes a run in MuJoCo.
        change: changes the draft in place.
    """

    policy: str
    name: str
    culprit: str
    twin: bool
    change: Callable[[Draft], None]

    def write(self, folder: Path, assets: Path) -> Path:
        """Write the workflow and what belongs to it into a folder; return the workflow."""
        draft = Draft(self.policy, folder, assets)
        self.change(draft)
        return draft.write()


class Draft:
    """A copy of a good workflow that may be changed.

    Attributes:
        workflow: its values.
        given: facts of the policy: given in the workflow, or its `policy.yaml` (go2).
        deploy: values of `deploy.yaml` (mjlab only).
        metadata: pairs of the network's metadata to put in, None to leave them (holosoma, go1).
        leave_out: files of the policy that are lost.
        effort_factor: by which the robot file's limits are multiplied, None to leave it.
        model_changes: text of the model's file to other text.
    """

    def __init__(self, policy: str, folder: Path, assets: Path) -> None:
        self.policy, self.folder, self.assets = policy, folder, assets
        self.metadata: list[tuple[str, str]] | None = None
        folder_of = ROOT / "config" / "workflows"
        path = folder_of / f"{WORKFLOWS[policy]}.yaml"
        if policy == "rover":
            path = ROOT / "examples" / "rover" / "drive.yaml"
        self.program: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
        if policy == "dance":
            del self.program["policies"]["walk"]
            self.program["flow"] = {"policy": "dance"}
            self.program["scene"]["initial_pose"] = "policy:dance"
        self.key, entry = next(iter(self.program["policies"].items()))
        self.given: dict[str, Any]
        if self.ours:  # everything stands in its policy.yaml
            self.source = ROOT / "config" / "policies" / "go2_velocity"
            if policy == "rover":
                self.source = path.parent / "policy"
                self.program["robot"] = str(path.parent / "rover.yaml")
            text = (self.source / "policy.yaml").read_text(encoding="utf-8")
            self.given = yaml.safe_load(text)
            self.given["observation.terms"] = self.given.pop("observation")["terms"]
            self.given["action.scale"] = self.given["action"].pop("scale")
        if policy in ("bare", "filtered"):
            self.metadata = []
            del self.given["sha256"]
        if policy == "filtered":
            self.given["action"] |= {
                "clip": [-100.0, 100.0],
                "filter": {"alpha": ALPHA},
                "feedback": "filtered",
            }
        if not self.ours:
            self.source = assets / entry["path"].removeprefix("assets:")
            self.given = deepcopy(entry["given"])
        self.deploy: dict[str, Any] = {}
        if policy == "mjlab":
            text = (self.source / "deploy.yaml").read_text(encoding="utf-8")
            self.deploy = yaml.safe_load(text)
        self.leave_out: set[str] = set()
        self.effort_factor: float | None = None
        self.model_changes: dict[str, str] = {}

    @property
    def ours(self) -> bool:
        """Whether the contract is a `policy.yaml`."""
        return self.policy in (*GO2, "rover")

    @property
    def terms(self) -> list[dict[str, Any]]:
        """The given terms of the observation."""
        terms: list[dict[str, Any]] = self.given["observation.terms"]
        return terms

    def network_metadata(self) -> list[tuple[str, str]]:
        """Return the network's metadata, to be changed."""
        import onnx

        model = onnx.load(str(next(self.source.glob("*.onnx"))), load_external_data=False)
        self.metadata = [(entry.key, entry.value) for entry in model.metadata_props]
        return self.metadata

    def write(self) -> Path:
        """Write everything; return the workflow's path."""
        policy = self.folder / "policy"
        policy.mkdir(parents=True)
        for path in self.source.iterdir():
            if path.name not in self.leave_out and path.name != "deploy.yaml":
                shutil.copyfile(path, policy / path.name)
        if self.deploy:
            text = yaml.safe_dump(self.deploy, sort_keys=False)
            (policy / "deploy.yaml").write_text(text, encoding="utf-8")
        if self.metadata is not None:
            import onnx

            network = next(policy.glob("*.onnx"))
            model = onnx.load(str(network), load_external_data=False)
            del model.metadata_props[:]
            for key, value in self.metadata:
                entry = model.metadata_props.add()
                entry.key, entry.value = key, value
            if self.policy == "filtered":
                behind_filter(model, ALPHA)
            network.write_bytes(model.SerializeToString())
        if self.effort_factor is not None:
            self._write_robot(self.effort_factor)
        if self.model_changes:
            self._write_model()
        if self.ours:
            values = dict(self.given)
            values["observation"] = {"terms": values.pop("observation.terms")}
            values["action"] = {**values["action"], "scale": values.pop("action.scale")}
            text = yaml.safe_dump(values, sort_keys=False)
            (policy / "policy.yaml").write_text(text, encoding="utf-8")
            self.program["policies"][self.key] = "./policy"
        else:
            self.program["policies"][self.key] = {"path": "./policy", "given": self.given}
        path = self.folder / f"{self.program['name']}.yaml"
        path.write_text(yaml.safe_dump(self.program, sort_keys=False), encoding="utf-8")
        return path

    def _write_model(self) -> None:
        named = self.program["scene"].get("model")
        path = ROOT / "config" / "models" / "go2" / "go2.xml"
        if named is not None:
            path = self.assets / named.removeprefix("assets:")
        text = path.read_text(encoding="utf-8")
        for old, new in self.model_changes.items():
            assert old in text, old
            text = text.replace(old, new)
        (self.folder / path.name).write_text(text, encoding="utf-8")
        self.program["scene"]["model"] = f"./{path.name}"

    def _write_robot(self, factor: float) -> None:
        name = self.program["robot"]
        text = (ROOT / "config" / "robots" / f"{name}.yaml").read_text(encoding="utf-8")
        robot = yaml.safe_load(text)
        for joint in robot["joints"]:
            joint["effort"] *= factor
        path = self.folder / f"{name}.yaml"
        path.write_text(yaml.safe_dump(robot, sort_keys=False), encoding="utf-8")
        self.program["robot"] = f"./{path.name}"


def behind_filter(model: Any, alpha: float) -> None:
    """Let a network of 12 actions, its last 12 inputs the filtered ones before, undo a low pass.

    y = α x + (1 − α) y_before, so with x = (y − (1 − α) y_before) / α the filtered action is the
    network's own as it was trained.
    """
    import numpy as np
    from onnx import helper, numpy_helper

    graph = model.graph
    obs, out = graph.input[0].name, graph.output[0].name
    for node in graph.node:
        for i, name in enumerate(node.output):
            if name == out:
                node.output[i] = "trained"
    figures = {"new": np.float32(1.0 / alpha), "old": np.float32((1.0 - alpha) / alpha)}
    places = {"start": [33], "stop": [45], "axis": [1]}
    graph.initializer.extend(numpy_helper.from_array(np.array(v), k) for k, v in figures.items())
    graph.initializer.extend(
        numpy_helper.from_array(np.array(v, np.int64), k) for k, v in places.items()
    )
    graph.node.extend(
        [
            helper.make_node("Slice", [obs, *places], ["before"]),
            helper.make_node("Mul", ["before", "old"], ["held"]),
            helper.make_node("Mul", ["trained", "new"], ["raised"]),
            helper.make_node("Sub", ["raised", "held"], [out]),
        ]
    )


def breadth_first(count: int) -> list[int]:
    """Return the places of joints, given limb by limb, in breadth-first order."""
    if count == 12:  # a quadruped: four legs of three joints
        return [leg * 3 + depth for depth in range(3) for leg in range(4)]
    limbs = [range(6), range(6, 12), range(12, 15)]  # G1: legs, waist, then the arms on it
    order = [limb[d] for d in range(6) for limb in limbs if d < len(limb)]
    return order + [arm + d for d in range(7) for arm in (15, 22)]


def swap(values: list[Any], i: int, j: int) -> None:
    """Exchange two places of a list."""
    values[i], values[j] = values[j], values[i]


# -- mistakes that all three can have ----------------------------------------------------------


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


def phase_exchanged(draft: Draft) -> None:
    """The source has the cosines first, and it was taken for sines first."""
    for term in draft.terms:
        if term["state"].startswith("gait_phase_"):
            term["state"] = {"sin": "gait_phase_cos", "cos": "gait_phase_sin"}[term["state"][-3:]]


def phase_in_degrees(draft: Draft) -> None:
    draft.given["phase"]["offsets"] = [0.0, 180.0]


def phase_stands_in_degrees(draft: Draft) -> None:
    draft.given["phase"]["stand"] = 180.0


def phase_in_milliseconds(draft: Draft) -> None:
    draft.given["phase"]["period"] = 1000.0


def given_absolute(draft: Draft) -> None:
    term = next(t for t in draft.terms if t["state"] == "joint_pos")
    del term["subtract"]


# -- filters, feedback, slew -----------------------------------------------------------------


def filter_missing(draft: Draft) -> None:
    del draft.given["action"]["filter"]
    draft.given["action"]["feedback"] = "raw"


def filter_extra(draft: Draft) -> None:
    draft.given["action"]["filter"] = {"low_pass": 1.0}


def filter_turned(draft: Draft) -> None:
    """The program has the weight of the old action."""
    draft.given["action"]["filter"] = {"alpha": 1.0 - ALPHA}


def filter_cut_off(draft: Draft) -> None:
    """α = 0.25 is a cut-off of 2.29 Hz at 50 Hz."""
    draft.given["action"]["filter"] = {"low_pass": 4.0 * 2.29}


def filter_radians(draft: Draft) -> None:
    draft.given["action"]["filter"] = {"low_pass": 2.0 * 3.14159 * 2.29}


def feedback_raw(draft: Draft) -> None:
    draft.given["action"]["feedback"] = "raw"


def term_filter_extra(draft: Draft) -> None:
    """Of the last action; what is measured may be smoothed a lot before this policy minds."""
    term = next(t for t in draft.terms if t["state"] == "action")
    term["filter"] = {"moving_average": 5}


# -- motions -----------------------------------------------------------------------------------


def dance_quaternion(draft: Draft) -> None:
    """The reference's quaternion, x first, is taken for one with w first."""
    outputs = draft.given["outputs"]
    outputs["motion_body_quat_w"] = outputs.pop("motion_ref_quat_xyzw")
    draft.given["motion"]["bodies"] = ["torso_link"]


def dance_anchor_misspelt(draft: Draft) -> None:
    draft.given["motion"]["anchor_body"] = "torso"


def dance_ends_first(draft: Draft) -> None:
    draft.given["motion"] |= {"start": 5.0, "end": 2.0}


def dance_exchanged(draft: Draft) -> None:
    """The reference's velocities first."""
    term = next(t for t in draft.terms if t["state"] == "motion_command")
    term["index"] = [*range(29, 58), *range(29)]


def dance_scale(draft: Draft) -> None:
    """The usual scale of walks."""
    draft.given["action"]["scale"] = 0.25


def dance_reference_relative(draft: Draft) -> None:
    """The default pose taken off the reference, too, as off the joints."""
    term = next(t for t in draft.terms if t["state"] == "motion_command")
    term["subtract"] = [*draft.given["default_joint_pos"], *[0.0] * 29]


# -- wheels ------------------------------------------------------------------------------------


def wheels_exchanged(draft: Draft) -> None:
    joints = draft.given["joints"]
    swap(joints, 0, 1)


def wheels_position(draft: Draft) -> None:
    del draft.given["action"]["kind"]


def wheels_stiff(draft: Draft) -> None:
    draft.given["stiffness"] = [10.0, 10.0, 10.0]


def wheels_undamped(draft: Draft) -> None:
    draft.given["damping"] = [0.0, 0.0, 0.5]


def wheels_scale(draft: Draft) -> None:
    draft.given["action.scale"][:2] = [-12.5, -12.5]


def wheels_one_scale(draft: Draft) -> None:
    draft.given["action.scale"][1] *= 0.5


def rims_in_radians(draft: Draft) -> None:
    next(t for t in draft.terms if t["name"] == "rims")["scale"] = 1.0


def turn_upside_down(draft: Draft) -> None:
    next(t for t in draft.terms if t["name"] == "turn")["scale"] = -1.0


def slew_slow(draft: Draft) -> None:
    """In [m/s] for one tick, not in [m/s²]."""
    draft.given["command"]["slew"] = [0.03, 0.02, 0.08]


def slew_zero(draft: Draft) -> None:
    draft.given["command"]["slew"] = [0.0, 0.0, 0.0]


# -- metadata in the network -----------------------------------------------------------------------


def metadata_twice(draft: Draft) -> None:
    metadata = draft.network_metadata()
    if draft.policy == "go1":
        joints = ",".join(draft.given["joints"])
        metadata += [("joint_names", joints), ("joint_names", joints.replace("FR", "XX"))]
    else:
        metadata.append(("kp", "[1.0]"))


def _edit(draft: Draft, key: str, change: Callable[[list[Any]], list[Any]]) -> None:
    import json

    pairs = draft.network_metadata() if draft.metadata is None else draft.metadata
    draft.metadata = [
        (name, json.dumps(change(json.loads(value))) if name == key else value)
        for name, value in pairs
    ]


def metadata_order(draft: Draft) -> None:
    """Names, gains and pose agree; the network has them in another order."""
    order = breadth_first(29)
    for key in ("dof_names", "kp", "kd"):
        _edit(draft, key, lambda values: [values[i] for i in order])
    pose = draft.given["default_joint_pos"]
    draft.given["default_joint_pos"] = [pose[i] for i in order]


def metadata_gains(draft: Draft) -> None:
    for key in ("kp", "kd"):
        _edit(draft, key, lambda values: values[::-1])


def metadata_legs_gains(draft: Draft) -> None:
    """Knee and hip pitch exchanged on both sides: symmetric, so only a run can show it."""

    def change(values: list[Any]) -> list[Any]:
        return [0.15 * value if i < LEGS else value for i, value in enumerate(values)]

    for key in ("kp", "kd"):
        _edit(draft, key, change)


def metadata_no_damping(draft: Draft) -> None:
    _edit(draft, "kd", lambda values: [0.0 for _ in values])


def metadata_missing_joint(draft: Draft) -> None:
    _edit(draft, "dof_names", lambda values: values[:-1])


def _listed() -> Iterator[Variant]:
    def of(policy: str, *entries: tuple[str, str, bool, Callable[[Draft], None]]) -> list[Variant]:
        return [Variant(policy, *entry) for entry in entries]

    yield from of(
        "mjlab",
        ("order", "joint order", True, deploy_order),
        ("names_only", "joints", False, deploy_names_only),
        ("left_right", "joint order", True, deploy_left_right),
        ("gains_permuted", "stiffness", False, deploy_gains),
        ("gains_swapped", "stiffness and damping", False, deploy_swapped_gains),
        ("gravity", "projected_gravity", True, deploy_gravity),
        ("scale", "observation scales", True, deploy_scale),
        ("pose", "default_joint_pos", False, deploy_pose),
        ("action_scale", "action.scale", False, deploy_action),
        ("two_rates", "rate", False, two_rates),
        ("missing_joint", "joint_ids_map", False, deploy_missing_joint),
        ("extra_term", "base_lin_vel", False, deploy_extra_term),
        ("terms_order", "base_ang_vel", True, deploy_terms),
        ("no_weights", "policy.onnx.data", False, deploy_no_weights),
        ("passive_damping", "passive damping", True, passive_damping),
        ("low_effort", "effort of ", False, low_effort),
    )
    yield from of(
        "go1",
        ("order", "joint order", True, given_order),
        ("names_only", "joints", False, given_names_only),
        ("left_right", "joint order", True, given_left_right),
        ("front_rear", "joint order", True, given_front_rear),
        ("gravity", "projected_gravity", True, given_gravity),
        ("scale", "observation scales", True, given_scale),
        ("pose", "default_joint_pos", True, given_pose),
        ("one_side", "default_joint_pos", False, given_one_side),
        ("action_scale", "action.scale", False, given_action),
        ("milliseconds", "period", False, milliseconds),
        ("two_rates", "rate", False, two_rates),
        ("missing_joint", "default_joint_pos", False, given_missing_joint),
        ("misspelt_joint", "FL_tigh_joint", False, given_misspelt),
        ("extra_term", "acceleration", False, given_extra_term),
        ("terms_order", "gyro", True, given_terms),
        ("gains_swapped", "stiffness and damping", False, given_swapped_gains),
        ("stiff", "stiffness", False, given_stiff),
        ("metadata_twice", "joint_names", False, metadata_twice),
        ("passive_damping", "passive damping", True, passive_damping),
        ("no_collision", "collision geometry", False, no_collision),
        ("low_effort", "effort of ", False, low_effort),
    )
    yield from of(
        "holosoma",
        ("order", "joint order", True, metadata_order),
        ("gains_reversed", "stiffness", False, metadata_gains),
        ("gains_of_legs", "gains", True, metadata_legs_gains),
        ("no_damping", "damping", False, metadata_no_damping),
        ("gravity", "projected_gravity", True, given_gravity),
        ("scales", "scale", True, given_scale),
        ("pose", "default_joint_pos", False, given_pose),
        ("one_side", "default_joint_pos", False, given_one_side),
        ("action_scale", "action.scale", True, given_action),
        ("two_rates", "rate", False, two_rates),
        ("missing_joint", "dof_names", False, metadata_missing_joint),
        ("extra_term", "acceleration", False, given_extra_term),
        ("terms_order", "observation.terms", True, given_terms),
        ("training_order", "observation.terms", True, given_training_order),
        ("no_phase", "phase", False, given_no_phase),
        ("absolute", "dof_pos", True, given_absolute),
        ("phase_exchanged", "order of sines and cosines", True, phase_exchanged),
        ("phase_in_degrees", "phase.offsets", False, phase_in_degrees),
        ("phase_stands_in_degrees", "phase.stand", False, phase_stands_in_degrees),
        ("phase_in_milliseconds", "phase.period", False, phase_in_milliseconds),
        ("metadata_twice", "kp", False, metadata_twice),
        ("passive_damping", "passive damping", True, passive_damping),
        ("low_effort", "effort of ", False, low_effort),
    )

    yield from of(
        "go2",
        ("order", "joint order", True, given_order),
        ("names_only", "default_joint_pos", False, given_names_only),
        ("left_right", "joint order", True, given_left_right),
        ("front_rear", "joint order", True, given_front_rear),
        ("gravity", "projected_gravity", True, given_gravity),
        ("scales", "observation scales", True, given_scale),
        ("pose", "default_joint_pos", False, given_pose),
        ("one_side", "default_joint_pos", False, given_one_side),
        ("action_scale", "action.scale", False, given_action),
        ("milliseconds", "period", False, milliseconds),
        ("two_rates", "rate", False, two_rates),
        ("missing_joint", "default_joint_pos", False, given_missing_joint),
        ("misspelt_joint", "FL_tigh_joint", False, given_misspelt),
        ("extra_term", "acceleration", False, given_extra_term),
        ("terms_order", "base_ang_vel", True, given_terms),
        ("absolute", "joint_pos_rel", True, given_absolute),
        ("gains_swapped", "stiffness", False, given_swapped_gains),
        ("stiff", "stiffness", False, given_stiff),
        ("other_network", "sha256", False, other_network),
        ("passive_damping", "passive damping", True, passive_damping),
        ("no_collision", "collision geometry", False, no_collision),
        ("low_effort", "effort of ", False, low_effort),
    )

    yield from of(
        "bare",
        ("names_only", "joints", False, given_names_only),
        ("pose", "default_joint_pos", True, given_pose),
        ("one_side", "default_joint_pos", False, given_one_side),
        ("action_scale", "action.scale", True, given_action),
        ("gains_swapped", "stiffness and damping", False, given_swapped_gains),
        ("stiff", "stiffness", False, given_stiff),
        ("missing_joint", "default_joint_pos", False, given_missing_joint),
        ("misspelt_joint", "FL_tigh_joint", False, given_misspelt),
        ("gravity", "projected_gravity", True, given_gravity),
        ("terms_order", "base_ang_vel", True, given_terms),
        ("filter_extra", "action.filter", True, filter_extra),
        ("term_filter_extra", "filter of term 'last_action'", True, term_filter_extra),
    )

    yield from of(
        "filtered",
        ("filter_missing", "action.filter", True, filter_missing),
        ("filter_turned", "action.filter", True, filter_turned),
        ("filter_cut_off", "action.filter", True, filter_cut_off),
        ("filter_radians", "action.filter", True, filter_radians),
        ("feedback_raw", "action.feedback", True, feedback_raw),
        ("order", "joint order", True, given_order),
        ("left_right", "joint order", True, given_left_right),
        ("gravity", "projected_gravity", True, given_gravity),
        ("scales", "observation scales", True, given_scale),
        ("milliseconds", "period", False, milliseconds),
    )

    yield from of(
        "rover",
        ("wheels_exchanged", "joint order", True, wheels_exchanged),
        ("wheels_position", "action.kind", False, wheels_position),
        ("wheels_stiff", "stiffness", False, wheels_stiff),
        ("wheels_undamped", "damping", False, wheels_undamped),
        ("wheels_scale", "action.scale", True, wheels_scale),
        ("wheels_one_scale", "action.scale", False, wheels_one_scale),
        ("rims_in_radians", "rims", True, rims_in_radians),
        ("turn_upside_down", "turn", True, turn_upside_down),
        ("slew_slow", "command.slew", True, slew_slow),
        ("slew_zero", "slew", False, slew_zero),
    )

    yield from of(
        "dance",
        ("quaternion", "motion_body_quat_w", False, dance_quaternion),
        ("anchor_misspelt", "anchor_body", False, dance_anchor_misspelt),
        ("ends_first", "motion.end", False, dance_ends_first),
        ("exchanged", "order within 'motion_command'", True, dance_exchanged),
        ("scale", "action.scale", True, dance_scale),
        ("reference_relative", "subtract of 'motion_command'", True, dance_reference_relative),
        ("terms_order", "observation.terms", True, given_terms),
        ("absolute", "dof_pos", True, given_absolute),
        ("pose", "default_joint_pos", False, given_pose),
        ("one_side", "default_joint_pos", False, given_one_side),
        ("two_rates", "rate", False, two_rates),
        ("low_effort", "effort of ", False, low_effort),
    )


VARIANTS = tuple(_listed())


def main() -> None:
    """Write all variants below a folder, for a look by hand."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--assets", type=Path, default=ROOT.parent / "shared" / "assets")
    arguments = parser.parse_args()
    for variant in VARIANTS:
        folder = arguments.folder / variant.policy / variant.name
        print(variant.write(folder, arguments.assets))


if __name__ == "__main__":
    main()
