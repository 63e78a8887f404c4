"""Poses the slow way: a chain of rotation matrices, read off the compiled model by hand."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


def matrix(quat):
    w, x, y, z = quat
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def pose(loaded, joint_pos, place, above):
    """Return position and rotation of a place in the frame of a body above it, all hinges."""
    model = loaded.model
    angles = dict(zip(loaded.joints, joint_pos))
    turn = matrix(place.quat)
    at = np.array(place.position)
    body = model.body(place.body).id
    while model.body(body).name != above:
        first = model.body_jntadr[body]
        count = model.body_jntnum[body]
        for joint in range(first + count - 1, first - 1, -1):
            half = 0.5 * angles[joint]
            hinge = matrix([np.cos(half), *(np.sin(half) * model.jnt_axis[joint])])
            anchor = model.jnt_pos[joint]
            turn = hinge @ turn
            at = anchor + hinge @ (at - anchor)
        own = matrix(model.body_quat[body])
        turn = own @ turn
        at = model.body_pos[body] + own @ at
        body = model.body_parentid[body]
    return at, turn
