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

from benchmarks.copied_hand import copied_hand, smooth_motion
from benchmarks.samples import Samples
from unicon_core.blocks.retarget import Retarget
from unicon_core.models.find import pick_model
from unicon_core.retarget.hand_model import HandModel
from unicon_core.retarget.human_hand import JOINTS
from unicon_core.robots import Robot, load_robot
from unicon_core.states import StateSpec
from unicon_core.testing import Bench as BlockBench
from unicon_ros.bench.report import Bench

Side: TypeAlias = Callable[[NDArray[np.float32], NDArray[np.float32]], NDArray[np.floating]]
"""Returns the joints for a human hand, and for the vectors of the tips from the palm's body."""

ROBOT = "inspire_rh56_left"
RATE = 50.0  # Hz
TICKS = 500  # of a round
OTHER = "dex-retargeting"


def run(rounds: int | None = None) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds, 5 unless told.
    """
    bench = Bench("retarget", rounds or 5)
    robot = load_robot(ROBOT)
    model = HandModel(robot)
    sides: dict[str, Side] = {"unicon": _ours(robot)}
    if find_spec("dex_retargeting"):
        sides[OTHER] = _other(robot)
    times, errors = Samples(), Samples()
    now = time.perf_counter_ns
    for number in range(bench.rounds):
        motion = smooth_motion(model, TICKS, RATE, seed=number)
        took, wrong = np.zeros((2, len(sides), TICKS))
        for tick, q in enumerate(motion):
            hand = copied_hand(model, q)
            vectors = model.tips.astype(np.float32)
            for i, side in enumerate(sides.values()):
                begin = now()
                found = side(hand, vectors)
                took[i, tick] = (now() - begin) * 1e-3
                wrong[i, tick] = np.abs(found - q).max()
        for i, name in enumerate(sides):
            times.add(name, took[i, 1:])  # in the first each looks for the hand
            errors.add(name, wrong[i, 1:])
    for name in sides:
        bench.case(name, times.of(name))
        bench.case(f"{name}: joint error [mrad]", errors.of(name) * 1e3)
    bench.ratio("joint_error_p99", float(np.percentile(errors.of("unicon"), 99)), 0.01)
    if OTHER in sides:
        bench.ratio("retarget", times.ratio("unicon", OTHER), 0.1)
        bench.facts[OTHER] = metadata.version(OTHER)
    else:
        bench.facts[OTHER] = f"not compared, it is not installed: pip install {OTHER}"
    return bench


def _ours(robot: Robot) -> Side:
    name = "webxr_left_hand"
    declared = {**Retarget.declares(robot=robot, side="left"), name: StateSpec((JOINTS, 7))}
    bed = BlockBench(robot, period=1.0 / RATE, states=declared)
    poses, command = bed.states[name], bed.states["joint_pos_command"]
    tick = bed.block(Retarget, side="left").tick

    def side(hand: NDArray[np.float32], _: NDArray[np.float32]) -> NDArray[np.float32]:
        poses[...] = hand
        tick()
        return command

    return side


def _other(robot: Robot) -> Side:
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
