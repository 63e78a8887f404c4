"""Diagnosis of a record: causes with probability, size and remedy; workflows that tell them apart.

    found = diagnose(open_record("real.mcap"), "real.mcap")
    for cause in found.causes:
        print(cause.name, cause.probability, cause.size, cause.remedy)
    text = experiment_text("go2", "wiggle", "wiggle.yaml")

In an experiment a robot moves so that a cause shows, behind the robot's safety blocks.
"""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import yaml

from unicon_base import AnyDict, UniconError
from unicon_base.arrays import Float64
from unicon_base.resources import find_config
from unicon_core.platforms.kit.scene import Scene
from unicon_core.policies import PolicyContract
from unicon_core.robots import Robot, load_robot
from unicon_core.robots.load import joints_like
from unicon_core.signals import SIGNALS, Interrupted
from unicon_lab.diagnose import MOTIONS, Cause, Diagnosis, Shown, name_of
from unicon_lab.diagnose.contract import contract_causes
from unicon_lab.diagnose.motion import BASE_ANSWERS, HUNG_HEIGHT, MOVING, Motion, motion_of
from unicon_lab.diagnose.plant import KINDS, MOTION, OF_BASE, Place
from unicon_lab.diagnose.replays import Replays
from unicon_lab.diagnose.search import MOST_REFERENCE, Found, Search
from unicon_lab.recording import Record, open_record
from unicon_lab.replay.workflow import recorded_values, robot_of

MOST = {16: 100, 200: 40}
"""Windows that are replayed, by the number of joints up to which: a G1's take three times as
long."""

Tell = Callable[..., object]
"""Takes a line of progress; with a share from 0 to 1, how much of that is done."""


def diagnose(
    record: Record,
    where: str,
    *,
    contracts: Sequence[PolicyContract] | None = None,
    robot: Robot | None = None,
    reference: Record | Search | None = None,
    hung: bool = False,
    window: float = 0.2,
    processes: int = 0,
    tell: Tell = lambda *_: None,
) -> Diagnosis:
    """Return what differs from the contract, then the causes in the plant.

    Args:
        record: with the command states and what was measured.
        where: the record's name, for messages.
        contracts: that are given; None for those of the recorded workflow, as their files are now.
        robot: whose simulator is compared; None for the record's.
        reference: of the same robot without the trouble, or what `searched` found in it: what its
            simulator lacks in both is no cause. None where the simulator is like the healthy robot.
        hung: the robot hung in the air, or its base was fixed.
        window: of a replay in [s].
        processes: at once; 0 for as many as there are cores.
        tell: takes lines of progress, and the share that is done of what a line says.

    Raises:
        UniconError: a record lacks something, or is of another robot.
    """
    robot, scene = simulated(record, where, robot)
    causes, notes = list[Cause](), list[str]()
    for contract in [None] if contracts is None else contracts:
        found, more = contract_causes(record, where, contract, tell)
        causes, notes = causes + found, notes + more
    try:
        motion, scene = motion_in(record, where, window, hung, robot, scene)
    except UniconError as error:
        if not causes:
            raise
        return Diagnosis(tuple(causes), (*notes, f"the plant is not examined: {error}"))
    healthy, before = None, None
    if isinstance(reference, Record):
        simulated(reference, "the reference", robot)
        healthy, _ = motion_in(reference, "the reference", window, hung, robot, scene)
    elif reference is not None:
        before, healthy = reference, reference.motion
    if healthy is not None and healthy.has_base != motion.has_base:
        raise UniconError(
            f"one of {where} and the reference has no base_quat and base_ang_vel; record both"
        )
    with SIGNALS.guard():
        try:
            if healthy is not None and before is None:
                before = searched(healthy, robot, scene, processes, tell)
        except Interrupted:
            return Diagnosis(tuple(causes), (*notes, _INTERRUPTED), complete=False)
        plant = plant_causes(motion, robot, scene, before, processes, tell)
    return replace(plant, causes=(*causes, *plant.causes), notes=(*notes, *plant.notes))


def searched(
    healthy: Motion,
    robot: Robot,
    scene: Scene,
    processes: int = 0,
    tell: Tell = lambda *_: None,
) -> Search:
    """Return what a search found in the motion of a healthy robot; arguments as of `diagnose`."""
    places = places_of(healthy, robot, range(robot.num_joints), KINDS)
    progress = _share(tell, "the reference")
    with Replays(robot, scene, healthy, processes_of(processes), progress) as replays:
        search = Search(healthy, places, replays.plant.limbs, replays, tell, most=MOST_REFERENCE)
        search.go()
    return search


def plant_causes(
    motion: Motion,
    robot: Robot,
    scene: Scene,
    reference: Search | None = None,
    processes: int = 0,
    tell: Tell = lambda *_: None,
) -> Diagnosis:
    """Return the causes in the plant alone.

    Args:
        motion: of the robot.
        robot: whose simulator is compared.
        scene: in which it is simulated.
        reference: what was found in the same robot without the trouble, or None.
        processes, tell: as of `diagnose`.
    """
    notes = [] if motion.has_base else [_NO_BASE]
    notes += [_STILL] if motion.still else []
    places = places_of(motion, robot, range(robot.num_joints), KINDS)
    found, own, progress = Found(), dict[str, Float64](), _share(tell, "the plant")
    with SIGNALS.guard():
        try:
            with Replays(robot, scene, motion, processes_of(processes), progress) as replays:
                own = replays.plant.own
                search = Search(motion, places, replays.plant.limbs, replays, tell, reference)
                found = search.found
                search.go()
        except Interrupted:
            notes.append(_INTERRUPTED)
    causes = [cause_of(found, place, alike, robot, own, motion) for place, alike in found.causes]
    more = "" if causes else "sway" if motion.hung and robot.walks else "wiggle"
    return Diagnosis(tuple(causes), tuple(notes), len(motion.starts), found.complete, more)


def _share(tell: Tell, what: str) -> Callable[[float], object]:
    return lambda share: tell(what, share)


_INTERRUPTED = "interrupted: causes that come later are not known"
_STILL = f"no joint moves by {MOVING} rad: joints, gains and ground friction are not examined"
_NO_BASE = (
    "attitude and turn rate of the base were not recorded: payload, centre of mass, inertia, gyro "
    "and IMU mounting are not examined"
)


def motion_in(
    record: Record, where: str, window: float, hung: bool, robot: Robot, scene: Scene
) -> tuple[Motion, Scene]:
    """Return the motion of a record, and the scene in which it is replayed."""
    motion = _thinned(motion_of(record, where, window), robot)
    if not hung:
        return motion, scene
    return motion.hung_up(), replace(scene, gantry=True, initial_height=HUNG_HEIGHT)


def _thinned(motion: Motion, robot: Robot) -> Motion:
    most = next(most for joints, most in MOST.items() if robot.num_joints <= joints)
    count = len(motion.starts)
    if count <= most:
        return motion
    return replace(
        motion, starts=motion.starts[np.linspace(0, count - 1, most).round().astype(int)]
    )


def processes_of(asked: int) -> int:
    """Return how many processes were asked for; 0 stands for one on each core."""
    return asked or len(os.sched_getaffinity(0))


def places_of(
    motion: Motion, robot: Robot, joints: Sequence[int], kinds: Iterable[str]
) -> list[Place]:
    """Return what may differ, of some kinds: in each of some joints, and in the whole robot.

    Joints alike only where these are all of them; the base where it was measured.
    """
    kinds = [k for k in kinds if (motion.has_base if k in OF_BASE else not motion.still)]
    every = len(joints) == robot.num_joints
    whole = [(kind, -1) for kind in kinds if every or not KINDS[kind].each]
    return whole + [(kind, joint) for kind in kinds if KINDS[kind].each for joint in joints]


def cause_of(
    found: Found,
    place: Place,
    alike: Sequence[Place],
    robot: Robot,
    own: dict[str, Float64],
    motion: Motion,
) -> Cause:
    """Return one place of what was found as a cause, with its evidence and remedy.

    Args:
        found: of the search.
        place: of the cause.
        alike: places that the motion does not tell from it.
        robot: names joints.
        own: what the simulator has of each joint; see `Plant.own`.
        motion: that was searched.
    """
    kind, joint = place
    size, half = found.change[place], found.deviation[place]
    before = float(own[kind][max(joint, 0)]) if kind in own else 1.0
    explained = 1.0 - found.after / max(found.before, 1e-30)
    words = {"size": size, "after": before + size, "joint": where_of(joint, robot) or "*"}
    shown = _shown(found, place, robot, motion)
    record, without, with_it = map(np.array, (shown.record, shown.without, shown.with_it))
    off, left = (float(np.sqrt(((record - each) ** 2).mean())) for each in (without, with_it))
    return Cause(
        kind=kind,
        where=where_of(joint, robot),
        layer="plant",
        probability=found.probability[place],
        size=size,
        low=size - half,
        high=size + half,
        unit=KINDS[kind].unit,
        evidence=f"{shown.signal} at {shown.time[0]:.1f} s: a replay is off by {off:.2g} "
        f"{shown.unit} RMS without it, by {left:.2g} with it; all causes explain {explained:.0%} "
        "of the square error of the joints",
        remedy=KINDS[kind].remedy.format(**words),
        alike=tuple(name_of(other, where_of(j, robot)) for other, j in alike),
        shown=shown,
        next=min((MOTION.get(each, "wiggle") for each, _ in (place, *alike)), key=MOTIONS.index)
        if alike
        else "",
    )


def _shown(found: Found, place: Place, robot: Robot, motion: Motion) -> Shown:
    window, channel, (without, with_it) = found.shown[place]
    base = channel - robot.num_joints
    ticks = motion.starts[window] + np.arange(1, motion.length + 1)
    return Shown(
        signal=BASE_ANSWERS[base] if base >= 0 else robot.joint_names[channel],
        unit="rad" if base < 0 else "rad/s" if "rate" in BASE_ANSWERS[base] else "g",
        time=(ticks * motion.period).tolist(),
        record=motion.answers[window, :, channel].tolist(),
        without=without.tolist(),
        with_it=with_it.tolist(),
    )


def where_of(joint: int, robot: Robot) -> str:
    """Return the name of a place's joint, "" of the whole robot."""
    return robot.joint_names[joint] if joint >= 0 else ""


def simulated(record: Record, where: str, robot: Robot | None) -> tuple[Robot, Scene]:
    """Return the robot whose simulator a record is compared with, and its scene.

    Raises:
        UniconError: the record is of another robot, or of several in one.
    """
    said = recorded_values(record)
    if robot is None and isinstance(said.get("robot"), dict):
        raise UniconError(
            f"{record.facts.get('robot')} is made of {', '.join(map(str, said['robot']))}, and an "
            "overlay extends one file: record a run of that robot alone"
        )
    try:
        robot = robot or load_robot(robot_of(record))
    except UniconError as error:
        raise UniconError(f"{error}; give the robot with --robot") from error
    if record.joints != robot.joint_names:
        raise UniconError(
            f"{where} is of {record.facts.get('robot') or 'another robot'} with "
            f"{len(record.joints)} joints, and robot {robot.name} has others: give that robot's "
            "file with --robot"
        )
    scene = said.get("scene") or {}
    path = record.facts.get("workflow_path")
    model = scene.get("model") if isinstance(scene, dict) else None
    return robot, Scene(model=model, folder=Path(path).parent if path else None)


SIZES = {"drop": 0.25, "wiggle": 0.1, "sway": 0.05, "rest": 0.0}
"""By which joints move at most in [rad], [m] of sliding joints."""
SHARE = 0.25
"""Of a joint's range that a motion takes at most."""
_UNMET = re.compile("twin|button|observation|action|height")
"""In names of safety blocks that read what an experiment lacks, or need a robot on the ground."""


def experiment_text(subject: str, kind: str, file: str, joints: Sequence[str] = ()) -> str:
    """Return the text of a workflow, made of `config/experiments/KIND.yaml`.

    Args:
        subject: name or file of a robot; or a record, whose robot, model, platform, rate, safety
            and median gains the workflow has. A humanoid sways and rests by the record's own flow.
        kind: of `MOTIONS`.
        file: that the text is for, as a shell finds it.
        joints: names and patterns of those that move, all unless given.

    Raises:
        UniconError: there is no such robot or record, or it cannot move so.
    """
    given, said = Path(subject), AnyDict()
    words: AnyDict = {"platform": "mujoco", "platforms": None, "model": None, "rate": 50.0}
    words |= {"stiffness": 1.0, "damping": 1.0}
    if given.suffix == ".mcap" or given.is_dir():
        record = open_record(given)
        robot, scene = simulated(record, given.name, None)
        said = recorded_values(record)
        words |= {key: said[key] for key in ("platform", "platforms") if key in said}
        words |= {"robot": robot_of(record), "rate": round(1.0 / record.period, 3)}
        words |= {"model": str(scene.model_path(robot))} if scene.model else {}
        for word, most in (("stiffness", 2.0), ("damping", 5.0)):
            own = getattr(robot, f"joint_{word}")
            used = record.states(f"joint_{word}") / np.where(own > 0.0, own, 1.0)
            words[word] = round(min(float(np.median(used)) or 1.0, most), 3)
    else:
        robot = load_robot(subject)
        words["robot"] = str(given.absolute()) if given.suffix else subject
    words["safety"] = ["finite", "joint_limits", *["tilt_stop"] * robot.floats]
    if isinstance(said.get("safety"), list):
        words["safety"] = [each for each in said["safety"] if not _UNMET.search(str(each))]
    if kind in ("sway", "rest"):
        balanced = robot.kind == "humanoid" and "policies" in said
        if robot.kind != "quadruped" and not balanced:
            raise UniconError(
                f"robot {robot.name} does not stand by gains; give --kind wiggle or drop, or of a "
                "humanoid the record of a policy that balances it"
            )
        if joints and (balanced or kind == "rest"):
            raise UniconError(f"a {kind} of {robot.name} takes no --joints; leave them out")
        kind += "_of_policy" * balanced
    words |= _moves(robot, SIZES[kind.partition("_")[0]], joints)
    text = {key: json.dumps(value) for key, value in words.items()}
    ours = ("commands", "duration", "name")
    flow = {key: value for key, value in said.items() if key not in ours}
    behind = "\n" + yaml.safe_dump(flow | {"robot": words["robot"]}, sort_keys=False)
    text["file"], text["record"] = map(shlex.quote, (file, file.removesuffix("yaml") + "mcap"))
    template = find_config("experiments", kind).read_text("utf-8")
    filled = Template(template).substitute(text) + behind * kind.endswith("_of_policy")
    return re.sub(r"\n *(model|platforms): null", "", filled)


def _moves(robot: Robot, most: float, patterns: Sequence[str]) -> AnyDict:
    """Return joints, amplitudes, and poses: about which they move, at their end, to lie in."""
    moving = sorted({i for pattern in patterns or ["*"] for i in joints_like(pattern, robot)})
    lower, upper, stand = np.array((robot.lower, robot.upper, robot.default_joint_pos), float)
    size = np.fmin(most, SHARE * (upper - lower)).round(4)
    room = size + 1e-3
    centre = np.fmin(np.fmax(np.nan_to_num(stand), lower + room), upper - room)
    lifted = centre + np.where(upper - centre > centre - lower, size, -size)

    def named(values: Any) -> dict[str, float]:
        return {robot.joint_names[i]: round(float(values[i]), 4) for i in moving}

    return {
        "joints": list(patterns) or ["*"],
        "amplitude": named(size) if np.ptp(size) else float(size[0]),
        "around": "stand" if np.array_equal(centre, stand) else named(centre),
        "lifted": named(lifted),
        "lying": "stand" if np.isnan(robot.rest_joint_pos).any() else "rest",
    }
