"""The visuals of a URDF, which MuJoCo mostly drops, as looks of links; for robot_description."""

from __future__ import annotations

import math
import xml.etree.ElementTree as Xml
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from unicon_core.models.kinematic_tree import BASE
from unicon_core.models.links import Geom, Link
from unicon_core.models.mesh_files import MeshFiles
from unicon_core.models.quaternions import about, multiply
from unicon_core.models.urdf_repair import repaired_urdf


def give_visuals(path: Path, links: Sequence[Link], base_frame: str, files: MeshFiles) -> set[str]:
    """Give links the visuals of a URDF, if any is a mesh; return the names of its links."""
    root = Xml.fromstring(repaired_urdf(path, []) or path.read_text("utf-8-sig", "replace"))
    compiler = root.find("mujoco/compiler")
    folder = path.parent / ("" if compiler is None else compiler.get("meshdir", ""))
    colours = {
        material.get("name", ""): colour.get("rgba", "")
        for material in root.iter("material")
        if (colour := material.find("color")) is not None
    }
    children = {child.get("link") for child in root.iter("child")}
    by_name: dict[str, Link] = {link.name: link for link in links}
    looks: dict[str, list[Geom]] = {}
    blind: set[str] = set()
    for element in root.findall("link"):
        name = element.get("name", "")
        if name not in by_name and name not in children:
            name = base_frame or BASE  # the root is called as the robot file says
        visuals = [_visual(v, path, folder, colours, files) for v in element.findall("visual")]
        looks.setdefault(name, []).extend(geom for geom in visuals if geom is not None)
        if visuals:
            blind.add(name)
    if any(geom.uri for each in looks.values() for geom in each):
        for name in looks.keys() & by_name.keys():
            by_name[name].looks = None if name in blind and not looks[name] else looks[name]
    return {*looks}


def _visual(
    visual: Xml.Element, path: Path, folder: Path, colours: dict[str, str], files: MeshFiles
) -> Geom | None:
    """Return a `<visual>` as it stands; None where its mesh is lacking, or a figure is none."""
    shape, origin, material = (visual.find(tag) for tag in ("geometry/*", "origin", "material"))
    if shape is None:
        return None
    place = {} if origin is None else origin.attrib
    try:
        position = np.array(_figures(place.get("xyz", "0 0 0"), 3))
        turns = zip(np.eye(3), _figures(place.get("rpy", "0 0 0"), 3))
        roll, pitch, yaw = (about(axis, angle) for axis, angle in turns)
        quat = multiply(multiply(yaw, pitch), roll)
        rgba: tuple[float, ...] = ()
        if material is not None:
            colour = material.find("color")
            given = colours.get(material.get("name", "")) if colour is None else colour.get("rgba")
            rgba = _figures(given, 4) if given else ()
        if shape.tag == "mesh":
            scale = _figures(shape.get("scale", "1 1 1"), 3)
            uri = files.named(shape.get("filename", ""), path, folder)
            return Geom("mesh", scale, position, quat, rgba, uri=uri) if uri else None
        keys = {"box": {"size": 3}, "sphere": {"radius": 1}, "cylinder": {"radius": 1, "length": 1}}
        sizes = [_figures(shape.get(key, ""), n) for key, n in keys.get(shape.tag, {}).items()]
    except ValueError:
        return None
    return Geom(shape.tag, sum(sizes, ()), position, quat, rgba) if sizes else None


def _figures(text: str, count: int) -> tuple[float, ...]:
    figures = tuple(float(word) for word in text.split())
    if len(figures) != count or not all(map(math.isfinite, figures)):
        raise ValueError(text)
    return figures
