"""Configurations of deployment programs, which lay out the observation themselves, as facts.

Booster's `deploy/configs/T1.yaml`, from BoosterRobotics/booster_gym: `deploy/utils/policy.py` lays
out the observation (gravity, angular velocity, command, cosine and sine of one clock, joint
positions relative to the pose, velocities, last action), lets the command change by 1 m/s² and
1 rad/s², clips the action and feeds the clipped one back; without a command cosine and sine are 0,
while the clock runs on. All joints stand in motor order, and the network moves the last
`num_actions` of them. `deploy/deploy.py` sends targets every `dt` through a low pass of its own.

unitree_rl_gym's `deploy/deploy_{mujoco,real}/configs/*.yaml`, from unitreerobotics/unitree_rl_gym:
`deploy_mujoco.py` and `deploy_real.py` lay out the observation (angular velocity, gravity, command,
joint positions relative to the pose, velocities, last action, sine and cosine of one clock of 0.8 s
that runs on), feed the raw action back and clip nothing. The first counts the joints as its model
has them (`qpos[7:]`); the second names motors (`leg_joint2motor_idx`), holds the others at
`arm_waist_target`, and takes a stick of ±1 times `max_cmd` as command.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from unicon_base import AnyDict
from unicon_core.policies.facts import Facts
from unicon_core.policies.importers.source import Source, motors_of, scaled_term

_PROGRAM = "its deploy program"
_SLEW = 1.0  # of the command in [m/s²] and [rad/s²]: one period for each tick, in policy.py
_STILL = 1e-5  # [m/s], [rad/s]: no command below it, in policy.py
_BOOSTER = {"stiffness": "stiffness", "damping": "damping", "default_joint_pos": "default_qpos"}
# Term to the keys of its scale under `policy.normalization`, in the order of policy.py.
_BOOSTER_SCALES: dict[str, list[str]] = {
    "gravity": ["gravity"],
    "ang_vel": ["ang_vel"],
    "command": ["lin_vel", "lin_vel", "ang_vel"],
    "cos_phase": [],
    "sin_phase": [],
    "dof_pos": ["dof_pos"],
    "dof_vel": ["dof_vel"],
    "actions": [],
}

_PERIOD = 0.8  # of the clock in [s]; it stands in both programs
_ROOT = "{LEGGED_GYM_ROOT_DIR}/"
_LEGS, _REST = "leg_joint2motor_idx", "arm_waist_joint2motor_idx"
# Fact to its key, and to the key of the joints that are held.
_UNITREE = {
    "stiffness": ("kps", "arm_waist_kps"),
    "damping": ("kds", "arm_waist_kds"),
    "default_joint_pos": ("default_angles", "arm_waist_target"),
}
# Term to the key of its scale, in the order of the programs.
_UNITREE_SCALES = {
    "ang_vel": "ang_vel_scale",
    "gravity": "",
    "command": "cmd_scale",
    "joint_pos": "dof_pos_scale",
    "joint_vel": "dof_vel_scale",
    "last_action": "",
    "phase": "",
}


def _term(name: str, scale: list[float], moved: Iterable[int]) -> AnyDict:
    """Return a term; of joints it sees the moved ones alone, if any are said."""
    term = scaled_term(name, scale)
    places = list(moved) if term["state"] in ("joint_pos", "joint_vel") else []
    return {**term, "index": places} if places else term


def booster_facts(source: Source) -> Facts:
    """Return what a configuration of Booster says.

    Raises:
        PolicyError: it is against the format.
    """
    path, facts = source.path, source.facts
    facts.source = "Booster configuration"
    dt = source.number("common.dt")
    source.say_period("common.dt", "policy.control.decimation")
    pose = "common.default_qpos"
    count, moved = len(source.numbers(pose)), source.whole("policy.num_actions")
    if moved > count:
        raise source.wrong(
            "policy.num_actions",
            f"policy.num_actions is {moved}, and {pose} has {count} joints; give at most as many",
        )
    for fact, key in _BOOSTER.items():
        source.copy(fact, f"common.{key}", count, pose)
    named = f"{pose} has {count}; name the joints of all motors in their order"
    joints, robot = source.joints(count, named), source.robot
    if robot is not None:
        motors = motors_of(robot)
        if len(motors) != count:
            raise source.wrong(
                pose,
                f"{pose} has {count} joints, and robot {robot.name!r} has {len(motors)} motors; "
                "choose the robot whose motors it counts",
            )
        source.say_motors(pose, sorted(motors), robot)
        joints = facts.values["joints"]
    elif joints is not None:
        facts.values["joints"] = joints
    else:
        facts.asks["joints"] = f"the {count} motors of the robot in their order: name the robot"
    source.copy("action.scale", "policy.control.action_scale", moved, "num_actions")
    source.say_clip("policy.normalization.clip_actions")
    part = range(count - moved, count) if moved < count else range(0)
    if joints is not None and part:
        source.say("action.joints", joints[part.start :], "policy.num_actions")
    terms = [
        _term(name, [source.number(f"policy.normalization.{k}") for k in keys] or [1.0], part)
        for name, keys in _BOOSTER_SCALES.items()
    ]
    size, program = "policy.num_observations", "deploy/utils/policy.py lays out"
    source.say_terms(terms, size, 11 + 3 * moved, f"{program} for {moved} actions")
    facts.say("command", {"slew": _SLEW}, _PROGRAM)
    frequency = source.number("policy.gait_frequency")
    if not frequency > 0.0:
        text = f"policy.gait_frequency is {frequency:g}; give the steps in [Hz], above 0"
        raise source.wrong("policy.gait_frequency", text)
    phase = {
        "period": 1.0 / frequency,
        "offsets": [0.0],
        "stand": "zero",
        "resume": "clock",
        "stand_below": _STILL,
    }
    source.say("phase", phase, "policy.gait_frequency")
    facts.notes.append(
        f"{path.name}: its program sends the targets every {dt:g} s through a low pass (0.8 old + "
        "0.2 new), which a policy's tick does not do; action.filter of the contract is once a tick"
    )
    base = path.parent.parent if path.parent.name == "configs" else None
    source.network("policy.policy_path", source.need("policy.policy_path"), base)
    return facts


def unitree_rl_gym_facts(source: Source) -> Facts:
    """Return what a configuration of unitree_rl_gym says.

    Raises:
        PolicyError: it is against the format.
    """
    facts, document = source.facts, source.document
    facts.source = "unitree_rl_gym configuration"
    count = source.whole("num_actions")
    rest: list[int] = []
    if _LEGS in document:
        rest = _motors(source, count)
    else:
        source.say_period("simulation_dt", "control_decimation")
        what = f"num_actions is {count}; name the joints that it moves, in the order of its model"
        if source.joints(count, what) is None:
            model = Path(str(document.get("xml_path", "its model"))).name
            facts.asks["joints"] = f"the {count} of {model}, in its order"
    for fact, (key, held) in _UNITREE.items():
        more = source.numbers(held, len(rest)) if rest else []
        source.say(fact, source.numbers(key, count, "num_actions") + more, key)
    source.copy("action.scale", "action_scale", count, "num_actions")
    source.say("action.feedback", "raw", "action_scale")
    seen = range(count) if "joints" in facts.values["action"] else range(0)
    terms = []
    for i, (name, key) in enumerate(_UNITREE_SCALES.items()):
        terms.append(
            _term(name, source.numbers(key, 3 if name == "command" else 1) if key else [1.0], seen)
        )
        if (line := source.line(key)) is not None:
            facts.lines[("observation", "terms", i)] = line
    program = f"deploy_mujoco.py and deploy_real.py lay out for {count} actions"
    source.say_terms(terms, "num_obs", 11 + 3 * count, program)
    facts.say("phase", {"period": _PERIOD, "offsets": [0.0]}, _PROGRAM)
    folder, named, base = source.path.parent, source.need("policy_path"), None
    if isinstance(named, str) and named.startswith(_ROOT):
        named = named.removeprefix(_ROOT)
        if len(folder.parents) > 2 and folder.name == "configs":
            base = folder.parents[2]
    source.network("policy_path", named, base)
    return facts


def _motors(source: Source, count: int) -> list[int]:
    """Note what the program of the real robot says; return the motors that it holds."""
    facts, document = source.facts, source.document
    source.say("period", source.number("control_dt"), "control_dt")
    legs = source.places(_LEGS)
    rest = source.places(_REST) if document.get(_REST) else []
    both = sorted({*legs} & {*rest})
    if len(legs) != count or both:
        what = f"motor {both[0]} stands in both" if both else f"{len(legs)} for num_actions {count}"
        raise source.wrong(_LEGS, f"{_LEGS} and {_REST}: {what}; name each motor once")
    order = legs + rest
    what = f"{_LEGS} and {_REST} have {len(order)} motors; name their joints, in this order"
    if source.robot is not None:
        source.say_motors(_LEGS, order, source.robot)
    elif (joints := source.joints(len(order), what)) is not None:
        facts.values["joints"] = joints
    else:
        facts.asks["joints"] = f"motors {', '.join(map(str, order))} of the robot: name the robot"
    if rest and "joints" in facts.values:
        source.say("action.joints", facts.values["joints"][:count], _LEGS)
    if document.get("max_cmd") is not None:
        most = zip(("lin_vel_x", "lin_vel_y", "ang_vel_z"), source.numbers("max_cmd", 3))
        ranges = {name: [-value, value] for name, value in most}
        source.say("command_ranges", ranges, "max_cmd")
    if document.get("imu_type") == "torso":
        facts.notes.append(
            f"{source.path.name}: imu_type is torso: its program turns the IMU's readings by the "
            "waist to the pelvis; base_quat and base_ang_vel must be the pelvis's"
        )
    return rest
