"""Human hands of a grown-up's proportions, with fingers that bend as they are told."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.retarget import bent
from unicon_core.models.loaded import about, multiply, rotate
from unicon_manipulation.retarget.human_hand import CHAINS

__all__ = ["human_hand", "pinched", "placed"]

Float = NDArray[np.float64]
Poses = NDArray[np.float32]

_KNUCKLES = {  # of a right hand, from the wrist in its frame [m]
    "thumb": (0.025, 0.025, -0.012),
    "index": (0.095, 0.028, 0.0),
    "middle": (0.098, 0.005, 0.004),
    "ring": (0.09, -0.017, 0.0),
    "pinky": (0.08, -0.036, -0.008),
}
_BONES = {  # Buryanov & Kotiuk 2010 [m]
    "thumb": (0.046, 0.032, 0.022),
    "index": (0.040, 0.022, 0.016),
    "middle": (0.045, 0.026, 0.017),
    "ring": (0.041, 0.026, 0.017),
    "pinky": (0.033, 0.018, 0.016),
}


def human_hand(bends: dict[str, float], size: float = 1.0, side: str = "right") -> Poses:
    """Return the poses of a hand, shape (25, 7).

    Args:
        bends: finger to how far it bends, 0 straight (unless given) to 1 into the palm.
        size: 1 for a grown-up's.
        side: left or right.
    """
    points = np.zeros((25, 3))
    for finger, chain in CHAINS.items():
        points[chain[0]] = at = np.array(_KNUCKLES[finger])
        if finger != "thumb":
            points[chain[0] - 1] = 0.3 * at
        for number, bone in enumerate(_BONES[finger], 1):
            bend = bends.get(finger, 0.0) * number
            if finger == "thumb":  # beside the palm, then across it
                way = rotate(
                    about(np.array((1.0, 0.0, 0.0)), -0.3), np.array((0.5**0.5, 0.5**0.5, 0.0))
                )
                way = rotate(about(np.array((0.0, 0.0, 1.0)), -0.6 * bend), way)
            else:
                way = np.array((np.cos(1.5 * bend), 0.0, -np.sin(1.5 * bend)))
            points[chain[number]] = at = at + bone * way
    return _poses(points * size, side)


def pinched(finger: str, apart: float, size: float = 1.0, side: str = "right") -> Poses:
    """Return a hand whose thumb's tip is so far in [m] below that of a finger that bends half."""
    poses = human_hand({finger: 0.35}, 1.0, "right")
    points = poses[:, :3].astype(np.float64)
    tip = points[CHAINS[finger][-1]] - (0.0, 0.0, apart / size)
    length = max(sum(_BONES["thumb"]), float(np.linalg.norm(tip - points[1])) * 1.001)
    points[list(CHAINS["thumb"])] = bent(points[1], tip, length)
    return _poses(points * size, side)


def placed(poses: Poses, axis: Float, angle: float, at: Float) -> Poses:
    """Return a hand carried to another place of the room."""
    turn, found = about(axis / np.linalg.norm(axis), angle), poses.copy()
    for pose in found:
        pose[:3] = rotate(turn, pose[:3].astype(np.float64)) + at
        pose[3:] = multiply(turn, pose[3:].astype(np.float64))
    return found


def _poses(points: Float, side: str) -> Poses:
    poses = np.zeros((25, 7), np.float32)
    poses[:, :3] = points * ((1.0, 1.0, 1.0) if side == "right" else (1.0, -1.0, 1.0))
    poses[:, 3] = 1.0
    return poses
