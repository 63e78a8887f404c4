"""legged_gym's dumped configuration as facts, as far as it says them.

From leggedrobotics/legged_gym `envs/base/legged_robot.py`: period = `sim.dt` ·
`control.decimation`; gains match by a part of the joint's name; actions are clipped to
`normalization.clip_actions`, and the clipped action is fed back. The terms and the joint order
stand in Python code, so they must be given; `normalization.obs_scales` has a term's scale.
"""

from __future__ import annotations

from collections.abc import Mapping

from unicon_core.policies.facts import GAINS, Facts, dig
from unicon_core.policies.importers.source_reader import Source
from unicon_core.policies.importers.training import say_period, say_ranges, values_by_pattern


def legged_gym_facts(source: Source) -> Facts:
    """Return what a legged_gym configuration says; given joints resolve its names.

    Raises:
        PolicyError: given joints are no names.
    """
    path, document, lines = source.path, source.located.value, source.located.lines
    facts = Facts(path, "legged_gym configuration", by_pattern=True)
    say_period(facts, document, "sim.dt", "control.decimation")
    facts.say("action.feedback", "clipped")
    scale, line = dig(document, "control", "action_scale"), lines.get(("control", "action_scale"))
    if line is not None:
        facts.say("action.scale", scale, "control.action_scale", line)
    bound = dig(document, "normalization", "clip_actions")
    if isinstance(bound, (int, float)):
        facts.say("action.clip", [-bound, bound])
    scales = dig(document, "normalization", "obs_scales")
    if isinstance(scales, Mapping):
        listed = ", ".join(f"{name} {value}" for name, value in scales.items())
        facts.notes.append(f"{path.name}: scales for the terms to give: {listed}")
    joints = source.joints
    if joints is not None:
        facts.say("joints", joints)
        pose = values_by_pattern(document["init_state"]["default_joint_angles"], joints)
        if pose is not None:
            facts.say("default_joint_pos", pose)
        for key in GAINS:
            gains = values_by_pattern(dig(document, "control", key), joints, whole=False)
            if gains is not None:
                facts.say(key, gains, f"control.{key}")
    say_ranges(facts, document, "commands.ranges")
    facts.say("observation.start", "zeros")
    return facts
