"""Links, joints and geoms of a robot, read from a compiled MuJoCo model; for URDF and transforms.

A link's frame is where URDF has it: at its joint's anchor, turned as the body is at joint position
0. MuJoCo's joint positions count from `qpos0`, so a body's pose is turned back by it here.

Written as URDF, capsules become a cylinder and two spheres, meshes their bounding boxes, or in a
`<visual>` their files where the links have `looks`. Names of links and joints are the model's,
limits of effort and speed the robot file's. An engine gets links that have a mass each, and no
frames without a body.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np

from unicon_base.arrays import Float64
from unicon_core.models.frames import yaw_of
from unicon_core.models.loaded import (
    LoadedModel,
    about,
    find_joints,
    free_joint,
    import_mujoco,
    is_simple,
    multiply,
    rotate,
    solid,
)
from unicon_core.robots import Robot


@dataclass
class Geom:
    """One shape of a link.

    Attributes:
        shape: `box`, `sphere`, `cylinder` or `mesh`.
        size: box: edges; sphere: radius; cylinder: radius, length; in [m]; mesh: scale.
        position: in the link's frame, [m], shape (3,).
        quat: geom to link, wxyz.
        rgba: colour; empty for that of a mesh's own file.
        number: of the model's geom of which it is a part, -1 for none.
        uri: of a mesh's file.
    """

    shape: str
    size: tuple[float, ...]
    position: Float64
    quat: Float64
    rgba: tuple[float, ...]
    number: int = -1
    uri: str = ""


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
        geoms: what it looks like, in primitives.
        looks: what it looks like with meshes; None where it has none.
        number: of the model's joint that carries it, -1 where it is fixed.
    """

    name: str
    parent: int
    position: Float64 = field(default_factory=lambda: np.zeros(3))
    quat: Float64 = field(default_factory=lambda: np.array((1.0, 0.0, 0.0, 0.0)))
    joint: str = ""
    index: int = -1
    sliding: bool = False
    axis: Float64 = field(default_factory=lambda: np.array((0.0, 0.0, 1.0)))
    lower: float = float("nan")
    upper: float = float("nan")
    mass: float = 0.0
    centre: Float64 = field(default_factory=lambda: np.zeros(3))
    inertia_quat: Float64 = field(default_factory=lambda: np.array((1.0, 0.0, 0.0, 0.0)))
    inertia: Float64 = field(default_factory=lambda: np.zeros(3))
    geoms: list[Geom] = field(default_factory=list)
    looks: list[Geom] | None = None
    number: int = -1


BASE = "base_link"
"""In every tree (REP-105): its root, or where the robot calls its base otherwise fixed to that. The
root is what odometry and /tf call the base, since a frame has one parent."""


def read_tree(model: Any, robot: Robot, *, colliding: bool = False) -> list[Link]:
    """Return the links of a robot in a compiled model, root first.

    Args:
        model: an `MjModel` that has the robot's joints.
        robot: gives joint names, base frame and the IMU's place.
        colliding: the geoms are those that collide, not those that are shown.
    """
    return _Reader(model, robot, colliding).links


def frame_of(model: Any, robot: Robot, body: int) -> tuple[str, Float64] | None:
    """Return the name of the frame that a body carries and its origin in the body's frame, [m].

    The frame is turned as the body. None where the body is not part of the robot.

    Args:
        model: an `MjModel` that has the robot's joints.
        robot: as for `read_tree`.
        body: number of the body in the model.
    """
    reader = _Reader(model, robot)
    if body not in reader.of_body:
        return None
    number, origin = reader.of_body[body]
    return reader.links[number].name, origin


class _Reader:
    def __init__(self, model: Any, robot: Robot, colliding: bool = False) -> None:
        self._mujoco, self._model, self._robot = import_mujoco(), model, robot
        self._colliding = colliding
        joints = find_joints(model, robot, robot.path)
        self._rank = {joint: rank for rank, joint in enumerate(joints)}
        self._roots = {int(body) for body in model.body_rootid[model.jnt_bodyid[joints]]}
        base = free_joint(model, joints[0])
        self._root = 0 if base is None else int(model.jnt_bodyid[base])
        self.links: list[Link] = []
        self.of_body: dict[int, tuple[int, Float64]] = {}  # body -> last link, its shift
        self._read()

    def _read(self) -> None:
        robot, model = self._robot, self._model
        none = np.zeros(3)
        names = dict.fromkeys((BASE, robot.base_frame or BASE))
        # Odometry tells of a base that moves; a fixed one stands below `base_link` in the world.
        for name in reversed(names) if self._root else names:
            self.links.append(Link(name, min(len(self.links), 1) - 1))
        base, root = self.links[0], 0 if self._root else len(names) - 1
        self.of_body[self._root] = (root, none)
        if self._root:
            self._dress(base, self._root, none)
        for body in range(1, model.nbody):
            parent = int(model.body_parentid[body])
            # A fixed robot's bodies stand beside other things in the world: take those with joints.
            ours = parent or self._root or body in self._roots
            if ours and body != self._root and parent in self.of_body:
                self._add_body(body, parent)
        if base.mass:  # tools refuse inertia at the root: a link of its own carries it
            self.links.append(replace(base, name=f"{base.name}_inertia", parent=0, geoms=[]))
            base.mass = 0.0
        imu = robot.imu
        taken = {link.name for link in self.links}
        if imu is not None and imu.frame not in taken and np.isfinite(imu.position).all():
            link = Link(imu.frame, root, imu.position.astype(float))
            if np.isfinite(imu.quat).all():
                link.quat = imu.quat.astype(float)
            self.links.append(link)

    def _add_body(self, body: int, parent_body: int) -> None:
        model = self._model
        parent, parent_shift = self.of_body[parent_body]
        position = np.array(model.body_pos[body]) - parent_shift
        quat = np.array(model.body_quat[body])
        name = model.body(body).name or f"body_{body}"
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        shift = np.zeros(3)
        joints = [j for j in range(first, first + count) if is_simple(model, j)]
        if not joints:
            base = self.links[parent]
            here = not position.any() and abs(quat[0]) > 1.0 - 1e-9
            if here and name == base.name and not base.mass:  # in a massless `base`, as A1's trunk
                self.of_body[body] = parent, shift
                self._dress(base, body, shift)
                return
            self.links.append(Link(name, parent, position, quat))
        for number, joint in enumerate(joints):
            anchor, axis = np.array(model.jnt_pos[joint]), np.array(model.jnt_axis[joint])
            zero = float(model.qpos0[model.jnt_qposadr[joint]])
            sliding = bool(model.jnt_type[joint] == int(self._mujoco.mjtJoint.mjJNT_SLIDE))
            position = position + rotate(quat, anchor - shift)
            if sliding:
                position = position - rotate(quat, axis * zero)
            else:
                quat = multiply(quat, about(axis, -zero))
            own = name if joint == joints[-1] else f"{name}_{number}"
            rank = self._rank.get(joint, -1)
            label = self._robot.joint_names[rank] if rank >= 0 else model.joint(joint).name
            link = Link(own, parent, position, quat, label or f"joint_{joint}", rank, sliding, axis)
            link.number = joint
            if model.jnt_limited[joint]:
                link.lower, link.upper = map(float, model.jnt_range[joint])
            self.links.append(link)
            parent, shift = len(self.links) - 1, anchor
            position, quat = np.zeros(3), np.array((1.0, 0.0, 0.0, 0.0))
        self.of_body[body] = (len(self.links) - 1, shift)
        self._dress(self.links[-1], body, shift)

    def _dress(self, link: Link, body: int, shift: Float64) -> None:
        """Give a link the inertia and the looks of a body."""
        model = self._model
        link.mass = float(model.body_mass[body])
        link.centre = np.array(model.body_ipos[body]) - shift
        link.inertia_quat = np.array(model.body_iquat[body])
        link.inertia = np.array(model.body_inertia[body])
        first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
        geoms = range(first, first + count)
        # MuJoCo's viewers hide the groups from 3 on.
        shown = [g for g in geoms if model.geom_group[g] < 3] or geoms
        touching = [geom for geom in geoms if solid(model, geom)]
        for geom in touching if self._colliding else shown:
            link.geoms += self._geoms(geom, shift)

    def _geoms(self, geom: int, shift: Float64) -> list[Geom]:
        model, kinds = self._model, self._mujoco.mjtGeom
        kind = kinds(int(model.geom_type[geom]))
        size = [float(x) for x in model.geom_size[geom]]
        position = np.array(model.geom_pos[geom]) - shift
        quat = np.array(model.geom_quat[geom])
        material = int(model.geom_matid[geom])
        colour = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        rgba = tuple(round(float(x), 4) for x in colour)

        def part(shape: str, *sizes: float, at: Float64 = position) -> Geom:
            return Geom(shape, sizes, at, quat, rgba, geom)

        if kind == kinds.mjGEOM_SPHERE:
            return [part("sphere", size[0])]
        if kind == kinds.mjGEOM_BOX:
            return [part("box", *(2.0 * x for x in size))]
        if kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
            parts = [part("cylinder", size[0], 2.0 * size[1])]
            if kind == kinds.mjGEOM_CAPSULE:  # which URDF lacks
                end = rotate(quat, np.array((0.0, 0.0, size[1])))
                parts += [part("sphere", size[0], at=position + at) for at in (end, -end)]
            return parts
        if kind in (kinds.mjGEOM_ELLIPSOID, kinds.mjGEOM_MESH):
            centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
            middle = position + rotate(quat, np.array(centre))
            return [part("box", *(2.0 * float(x) for x in half), at=middle)]
        return []  # planes and height fields are not part of a robot


def urdf(links: Sequence[Link], robot: Robot) -> str:
    """Return the URDF text of a tree of links.

    Args:
        links: root first, as `kinematic_tree.read_tree` gives them.
        robot: gives the name and the limits of effort [N·m] and speed [rad/s].
    """
    root = Xml.Element("robot", name=robot.name)
    for link in links:
        element = Xml.SubElement(root, "link", name=link.name)
        if link.mass > 0.0:
            _inertial(element, link)
        for geom in link.geoms if link.looks is None else link.looks:
            _geom(Xml.SubElement(element, "visual"), geom, True)
        for geom in link.geoms:
            _geom(Xml.SubElement(element, "collision"), geom, False)
    for link in links:
        if link.parent >= 0:
            _joint(root, link, links[link.parent].name, robot)
    Xml.indent(root)
    return '<?xml version="1.0"?>\n' + Xml.tostring(root, encoding="unicode") + "\n"


def _joint(root: Xml.Element, link: Link, parent: str, robot: Robot) -> None:
    limited = math.isfinite(link.lower) and math.isfinite(link.upper)
    kind = "fixed"
    if link.joint:
        kind = "prismatic" if link.sliding else "revolute" if limited else "continuous"
    element = Xml.SubElement(root, "joint", name=link.joint or f"{link.name}_fixed", type=kind)
    Xml.SubElement(element, "parent", link=parent)
    Xml.SubElement(element, "child", link=link.name)
    _origin(element, link.position, link.quat)
    if not link.joint:
        return
    Xml.SubElement(element, "axis", xyz=_numbers(link.axis))
    effort, velocity = 0.0, 0.0
    if link.index >= 0:
        effort = float(np.nan_to_num(robot.effort_limit[link.index]))
        velocity = float(np.nan_to_num(robot.velocity_limit[link.index]))
    limits = {"effort": f"{effort:.6g}", "velocity": f"{velocity:.6g}"}
    if limited:
        limits |= {"lower": f"{link.lower:.9g}", "upper": f"{link.upper:.9g}"}
    Xml.SubElement(element, "limit", limits)


def _geom(element: Xml.Element, geom: Geom, visual: bool) -> None:
    _origin(element, geom.position, geom.quat)
    shape = Xml.SubElement(element, "geometry")
    if geom.shape == "box":
        Xml.SubElement(shape, "box", size=_numbers(geom.size))
    elif geom.shape == "sphere":
        Xml.SubElement(shape, "sphere", radius=f"{geom.size[0]:.6g}")
    elif geom.shape == "mesh":
        Xml.SubElement(shape, "mesh", filename=geom.uri, scale=_numbers(geom.size))
    else:
        radius, length = geom.size
        Xml.SubElement(shape, "cylinder", radius=f"{radius:.6g}", length=f"{length:.6g}")
    if visual and geom.rgba:
        material = Xml.SubElement(element, "material", name="c" + "_".join(map(str, geom.rgba)))
        Xml.SubElement(material, "color", rgba=_numbers(geom.rgba))


def _inertial(element: Xml.Element, link: Link) -> None:
    inertial = Xml.SubElement(element, "inertial")
    _origin(inertial, link.centre, link.inertia_quat)
    Xml.SubElement(inertial, "mass", value=f"{link.mass:.6g}")
    ixx, iyy, izz = (f"{value:.6g}" for value in link.inertia)
    Xml.SubElement(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0", ixz="0", iyz="0")


def _origin(element: Xml.Element, position: Float64, quat: Float64) -> None:
    Xml.SubElement(element, "origin", xyz=_numbers(position), rpy=_numbers(_rpy(quat)))


def _rpy(quat: Float64) -> tuple[float, float, float]:
    """Return fixed-axis roll, pitch, yaw [rad] of a unit quaternion wxyz, as URDF has them."""
    w, x, y, z = map(float, quat)
    sine = 2.0 * (w * y - x * z)
    if abs(sine) > 1.0 - 1e-9:  # looking straight up or down: roll is free, let it be 0
        # There R = Rz(yaw) Ry(±90°), so yaw alone is left in the first column's neighbours.
        return (
            0.0,
            math.copysign(0.5 * math.pi, sine),
            math.atan2(2.0 * (w * z - x * y), 1.0 - 2.0 * (x * x + z * z)),
        )
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return roll, math.asin(sine), yaw_of((w, x, y, z))


def _numbers(values: Sequence[float] | Float64) -> str:
    return " ".join(f"{0.0 if abs(value) < 1e-12 else float(value):.9g}" for value in values)


_LIGHT, _SMALL = 1e-4, 1e-6  # [kg], [kg·m²] of a link between two joints of one body


def physical_urdf(loaded: LoadedModel, robot: Robot) -> str:
    """Return a model as URDF text for a physics engine that reads no MJCF."""
    return urdf(physical_links(read_tree(loaded.model, robot, colliding=True)), robot)


def physical_links(links: Sequence[Link]) -> list[Link]:
    """Return the same tree for an engine that takes a link without inertia for one of 1 kg.

    A link that coincides with its parent becomes a part of it; a frame without mass and geoms goes.

    Args:
        links: root first, as `kinematic_tree.read_tree` gives them.
    """
    kept: list[Link] = []
    place: dict[int, int] = {}  # of a link -> of what it became
    parents = {link.parent for link in links}
    for i, link in enumerate(links):
        parent = place.get(link.parent, -1)
        still = not link.joint and parent >= 0
        if still and not link.position.any() and abs(link.quat[0]) > 1.0 - 1e-9:
            into = kept[parent]
            if link.mass > 0.0 and into.mass == 0.0:
                into = replace(
                    into,
                    mass=link.mass,
                    centre=link.centre,
                    inertia=link.inertia,
                    inertia_quat=link.inertia_quat,
                )
            if into.mass == link.mass or link.mass == 0.0:
                kept[parent] = replace(into, geoms=[*into.geoms, *link.geoms])
                place[i] = parent
                continue
        if still and i not in parents and link.mass == 0.0 and not link.geoms:
            continue
        place[i] = len(kept)
        kept.append(replace(link, parent=parent))
    return [
        link if link.mass > 0.0 else replace(link, mass=_LIGHT, inertia=np.full(3, _SMALL))
        for link in kept
    ]
