"""Slow twin: distances between capsules by the closest points of two segments, pair by pair.

Ericson, Real-Time Collision Detection, 2005, 5.1.9.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from unicon_core.robots import Robot
from unicon_manipulation.ik.chain import Chain

__all__ = ["between", "nearest", "placed"]


def between(one: Any, other: Any) -> float:
    """Return the distance between two segments, each two points in [m]."""
    (p, p_end), (q, q_end) = one, other
    d1, d2, r = p_end - p, q_end - q, p - q
    a, e, f = d1 @ d1, d2 @ d2, d2 @ r
    if a < 1e-12 and e < 1e-12:
        return float(np.linalg.norm(r))
    if a < 1e-12:
        s, t = 0.0, np.clip(f / e, 0.0, 1.0)
    else:
        c = d1 @ r
        if e < 1e-12:
            s, t = np.clip(-c / a, 0.0, 1.0), 0.0
        else:
            b = d1 @ d2
            denominator = a * e - b * b
            s = np.clip((b * f - c * e) / denominator, 0.0, 1.0) if denominator > 1e-12 else 0.0
            t = (b * s + f) / e
            if t < 0.0:
                s, t = np.clip(-c / a, 0.0, 1.0), 0.0
            elif t > 1.0:
                s, t = np.clip((b - c) / a, 0.0, 1.0), 1.0
    return float(np.linalg.norm(r + s * d1 - t * d2))


def placed(robot: Robot, chain: Chain, name: str) -> tuple[Any, float]:
    """Return the segment of a capsule where the chain stands, and its radius in [m]."""
    capsule = robot.capsules[name]
    body = chain.loaded.model.body(capsule.body).id
    turn, place = chain.data.xmat[body].reshape(3, 3), chain.data.xpos[body]
    return [place + turn @ np.array(end) for end in (capsule.start, capsule.end)], capsule.radius


def nearest(robot: Robot, chain: Chain, pairs: Iterable[tuple[str, str]]) -> float:
    """Return the smallest distance of pairs of capsules where the chain stands in [m]."""
    at = {name: placed(robot, chain, name) for pair in pairs for name in pair}
    return min(between(at[a][0], at[b][0]) - at[a][1] - at[b][1] for a, b in pairs)
