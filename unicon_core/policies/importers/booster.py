"""Booster's `deploy/configs/T1.yaml` (booster_gym) as facts.

From BoosterRobotics/booster_gym: `deploy/utils/policy.py` lays out the observation (gravity,
angular velocity, command, cosine and sine of one clock, joint positions relative to the pose,
velocities, last action), lets the command change by 1 m/s² and 1 rad/s², clips the action and feeds
the clipped one back; without a command cosine and sine are 0, while the clock runs on. All joints
stand in motor order, and the network moves the last `num_actions` of them. `deploy/deploy.py` sends
targets every `dt` through a low pass of its own.
"""

from __future__ import annotations

from typing import Any

from unicon_core.errors import PolicyError
from unicon_core.policies.facts import Facts, dig
from unicon_core.policies.importers.source_reader import Source, SourceReader

_SLEW = 1.0  # of the command in [m/s²] and [rad/s²]: one period for each tick, in policy.py
_STILL = 1e-5  # [m/s], [rad/s]: no command below it, in policy.py


def is_booster(values: Any) -> bool:
    """Whether a YAML document is a configuration of booster_gym's deployment."""
    return dig(values, "common", "default_qpos") is not None and "policy" in values


def booster_facts(source: Source) -> Facts:
    """Return what a configuration says.

    Raises:
        PolicyError: it is against the format.
    """
    path = source.path
    facts = Facts(path, "Booster configuration")
    reader = SourceReader(facts, source.located)
    control = ("policy", "control")
    dt, decimation = reader.number("common", "dt"), reader.whole(*control, "decimation")
    reader.say(("period",), dt * decimation, ("common", "dt"))
    facts.keys[("period",)] = "common.dt · policy.control.decimation"
    count = len(reader.floats(("common", "default_qpos"), reader.need("common", "default_qpos")))
    moved = reader.whole("policy", "num_actions")
    if moved > count:
        raise reader.wrong(
            ("policy", "num_actions"),
            f"policy.num_actions is {moved}, and common.default_qpos has {count} joints; give at "
            "most as many",
        )
    for target, key in _GAINS:
        of = f"the {count} joints of common.default_qpos"
        reader.say_vector((target,), "common", key, count=count, of=of)
    _joints(reader, count, source)
    of = f"num_actions {moved}"
    reader.say_vector(("action", "scale"), *control, "action_scale", count=moved, of=of)
    most = reader.number("policy", "normalization", "clip_actions")
    reader.say(("action", "clip"), [-most, most], ("policy", "normalization", "clip_actions"))
    facts.values["action"]["feedback"] = "clipped"
    joints = facts.values.get("joints")
    if joints is not None and moved < count:
        reader.say(("action", "joints"), joints[count - moved :], ("policy", "num_actions"))
    _observation(reader, count, moved)
    facts.notes.append(
        f"{path.name}: its program sends the targets every {dt:g} s through a low pass (0.8 old + "
        "0.2 new), which a policy's tick does not do; action.filter of the contract is once a tick"
    )
    base = path.parent.parent if path.parent.name == "configs" else None
    reader.network(("policy", "policy_path"), reader.need("policy", "policy_path"), base)
    return facts


_GAINS = (("stiffness", "stiffness"), ("damping", "damping"), ("default_joint_pos", "default_qpos"))


def _joints(reader: SourceReader, count: int, source: Source) -> None:
    facts, joints, robot = reader.facts, source.joints, source.robot
    if joints is not None and len(joints) != count:
        raise PolicyError(
            f"{facts.path}: given joints has {len(joints)} names, and common.default_qpos has "
            f"{count}; name the joints of all motors in their order"
        )
    if robot is not None:
        motors = source.motors
        if len(motors) != count:
            raise reader.wrong(
                ("common", "default_qpos"),
                f"common.default_qpos has {count} joints, and robot {robot.name!r} has "
                f"{len(motors)} motors; choose the robot whose motors it counts",
            )
        names = [motors[i] for i in sorted(motors)]
        reader.say(("joints",), names, ("common", "default_qpos"))
        facts.values["robot"] = robot.name
    elif joints is not None:
        facts.values["joints"] = joints
    else:
        facts.asks["joints"] = f"the {count} motors of the robot in their order: name the robot"


def _observation(reader: SourceReader, count: int, moved: int) -> None:
    facts, laid_out = reader.facts, 11 + 3 * moved
    inputs = reader.whole("policy", "num_observations")
    if inputs != laid_out:
        facts.asks["observation.terms"] = (
            f"num_observations is {inputs}, and what deploy/utils/policy.py lays out for {moved} "
            f"actions has {laid_out}"
        )
        return

    def scale(key: str) -> float:
        return reader.number("policy", "normalization", key)

    own = {} if moved == count else {"index": list(range(count - moved, count))}
    speeds = [scale("lin_vel"), scale("lin_vel"), scale("ang_vel")]
    facts.values["observation"] = {
        "terms": [
            {"name": "gravity", "state": "projected_gravity", "scale": scale("gravity")},
            {"name": "ang_vel", "state": "base_ang_vel", "scale": scale("ang_vel")},
            {"name": "command", "state": "velocity_command", "scale": speeds},
            {"name": "cos_phase", "state": "gait_phase_cos"},
            {"name": "sin_phase", "state": "gait_phase_sin"},
            {"name": "dof_pos", "state": "joint_pos", "subtract": "default_joint_pos",
             "scale": scale("dof_pos"), **own},
            {"name": "dof_vel", "state": "joint_vel", "scale": scale("dof_vel"), **own},
            {"name": "actions", "state": "action"},
        ]
    }  # fmt: skip
    facts.values["command"] = {"slew": _SLEW}
    frequency = reader.number("policy", "gait_frequency")
    if not frequency > 0.0:
        raise reader.wrong(
            ("policy", "gait_frequency"),
            f"policy.gait_frequency is {frequency:g}; give the steps in [Hz], above 0",
        )
    phase = {
        "period": 1.0 / frequency,
        "offsets": [0.0],
        "stand": "zero",
        "resume": "clock",
        "stand_below": _STILL,
    }
    reader.say(("phase",), phase, ("policy", "gait_frequency"))
    for key in ("command", "observation"):
        facts.keys[(key,)] = "its deploy program"
