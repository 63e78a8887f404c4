"""Records of robots with an injected fault, and how large a fault may be.

A record takes 20 s. The velocity command sways, sensors have noise, the base is pushed; seed 0 has
no latency, seed 1 one of 4 ms and seed 2 one of a tick. PyBullet's robots have masses and ground
friction that differ by up to 10 %, by the seed. Emulated robots run in real time behind Unitree's
protocol: the Go2 walks, without a measured velocity of its base, and the G1 hangs.
"""

from __future__ import annotations

import json
from collections import deque
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.injected import EDITED, HEALTHY, LOWERED, OF_JOINT, Case, mistake
from benchmarks.transfers import emulated
from unicon_base.arrays import Array, Float64
from unicon_core.flow import Block, Stage
from unicon_core.models.find import pick_model
from unicon_core.models.frames import turned_by
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel
from unicon_core.platforms.kit.base import rotation
from unicon_core.robots import Robot, load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow import Hook, Program, load_document
from unicon_core.workflow.document import split_setting
from unicon_core.workflow.members import load_robot_of
from unicon_core.workflow.policies import load_policies
from unicon_lab.diagnose import name_of
from unicon_lab.diagnose.plant import KINDS, Place
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording import Record, open_record
from unicon_lab.recording.run_recording import Recording

SECONDS = 20.0
LATENCY = (0.0, 0.004, 0.02)
"""Of the motors in [s], by the seed."""
FILES = {"go2": "go2", "go1": "go1", "g1": "g1_29dof"}
"""Robot to its file."""
NOISE = {"joint_pos": 0.003, "joint_vel": 0.2, "base_ang_vel": 0.05, "base_quat": 0.003}
SENSORS = (*NOISE, "projected_gravity")
HUNG = {"gantry": True, "initial_height": 3.0}
PUSHED = {"push": {"every": 3.0, "velocity": 0.2}}
MASSES = 0.1
"""Share by which masses and ground friction of the second simulator differ."""


def made(
    case: Case, take: int, folder: Path, seconds: float = SECONDS
) -> tuple[Record, str, str, float]:
    """Make the record of a case.

    Args:
        case: what is wrong with it.
        take: of noise, pushes and commands.
        folder: of the record, which has to stay.
        seconds: of the run.

    Returns:
        The record; and what its diagnosis has to find: name and layer of the cause, "" of a healthy
        robot, and the change of the plant, NaN of the contract.

    Raises:
        UniconError: it cannot be made, such as for want of a simulator.
    """
    robot = load_robot(FILES[case.robot])
    loaded = load_model(pick_model(robot), robot, quiet=True)
    joint = robot.joint_names[case.joint]
    joints, model = _joints(case, robot, loaded), loaded.path
    if case.plant == "pybullet" or any(kind.startswith(EDITED) for kind, _ in case.change):
        model = folder / "edited.xml"
        load_model(loaded.path, robot, quiet=True, prepare=partial(_edit, case, loaded, model))
    path = folder / f"{take}.mcap"
    recording = Recording(path, warn=_quiet, patient=True)
    faults = FaultRecord("off", _quiet, recording)
    hooks: list[Hook] = [_late] if case.kind == "late sensors" else []
    options: dict[str, Any] = {"commands": [{"velocity_command": {"schedule": _sway(take)}}]}
    with ExitStack() as stack:
        if case.plant == "emulated":
            said = {"schema": "unicon.robot/1", "extends": robot.name, "simulated": joints}
            overlay = folder / "robot.yaml"
            overlay.write_text(json.dumps(said), encoding="utf-8")
            arguments = ("--model", str(model), "--seed", str(take), *["--hang"] * case.hung)
            there = stack.enter_context(emulated("unitree", str(overlay), arguments))
            options |= {"platform": "unitree", **dict(map(split_setting, there.sets[1:]))}
        else:
            hooks.insert(0, partial(_sensed, case.change))
            scene = {"model": str(model), "joints": joints, "noise": NOISE, "seed": take}
            scene |= HUNG if case.hung else PUSHED
            options |= {f"scene.{key}": value for key, value in scene.items()}
            options |= {"platform": case.plant, f"platforms.{case.plant}.passive": "keep"}
        document = load_document(f"{case.robot}_walk", options)
        contract = load_policies(document, load_robot_of(document))["walk"]
        name, layer, amount = "", "", float("nan")
        if case.change:
            (((kind, at), amount),) = case.change.items()
            name, layer = name_of(kind, joint if at >= 0 else ""), "plant"
        elif case.kind != HEALTHY:
            (contract, name), layer = mistake(contract, case, joint), "contract"
        hooks += [recording.hook, faults.hook]
        program = Program(document, hooks=hooks, contracts={"walk": contract})
        stack.callback(program.close)
        speed: Any = "max" if program.platform.facts.simulated else "real"
        runner = Runner(program, RunOptions(duration=seconds, speed=speed, warn=_quiet))
        faults.attach(runner)
        faults.write(runner.run())
    record = open_record(path)
    record.facts = {k: v.replace(str(model), str(loaded.path)) for k, v in record.facts.items()}
    return record, name, layer, amount


def _quiet(text: str) -> None:
    """Take a warning, such as that a command is held to its range."""


def _sway(take: int) -> list[list[float]]:
    """Return the rows of a schedule [s, m/s, m/s, rad/s], longer than a run."""
    t = np.arange(0.0, 2.0 * SECONDS, 0.2)
    vx, vy, wz = (np.sin(rate * t + (k + 1) * take) for k, rate in enumerate((1.1, 0.7, 0.9)))
    rows: list[list[float]] = np.stack([t, 0.3 + 0.3 * vx, 0.2 * vy, 0.5 * wz], 1).tolist()
    return rows


def _joints(case: Case, robot: Robot, loaded: LoadedModel) -> dict[str, dict[str, float]]:
    """Return what a simulator is told of the joints."""
    model, latency = loaded.model, LATENCY[case.seed]
    own = {"delay": latency, "strength": 1.0}
    joints = {name: {"delay": latency} for name in robot.joint_names if latency}
    for (kind, at), amount in case.change.items():
        for i in [at] if at >= 0 else range(robot.num_joints):
            own["friction"] = model.dof_frictionloss[loaded.dofs[i]]
            own["armature"] = model.dof_armature[loaded.dofs[i]]
            if kind in own:
                joints.setdefault(robot.joint_names[i], {})[kind] = float(own[kind] + amount)
    return joints


def _edit(case: Case, loaded: LoadedModel, path: Path, spec: Any) -> None:
    """Write a model in which masses [kg], frictions and dampings are others."""
    model, change = loaded.model, {kind: amount for (kind, _), amount in case.change.items()}
    share = MASSES if case.plant == "pybullet" else 0.0
    spread = 1.0 + share * np.random.default_rng(case.seed).uniform(-1, 1, model.nbody)
    moment = np.array([change.get(f"centre of mass {axis}", 0.0) for axis in "xyz"])
    for body in spec.bodies[1:]:
        i = model.body(body.name).id
        base = i == model.jnt_bodyid[loaded.base]
        body.explicitinertial, body.fullinertia = True, np.full(6, np.nan)
        body.mass = model.body_mass[i] * spread[i] + base * change.get("payload", 0.0)
        body.ipos = model.body_ipos[i] + base * moment / max(body.mass, 1e-9)
        body.iquat = model.body_iquat[i]
        body.inertia = model.body_inertia[i] * spread[i] * (1 + base * change.get("inertia", 0.0))
    for touching in (*spec.geoms, *spec.pairs):
        touching.friction *= spread[0] * (1.0 + change.get("ground friction", 0.0))
    for (kind, at), amount in case.change.items():
        if kind == "viscous friction":
            for joint in loaded.joints if at < 0 else [loaded.joints[at]]:
                spec.joint(model.joint(joint).name).damping[0] += amount
    spec.meshdir = str((loaded.path.parent / spec.meshdir).resolve())
    spec.compile()
    path.write_text(spec.to_xml(), encoding="utf-8")


def _sensed(change: dict[Place, float], program: Program) -> dict[Stage, list[Block]]:
    """Let the sensors and motors of a simulated robot be wrong."""
    states, platform = program.states, program.platform
    recv, send = platform.recv, platform.send
    offset, amounts = np.zeros(program.robot.num_joints), dict.fromkeys(KINDS, 0.0)
    for (kind, joint), amount in change.items():
        offset[joint] = amount * (kind == "encoder offset")
        amounts[kind] = amount
    bias = [amounts[f"gyro bias {axis}"] for axis in "xyz"]
    tilt = [amounts["attitude x"], amounts["attitude y"], 0.0]
    mount = rotation(np.array(turned_by((1.0, 0.0, 0.0, 0.0), tilt, 1.0)))

    def sensed() -> bool | None:
        gone = recv()
        states["joint_pos"][...] += offset
        states["base_ang_vel"][...] = states["base_ang_vel"] @ mount + bias
        states["projected_gravity"][...] = states["projected_gravity"] @ mount
        states["base_quat"][...] = turned_by(states["base_quat"].tolist(), tilt, 1.0)
        return gone

    def acted() -> bool | None:
        sent = {name: states[name].copy() for name in COMMAND_STATES}
        states["joint_pos_target"][...] -= offset
        for word in ("stiffness", "damping"):
            states[f"joint_{word}"][...] *= 1.0 + amounts[word]
        try:
            return send()
        finally:
            for name, value in sent.items():
                states[name][...] = value

    for name, method in (("recv", sensed), ("send", acted)):
        setattr(platform, name, method)
    return {}


def _late(program: Program) -> dict[Stage, list[Block]]:
    """Let the policy see its sensors a tick late, and the record what they said."""
    views = [program.states[name] for name in SENSORS]
    said: deque[list[Array]] = deque(maxlen=2)

    def write(values: list[Array]) -> None:
        for view, value in zip(views, values):
            view[...] = value

    def told() -> None:
        said.append([view.copy() for view in views])
        write(said[0])

    def measured() -> None:
        write(said[-1])

    blocks = {Stage.INPUT: told, Stage.OBSERVE: measured}
    return {stage: [Block(str(stage), tick, amends=SENSORS)] for stage, tick in blocks.items()}


LEAST, MOST, STEP = 0.05, 20.0, 2.0
"""Of a change of the contract; and factor between two sizes that are tried."""
MATTERS = 0.1
"""Share by which a fault changes how a robot walks."""
WALKS = 0.8
"""Share of the error of a robot that stands still, from which on a robot does not walk."""


def ladder(robot: str, kind: str) -> list[float]:
    """Return five sizes: from the smallest that matters to the last before the robot falls.

    It matters from where on the RMS error of the velocity, or the RMS tilt, is off by 10 %.
    """
    known = KINDS.get(kind.removesuffix(OF_JOINT))
    size, most = (LEAST, MOST) if known is None else (known.least, known.high)
    if known is not None and kind.removesuffix(OF_JOINT) in LOWERED:
        most = -known.low
    case, last, matters = Case(robot, "mujoco", kind, 3, 0), size, size
    healthy = _walk(replace(case, kind=HEALTHY))
    while size <= most and np.isfinite(walked := _walk(replace(case, amount=size))).all():
        last = size
        size *= STEP
        if (abs(walked / healthy - 1.0) < MATTERS).all():
            matters = size
    return [float(f"{each:.3g}") for each in np.geomspace(min(matters, last / 2), last, 5)]


def _walk(case: Case) -> Float64:
    """Return RMS error of the velocity and RMS tilt of 10 s.

    Infinite where the robot falls, or hardly follows its command.
    """
    with TemporaryDirectory(prefix="unicon_diagnose_") as folder:
        record, *_ = made(case, 1, Path(folder), 13.0)
        command, linear, angular, gravity = map(record.states, WALK)
        if not record.ended.all() or len(command) < 600:
            return np.full(2, np.inf)
        speed = np.c_[linear[:, :2], angular[:, 2]]
        errors = (command - speed)[150:], gravity[150:, :2], command[150:]
        velocity, tilt, still = np.sqrt([(error**2).sum(1).mean() for error in errors])
        return np.array([velocity, tilt if velocity < WALKS * still else np.inf])


WALK = ("velocity_command", "base_lin_vel", "base_ang_vel", "projected_gravity")
