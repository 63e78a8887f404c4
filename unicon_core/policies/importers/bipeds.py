"""Deployments of bipeds, whose programs lay out the observation themselves, as facts.

**humanoid-gym**, from roboterax/humanoid-gym: a legged_gym configuration in Python
(`envs/custom/humanoid_config.py`). `humanoid_env.py` (compute_observations) lays out sine and
cosine of one clock of `rewards.cycle_time`, command, joint positions relative to the pose,
velocities, last action, angular velocity, and roll, pitch, yaw; each frame is clipped after
scaling; `env.frame_stack` whole frames, oldest first, begin with zeros.

**LimX TRON1**, from limxdynamics/tron1-rl-deploy-python: `controllers/model/*/params.yaml` with
`policy/{isaacgym,isaaclab}/{encoder,policy}.onnx`, whose tensors are vectors. The programs
`controllers/{Point,Sole,Wheel}footController.py` lay out angular velocity, gravity, joint
positions relative to the pose (without wheels), velocities, last action and, of feet, sine and
cosine of one clock and the constants frequency, offset, duration and height of its gait. The
encoder gets a history of whole frames, as long as its input; the actor what it gives, the newest
frame, and the command; SF's of Isaac Gym two zeros more. Isaac Lab's networks count the joints of
both sides in turns. Wheels get velocities, scaled by their damping. Beside the contract: at 500 Hz
the programs limit each target so that the servo's torque stays within `user_torque_limit`, and
feed that back as last action; they clip the actor's frame alone, at ±100.

**Agibot X1**, from AgibotTech/agibot_x1_infer: `control_module/cfg/rl_x1.yaml`, in which the
controllers named `rl_…` are policies. `rl_controller.cc` lays out what humanoid-gym does; the clock
is the machine's time, and stands at 0 while the norm of the command is at most `cmd_threshold`.
Beside the contract: at 1 kHz each position passes a second-order Butterworth low pass of cut-off
`wc` [rad/s], bilinear without prewarping (`utilities.cc`). Joints of `paralle_list`, the ankles,
get torques instead: kp (q* − q) − kd q̇ of each millisecond through that low pass, with gains of 0.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from unicon_base import AnyDict, AnyMapping, PolicyError
from unicon_core.policies.facts import GAINS, VOCABULARY, Facts
from unicon_core.policies.importers.env_yaml import legged_gym_facts
from unicon_core.policies.importers.source import RATE, Source
from unicon_core.policies.networks.onnx_file import OnnxFile, read_onnx

_LIMX, _WORDS = "PointfootCfg", VOCABULARY["limx"]
_STICK = 0.5  # what a LimX program gives at most
_POINT_GAIT = (2.0, 0.5, 0.5, 0.1)  # of PointfootController.py


def _say_frame(
    source: Source,
    moved: int,
    scales: str,
    keys: Iterable[str],
    program: str,
    command: str = "lin_vel lin_vel ang_vel",
) -> None:
    """Note the terms of humanoid-gym and the clock.

    Args:
        source: of the configuration.
        moved: number of joints.
        scales: what stands before the keys of the scales.
        keys: where highest value, number of frames and size of a frame stand.
        program: that lays out.
        command: keys of its scale, those of vx, vy and wz.
    """
    clip, history, size = keys
    bound, frames = source.number(clip), source.whole(history)
    frame = VOCABULARY["humanoid_gym"]["terms"] | {"command": command}
    terms = [
        {**source.term(name, scale, scales, bound=bound), "history": frames}
        for name, scale in frame.items()
    ]
    terms[-1]["state"] = "base_rpy"
    source.say_terms(terms, size, 11 + 3 * moved, f"{program} lays out")
    source.facts.say("observation.layout", "frame_major")


def humanoid_gym_facts(source: Source) -> Facts:
    """Return what a humanoid-gym configuration says; given joints resolve its names.

    Raises:
        PolicyError: it is against the format.
    """
    facts = legged_gym_facts(source)
    facts.source, facts.notes = "humanoid-gym configuration", []
    keys = "normalization.clip_observations", "env.frame_stack", "env.num_single_obs"
    moved = source.whole("env.num_actions")
    _say_frame(source, moved, "normalization.obs_scales.", keys, "humanoid_env.py")
    cycle = source.number("rewards.cycle_time")
    source.say("phase", {"period": cycle, "offsets": [0.0]}, "rewards.cycle_time")
    return facts


def agibot_facts(source: Source) -> Facts:
    """Return what an Agibot X1 configuration says of the policy that the given `name` names.

    Raises:
        PolicyError: it is against the format, or has several policies and none is named.
    """
    facts = source.facts
    facts.source = "Agibot X1 configuration"
    controllers = source.value(AnyMapping, "controllers")
    names = [name for name in controllers if str(name).startswith("rl_")]
    name = source.given.get("name", names[0] if len(names) == 1 else None)
    if name not in names:
        raise source.wrong(
            "controllers", f"it has the policies {', '.join(names) or 'none'}; give name: one"
        )
    facts.values["name"] = name
    at = f"controllers.{name}"
    walk, onnx = f"{at}.walk_step_conf", f"{at}.onnx_conf"
    source.say_rate("control_frequecy", f"{walk}.decimation")
    moved = source.whole(f"{onnx}.actions_size")
    source.say("joints", source.need(f"{at}.joint_list"), f"{at}.joint_list")
    for fact, key in zip(("default_joint_pos", *GAINS), ("init_state", *GAINS)):
        source.copy(fact, f"{at}.{key}", moved, "actions_size")
    source.copy("action.scale", f"{walk}.action_scale", 1)
    source.say_clip(f"{onnx}.actions_clip")
    keys = (f"{onnx}.{key}" for key in ("observations_clip", "num_hist", "observations_size"))
    command = "lin_vel lin_vel 1"  # wz as it is
    _say_frame(source, moved, f"{at}.obs_scales.", keys, "rl_controller.cc", command)
    phase: AnyDict = {"period": source.number(f"{walk}.cycle_time"), "offsets": [0.0]}
    if source.value(bool, f"{walk}.sw_mode"):
        below = source.number(f"{walk}.cmd_threshold")
        phase |= {"stand": 0.0, "resume": "clock", "stand_below": below}
    source.say("phase", phase, f"{walk}.cycle_time")
    listed = ", ".join(source.value(list[str], f"{at}.lpf_conf.paralle_list"))
    facts.notes.append(
        f"{source.path.name}: its program filters positions at 1 kHz (wc "
        f"{source.number(f'{at}.lpf_conf.wc'):g} rad/s) and gives {listed} filtered torques; here "
        "the servos have the gains, and nothing is filtered"
    )
    named = source.need(f"{onnx}.policy_file")
    path = f"policy/{Path(named).name}" if isinstance(named, str) else named
    source.network(f"{onnx}.policy_file", path, source.path.parent.parent)
    return facts


def limx_facts(source: Source) -> Facts:
    """Return what a LimX `params.yaml` says, and the networks below it.

    Raises:
        PolicyError: it is against the format, or its networks are.
    """
    facts = source.facts
    facts.source, source.document = "LimX params.yaml", source.need(_LIMX)
    source.files = [(source.located, (_LIMX,))]
    names = source.numbers("joint_names", hint=list[str])
    count = len(names)
    if count % 2:
        raise source.wrong("joint_names", f"joint_names has {count} names; both legs have as many")
    source.say_rate("loop_frequency", "control.decimation")
    kind = _limx_networks(source)
    if kind == "isaaclab":
        names = [names[i + side] for i in range(count // 2) for side in (0, count // 2)]
    source.say("joints", names, "joint_names")
    pose = "init_state.default_joint_angle"
    facts.say("default_joint_pos", [source.number(f"{pose}.{name}") for name in names], pose)
    parts = [name.partition("_")[0] for name in names]
    wheels = [part == "wheel" for part in parts]
    position, kp = (source.number(f"control.{key}") for key in ("action_scale_pos", "stiffness"))
    kd = [source.number(f"control.{_WORDS['damping'].get(part, 'damping')}") for part in parts]
    facts.say("stiffness", [0.0 if wheel else kp for wheel in wheels], "control")
    facts.say("damping", kd, "control")
    scale = [d if wheel else position for d, wheel in zip(kd, wheels)]
    source.say("action.scale", scale, "control.action_scale_pos")
    if any(wheels):
        facts.say("action.kind", ["velocity" if wheel else "position" for wheel in wheels])
    source.say_clip("normalization.clip_scales.clip_actions")
    gait = _POINT_GAIT
    if "ankle" in parts:
        height = source.number("gait.swing_height")
        frequency = source.value(RATE, "gait.frequencies")
        gait = (frequency, *_POINT_GAIT[1:3], height)
    if not any(wheels):
        facts.say("phase", {"period": 1.0 / gait[0], "offsets": [0.0]}, "its program's gait")
    _limx_terms(source, wheels, gait)
    axes = ("lin_vel_x", "lin_vel_y", "ang_vel_z")
    facts.say("command_ranges", {axis: [-_STICK, _STICK] for axis in axes}, "its program's stick")
    facts.notes.append(
        f"{source.path.name}: velocity_command is scaled by user_cmd_scales, as its program does a "
        f"stick of ±{_STICK:g}; its limit of torques at 500 Hz is not imported"
    )
    if any(source.number(f"imu_orientation_offset.{axis}") for axis in ("roll", "pitch", "yaw")):
        facts.notes.append(
            f"{source.path.name}: imu_orientation_offset is not imported; the robot file has it"
        )
    return facts


def _limx_networks(source: Source) -> str:
    """Find encoder and actor, whose folder says where they were trained; return its name."""
    facts, folder = source.facts, source.path.parent / "policy"
    found = [k for k in ("isaacgym", "isaaclab") if (folder / k / "policy.onnx").is_file()]
    chosen = [kind for kind in found if kind in str(source.given.get("onnx"))] or found
    if len(chosen) != 1:
        options = " or ".join(f"policy/{kind}/policy.onnx" for kind in found)
        remedy = f"give onnx: {options}" if found else "put policy/isaacgym/policy.onnx there"
        raise PolicyError(f"{source.path}: {len(found)} networks are below it; {remedy}")
    (kind,) = chosen
    facts.values["onnx"] = f"policy/{kind}/policy.onnx"
    return kind


def _limx_terms(source: Source, wheels: list[bool], gait: tuple[float, ...]) -> None:
    facts, count = source.facts, len(wheels)
    actor = read_onnx(facts.model())
    encoder = read_onnx(actor.path.with_name("encoder.onnx"))
    seen = [i for i in range(count) if not wheels[i]]
    scales = "normalization.obs_scales."
    frame = [source.term(name, scale, scales) for name, scale in _WORDS["terms"].items()]
    if any(wheels):
        frame[2]["index"] = seen
    else:
        frame += [source.term("clock"), {"name": "gait", "value": list(gait)}]
    size = 6 + len(seen) + 2 * count + (0 if any(wheels) else 6)
    if (said := source.whole(place := "size.observations_size")) != size:
        text = f"is {said}, and its program lays out {size} for {count} joints; correct one"
        raise source.wrong(place, f"{place} {text}")
    (given, history), (latent, _) = _only(encoder.inputs, encoder), _only(encoder.outputs, encoder)
    (taken, width), code = _only(actor.inputs, actor), source.whole("size.encoder_output_size")
    zeros = width - code - size - 3
    if history % size or zeros < 0:
        raise PolicyError(
            f"{encoder.path}: it takes {history} values and the actor {width}, which fit no frames "
            f"of {size} values, {code} of the encoder and 3 of the command; give the networks of "
            "this params.yaml"
        )
    terms = [{**term, "history": history // size} for term in frame]
    terms.append(source.term("command", "lin_vel_x lin_vel_y ang_vel_yaw", "user_cmd_scales."))
    if zeros:
        terms.append({"name": "unused", "value": [0.0] * zeros})
    facts.values["observation"] = {"layout": "frame_major", "newest": "last", "terms": terms}
    named = str(Path(facts.values["onnx"]).with_name("encoder.onnx"))
    fed = {given: f"observation[0:{history}]"}
    newest = f"observation[{history - size}:{history + 3 + zeros}]"
    facts.values |= {
        "networks": {"encoder": {"onnx": named, "feeds": fed}},
        "feeds": {taken: [f"encoder.{latent}", newest]},
    }


def _only(tensors: tuple[Any, ...], file: OnnxFile) -> tuple[str, int]:
    """Return name and width of the only input or output of a network."""
    if len(tensors) != 1 or not isinstance(tensors[0].width, int):
        listed = ", ".join(map(str, tensors))
        raise PolicyError(f"{file.path}: it has {listed}; one vector is wanted in and one out")
    return tensors[0].name, tensors[0].width
