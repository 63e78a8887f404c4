"""Booster's `deploy/configs/T1.yaml` (booster_gym) as facts.

From BoosterRobotics/booster_gym: `deploy/utils/policy.py` lays out the observation (gravity,
angular velocity, command, cosine and sine of one clock, joint positions relative to the pose,
velocities, last action), lets the command change by 1 m/s² and 1 rad/s², clips the action and feeds
the clipped one back; without a command cosine and sine are 0, while the clock runs on. All joints
stand in motor order, and the network moves the last `num_actions` of them. `deploy/deploy.py` sends
targets every `dt` through a low pass of its own.
"""

from __future__ import annotations

from unicon_core.policies.facts import Facts, term_state
from unicon_core.policies.importers.source_reader import Source, SourceReader, motors_of

_SLEW = 1.0  # of the command in [m/s²] and [rad/s²]: one period for each tick, in policy.py
_STILL = 1e-5  # [m/s], [rad/s]: no command below it, in policy.py


_GAINS = {"stiffness": "stiffness", "damping": "damping", "default_joint_pos": "default_qpos"}
# Term to the keys of its scale under `policy.normalization`, in the order of policy.py.
_SCALES: dict[str, list[str]] = {
    "gravity": ["gravity"],
    "ang_vel": ["ang_vel"],
    "command": ["lin_vel", "lin_vel", "ang_vel"],
    "cos_phase": [],
    "sin_phase": [],
    "dof_pos": ["dof_pos"],
    "dof_vel": ["dof_vel"],
    "actions": [],
}


def booster_facts(source: Source) -> Facts:
    """Return what a configuration says.

    Raises:
        PolicyError: it is against the format.
    """
    path = source.path
    facts = Facts(path, "Booster configuration")
    reader = SourceReader(facts, source.located)
    dt = reader.say_period("common.dt", "policy.control.decimation")
    count, moved = len(reader.floats("common.default_qpos")), reader.whole("policy.num_actions")
    if moved > count:
        raise reader.wrong(
            "policy.num_actions",
            f"policy.num_actions is {moved}, and common.default_qpos has {count} joints; give at "
            "most as many",
        )
    for fact, key in _GAINS.items():
        of = f"the {count} joints of common.default_qpos"
        reader.say_vector(fact, f"common.{key}", count, of)
    _joints(reader, count, source)
    reader.say_vector("action.scale", "policy.control.action_scale", moved, f"num_actions {moved}")
    clip = "policy.normalization.clip_actions"
    most = reader.number(clip)
    reader.say("action.clip", [-most, most], clip)
    facts.say("action.feedback", "clipped")
    joints = facts.values.get("joints")
    if joints is not None and moved < count:
        reader.say("action.joints", joints[count - moved :], "policy.num_actions")
    _observation(reader, count, moved)
    facts.notes.append(
        f"{path.name}: its program sends the targets every {dt:g} s through a low pass (0.8 old + "
        "0.2 new), which a policy's tick does not do; action.filter of the contract is once a tick"
    )
    base = path.parent.parent if path.parent.name == "configs" else None
    reader.network("policy.policy_path", reader.need("policy.policy_path"), base)
    return facts


def _joints(reader: SourceReader, count: int, source: Source) -> None:
    facts, robot = reader.facts, source.robot
    joints = reader.given_joints(
        source,
        count,
        f"common.default_qpos has {count}; name the joints of all motors in their order",
    )
    if robot is not None:
        motors = motors_of(robot)
        if len(motors) != count:
            raise reader.wrong(
                "common.default_qpos",
                f"common.default_qpos has {count} joints, and robot {robot.name!r} has "
                f"{len(motors)} motors; choose the robot whose motors it counts",
            )
        reader.say("joints", [motors[i] for i in sorted(motors)], "common.default_qpos")
        facts.values["robot"] = robot.name
    elif joints is not None:
        facts.values["joints"] = joints
    else:
        facts.asks["joints"] = f"the {count} motors of the robot in their order: name the robot"


def _observation(reader: SourceReader, count: int, moved: int) -> None:
    facts, program = reader.facts, "deploy/utils/policy.py lays out"
    if not reader.is_laid_out("policy.num_observations", 11 + 3 * moved, moved, program):
        return
    terms = []
    for name, keys in _SCALES.items():
        term = {"name": name, **term_state(name)}
        scales = [reader.number(f"policy.normalization.{key}") for key in keys]
        if scales:
            term["scale"] = scales if len(scales) > 1 else scales[0]
        if name.startswith("dof_") and moved < count:
            term["index"] = list(range(count - moved, count))
        terms.append(term)
    facts.say("observation", {"terms": terms}, "its deploy program")
    facts.say("command", {"slew": _SLEW}, "its deploy program")
    frequency = reader.number("policy.gait_frequency")
    if not frequency > 0.0:
        raise reader.wrong(
            "policy.gait_frequency",
            f"policy.gait_frequency is {frequency:g}; give the steps in [Hz], above 0",
        )
    phase = {
        "period": 1.0 / frequency,
        "offsets": [0.0],
        "stand": "zero",
        "resume": "clock",
        "stand_below": _STILL,
    }
    reader.say("phase", phase, "policy.gait_frequency")
