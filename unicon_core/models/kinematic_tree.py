"""Links, joints and geoms of a robot, read from a compiled MuJoCo model; for URDF and transforms.

A link's frame is where URDF has it: at its joint's anchor, turned as the body is at joint position
0. MuJoCo's joint positions count from `qpos0`, so a body's pose is turned back by it here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import UniconError
from unicon_core.models.find import find_model
from unicon_core.models.joints import find_joints
from unicon_core.models.load import import_mujoco, load_model
from unicon_core.robots import Robot
from unicon_core.workflow import Program

__all__ = ["Geom", "Link", "frame_of", "multiply", "read_tree", "rotate", "tree_of"]

Float = NDArray[np.float64]

BASE = "base_link"
"""Root of every tree (REP-105), whatever the robot calls its base."""


@dataclass
class Geom:
    """One primitive of a link.

    Attributes:
        shape: `box`, `sphere` or `cylinder`.
        size: box: edges; sphere: radius; cylinder: radius, length; in [m].
        position: in the link's frame, [m], shape (3,).
        quat: geom to link, wxyz.
        rgba: colour.
    """

    shape: str
    size: tuple[float, ...]
    position: Float
    quat: Float
    rgba: tuple[float, ...]


@dataclass
class Link:
    """One link and the joint that carries it.

    Attributes:
        name: frame name.
        parent: number of the parent link, -1 for the root.
        position: of the joint in the parent's frame in [m], shape (3,).
        quat: link to parent at joint position 0, wxyz.
        joint: name of the joint in the robot's words, "" where it is fixed.
        index: number of the joint in the robot's order, -1 where it is none of them.
        sliding: moves along the axis and does not turn about it.
        axis: unit vector in the link's frame, shape (3,).
        lower, upper: limits in [rad] or [m]; NaN where there are none.
        mass: in [kg], 0 for a link without inertia.
        centre: centre of mass in the link's frame in [m], shape (3,).
        inertia_quat: principal axes to link, wxyz.
        inertia: principal moments in [kg·m²], shape (3,).
        geoms: what it looks like.
    """

    name: str
    parent: int
    position: Float
    quat: Float
    joint: str = ""
    index: int = -1
    sliding: bool = False
    axis: Float = field(default_factory=lambda: np.array((0.0, 0.0, 1.0)))
    lower: float = float("nan")
    upper: float = float("nan")
    mass: float = 0.0
    centre: Float = field(default_factory=lambda: np.zeros(3))
    inertia_quat: Float = field(default_factory=lambda: np.array((1.0, 0.0, 0.0, 0.0)))
    inertia: Float = field(default_factory=lambda: np.zeros(3))
    geoms: list[Geom] = field(default_factory=list)


def tree_of(program: Program) -> list[Link]:
    """Return the links of a workflow's robot, root first, from its simulator's or its own model.

    Raises:
        UniconError: there is no model, or MuJoCo is not installed to read it.
    """
    robot = program.robot
    model = getattr(program.platform, "model", None)
    if model is None:
        if robot.model is None:
            raise UniconError(f"robot {robot.name} names no model; add model: PATH to {robot.path}")
        import_mujoco()
        model = load_model(find_model(robot.model), robot).model
    return read_tree(model, robot)


def read_tree(model: Any, robot: Robot) -> list[Link]:
    """Return the links of a robot in a compiled model, root first.

    Args:
        model: an `MjModel` that has the robot's joints.
        robot: gives joint names, base frame and the IMU's place.
    """
    return _Reader(import_mujoco(), model, robot).read()


def frame_of(model: Any, robot: Robot, body: int) -> tuple[str, Float] | None:
    """Return the name of the frame that a body carries and its origin in the body's frame, [m].

    The frame is turned as the body. None where the body is no part of the robot.

    Args:
        model: an `MjModel` that has the robot's joints.
        robot: as for `read_tree`.
        body: number of the body in the model.
    """
    reader = _Reader(import_mujoco(), model, robot)
    links = reader.read()
    if body not in reader.of_body:
        return None
    number, origin = reader.of_body[body]
    return links[number].name, origin


class _Reader:
    def __init__(self, mujoco: Any, model: Any, robot: Robot) -> None:
        self._mujoco, self._model, self._robot = mujoco, model, robot
        names = [self._name("JOINT", i) for i in range(model.njnt)]
        joints = find_joints(names, robot.joint_names, robot.path)
        self._rank = {joint: rank for rank, joint in enumerate(joints)}
        self._root = self._base_body(joints[0])
        self._links: list[Link] = []
        self.of_body: dict[int, tuple[int, Float]] = {}  # body -> last link, its shift

    def read(self) -> list[Link]:
        robot, model = self._robot, self._model
        none, same = np.zeros(3), np.array((1.0, 0.0, 0.0, 0.0))
        self._links.append(Link(BASE, -1, none, same))
        root = 0
        if robot.base_frame and robot.base_frame != BASE:
            self._links.append(Link(robot.base_frame, 0, none, same))
            root = 1
        self.of_body[self._root] = (root, none)
        if self._root:
            self._dress(self._links[root], self._root, none)
            if root == 0:  # tools refuse inertia at the root: a link of its own carries it
                base = self._links[0]
                carrier = Link(f"{BASE}_inertia", 0, none, same, mass=base.mass)
                carrier.centre, carrier.inertia = base.centre, base.inertia
                carrier.inertia_quat, base.mass = base.inertia_quat, 0.0
                self._links.append(carrier)
        for body in range(1, model.nbody):
            parent = int(model.body_parentid[body])
            if body != self._root and parent in self.of_body and self._belongs(body):
                self._add_body(body, parent)
        imu = robot.imu
        taken = {link.name for link in self._links}
        if imu is not None and imu.frame not in taken and np.isfinite(imu.position).all():
            quat = imu.quat if np.isfinite(imu.quat).all() else same
            self._links.append(
                Link(imu.frame, root, imu.position.astype(float), quat.astype(float))
            )
        return self._links

    def _belongs(self, body: int) -> bool:
        """A fixed robot's bodies stand beside other things in the world: take those with joints."""
        if self._root or int(self._model.body_parentid[body]):
            return True
        weld = {int(self._model.body_rootid[self._model.jnt_bodyid[joint]]) for joint in self._rank}
        return body in weld

    def _base_body(self, joint: int) -> int:
        model = self._model
        body = int(model.jnt_bodyid[joint])
        while body:
            first = int(model.body_jntadr[body])
            if first >= 0 and model.jnt_type[first] == int(self._mujoco.mjtJoint.mjJNT_FREE):
                return body
            body = int(model.body_parentid[body])
        return 0

    def _add_body(self, body: int, parent_body: int) -> None:
        model = self._model
        parent, parent_shift = self.of_body[parent_body]
        position = np.array(model.body_pos[body]) - parent_shift
        quat = np.array(model.body_quat[body])
        name = self._name("BODY", body) or f"body_{body}"
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        shift = np.zeros(3)
        joints = [j for j in range(first, first + count) if self._is_simple(j)]
        if not joints:
            self._links.append(Link(name, parent, position, quat))
        for number, joint in enumerate(joints):
            anchor, axis = np.array(model.jnt_pos[joint]), np.array(model.jnt_axis[joint])
            zero = float(model.qpos0[model.jnt_qposadr[joint]])
            sliding = model.jnt_type[joint] == int(self._mujoco.mjtJoint.mjJNT_SLIDE)
            position = position + rotate(quat, anchor - shift)
            if sliding:
                position = position - rotate(quat, axis * zero)
            else:
                quat = multiply(quat, _about(axis, -zero))
            last = number == len(joints) - 1
            rank = self._rank.get(joint, -1)
            ranged = bool(model.jnt_limited[joint])
            lower, upper = model.jnt_range[joint] if ranged else (float("nan"), float("nan"))
            label = self._robot.joint_names[rank] if rank >= 0 else self._name("JOINT", joint)
            self._links.append(
                Link(
                    name if last else f"{name}_{number}",
                    parent,
                    position,
                    quat,
                    label or f"joint_{joint}",
                    rank,
                    bool(sliding),
                    axis,
                    float(lower),
                    float(upper),
                )
            )
            parent, shift = len(self._links) - 1, anchor
            position, quat = np.zeros(3), np.array((1.0, 0.0, 0.0, 0.0))
        self.of_body[body] = (len(self._links) - 1, shift)
        self._dress(self._links[-1], body, shift)

    def _is_simple(self, joint: int) -> bool:
        kinds = self._mujoco.mjtJoint
        simple = int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE)
        return int(self._model.jnt_type[joint]) in simple

    def _dress(self, link: Link, body: int, shift: Float) -> None:
        """Give a link the inertia and the looks of a body."""
        model = self._model
        link.mass = float(model.body_mass[body])
        link.centre = np.array(model.body_ipos[body]) - shift
        link.inertia_quat = np.array(model.body_iquat[body])
        link.inertia = np.array(model.body_inertia[body])
        first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
        geoms = range(first, first + count)
        shown = [g for g in geoms if model.geom_group[g] < 3]  # MuJoCo's viewers hide the others
        for geom in shown or geoms:
            link.geoms += self._geoms(geom, shift)

    def _geoms(self, geom: int, shift: Float) -> list[Geom]:
        model, kinds = self._model, self._mujoco.mjtGeom
        kind = int(model.geom_type[geom])
        size = [float(x) for x in model.geom_size[geom]]
        position = np.array(model.geom_pos[geom]) - shift
        quat = np.array(model.geom_quat[geom])
        material = int(model.geom_matid[geom])
        colour = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        rgba = tuple(round(float(x), 4) for x in colour)

        def part(shape: str, *sizes: float, at: Float = position) -> Geom:
            return Geom(shape, sizes, at, quat, rgba)

        if kind == int(kinds.mjGEOM_SPHERE):
            return [part("sphere", size[0])]
        if kind == int(kinds.mjGEOM_BOX):
            return [part("box", *(2.0 * x for x in size))]
        if kind == int(kinds.mjGEOM_CYLINDER):
            return [part("cylinder", size[0], 2.0 * size[1])]
        if kind == int(kinds.mjGEOM_CAPSULE):  # which URDF lacks
            end = rotate(quat, np.array((0.0, 0.0, size[1])))
            return [
                part("cylinder", size[0], 2.0 * size[1]),
                part("sphere", size[0], at=position + end),
                part("sphere", size[0], at=position - end),
            ]
        if kind in (int(kinds.mjGEOM_ELLIPSOID), int(kinds.mjGEOM_MESH)):
            centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
            middle = position + rotate(quat, np.array(centre))
            return [part("box", *(2.0 * float(x) for x in half), at=middle)]
        return []  # planes and height fields are no part of a robot

    def _name(self, kind: str, number: int) -> str:
        name: str | None = self._mujoco.mj_id2name(
            self._model, getattr(self._mujoco.mjtObj, f"mjOBJ_{kind}"), number
        )
        return name or ""


def multiply(a: Float, b: Float) -> Float:
    """Return the product of two quaternions wxyz, shape (…, 4)."""
    aw, ax, ay, az = np.moveaxis(np.asarray(a), -1, 0)
    bw, bx, by, bz = np.moveaxis(np.asarray(b), -1, 0)
    return np.stack(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ),
        axis=-1,
    )


def rotate(quat: Float, vector: Float) -> Float:
    """Return a vector turned by a unit quaternion wxyz, shape (3,)."""
    w, u = quat[0], quat[1:]
    turned: Float = vector + 2.0 * np.cross(u, np.cross(u, vector) + w * vector)
    return turned


def _about(axis: Sequence[float] | Float, angle: float) -> Float:
    return np.concatenate(([np.cos(0.5 * angle)], np.sin(0.5 * angle) * np.asarray(axis)))
