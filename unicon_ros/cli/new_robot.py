"""`unicon robots new MODEL [--out FILE]`: a robot file of what an MJCF or URDF knows."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from unicon_base import AnyDict, ModelError, RobotError
from unicon_base.arrays import Float64
from unicon_base.located_yaml import parse_yaml
from unicon_core.check.joints import model_joints
from unicon_core.models.find import find_model
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel, drives, import_mujoco, is_simple
from unicon_core.page import refuse_existing, write_file
from unicon_core.robots import Robot
from unicon_core.robots.file import KINDS, SCHEMA, joint_bounds
from unicon_core.robots.load import read_robot_file
from unicon_core.robots.robot import JOINT_FIELDS
from unicon_ros.cli.robot_kind import feet_of, kind_of, legs_of, wheels_of

_IMU = re.compile(r"(^|_)imu", re.IGNORECASE)
# What MuJoCo calls a model that has no name.
_NAMELESS = "MuJoCo Model"
_STANDING = re.compile(r"home|stand|default|init", re.IGNORECASE)
_LEGS = {"humanoid": 2, "quadruped": 4}
UNITS = "rad, rad/s, N·m, N·m/rad, N·m·s/rad; bring them into the vendor's motor order"
_LYING = re.compile(r"rest|lie|lying|prone|crouch|sit", re.IGNORECASE)


@dataclass
class _Facts:
    """What was found: figures by key of a joint, shape (n,), NaN where it is not said.

    `hangs`: its base should move freely, and the model fixes it. `passive`: joints left out, which
    have no actuator where others have one. `damped`: damping of the joints themselves.
    """

    name: str
    kind: str
    reason: str
    base: str
    hangs: bool
    joints: tuple[str, ...]
    passive: list[str]
    figures: dict[str, Float64]
    damped: Float64
    imu: tuple[str, Float64, Float64] | None
    feet: list[str]
    sources: dict[str, str]


def new_robot(model: str, out: str | None, kind: str | None = None) -> str:
    """Write a robot file of what a model knows; return what was written and what is not known.

    Args:
        model: path, `assets:PATH` or `robot_descriptions:NAME` of an MJCF or a URDF.
        out: the file; NAME.yaml of what the model calls itself, or of its file, where it is None.
        kind: of the robot; what the model says where it is None.

    Raises:
        ModelError: there is no such model, or it has no joints.
        RobotError: the model does not say the kind.
        UniconError: the file exists, or cannot be written.
    """
    path = find_model(model, Path.cwd())
    bare = load_model(path, _robot(path, (), "arm"), quiet=True)
    file = Path(out) if out else Path(f"{_name(bare)}.yaml")
    if file.suffix != ".yaml":
        raise RobotError(f"robots new: {file} is not a .yaml file; give --out NAME.yaml")
    refuse_existing(file, "robots new: ")
    if kind is not None and kind not in KINDS:
        raise RobotError(
            f"robots new: --kind {kind} is none of {', '.join(KINDS)}; give one of them"
        )
    facts = _facts(bare, file.stem, kind)
    models, named = _models(model, path, file)
    text = _text(facts, models)
    read_robot_file(parse_yaml(text, file, RobotError))
    write_file(file, text.encode())
    unknown = _unknown(facts)
    lines = [
        f"{file}: {facts.kind} ({facts.reason}; else give --kind), {len(facts.joints)} joints "
        f"of {path}",
        f"not known: {', '.join(unknown)}" if unknown else "not known: nothing",
        "look at all of it, correct what your robot has otherwise, and take from unknown what you "
        "give, with its source",
    ]
    if facts.passive:
        lines.append(
            f"{len(facts.passive)} joints are left out, since the model has no actuator for them: "
            f"{', '.join(facts.passive)}; they stay passive in it: add those that a motor turns"
        )
    stiff = ~np.isnan(facts.figures["stiffness"])
    if (stiff & np.isnan(facts.figures["damping"]) & (facts.damped > 0.0)).any():
        lines.append(
            "the model's actuators do not damp and its joints do, by "
            f"{facts.damped[stiff].max():.3g} N·m·s/rad at most: damping: 0.0 simulates it as it is"
        )
    if len(facts.feet) != _LEGS.get(facts.kind, len(facts.feet)):
        lines.append(
            f"{len(facts.feet)} feet were found for the {_LEGS[facts.kind]} legs of a "
            f"{facts.kind} ({', '.join(facts.feet) or 'none'}): name a body, site or geom of the "
            "model for each under feet"
        )
    if facts.hangs:
        lines.append(
            f"the model fixes its base, so the robot hangs in the air: write <freejoint/> into "
            f"body {facts.base!r} of {path}"
        )
    return "\n".join([*lines, *named])


def _name(bare: LoadedModel) -> str:
    """Return what a model calls itself, else its file's stem, as the name of a file.

    A scene is called as the file that it includes.
    """
    own = bytes(bare.model.names).split(b"\0")[0].decode("utf-8", "replace")
    own = bare.path.stem if own in ("", _NAMELESS) else own
    if own.lower().endswith("scene"):
        with suppress(ET.ParseError):  # MuJoCo reads more than XML
            files = (each.get("file", "") for each in ET.parse(bare.path).iter("include"))
            own = next((Path(file).stem for file in files if file), own)
    return re.sub(r"[^A-Za-z0-9_]", "_", own)


def _facts(bare: LoadedModel, name: str, kind: str | None) -> _Facts:
    path, model = bare.path, bare.model
    simple, passive = _driven(model, _simple(model))
    names = [model.joint(i).name for i in simple]
    if not all(names) or not names:
        what = "a joint without a name" if names else "no joint that turns or slides"
        raise ModelError(f"model {path}: it has {what}; name the joints of the robot in the model")
    joints, order = _ordered(path, model, names)
    kind, reason = (kind, "as given") if kind else kind_of(model, simple, str(path))
    wheels = wheels_of(model, simple)
    feet = feet_of(model, legs_of(model, simple)) if kind in _LEGS else []
    loaded = load_model(path, _robot(path, joints, kind), quiet=True)
    model = loaded.model
    base = _base(loaded)
    hangs = kind not in ("hand", "arm") and loaded.base is None
    figures, sources = _figures(loaded, joints, path)
    for i in (i for i, joint in enumerate(joints) if joint in wheels):
        figures["lower"][i], figures["upper"][i] = -np.inf, np.inf
    imu = _imu(model, base)
    known = [key for key in ("effort", "velocity") if not np.isnan(figures[key]).all()]
    if not np.isnan((figures["lower"], figures["upper"])).all():
        known.insert(0, "limits")
    said = ", ".join(("names", *known))
    sources = {"joints": f"{path.name}: {said}; order: {order}"} | sources
    if imu is not None:
        sources["imu"] = f"{path.name}: {imu[0]}"
    if feet:
        sources["feet"] = f"{path.name}: names at the ends of its legs"
    sources["transport"] = "not known"
    names = [model.joint(i).name or f"joint {i}" for i in passive]
    body = model.body(base).name
    damped = np.array([model.dof_damping[model.jnt_dofadr[i]] for i in loaded.joints])
    return _Facts(
        name, kind, reason, body, hangs, joints, names, figures, damped, imu, feet, sources
    )


def _simple(model: Any) -> list[int]:
    """Return the joints with one axis of the tree that has most of them: the robot's."""
    joints = [i for i in range(model.njnt) if is_simple(model, i)]
    roots = [int(model.body_rootid[model.jnt_bodyid[i]]) for i in joints]
    most = max(roots, key=roots.count, default=0)
    return [i for i, root in zip(joints, roots) if root == most]


def _driven(model: Any, joints: list[int]) -> tuple[list[int], list[int]]:
    """Return the joints with an actuator, and the others; all of a model without actuators."""
    mujoco = import_mujoco()
    driven, tendon = {*drives(model)}, int(mujoco.mjtTrn.mjTRN_TENDON)
    for pulled in model.actuator_trnid[model.actuator_trntype == tendon, 0]:
        first, count = int(model.tendon_adr[pulled]), int(model.tendon_num[pulled])
        wraps = slice(first, first + count)
        fixed = model.wrap_type[wraps] == int(mujoco.mjtWrap.mjWRAP_JOINT)
        driven |= {*model.wrap_objid[wraps][fixed].tolist()}
    own = [joint for joint in joints if joint in driven]
    return (own, [joint for joint in joints if joint not in driven]) if own else (joints, [])


def _robot(path: Path, joints: tuple[str, ...], kind: str) -> Robot:
    """A robot that the model's loader takes: nothing is known of it but its joints' names."""
    nothing: Any = {
        field: np.full(len(joints), np.nan, np.float32) for field in JOINT_FIELDS.values()
    }
    return Robot(
        name=path.stem,
        description="",
        manufacturer="",
        kind=kind,
        path=path,
        models={},
        base_frame="",
        joint_names=joints,
        imu=None,
        feet=(),
        transport={},
        sources={},
        unknown=(),
        **nothing,
    )


def _ordered(path: Path, model: Any, names: list[str]) -> tuple[tuple[str, ...], str]:
    """Return the joints in the order of the actuators where each has its own, and what was taken.

    The vendor's motor order may be another one.
    """
    driven = drives(model)
    first = {model.joint(j).name: min(ids) for j, ids in driven.items()}
    if path.suffix.lower() != ".urdf" and set(names) <= set(first):
        return tuple(sorted(names, key=first.__getitem__)), "its actuators"
    return tuple(names), "its joints"


def _base(loaded: LoadedModel) -> int:
    """Return the body that carries the robot: of the free joint, else the first one."""
    free = loaded.base
    if free is not None:
        return int(loaded.model.jnt_bodyid[free])
    body = int(loaded.model.jnt_bodyid[loaded.joints[0]])
    while int(loaded.model.body_parentid[body]):
        body = int(loaded.model.body_parentid[body])
    return body


def _imu(model: Any, base: int) -> tuple[str, Float64, Float64] | None:
    """Return name, position [m] and quaternion wxyz of an IMU that is fixed to the base."""
    mujoco = import_mujoco()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    weld = model.body_weldid[base]
    turn = np.array(data.xmat[base]).reshape(3, 3)
    sites = ((i, "site", model.site_bodyid[i]) for i in range(model.nsite))
    bodies = ((i, "body", i) for i in range(1, model.nbody))
    for i, kind, body in (*sites, *bodies):
        name = getattr(model, kind)(i).name
        if model.body_weldid[body] != weld or not _IMU.search(name):
            continue
        at, matrix = (data.site_xpos, data.site_xmat) if kind == "site" else (data.xpos, data.xmat)
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, (turn.T @ np.array(matrix[i]).reshape(3, 3)).ravel())
        return name, turn.T @ (at[i] - data.xpos[base]), quat
    return None


def _figures(
    loaded: LoadedModel, joints: tuple[str, ...], path: Path
) -> tuple[dict[str, Float64], dict[str, str]]:
    said = model_joints(loaded)
    assert said is not None  # there is a model
    speeds = _speeds(path)
    poses = loaded.key_poses()
    nothing = np.full(len(joints), np.nan)
    stand = next((key for key in poses if _STANDING.search(key)), None)
    rest = next((key for key in poses if _LYING.search(key)), None)
    if stand is None:
        stand = next((key for key in poses if key != rest), None)
    figures = {
        "lower": said.lower,
        "upper": said.upper,
        "velocity": np.array([speeds.get(name, np.nan) for name in joints]),
        "effort": said.effort,
        "default": nothing if stand is None else poses[stand],
        "rest": nothing if rest is None else poses[rest],
        "stiffness": said.stiffness,
        "damping": np.where(said.damping > 0.0, said.damping, np.nan),
    }
    bounds = joint_bounds()
    for key, values in figures.items():
        figures[key] = np.where(np.abs(values) <= bounds[key], values, np.nan)
    for key in ("velocity", "effort"):
        figures[key] = np.where(figures[key] > 0.0, figures[key], np.nan)
    wrong = figures["lower"] >= figures["upper"]
    for key in ("lower", "upper"):
        figures[key] = np.where(wrong, np.nan, figures[key])
    for key in ("default", "rest"):  # a key frame on a limit may lie beyond it by rounding
        beyond = (figures[key] < figures["lower"] - 1e-4) | (figures[key] > figures["upper"] + 1e-4)
        inside = np.fmax(np.fmin(figures[key], figures["upper"]), figures["lower"])
        figures[key] = np.where(beyond | np.isnan(figures[key]), np.nan, inside)
    sources = {}
    if not np.isnan([figures["stiffness"], figures["damping"]]).all():
        sources["gains"] = f"{path.name}: position actuators"
    for key, frame in (("default", stand), ("rest", rest)):
        if not np.isnan(figures[key]).all():
            sources[key] = f"{path.name}: key frame {frame!r}"
    return figures, sources


def _speeds(path: Path) -> dict[str, float]:
    """Return joint to largest speed [rad/s] of a URDF, which MuJoCo does not keep."""
    if path.suffix.lower() != ".urdf":
        return {}
    speeds = {}
    for joint in ET.parse(path).getroot().findall("joint"):
        limit = joint.find("limit")
        try:
            speeds[joint.get("name", "")] = float(
                "nan" if limit is None else limit.get("velocity", "nan")
            )
        except ValueError:
            continue
    return speeds


def _unknown(facts: _Facts) -> list[str]:
    unknown = ["joint_order"]
    unknown += [f"joints.{key}" for key, each in facts.figures.items() if np.isnan(each).any()]
    walks = facts.kind in ("quadruped", "humanoid")
    unknown += ["imu"] if walks and facts.imu is None else []
    if not facts.feet:
        unknown += ["feet"] if walks else ["fingertips"] if facts.kind == "hand" else []
    return [*unknown, "transport.protocol"]


def _models(model: str, path: Path, file: Path) -> tuple[dict[str, str], list[str]]:
    """Return what the file says under `models`, and a line where it cannot name the model."""
    kind = "urdf" if path.suffix.lower() == ".urdf" else "mjcf"
    if model.startswith(("assets:", "robot_descriptions:")):
        return {kind: model}, []
    try:
        return {kind: path.resolve().relative_to(file.resolve().parent).as_posix()}, []
    except ValueError:
        line = f"the model does not lie beside {file}: let the workflow name it, scene: {{model: "
        return {}, [f"{line}{path}}}"]


def _text(facts: _Facts, models: dict[str, str]) -> str:
    form: AnyDict = {"sort_keys": False, "allow_unicode": True, "width": 1000}
    imu = None
    if facts.imu is not None:
        frame, position, quat = facts.imu
        imu = {"frame": frame, "position": _list(position), "quat": _list(quat)}
    contacts = {"hand": "fingertips", "arm": "", "wheeled": ""}.get(facts.kind, "feet")
    told = {
        "schema": SCHEMA,
        "name": facts.name,
        "description": f"{facts.name}, with {len(facts.joints)} joints, of its model",
        "manufacturer": "unknown",
        "kind": facts.kind,
        "models": models,
        "base_frame": facts.base or "base",
        "joints": [
            {"name": name, **{key: _figure(values[i]) for key, values in facts.figures.items()}}
            for i, name in enumerate(facts.joints)
        ],
        "imu": imu,
        **({contacts: facts.feet} if contacts else {}),
        "transport": {"protocol": None},
        "unknown": _unknown(facts),
    }
    # A line for each joint, and for each source.
    text = str(yaml.safe_dump(told, default_flow_style=None, **form))
    sources = yaml.safe_dump({"sources": facts.sources}, default_flow_style=False, **form)
    return text.replace("\njoints:\n", f"\njoints: # {UNITS}\n") + str(sources)


def _figure(value: float) -> float | None:
    return None if np.isnan(value) else round(float(value), 6) + 0.0


def _list(values: Float64) -> list[float | None]:
    return [*map(_figure, values)]
