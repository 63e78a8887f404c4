"""`unicon bench retarget`: a human hand's 25 poses to a robot hand's joints, ours and others'.

The human hand is a copy of the robot's, which swings through all its joints: what should come back
is known. Ours takes the poses, looks at whether they can be a hand, measures its proportions and
solves; dex-retargeting (of AnyTeleop, its kind "vector") is given finished vectors of the right
scale and solves. It is compared where it is installed; with its torch it takes 2 to 6 GB.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from importlib import import_module, metadata
from importlib.util import find_spec
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from benchmarks.samples import Samples
from unicon_base.arrays import Float32, Float64
from unicon_core.models.find import pick_model
from unicon_core.robots import Robot, load_robot
from unicon_core.states import StateSpec
from unicon_core.testing import Bench as BlockBench
from unicon_manipulation.retarget.hand_model import CHAINS, JOINTS, HandModel
from unicon_manipulation.retargeting_block import Retarget
from unicon_ros.bench.report import Bench

Retargeter: TypeAlias = Callable[[Float32, Float32], NDArray[np.floating]]
"""Returns the joints for a human hand, and for the vectors of the tips from the palm's body."""

ROBOT = "inspire_rh56_left"
RATE = 50.0  # Hz
TICKS = 500  # of a round
OTHER = "dex-retargeting"


def run(rounds: int = 5) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds.
    """
    bench = Bench("retarget", rounds)
    robot = load_robot(ROBOT)
    model = HandModel(robot)
    sides: dict[str, Retargeter] = {"unicon": _ours(robot)}
    if find_spec("dex_retargeting"):
        sides[OTHER] = _other(robot)
    times, error = Samples(), "joint error [mrad]"
    now = time.perf_counter_ns
    for number in range(bench.rounds):
        rows = {name: list[tuple[float, float]]() for name in sides}
        for q in smooth_motion(model, TICKS, RATE, seed=number):
            hand = copied_hand(model, q)
            vectors = model.tips.astype(np.float32)
            for name, side in sides.items():
                begin = now()
                found = side(hand, vectors)
                rows[name].append(((now() - begin) * 1e-3, 1e3 * np.abs(found - q).max()))
        for name, of_ticks in rows.items():
            took, wrong = np.transpose(of_ticks[1:])  # in the first each looks for the hand
            times.add(name, took)
            times.add(f"{name}: {error}", wrong)
    times.add_to(bench)
    wrong = 1e-3 * times.of(f"unicon: {error}")
    bench.ratio("joint_error_p99", float(np.percentile(wrong, 99)), 0.01)
    if OTHER in sides:
        bench.facts[OTHER] = metadata.version(OTHER)
    else:
        bench.facts[OTHER] = f"not compared, it is not installed: pip install {OTHER}"
    return bench


def _ours(robot: Robot) -> Retargeter:
    name = "webxr_left_hand"
    declared = {**Retarget.declares(robot=robot, side="left"), name: StateSpec((JOINTS, 7))}
    bed = BlockBench(robot, period=1.0 / RATE, states=declared)
    poses, command = bed.states[name], bed.states["joint_pos_command"]
    tick = bed.block(Retarget, side="left").tick

    def side(hand: Float32, _: Float32) -> Float32:
        poses[...] = hand
        tick()
        return command

    return side


def _other(robot: Robot) -> Retargeter:
    assert robot.hand is not None
    logging.getLogger("dex_retargeting").setLevel(logging.CRITICAL)  # of meshes that are absent
    config = import_module("dex_retargeting.retargeting_config").RetargetingConfig
    tips = [place.body for place in robot.hand.fingers.values()]
    palm = robot.hand.palm.body
    made = config.from_dict(
        {
            "type": "vector",
            "urdf_path": str(pick_model(robot)),
            "wrist_link_name": palm,
            "target_joint_names": list(robot.joint_names),
            "target_origin_link_names": [palm] * len(tips),
            "target_task_link_names": tips,
            "target_link_human_indices": [[0] * len(tips), [4, 9, 14, 19, 24]],
            "scaling_factor": 1.0,
            "low_pass_alpha": 1.0,  # it filters nothing
        }
    ).build()
    ours = [made.joint_names.index(joint) for joint in robot.joint_names]
    return lambda _, vectors: made.retarget(vectors)[ours]


def copied_hand(model: HandModel, q: Float64) -> Float32:
    """Return the poses of a human hand whose fingers are as a robot's, shape (25, 7).

    Its fingers are as long as the robot's reach, or longer where they must be; the bones bend as
    they must. What is not among the robot's fingers lies beside the others.

    Args:
        model: of the robot's hand; it is put at `q`.
        q: the robot's joints in [rad], shape (n,).
    """
    model.put(q)
    tips, points = model.tips, np.zeros((JOINTS, 3))
    for i, finger in enumerate(model.fingers):
        begin, tip = model.begins[i] @ model.palm, tips[i] @ model.palm
        points[list(CHAINS[finger])] = bent(begin, tip, float(model.reach[i]))
        if finger == "thumb" and model.knee:
            begin, knee, tip = (
                x @ model.palm for x in (model.begins[i], model.points[-1], tips[i])
            )
            length = float(model.reach[i] - np.linalg.norm(tip - knee))
            points[1:5] = begin, corner(begin, knee, length), knee, tip
    side = np.sign(points[CHAINS["index"][0], 1] - points[CHAINS["middle"][0], 1])
    beside = np.array((0.0, 0.02 * side, 0.0))
    for other, before in (("ring", "middle"), ("pinky", "ring")):
        if other not in model.fingers:
            points[list(CHAINS[other])] = points[list(CHAINS[before])] - beside
    begins = points[[chain[0] for chain in CHAINS.values()]]
    points[0] = begins.mean(axis=0) - (0.08, 0.0, 0.0)
    for other, chain in CHAINS.items():
        if other != "thumb":
            points[chain[0] - 1] = 0.5 * (points[chain[0]] + points[0])
    poses = np.zeros((JOINTS, 7), np.float32)
    poses[:, :3] = points - points[0]
    poses[:, 3] = 1.0
    return poses


def bent(begin: Float64, tip: Float64, length: float) -> Float64:
    """Return the four ends of three bones from one point to another, shape (4, 3).

    Args:
        begin: first end in [m], shape (3,).
        tip: last end.
        length: of all three, at least the distance.
    """
    way = tip - begin
    distance = float(np.linalg.norm(way))
    middle = min(0.4 * distance, length / 3.0)
    foot = 0.5 * (1.0 - middle / distance) * way
    out = corner(begin, begin + 2.0 * foot, length - middle) - begin - foot
    return np.array((begin, begin + foot + out, tip - foot + out, tip))


def corner(begin: Float64, end: Float64, length: float) -> Float64:
    """Return where two bones of the same length meet that are so long together, shape (3,)."""
    way = end - begin
    aside = np.cross(way, (0.31, 0.95, 0.02))
    aside *= 0.5 * max(length**2 - float(way @ way), 0.0) ** 0.5 / np.linalg.norm(aside)
    met: Float64 = begin + 0.5 * way + aside
    return met


def smooth_motion(model: HandModel, ticks: int, rate: float, seed: int) -> Float64:
    """Return joints that swing through their whole ranges at 0.2 to 1 Hz, shape (ticks, n).

    Args:
        model: of the hand.
        ticks: how many.
        rate: of them in [Hz].
        seed: of phases and frequencies.
    """
    random = np.random.default_rng(seed)
    phase, hertz = random.uniform((0.0, 0.2), (2.0 * np.pi, 1.0), (len(model.lower), 2)).T
    turns = np.sin(2.0 * np.pi * hertz * np.arange(ticks)[:, None] / rate + phase)
    middle, half = 0.5 * (model.upper + model.lower), 0.5 * (model.upper - model.lower)
    swung: Float64 = middle + half * turns
    return swung
