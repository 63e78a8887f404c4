"""Copies of good workflows that may be changed, for the broken variants."""

from __future__ import annotations

import shutil
from copy import deepcopy
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


DANCE: dict[str, Any] = {
    "action": {"scale": 1.0, "clip": [-100, 100], "feedback": "clipped"},
    "inputs": {"observation": "obs", "time_step": "time_step"},
    "outputs": {
        "action": "actions",
        "motion_joint_pos": "joint_pos",
        "motion_joint_vel": "joint_vel",
        "motion_ref_quat_xyzw": "ref_quat_xyzw",
    },
    "motion": {"anchor_body": "torso_link"},
    "observation.terms": [
        {"name": "actions", "state": "action"},
        {"name": "base_ang_vel", "state": "base_ang_vel"},
        {"name": "dof_pos", "state": "joint_pos", "subtract": "default_joint_pos"},
        {"name": "dof_vel", "state": "joint_vel"},
        {"name": "motion_command", "state": "motion_command"},
        {"name": "motion_ref_ori_b", "state": "motion_anchor_ori_b"},
    ],
}
"""What the import of holosoma's whole-body tracking says, written out to be broken."""


class Draft:
    """A copy of a good workflow that may be changed.

    Attributes:
        workflow: its values.
        given: facts of the policy: given in the workflow, or its `policy.yaml` (go2).
        deploy: values of `deploy.yaml` (mjlab only).
        metadata: pairs of the network's metadata to put in, None to leave them (holosoma, go1).
        beside: what stands in the workflow beside the policy's path.
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
        if policy == "dance":
            self.given |= deepcopy(DANCE) | {"motion": self.given["motion"] | DANCE["motion"]}
            del self.given["action.scale"]
        self.deploy: dict[str, Any] = {}
        if policy == "mjlab":
            text = (self.source / "deploy.yaml").read_text(encoding="utf-8")
            self.deploy = yaml.safe_load(text)
        self.beside: dict[str, Any] = {}
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
            entry: dict[str, Any] = {"path": "./policy"}
        else:
            entry = {"path": "./policy", "given": self.given}
        self.program["policies"][self.key] = entry | self.beside
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
                node.output[i] = "filter_trained"
    figures = {
        "filter_new": np.float32(1.0 / alpha),
        "filter_old": np.float32((1.0 - alpha) / alpha),
    }
    places = {"filter_start": [33], "filter_stop": [45], "filter_axis": [1]}
    graph.initializer.extend(numpy_helper.from_array(np.array(v), k) for k, v in figures.items())
    graph.initializer.extend(
        numpy_helper.from_array(np.array(v, np.int64), k) for k, v in places.items()
    )
    graph.node.extend(
        [
            helper.make_node("Slice", [obs, *places], ["filter_before"]),
            helper.make_node("Mul", ["filter_before", "filter_old"], ["filter_held"]),
            helper.make_node("Mul", ["filter_trained", "filter_new"], ["filter_raised"]),
            helper.make_node("Sub", ["filter_raised", "filter_held"], [out]),
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
