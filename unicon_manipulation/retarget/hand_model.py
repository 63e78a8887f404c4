"""A robot hand's model: where its fingertips are, and how its driven joints move them.

Joints that others pull along are placed by those that pull, and so is how fast they move.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import ModelError, RobotError
from unicon_base.arrays import Bool, Float32, Float64
from unicon_core.models.find import pick_model
from unicon_core.models.frames import body_of
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel, body_in, dofs_above, import_mujoco
from unicon_core.models.posed import followers
from unicon_core.platforms.kit.base import rotation_of
from unicon_core.robots import Robot
from unicon_core.robots.robot import Hand

_SITE = "retarget_"
# How many poses of a finger are tried for its reach on a grid, of one joint at most, and on how
# many grids, each around the best pose of the one before.
_POSES, _EACH, _GRIDS = 250, 15, 5
# Driven joints with which a thumb may have its tip at one place in two ways.
_MANY = 3


class HandModel:
    """Kinematics of a robot hand, joints that others pull along included.

    Args:
        robot: with a `hand`.
        side: of it, where its file is of both.
        model: MJCF or URDF instead of the robot file's own.
        relative_to: folder of the file that names it.

    Attributes:
        fingers: as of the robot file.
        moved: joints of the robot that move a fingertip, shape (n,).
        lower: smallest allowed position of the robot's joints in [rad], shape (n,).
        upper: largest.
        default: the robot file's default pose in [rad], shape (n,).
        begins: where each finger begins to move, in the model's world in [m], shape (f, 3).
        reach: how far its tip gets from there within the limits, in [m], shape (f,).
        palm: rotation of the palm's frame to the model's world, shape (3, 3).
        knee: whether the last joint of the thumb is told too: where it has three or more driven
            ones, as an XHand's, its tip alone does not say how it bends.
        points: the fingertips of the last `put`, then that joint if it is told, in the model's
            world in [m], shape (p, 3).
        jacobian: of the points by the joints, shape (3 p, n).

    Raises:
        RobotError: the robot has no hand, or no limits.
        ModelError: there is no model, or it lacks a body or a joint that the file names.
        MissingDependencyError: mujoco is not installed.
    """

    def __init__(
        self,
        robot: Robot,
        side: str = "",
        model: str | None = None,
        relative_to: Path | None = None,
    ) -> None:
        hand = told_hand(robot).of(side)
        path = pick_model(robot, model, relative_to)
        loaded = load_model(path, robot, quiet=True, prepare=lambda spec: _mark(spec, path, hand))
        self._mujoco, self._loaded, self._model = import_mujoco(), loaded, loaded.model
        self._data = self._mujoco.MjData(loaded.model)
        self.fingers = tuple(hand.fingers)
        sites = [int(loaded.model.site(_SITE + finger).id) for finger in self.fingers]
        self._sites = np.array(sites, np.intp)
        self._pulled = Pulled(loaded)
        above = [dofs_above(loaded.model, int(loaded.model.site_bodyid[site])) for site in sites]
        each = np.array([(self._pulled.slopes[dofs] != 0.0).any(axis=0) for dofs in above])
        for finger, joints in zip(self.fingers, each):
            if not joints.any():
                raise ModelError(
                    f"model {path}: no joint of {robot.name} moves the tip of its {finger}; "
                    f"correct hand.fingers of {robot.path}"
                )
        self.moved = each.any(axis=0)
        self.lower, self.upper, self.default = (
            np.array(fact, np.float64)
            for fact in (robot.lower, robot.upper, robot.default_joint_pos)
        )
        for fact in (self.lower, self.upper, self.default):
            if not np.isfinite(fact[self.moved]).all():
                raise RobotError(
                    f"robot {robot.name} has no limits or no default pose for the joints of its "
                    f"fingers; add lower, upper and default to {robot.path}"
                )
            np.nan_to_num(fact, copy=False, posinf=0.0, neginf=0.0)
        thumb = self.fingers.index("thumb") if "thumb" in self.fingers else -1
        self.knee = thumb >= 0 and int(each[thumb].sum()) >= _MANY
        self._knee = self._moving(above[thumb])[0] if self.knee else -1
        count = len(self.fingers) + self.knee
        self.points, self.jacobian = np.zeros((count, 3)), np.zeros((3 * count, robot.num_joints))
        self._whole = np.zeros((3 * count, int(loaded.model.nv)))
        self._parts = [(site, self._whole[3 * i : 3 * i + 3]) for i, site in enumerate(sites)]
        self._slopes = self._pulled.slopes
        self.tips = self.points[: len(self.fingers)]
        self.put(self.default)
        self.palm = self._palm(path, hand)
        self.begins = np.array([self._data.xanchor[self._moving(dofs)[-1]] for dofs in above])
        self.reach = self._reached(each)

    def put(self, q: Float64) -> None:
        """Put the joints somewhere, [rad], shape (n,); `points`, `jacobian` are of there then."""
        mujoco, model, data = self._mujoco, self._model, self._data
        self._place(q)
        mujoco.mj_comPos(model, data)
        for site, part in self._parts:
            mujoco.mj_jacSite(model, data, part, None, site)
        if self.knee:
            at, body = data.xanchor[self._knee], int(model.jnt_bodyid[self._knee])
            self.points[-1] = at
            mujoco.mj_jac(model, data, self._whole[-3:], None, at, body)
        np.matmul(self._whole, self._slopes, out=self.jacobian)

    def _place(self, q: Float64) -> None:
        """Put the joints somewhere, for the tips alone."""
        self._pulled.put(self._data.qpos, q)
        self._mujoco.mj_kinematics(self._model, self._data)
        self._data.site_xpos.take(self._sites, axis=0, out=self.tips, mode="clip")

    def _moving(self, dofs: list[int]) -> list[int]:
        """Return the joints among these that the robot moves."""
        slopes = self._pulled.slopes
        return [int(self._model.dof_jntid[dof]) for dof in dofs if slopes[dof].any()]

    def _palm(self, path: Path, hand: Hand) -> Float64:
        found = body_of(self._loaded, hand.palm, "hand.palm")
        if (self._slopes[dofs_above(self._model, found)] != 0.0).any():
            raise ModelError(
                f"model {path}: joints of the hand move its palm {hand.palm.body!r}; name the body "
                "that carries the fingers: hand: {palm: {body: …}}"
            )
        own, body = np.zeros(9), self._data.xmat[found].reshape(3, 3)
        self._mujoco.mju_quat2Mat(own, np.array(hand.palm.quat))
        turned: Float64 = body @ own.reshape(3, 3)
        return turned

    def _reached(self, moved: Bool) -> Float64:
        """Return how far each tip gets from where its finger begins, tried on finer grids."""
        reach = np.zeros(len(self.fingers))
        for i, joints in enumerate(moved):
            places, q = np.flatnonzero(joints), self.default.copy()
            each = min(_EACH, max(3, int(_POSES ** (1.0 / len(places)))))
            lower, upper = self.lower[places], self.upper[places]
            for _ in range(_GRIDS):
                best = q[places]
                for values in product(*np.linspace(lower, upper, each).T):
                    q[places] = values
                    self._place(q)
                    far = float(np.linalg.norm(self.tips[i] - self.begins[i]))
                    if far > reach[i]:
                        reach[i], best = far, np.array(values)
                q[places], near = best, (upper - lower) / (each - 1)
                lower = np.maximum(best - near, self.lower[places])
                upper = np.minimum(best + near, self.upper[places])
        self.put(self.default)
        return reach


def told_hand(robot: Robot) -> Hand:
    """Return what a robot's file says of its hand.

    Raises:
        RobotError: nothing.
    """
    if robot.hand is None:
        remedy = f"add hand: {{palm: …, fingers: …}} to {robot.path}"
        if robot.members:
            remedy = f"say of whom: of: {' or '.join(list(robot.members)[1:])}"
        raise RobotError(f"robot {robot.name} has no hand; {remedy}")
    return robot.hand


def _mark(spec: Any, path: Path, hand: Hand) -> None:
    """Add a site at the tip of each finger."""
    for finger, place in hand.fingers.items():
        body = body_in(spec, place.body, f"hand.fingers.{finger}", path)
        body.add_site(name=_SITE + finger, pos=place.position)


class Pulled:
    """Places the robot's joints in a model, and those that follow them.

    Args:
        loaded: the model; its followers are URDF's `mimic` and MJCF's `equality/joint`.

    Attributes:
        slopes: of each degree of freedom of the model by each joint of the robot, at the last
            `put`, shape (nv, n).
    """

    def __init__(self, loaded: LoadedModel) -> None:
        model = loaded.model
        self._driven = loaded.addresses
        dof = dict(zip(model.jnt_qposadr.tolist(), model.jnt_dofadr.tolist()))
        self.slopes = np.zeros((model.nv, len(self._driven)))
        self.slopes[[dof[int(place)] for place in self._driven], range(len(self._driven))] = 1.0
        self._followers = [
            (place, dof[place], driver, dof.get(driver, -1), offset, start, tuple(polynomial))
            for place, driver, offset, start, polynomial in followers(loaded)
        ]
        self._linear = all(not any(each[-1][2:]) for each in self._followers)
        self._at = np.array([each[0] for each in self._followers], np.intp)
        qpos = np.array(model.qpos0)
        qpos[self._driven] = 0.0
        self._follow(qpos)
        self._fixed = qpos[self._at]  # where they are at 0, and how they go on from there
        self._rows = self.slopes[[each[1] for each in self._followers]]

    def put(self, qpos: Float64, q: Float64) -> None:
        """Write positions of the robot's joints, shape (n,), and of their followers into `qpos`."""
        qpos[self._driven] = q
        if self._linear:
            qpos[self._at] = self._fixed + self._rows @ q
        else:
            self._follow(qpos)

    def _follow(self, qpos: Float64) -> None:
        """Follow one by one, by polynomials of any degree (MuJoCo, XML, `equality/joint`)."""
        for place, row, driver, column, offset, start, polynomial in self._followers:
            turned = float(qpos[driver]) - start if driver >= 0 else 0.0
            value = slope = 0.0
            for factor in reversed(polynomial):  # Horner's rule, and its derivative
                slope = slope * turned + value
                value = value * turned + factor
            qpos[place] = offset + value
            if column >= 0:
                np.multiply(self.slopes[column], slope, out=self.slopes[row])


JOINTS = 25
"""Of a hand in WebXR, in the order of XRHandJoint (W3C, WebXR Hand Input Module, section 3.2): the
wrist, four of the thumb, then five of each finger, the first of them in the palm."""

CHAINS = {
    "thumb": (1, 2, 3, 4),
    "index": (6, 7, 8, 9),
    "middle": (11, 12, 13, 14),
    "ring": (16, 17, 18, 19),
    "pinky": (21, 22, 23, 24),
}
"""Finger to its joints from where it begins to move, to its tip: three bones."""

_INDEX, _PINKY = CHAINS["index"][0], CHAINS["pinky"][0]

ABSENT = "absent"
"""What `look` tells of a hand that nobody tracks."""

# [m]. A grown-up's phalanges have 16 to 45 mm on average, the thumb's bone in the palm 46 (Buryanov
# & Kotiuk, Proportions of Hand Segments, Int. J. Morphol. 28(3), 2010). What has a third of that or
# twice as much may be a hand; a finger of 1 m is none.
BONE = 0.005, 0.11
FINGER = 0.03, 0.2
PALM = 0.005, 0.22
WIDE = 0.02
"""In [m]: the knuckle of the index finger is that far and more to one side of the pinky's."""
_LOW, _HIGH = np.array((PALM, BONE, BONE, BONE)).T
_WHAT = ("the way from the wrist to the", *("a bone of the",) * 3)


class HumanHand:
    """What the fingers of a human hand say, of its 25 poses.

    Args:
        poses: position [m] and quaternion wxyz of each joint, in any one frame, shape (25, 7). The
            wrist's x leads to the fingers, its z out of the back of the hand.
        fingers: those that are asked for, as of `FINGERS` of a robot file.
        side: left or right; "" for either.
        mirrored: give what a hand of the other side would.

    Attributes:
        vectors: from where each finger begins to its tip, in the wrist's frame in [m], shape
            (f, 3).
        lengths: of the fingers along their bones in [m], however they bend, shape (f,).
        tips: of the fingers, in the wrist's frame from the wrist in [m], shape (f, 3).
        knee: from where the thumb begins to its last joint likewise, shape (3,).
    """

    def __init__(
        self, poses: Float32, fingers: Sequence[str], side: str = "", *, mirrored: bool = False
    ) -> None:
        self._points, self._wrist, self._side = poses[:, :3], poses[0, 3:], side
        self._fingers = tuple(fingers)
        self._chains = np.array([(0, *CHAINS[finger]) for finger in fingers])
        count = len(fingers)
        self.vectors, self.tips = np.zeros((count, 3)), np.zeros((count, 3))
        self.lengths, self.knee = np.zeros(count), np.zeros(3)
        self._across = np.array((1.0, -1.0, 1.0)) if mirrored else np.ones(3)
        self._thumb = self._fingers.index("thumb") if "thumb" in self._fingers else -1

    def look(self) -> str:
        """Take the poses anew; return "" if they are a hand, `ABSENT`, or what is wrong."""
        chains = self._points[self._chains].astype(np.float64)
        ways = chains[:, 1:] - chains[:, :-1]
        sizes = np.sqrt(np.einsum("fbx,fbx->fb", ways, ways))
        np.sum(sizes[:, 1:], axis=1, out=self.lengths)
        w, x, y, z = self._wrist.tolist()
        norm = w * w + x * x + y * y + z * z
        if not (
            ((sizes >= _LOW) & (sizes <= _HIGH)).all()
            and self.lengths.min() >= FINGER[0]
            and self.lengths.max() <= FINGER[1]
            and 0.8 < norm < 1.2
        ):
            return self._wrong(sizes, norm)
        turn = np.array(rotation_of(w, x, y, z, norm)).reshape(3, 3)
        wide = float((self._points[_INDEX] - self._points[_PINKY]) @ turn[:, 1])
        if self._side and (wide < -WIDE if self._side == "right" else wide > WIDE):
            return f"it is not a {self._side} hand"
        turn *= self._across
        if self._thumb >= 0:
            thumb = chains[self._thumb]
            np.matmul(thumb[3] - thumb[1], turn, out=self.knee)
        tips = chains[:, 4]
        np.matmul(tips - chains[:, 1], turn, out=self.vectors)
        np.matmul(tips - chains[:, 0], turn, out=self.tips)
        return ""

    def _wrong(self, sizes: Float64, norm: float) -> str:
        """Return why it is not a hand."""
        if np.isnan(self._points).any() or norm != norm or not sizes.any():
            return ABSENT  # as where nothing is tracked, all joints at one place
        if not np.isfinite(sizes).all():
            return "a joint is infinitely far away"
        if not 0.8 < norm < 1.2:
            return f"the wrist's quaternion has length {norm**0.5:.3g}"
        off = np.maximum(_LOW - sizes, sizes - _HIGH)
        if off.max() > 0.0:
            finger, bone = np.unravel_index(int(off.argmax()), off.shape)
            return f"{_WHAT[bone]} {self._fingers[finger]} is {sizes[finger, bone]:.3g} m"
        off = np.maximum(FINGER[0] - self.lengths, self.lengths - FINGER[1])
        finger = off.argmax()
        return f"the length of the {self._fingers[finger]} is {self.lengths[finger]:.3g} m"
