"""unitree_rl_gym's `deploy/deploy_{mujoco,real}/configs/*.yaml` as facts.

From unitreerobotics/unitree_rl_gym: `deploy_mujoco.py` and `deploy_real.py` lay out the observation
(angular velocity, gravity, command, joint positions relative to the pose, velocities, last action,
sine and cosine of one clock of 0.8 s that runs on), feed the raw action back and clip nothing. The
first counts the joints as its model has them (`qpos[7:]`); the second names motors
(`leg_joint2motor_idx`), holds the others at `arm_waist_target`, and takes a stick of ±1 times
`max_cmd` as command.
"""

from __future__ import annotations

from pathlib import Path

from unicon_core.policies.facts import Facts, term_state
from unicon_core.policies.importers.source_reader import Source, SourceReader

_PERIOD = 0.8  # of the clock in [s]; it stands in both programs
_ROOT = "{LEGGED_GYM_ROOT_DIR}/"
_LEGS, _REST = "leg_joint2motor_idx", "arm_waist_joint2motor_idx"
_GAINS = {"stiffness": "kps", "damping": "kds", "default_joint_pos": "default_angles"}
# Term to the key of its scale, in the order of the programs.
_SCALES = {
    "ang_vel": "ang_vel_scale",
    "gravity": "",
    "command": "cmd_scale",
    "joint_pos": "dof_pos_scale",
    "joint_vel": "dof_vel_scale",
    "last_action": "",
    "phase": "",
}
_HELD = {"kps": "arm_waist_kps", "kds": "arm_waist_kds", "default_angles": "arm_waist_target"}


def unitree_rl_gym_facts(source: Source) -> Facts:
    """Return what a configuration says.

    Raises:
        PolicyError: it is against the format.
    """
    facts = Facts(source.path, "unitree_rl_gym configuration")
    reader = SourceReader(facts, source.located)
    count = reader.whole("num_actions")
    (_real if _LEGS in reader.document else _mujoco)(reader, count, source)
    _common(reader, count)
    folder = source.path.parent
    root = folder.parents[2] if len(folder.parents) > 2 and folder.name == "configs" else None
    named = reader.need("policy_path")
    inside = isinstance(named, str) and named.startswith(_ROOT)
    reader.network(
        "policy_path", named[len(_ROOT) :] if inside else named, root if inside else None
    )
    return facts


def _mujoco(reader: SourceReader, count: int, source: Source) -> None:
    facts = reader.facts
    reader.say_period("simulation_dt", "control_decimation")
    joints = reader.given_joints(
        source,
        count,
        f"num_actions is {count}; name the joints that it moves, in the order of its model",
    )
    for fact, key in _GAINS.items():
        reader.say_vector(fact, key, count, f"num_actions {count}")
    if joints is None:
        model = Path(str(reader.document.get("xml_path", "its model"))).name
        facts.asks["joints"] = f"the {count} of {model}, in its order"


def _real(reader: SourceReader, count: int, source: Source) -> None:
    facts, counted = reader.facts, f"num_actions {count}"
    reader.say("period", reader.number("control_dt"), "control_dt")
    legs = reader.places(_LEGS)
    rest = reader.places(_REST) if reader.document.get(_REST) else []
    twice = sorted(set(legs) & set(rest))
    if len(legs) != count or twice:
        what = f"motor {twice[0]} stands in both" if twice else f"{len(legs)} for {counted}"
        raise reader.wrong(_LEGS, f"{_LEGS} and {_REST}: {what}; name each motor once")
    order = legs + rest
    if source.robot is not None:
        reader.say_motors(_LEGS, order, source.robot)
    elif source.joints is not None:
        facts.values["joints"] = reader.given_joints(
            source,
            len(order),
            f"{_LEGS} and {_REST} have {len(order)} motors; name the joints of these motors, in "
            "this order",
        )
    else:
        facts.asks["joints"] = f"motors {', '.join(map(str, order))} of the robot: name the robot"
    known = facts.values.get("joints")
    if rest and known is not None:
        reader.say("action.joints", known[:count], _LEGS)
    for fact, key in _GAINS.items():
        values = reader.vector(key, count, counted)
        if rest:
            values += reader.vector(_HELD[key], len(rest), f"the {len(rest)} motors of {_REST}")
        reader.say(fact, values, key)
    if reader.document.get("max_cmd") is not None:
        most = reader.vector("max_cmd", 3, "vx, vy and wz")
        names = ("lin_vel_x", "lin_vel_y", "ang_vel_z")
        ranges = {name: [-value, value] for name, value in zip(names, most)}
        reader.say("command_ranges", ranges, "max_cmd")
    if reader.document.get("imu_type") == "torso":
        facts.notes.append(
            f"{facts.path.name}: imu_type is torso: its program turns the IMU's readings by the "
            "waist to the pelvis; base_quat and base_ang_vel must be the pelvis's"
        )


def _common(reader: SourceReader, count: int) -> None:
    facts = reader.facts
    reader.say_vector("action.scale", "action_scale", count, f"num_actions {count}")
    reader.say("action.feedback", "raw", "action_scale")
    programs = "deploy_mujoco.py and deploy_real.py lay out"
    if not reader.is_laid_out("num_obs", 11 + 3 * count, count, programs):
        return
    own = {"index": list(range(count))} if "joints" in facts.values["action"] else {}
    terms = []
    for i, (name, key) in enumerate(_SCALES.items()):
        term = {"name": name, **(term_state(name) or {"state": "gait_phase"})}
        if key == "cmd_scale":
            term["scale"] = reader.vector(key, 3, "vx, vy and wz")
        else:
            term["scale"] = reader.number(key) if key else 1.0
        terms.append(term | own if name.startswith("joint_") else term)
        line = reader.line(key)
        if line is not None:
            facts.lines[("observation", "terms", i)] = line
    facts.say("observation.terms", terms, "its deploy program")
    facts.say("phase", {"period": _PERIOD, "offsets": [0.0]}, "its deploy program")
