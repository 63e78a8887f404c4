"""Which importer reads a deployment's configuration, or the metadata of an ONNX file.

Configurations that are classes in Python, as legged_gym and humanoid-gym have them, are read as
data. Nothing is run: of each class the literals and the classes within are taken, and those of base
classes in the same file. What a base class of another file says, or what is computed, is not said.

Configurations of two deployment programs, which lay out the observation themselves, are read here:

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

import ast
import json
from collections import defaultdict
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from unicon_base import AnyDict, AnyMapping, PolicyError, one_line
from unicon_base.located_yaml import Located, Where, read_text
from unicon_base.schema.marks import Within
from unicon_core.policies.facts import VOCABULARY, Facts, says
from unicon_core.policies.importers.bipeds import agibot_facts, humanoid_gym_facts, limx_facts
from unicon_core.policies.importers.deploy_yaml import deploy_yaml_facts, refuse_base, rl_sar_facts
from unicon_core.policies.importers.env_yaml import env_yaml_facts, legged_gym_facts, lerobot_facts
from unicon_core.policies.importers.metadata import exploy_facts, holosoma_facts, mjlab_facts
from unicon_core.policies.importers.source import RATE, Source, motors_of
from unicon_core.policies.networks.onnx_file import OnnxFile, short_text

_PROGRAM = "its deploy program"
_SLEW = 1.0  # of the command in [m/s²] and [rad/s²]: one period for each tick, in policy.py
_STILL = 1e-5  # [m/s], [rad/s]: no command below it, in policy.py
_BOOSTER, _UNITREE = VOCABULARY["booster"], VOCABULARY["unitree_rl_gym"]

_PERIOD = 0.8  # of the clock in [s]; it stands in both programs
_ROOT = "{LEGGED_GYM_ROOT_DIR}/"
_LEGS, _REST = "leg_joint2motor_idx", "arm_waist_joint2motor_idx"


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
    for fact, key in _BOOSTER["facts"].items():
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
    under = "policy.normalization."
    scales = _BOOSTER["terms"].items()
    terms = [source.term(name, scale, under, seen=part) for name, scale in scales]
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
    for fact, (key, held) in _UNITREE["facts"].items():
        more = source.numbers(held, len(rest)) if rest else []
        source.say(fact, source.numbers(key, count, "num_actions") + more, key)
    source.copy("action.scale", "action_scale", count, "num_actions")
    source.say("action.feedback", "raw", "action_scale")
    seen = range(count) if "joints" in facts.values["action"] else range(0)
    terms = [source.term(*pair, seen=seen) for pair in _UNITREE["terms"].items()]
    for i, key in enumerate(_UNITREE["terms"].values()):
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


# A key of the metadata that tells the format -> its reader; the first one counts.
_METADATA: dict[str, Callable[[OnnxFile], Facts]] = {
    "exploy_version": exploy_facts,
    "dof_names": holosoma_facts,
    "joint_names": mjlab_facts,
}
_NAMES = {"joint_names": ",".join, "dof_names": json.dumps}
# Format of a configuration -> its reader; the first one whose keys are all there counts.
_CONFIGURATIONS: dict[str, Callable[[Source], Facts]] = {
    "deploy_yaml": deploy_yaml_facts,
    "env_yaml": env_yaml_facts,
    "humanoid_gym": humanoid_gym_facts,
    "legged_gym": legged_gym_facts,
    "limx": limx_facts,
    "agibot": agibot_facts,
    "rl_sar": rl_sar_facts,
    "rl_sar_base": refuse_base,
    "unitree_rl_gym": unitree_rl_gym_facts,
    "booster": booster_facts,
    "lerobot": lerobot_facts,
}
_MOTORS = ("joint_ids_map", "leg_joint2motor_idx", "common.default_qpos")


def metadata_reader(onnx: OnnxFile) -> Callable[[OnnxFile], Facts] | None:
    """Return what reads the metadata of a file; None where they are of no known format."""
    keys = dict(onnx.metadata)
    return next((reader for key, reader in _METADATA.items() if key in keys), None)


def settled(
    onnx: OnnxFile, said: AnyMapping, where: str, *, whole: bool = False
) -> tuple[OnnxFile, list[str]]:
    """Return the file without keys that stand twice with different values, and notes of them.

    Args:
        onnx: the file.
        said: facts that count instead, with the keys of `policy.yaml`, nested or dotted.
        where: who says them, for messages: `given`, `policy.yaml`.
        whole: it is a whole contract, which leaves nothing to the metadata.

    Raises:
        PolicyError: a key stands twice, and its fact is not said.
    """
    values = defaultdict[str, list[str]](list)
    for key, value in dict.fromkeys(onnx.metadata):
        values[key].append(value)
    notes = []
    for key, (first, *others) in values.items():
        if not others:
            continue
        fact = VOCABULARY["metadata"].get(key)
        both = f"{short_text(first)} and as {short_text(others[0])}"
        text = f"metadata key {key!r} stands twice, as {both}"
        if fact is not None and (whole or says(said, fact)):
            notes.append(f"{onnx.path.name}: {text}; {fact} of {where} counts")
            continue
        settle = f", or say {fact} under 'given' or in a policy.yaml beside it" if fact else ""
        raise PolicyError(f"{onnx.path}: {text}; export the policy again with one of them{settle}")
    kept = [pair for pair in onnx.metadata if len(values[pair[0]]) == 1]
    for key, written in _NAMES.items():  # by which all vectors are read
        joints = said.get("joints")
        if len(values[key]) > 1 and isinstance(joints, list | tuple):
            kept.append((key, written([str(name) for name in joints])))
    return replace(onnx, metadata=tuple(kept)), notes


def configuration_reader(values: Any) -> Callable[[Source], Facts] | None:
    """Return what reads a YAML document of a deployment; None where it is of no known format."""
    for name, read in _CONFIGURATIONS.items():
        if all(_has(values, key) for key in VOCABULARY[name]["keys"]):
            return read
    return None


def counts_motors(values: Any) -> bool:
    """Whether a YAML document names joints by the numbers of a robot's motors."""
    return any(_has(values, key) for key in _MOTORS)


def _has(values: Any, key: str) -> bool:
    for step in key.split("."):
        if step == "*" and isinstance(values, Mapping) and len(values) == 1:
            (step,) = values
        if not isinstance(values, Mapping) or step not in values:
            return False
        values = values[step]
    return True


_Class: TypeAlias = tuple[AnyDict, dict[Where, int]]
_WRONG = (SyntaxError, ValueError, TypeError, MemoryError, RecursionError)


def read_python(path: Path) -> Located:
    """Return the one class of a file that is a known configuration, as nested mappings.

    Raises:
        PolicyError: the file cannot be read, or has none or several of them.
    """
    try:
        tree = ast.parse(read_text(path, PolicyError))
    except _WRONG as error:
        text = f"no Python: {one_line(error)}; give the file of the configuration"
        raise PolicyError(f"{path}: {text}") from error
    known: dict[str, _Class] = {}
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            _read(node, node.name, known)
    found = {
        name: made
        for name, made in known.items()
        if "." not in name and configuration_reader(made[0]) is not None
    }
    if len(found) != 1:
        names = ", ".join(found) or "none"
        text = f"has {len(found)} configurations of legged_gym or humanoid-gym ({names})"
        raise PolicyError(f"{path}: it {text}; leave one in a copy")
    ((values, lines),) = found.values()
    return Located(path, values, lines, PolicyError)


def _read(node: ast.ClassDef, name: str, known: dict[str, _Class]) -> _Class:
    """Return a class's literals and their lines; `known` gets it, and the classes within."""
    values: AnyDict = {}
    lines: dict[Where, int] = {}
    for base in node.bases:
        more, places = known.get(ast.unparse(base), ({}, {}))
        values, lines = values | more, lines | places
    lines[()] = node.lineno
    for item in node.body:
        match item:
            case ast.ClassDef(name=key):
                values[key], places = _read(item, f"{name}.{key}", known)
                lines |= {(key, *where): line for where, line in places.items()}
            case (
                ast.Assign(targets=[ast.Name(id=key)], value=ast.expr() as value)
                | ast.AnnAssign(target=ast.Name(id=key), value=ast.expr() as value)
            ):
                values.pop(key, None)
                with suppress(*_WRONG):  # computed
                    values[key] = ast.literal_eval(value)
                    lines[(key,)] = item.lineno
    known[name] = values, lines
    return values, lines
