"""The folder of a policy that LeRobot trained, as facts: `config.json` beside `model.safetensors`.

Facts of the format, from huggingface/lerobot 0.4: `policies/act/configuration_act.py` and
`policies/diffusion/configuration_diffusion.py` name sizes, rows and frames. Joints, period, gains
and pose stand nowhere in the folder; a data set of ours has the robot file's joint order, and
positions in [rad] as actions (`unicon bag export --lerobot`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from unicon_base import AnyDict, alternatives
from unicon_base.schema.marks import NotEmpty
from unicon_core.policies.facts import Facts, dig
from unicon_core.policies.importers.source import Source

WEIGHTS = "model.safetensors"
_ROWS = {"act": "chunk_size", "diffusion": "n_action_steps"}
# Features that the exporter of data sets names otherwise than their states.
_STATES = {"state": "joint_pos", "velocity": "joint_vel", "effort": "joint_effort"}


def lerobot_facts(source: Source) -> Facts:
    """Return what the folder says.

    Raises:
        PolicyError: it is of a kind that does not run here, takes pictures, or is against the
            format.
    """
    facts, kind = source.facts, str(source.document["type"])
    facts.source, facts.network = "LeRobot config.json", source.path.parent / WEIGHTS
    if kind not in _ROWS:
        raise source.wrong("type", f"type: policies that run are {alternatives(kind, _ROWS)}")
    moved = source.value(Annotated[list[int], NotEmpty], ("output_features", "action", "shape"))[0]
    names = source.joints(moved, f"the action in {source.path.name} moves {moved}")
    if names is None and source.robot is not None and source.robot.num_joints == moved:
        source.say("joints", list(source.robot.joint_names), "output_features")
        facts.notes.append(f"{source.path.name}: joints are those of {source.robot.name} in order")
    frames = source.whole("n_obs_steps")
    source.say("observation", {"layout": "frame_major", "terms": []}, "input_features")
    for feature in source.value(Mapping[str, AnyDict], "input_features"):
        name = feature.removeprefix("observation.")
        if name.startswith("image"):
            raise source.wrong(
                ("input_features", feature),
                f"{feature} is a picture, which no policy takes here yet; train it on states",
            )
        term: AnyDict = {"name": name, "scale": 1.0, "history": frames}
        if name != "environment_state":
            term["state"] = _STATES.get(name, name)
        facts.values["observation"]["terms"].append(term)
    source.say("action", {"scale": 1.0, "offset": 0.0}, "output_features")
    rows, steps = source.whole(_ROWS[kind]), source.whole("n_action_steps")
    source.say("chunk", {"size": rows}, _ROWS[kind])
    if steps < rows and dig(source.given, "chunk", "steps") is None:
        source.say("chunk.steps", steps, "n_action_steps")
    if (weight := source.document.get("temporal_ensemble_coeff")) is not None:
        facts.values["chunk"] |= {"execution": "ensemble", "weight": weight}
    for key, name in (("inputs", "observation"), ("outputs", "action")):
        facts.values[key] = {name: name}
    return facts
