"""Human hands whose fingertips are a robot's at known joints, for benchmarks and tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from unicon_core.retarget.hand_model import HandModel
from unicon_core.retarget.human_hand import CHAINS, JOINTS

Float = NDArray[np.float64]


def copied_hand(model: HandModel, q: Float, size: float = 1.0) -> NDArray[np.float32]:
    """Return the poses of a human hand whose fingers are as a robot's, shape (25, 7).

    Its fingers are as long as the robot's reach, or longer where they must be; the bones bend as
    they must. What is not among the robot's fingers lies beside the others.

    Args:
        model: of the robot's hand; it is put at `q`.
        q: the robot's joints in [rad], shape (n,).
        size: of the human's hand, for one of the robot's.
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
    poses[:, :3] = (points - points[0]) * size
    poses[:, 3] = 1.0
    return poses


def bent(begin: Float, tip: Float, length: float) -> Float:
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


def corner(begin: Float, end: Float, length: float) -> Float:
    """Return where two bones of the same length meet that are so long together, shape (3,)."""
    way = end - begin
    aside = np.cross(way, (0.31, 0.95, 0.02))
    aside *= 0.5 * max(length**2 - float(way @ way), 0.0) ** 0.5 / np.linalg.norm(aside)
    met: Float = begin + 0.5 * way + aside
    return met


def smooth_motion(model: HandModel, ticks: int, rate: float, seed: int) -> Float:
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
    swung: Float = middle + half * turns
    return swung
