"""URDF made from a robot's MuJoCo model: for rviz and tf, and for engines that read no MJCF.

Capsules become a cylinder and two spheres, meshes their bounding boxes, or in a `<visual>` their
files where the links have `looks`; names of links and joints are the model's, limits of effort and
speed the robot file's. An engine gets links that have a mass each, and no frames without a body.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from xml.etree import ElementTree as Xml

import numpy as np

from unicon_base.arrays import Float64
from unicon_core.models.kinematic_tree import Geom, Link, read_tree
from unicon_core.models.loaded import LoadedModel
from unicon_core.robots import Robot


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
    w, x, y, z = (float(value) for value in quat)
    sine = 2.0 * (w * y - x * z)
    if abs(sine) > 1.0 - 1e-9:  # looking straight up or down: roll is free, let it be 0
        # There R = Rz(yaw) Ry(±90°), so yaw alone is left in the first column's neighbours.
        return (
            0.0,
            math.copysign(0.5 * math.pi, sine),
            math.atan2(2.0 * (w * z - x * y), 1.0 - 2.0 * (x * x + z * z)),
        )
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return roll, math.asin(sine), yaw


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
