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

from pathlib import Path
from typing import Annotated

from unicon_base.schema.marks import Within
from unicon_core.policies.facts import Facts
from unicon_core.policies.importers.source import RATE, Source, motors_of

_PROGRAM = "its deploy program"
_SLEW = 1.0  # of the command in [m/s²] and [rad/s²]: one period for each tick, in policy.py
_STILL = 1e-5  # [m/s], [rad/s]: no command below it, in policy.py
_BOOSTER = {"stiffness": "stiffness", "damping": "damping", "default_joint_pos": "default_qpos"}
# Term to the keys of its scale under `policy.normalization`, in the order of policy.py.
_BOOSTER_SCALES = {
    "gravity": "gravity",
    "ang_vel": "ang_vel",
    "command": "lin_vel lin_vel ang_vel",
    "cos_phase": "1",
    "sin_phase": "1",
    "dof_pos": "dof_pos",
    "dof_vel": "dof_vel",
    "actions": "1",
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
    "gravity": "1",
    "command": "cmd_scale",
    "joint_pos": "dof_pos_scale",
    "joint_vel": "dof_vel_scale",
    "last_action": "1",
    "phase": "1",
}


def booster_facts(source: Source) -> Facts:
    """Return what a configuration of Booster says.

    Raises:
        PolicyError: it is against the format.
    """
    path, facts = source.path, source.facts
    facts.source = "Booster configuration"
    dt, pose = source.number("common.dt"), "common.default_qpos"
    source.say_period("common.dt", "policy.control.decimation")
    count = len(source.numbers(pose))
    moved = source.value(Annotated[int, Within(1, count)], "policy.num_actions")
    for fact, key in _BOOSTER.items():
        source.copy(fact, f"common.{key}", count, pose)
    robot = source.robot
    motors = range(count) if robot is None else sorted(motors_of(robot))
    if robot is not None and len(motors) != count:
        raise source.wrong(
            pose,
            f"{pose} has {count} joints, and robot {robot.name!r} has {len(motors)} motors; "
            "choose the robot whose motors it counts",
        )
    source.say_motors(pose, motors)
    joints = facts.values.get("joints")
    source.copy("action.scale", "policy.control.action_scale", moved, "num_actions")
    source.say_clip("policy.normalization.clip_actions")
    part = range(count - moved, count) if moved < count else range(0)
    if joints is not None and part:
        source.say("action.joints", joints[part.start :], "policy.num_actions")
    scales = _BOOSTER_SCALES.items()
    terms = [source.term(*pair, "policy.normalization.", seen=part) for pair in scales]
    size, program = "policy.num_observations", "deploy/utils/policy.py lays out"
    source.say_terms(terms, size, 11 + 3 * moved, f"{program} for {moved} actions")
    facts.say("command", {"slew": _SLEW}, _PROGRAM)
    frequency = source.value(RATE, "policy.gait_frequency")
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
    terms = [source.term(*pair, seen=seen) for pair in _UNITREE_SCALES.items()]
    for i, key in enumerate(_UNITREE_SCALES.values()):
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
    legs = source.places(_LEGS, count=count, of="num_actions")
    rest = source.places(_REST) if document.get(_REST) else []
    if both := {*legs} & {*rest}:
        text = f"motor {min(both)} stands in both; name each motor once"
        raise source.wrong(_LEGS, f"{_LEGS} and {_REST}: {text}")
    source.say_motors(_LEGS, legs + rest)
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
