"""legged_gym's dumped configuration as facts, as far as it says them.

From leggedrobotics/legged_gym `envs/base/legged_robot.py`: period = `sim.dt` ·
`control.decimation`; gains match by a part of the joint's name; actions are clipped to
`normalization.clip_actions`, and the clipped action is fed back. The terms and the joint order
stand in Python code, so they must be given; `normalization.obs_scales` has a term's scale.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from unicon_core.policies.facts import Facts, dig
from unicon_core.policies.importers.source_reader import Source
from unicon_core.policies.importers.training import command_ranges, say_period, values_by_pattern


def is_legged_gym(values: Any) -> bool:
    """Whether a YAML document is a legged_gym configuration."""
    return (
        isinstance(values, Mapping)
        and isinstance(values.get("control"), Mapping)
        and isinstance(values.get("init_state"), Mapping)
        and "default_joint_angles" in values["init_state"]
    )


def legged_gym_facts(source: Source) -> Facts:
    """Return what a legged_gym configuration says; given joints resolve its names.

    Raises:
        PolicyError: given joints are no names.
    """
    path, document, lines = source.path, source.located.value, source.located.lines
    facts = Facts(path, "legged_gym configuration", by_pattern=True)
    control, init = document["control"], document["init_state"]
    dt = dig(document, "sim", "dt")
    say_period(facts, dt, control.get("decimation"), "sim.dt · control.decimation")
    action: dict[str, Any] = {"feedback": "clipped"}
    if "action_scale" in control:
        action["scale"] = control["action_scale"]
        facts.keys[("action", "scale")] = "control.action_scale"
    bound = dig(document, "normalization", "clip_actions")
    if isinstance(bound, (int, float)):
        action["clip"] = [-bound, bound]
    scales = dig(document, "normalization", "obs_scales")
    if isinstance(scales, Mapping):
        listed = ", ".join(f"{name} {value}" for name, value in scales.items())
        facts.notes.append(f"{path.name}: scales for the terms to give: {listed}")
    facts.values["action"] = action
    joints = source.joints
    if joints is not None:
        facts.values["joints"] = joints
        pose = values_by_pattern(init["default_joint_angles"], joints)
        if pose is not None:
            facts.values["default_joint_pos"] = pose
        for key in ("stiffness", "damping"):
            gains = values_by_pattern(control.get(key), joints, whole=False)
            if gains is not None:
                facts.values[key] = gains
                facts.keys[(key,)] = f"control.{key}"
    ranges = command_ranges(dig(document, "commands", "ranges"))
    if ranges:
        facts.values["command_ranges"] = ranges
    facts.lines[("action", "scale")] = lines.get(("control", "action_scale"), 1)
    facts.values["observation"] = {"start": "zeros"}
    return facts
