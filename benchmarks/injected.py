"""Records of robots with an injected fault, and how large a fault may be.

A fault is in the plant, where joints, masses, sensors or gains are not what the simulator of the
robot has, or in the contract with which the policy ran. `injected.yaml` lists the kinds, five sizes
of each for each robot, which `ladder` finds, and what a kind changes. Where a policy would fall at
once, the robot hangs.

A record takes 20 s. The velocity command sways, sensors have noise, the base is pushed; seed 0 has
no latency, seed 1 one of 4 ms and seed 2 one of a tick. PyBullet's robots have masses and ground
friction that differ by up to 10 %, by the seed. Emulated robots run in real time behind Unitree's
protocol: the Go2 walks, without a measured velocity of its base, and the G1 hangs.
"""

from __future__ import annotations

import json
from collections import deque
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.samples import unsaid
from benchmarks.sloc import emulated
from unicon_base import AnyDict
from unicon_base.arrays import Array
from unicon_base.located_yaml import read_yaml
from unicon_core.check.joints import mirror_pairs
from unicon_core.check.twin.perturb import (
    exchanged,
    gains_of,
    permuted,
    renamed,
    with_action,
    with_gains,
    with_scales,
    with_terms,
)
from unicon_core.flow import Block, Stage
from unicon_core.models.find import pick_model
from unicon_core.models.frames import multiply, turned_by
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel
from unicon_core.platforms.kit.base import rotation
from unicon_core.policies import PolicyContract
from unicon_core.policies.contract import FilterSpec
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import Hook, HookBlocks, Program, load_document
from unicon_core.workflow.document import split_setting
from unicon_core.workflow.members import load_robot_of
from unicon_core.workflow.policies import load_policies
from unicon_lab.diagnose.plant import KINDS
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording import Record, open_record
from unicon_lab.recording.run_recording import Recording

SIZES = read_yaml(Path(__file__).with_name("injected.yaml")).value
SETUP = SIZES.pop("setup")  # what is left is kind to robot, or `all`, to its five sizes
HEALTHY = "healthy"
OF_JOINT = " of a joint"


@dataclass(frozen=True)
class Case:
    """One record that is made and diagnosed.

    Attributes:
        robot, plant: of the plants of `SETUP`.
        kind: of `SIZES`, or `HEALTHY`.
        size: which of the five; of a healthy record how many were before it.
        seed: of latency, and of what masses a plant has.
        amount: of the change.
        hung: whether the robot hangs.
    """

    robot: str
    plant: str
    kind: str
    size: int
    seed: int
    amount: float = 0.0
    hung: bool = False

    @property
    def name(self) -> str:
        """What tells it from all others."""
        return f"{self.robot}/{self.plant}/{self.kind}/{self.size}/{self.seed}"

    @property
    def joint(self) -> int:
        """Number of the joint, of a kind that concerns one."""
        return (5 * self.size + 7 * self.seed) % 12

    @property
    def joints(self) -> slice:
        """Numbers of the joints that it concerns."""
        one = self.kind.endswith(OF_JOINT)
        return slice(self.joint, self.joint + 1) if one else slice(None)

    @property
    def change(self) -> float:
        """Change of the plant; NaN of the contract."""
        what = self.kind.removesuffix(OF_JOINT)
        sign = -1.0 if what in SETUP["lowered"] else 1.0
        return sign * self.amount if what in KINDS else np.nan

    def of(self, what: str) -> float:
        """Return the change of one kind."""
        return self.change if self.kind.removesuffix(OF_JOINT) == what else 0.0


def cases() -> list[Case]:
    """Return all: 15 of each kind, which meets every robot and plant that has it, and healthy."""
    found = []
    for kind, known in {**SIZES, HEALTHY: {}}.items():
        cells = [
            (robot, plant)
            for plant, robots in SETUP["plants"].items()
            for robot, lacking in robots.items()
            if not kind.startswith(tuple(lacking))
        ]
        for i, (robot, plant) in zip(range(15 if known else 60), cycle(cells)):
            amounts = known.get(robot, known.get("all", [0.0] * 60))
            size, seed = i % len(amounts), i // (5 if known else len(cells)) % 3
            hung = "all" in known and plant != "pybullet"  # which has no gantry
            hung |= (robot, plant) == ("g1", "emulated")
            found.append(Case(robot, plant, kind, size + 1, seed, amounts[size], hung))
    return found


def mistake(c: PolicyContract, case: Case, joint: str) -> tuple[PolicyContract, str]:
    """Return the contract with a case's mistake, and what a diagnosis has to call the fault."""
    kind, s, k, joints = case.kind, case.amount, int(case.amount), c.joints
    parts = SETUP["mistakes"].get(kind, {})
    parts = parts.get(str(k), parts)
    called = parts.get("called", kind.replace("a joint", "{joint}"))
    by, seen = parts.get("size", s), parts.get("terms", ())
    if "{joint}" in called:
        by = by * (np.array(joints) == joint)
    where = [term.name for term in c.terms if term.state in seen]

    def changed(figures: Array) -> Any:
        return figures + np.float32(by) if "added" in parts else figures * np.float32(1 + by)

    c = with_action(c, **{key: changed(getattr(c.action, key)) for key in parts.get("action", ())})
    c = replace(c, **{key: changed(getattr(c, key)) for key in parts.get("contract", ())})
    c = with_scales(c, lambda t: changed(t.scale) if t.state in seen else t.scale)
    match kind:
        case "joint order" | "left right":
            order = sorted(joints) if k > 2 else joints[::-1]
            order = exchanged(joints, mirror_pairs(joints)) if kind == "left right" else order
            c = (renamed if k % 2 else permuted)(c, order)  # names alone, or figures with them
        case "joint exchange":
            a, b = where = [*joints[2 * k : 2 * k + 2]]
            c = renamed(c, exchanged(joints, [(a, b)]))
        case "term order":
            pair = c.terms[k - 1 : k + 1]
            where = [term.name for term in pair]
            c = with_terms(c, (*c.terms[: k - 1], *pair[::-1], *c.terms[k + 1 :]))
        case "action clip":
            c = with_action(c, clip=np.float32(np.outer((-1 / s, 1 / s), np.ones(len(joints)))))
        case "action filter":
            c = with_action(c, filter=FilterSpec(alpha=1 / (1 + s)))
        case "gain order":
            gains = gains_of(c)
            other = gains[:, ::-1]
            c = with_gains(c, gains[::-1] if k % 2 or np.allclose(other, gains) else other)
    return c, called.format(joint=joint, where=" and ".join(where))


def made(case: Case, take: int, folder: str, seconds: float = 20.0) -> tuple[Record, str]:
    """Make the record of a case.

    Args:
        case: what is wrong with it.
        take: of noise, pushes and commands.
        folder: of the record, which has to stay.
        seconds: of the run.

    Returns:
        The record; and the name of the cause that its diagnosis has to find, "" of a healthy robot.

    Raises:
        UniconError: it cannot be made, such as for want of a simulator.
    """
    robot = load_robot_of(load_document(f"{case.robot}_walk"))
    loaded = load_model(pick_model(robot), robot, quiet=True)
    here, names, model = Path(folder), robot.joint_names, loaded.path
    latency = SETUP["latency"][case.seed]
    touched = {"delay": latency + case.of("delay"), "strength": 1.0 + case.of("strength")}
    joints = {name: {"delay": latency} for name in names}
    joints |= dict.fromkeys(names[case.joints], touched)
    if case.plant == "pybullet" or case.kind.startswith(tuple(SETUP["edited"])):
        model = here / "edited.xml"
        load_model(loaded.path, robot, quiet=True, prepare=partial(_edit, case, loaded, model))
    overlay, path = here / "robot.yaml", here / "run.mcap"
    said = {"schema": "unicon.robot/1", "extends": robot.name, "simulated": joints}
    overlay.write_text(json.dumps(said))
    t = np.arange(0.0, 40.0, 0.2)  # longer than a run
    sway = np.sin(np.outer(t, (1.1, 0.7, 0.9)) + take * np.arange(1, 4))
    schedule = np.c_[t, sway * (0.3, 0.2, 0.5) + (0.3, 0.0, 0.0)].tolist()
    options: AnyDict = {"commands": [{"velocity_command": {"schedule": schedule}}]}
    options |= SETUP["platforms"][case.plant]
    simulated = case.plant != "emulated"
    if simulated:
        options |= {"scene.model": str(model), "scene.joints": joints, "scene.seed": take}
        options |= SETUP["hung" if case.hung else "walking"]
    arguments = ("--model", str(model), "--seed", str(take), *["--hang"] * case.hung)
    recording = Recording(path, warn=unsaid, patient=True)
    faults = FaultRecord("off", unsaid, recording)
    with emulated(options["platform"], str(overlay), arguments) as there:
        options |= dict(map(split_setting, there.sets[1:]))
        document = load_document(f"{case.robot}_walk", options)
        contract = load_policies(document, robot)["walk"]
        contract, name = mistake(contract, case, names[case.joint])
        hooks: list[Hook] = [partial(_wrong, case), recording.hook, faults.hook]
        with closing(Program(document, hooks=hooks, contracts={"walk": contract})) as program:
            how = RunOptions(duration=seconds, speed="max" if simulated else "real", warn=unsaid)
            runner = Runner(program, how)
            faults.attach(runner)
            faults.write(runner.run())
    record = open_record(path)
    record.facts = {k: v.replace(str(model), str(loaded.path)) for k, v in record.facts.items()}
    return record, name


def _edit(case: Case, loaded: LoadedModel, path: Path, spec: Any) -> None:
    """Write a model with other masses [kg], frictions, dampings and armatures.

    PyBullet's robots have masses and ground friction that differ by up to 10 %.
    """
    of, model, base = case.of, spec.compile(), loaded.model.jnt_bodyid[loaded.base]
    share = 0.1 if case.plant == "pybullet" else 0.0
    spread = 1.0 + share * np.random.default_rng(case.seed).uniform(-1.0, 1.0, model.nbody)
    model.body_mass *= spread
    model.body_mass[base] += of("payload")
    moment = [of(f"centre of mass {axis}") for axis in "xyz"]
    model.body_ipos[base] += moment / model.body_mass[base]
    model.body_inertia *= spread[:, None]
    model.body_inertia[base] *= 1.0 + of("inertia")
    model.geom_friction *= spread[0] * (1.0 + of("ground friction"))
    dofs = loaded.dofs[case.joints]
    model.dof_damping[dofs] += of("viscous friction")
    model.dof_frictionloss[dofs] += of("friction")
    model.dof_armature[dofs] += of("armature")
    spec.copy_back(model)
    spec.meshdir = str((loaded.path.parent / spec.meshdir).resolve())
    path.write_text(spec.to_xml(), "utf-8")


def _wrong(case: Case, program: Program) -> HookBlocks:
    """Let sensors and motors of a simulated robot be wrong, or what the policy sees a tick late."""
    of, states, platform = case.of, program.states, program.platform
    recv, send = platform.recv, platform.send
    offset = np.zeros(program.robot.num_joints)
    offset[case.joints] = of("encoder offset")
    bias = [of(f"gyro bias {axis}") for axis in "xyz"]
    tilt = [of("attitude x"), of("attitude y"), 0.0]
    mounted = turned_by((1.0, 0.0, 0.0, 0.0), tilt, 1.0)
    mount = rotation(np.array(mounted))

    def sensed() -> Any:
        gone = recv()
        states.joint_pos += offset
        states.base_ang_vel = states.base_ang_vel @ mount + bias
        states.projected_gravity = states.projected_gravity @ mount
        states.base_quat = multiply(states.base_quat.tolist(), mounted)
        return gone

    def acted() -> Any:
        sent = states.snapshot()
        states.joint_pos_target -= offset
        states.joint_stiffness *= 1.0 + of("stiffness")
        states.joint_damping *= 1.0 + of("damping")
        try:
            return send()
        finally:
            states.restore(sent)

    if case.plant != "emulated":
        vars(platform).update(recv=sensed, send=acted)
    if case.kind != "late sensors":
        return {}
    names, seen = SETUP["late"], deque[dict[str, Array]](maxlen=2)

    def see(which: int) -> None:
        for name, value in seen[which].items():
            states[name] = value

    def late() -> None:
        seen.append({name: states[name].copy() for name in names})
        see(0)

    now = partial(see, -1)  # the record has what they said
    return {
        Stage.INPUT: [Block("late", late, amends=names)],
        Stage.OBSERVE: [Block("now", now, amends=names)],
    }


def ladder(robot: str, kind: str) -> list[float]:
    """Return five sizes: from the smallest that matters to the last before the robot falls.

    Sizes are doubled. One matters from where on the RMS error of the velocity, or the RMS tilt, is
    off by 10 %.
    """
    case, size, most = Case(robot, "mujoco", kind, 3, 0, 1.0), 0.05, 20.0
    if known := KINDS.get(kind.removesuffix(OF_JOINT)):
        size, most = known.least, known.high if case.change > 0.0 else -known.low
    last = matters = size
    healthy = _walk(replace(case, kind=HEALTHY))
    while size <= most and np.isfinite(walked := _walk(replace(case, amount=size))).all():
        last = size
        size *= 2.0
        if (abs(walked / healthy - 1.0) < 0.1).all():
            matters = size
    return [float(f"{each:.3g}") for each in np.geomspace(min(matters, last / 2.0), last, 5)]


def _walk(case: Case) -> Array:
    """Return RMS error of the velocity and RMS tilt of 10 s.

    Infinite where the robot falls, or has 80 % of the error of one that stands still.
    """
    with TemporaryDirectory(prefix="unicon_diagnose_") as folder:
        record, _ = made(case, 1, folder, 13.0)
        names = ("velocity_command", "base_lin_vel", "base_ang_vel", "projected_gravity")
        command, linear, angular, gravity = map(record.states, names)
        if not record.ended.all() or len(command) < 600:
            return np.full(2, np.inf)
        off = command - np.c_[linear[:, :2], angular[:, 2]], gravity[:, :2], command
        velocity, tilt, still = (np.sqrt((each[150:] ** 2).sum(1).mean()) for each in off)
        return np.array([velocity, tilt if velocity < 0.8 * still else np.inf])
