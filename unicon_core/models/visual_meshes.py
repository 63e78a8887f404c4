"""Looks: links with the meshes that show them, for robot_description; collisions stay primitives.

Of an MJCF they are the mesh geoms that MuJoCo shows (groups 0 to 2), without those that collide
where others do not. Of a URDF they are its own `<visual>` elements, which MuJoCo mostly drops.
Each mesh file has a URI; those of strangers are refused.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as Xml
from collections.abc import Mapping, Sequence
from contextlib import suppress
from os.path import isfile
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from unicon_base import UniconError
from unicon_base.arrays import Float64
from unicon_base.packages import PACKAGE, package_file
from unicon_core.models.absent import mesh_places, model_folders, repaired_urdf
from unicon_core.models.find import pick_model
from unicon_core.models.kinematic_tree import BASE, Geom, Link, read_tree
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel, about, import_mujoco, multiply, rotate, solid
from unicon_core.robots import Robot

# Opacity below which a geom is there for contacts alone.
_FAINT = 0.05
# Times a unit quaternion: its inverse.
_BACK = np.array((1.0, -1.0, -1.0, -1.0))

# Of a mesh: `refpos` [m], shape (3,), `refquat`, wxyz, shape (4,), and its `meshdir`.
_Reference = tuple[Float64, Float64, str]


def dressed(path: Path, robot: Robot) -> tuple[LoadedModel, list[Link], str]:
    """Load a model; return it, its links with `looks`, and what is lacking, in one line, else "".

    Args:
        path: MJCF or URDF, as `find_model` found it.
        robot: as for `load_model` and `read_tree`.

    Raises:
        UniconError: the file is wrong, lacks a joint, or MuJoCo is not installed to read it.
    """
    references: dict[str, _Reference] = {}

    def note(spec: Any) -> None:
        for mesh in spec.meshes:
            folder = mesh.compiler.meshdir or spec.meshdir
            name = mesh.name or Path(mesh.file).stem
            references[name] = np.array(mesh.refpos), np.array(mesh.refquat), folder

    loaded = load_model(path, robot, quiet=True, prepare=note)
    links = read_tree(loaded.model, robot)
    files = MeshFiles(_models(path, robot))
    own = (
        give_visuals(path, links, robot.base_frame, files)
        if path.suffix.lower() == ".urdf"
        else set()
    )
    for link in links:
        if link.name not in own:
            _dress(link, loaded.model, references, files)
    return loaded, links, "; ".join([*loaded.absent.values(), *files.told()])


def _models(path: Path, robot: Robot) -> dict[str, Path]:
    models = {"": path}
    for member in robot.members.keys() & robot.mounts.keys():
        with suppress(UniconError):
            models[member] = pick_model(robot.members[member])
    return models


def _dress(link: Link, model: Any, references: dict[str, _Reference], files: MeshFiles) -> None:
    kind = int(import_mujoco().mjtGeom.mjGEOM_MESH)
    meshes = [g for g in link.geoms if g.number >= 0 and int(model.geom_type[g.number]) == kind]
    meshes = [geom for geom in meshes if model.geom_group[geom.number] < 3]
    free = [geom.number for geom in meshes if not solid(model, geom.number)]
    worn = {
        geom.number: _mesh(geom, model, references, files)
        for geom in meshes
        if not free or geom.number in free
    }
    if any(each.uri for each in worn.values()):
        hidden = {geom.number for geom in meshes} - worn.keys()
        seen = [g for g in link.geoms if g.number not in hidden and g.rgba[3] >= _FAINT]
        link.looks = [worn.get(geom.number, geom) for geom in seen]


def _mesh(geom: Geom, model: Any, references: dict[str, _Reference], files: MeshFiles) -> Geom:
    """Return a geom as its file has it; MuJoCo shifts and turns meshes when it compiles them.

    MuJoCo's own vertices are R(quat)ᵀ (scale ∘ R(refquat)ᵀ (file − refpos) − pos).
    """
    mesh = int(model.geom_dataid[geom.number])
    start = int(model.mesh_pathadr[mesh])
    if start < 0:
        return geom
    file = model.paths[start : model.paths.index(b"\0", start)].decode("utf-8", "surrogateescape")
    name = model.mesh(mesh).name
    refpos, refquat, folder = references[name]
    refback = refquat / np.linalg.norm(refquat) * _BACK
    scale = np.array(model.mesh_scale[mesh])
    if abs(refback[0]) < 1.0 - 1e-9 and np.ptp(scale) > 1e-9:
        files.refuse(file, "turned by refquat and scaled unevenly, which URDF cannot say")
        return geom
    uri = files.opened(name, folder, file)
    if not uri:
        return geom
    quat = multiply(geom.quat, model.mesh_quat[mesh] * _BACK)
    centre = rotate(geom.quat, np.array(model.geom_aabb[geom.number, :3]))
    shift = rotate(refback, scale * refpos) + model.mesh_pos[mesh]
    position = geom.position - centre - rotate(quat, shift)
    quat = multiply(quat, refback)
    return Geom("mesh", tuple(scale), position, quat, geom.rgba, geom.number, uri)


FORMATS = (".stl", ".dae", ".obj")
"""What RViz and Foxglove both read."""
# Folders of models alone: their meshes lie beside them, in `../meshes`.
_PARTED = ("urdf", "mjcf", "xml", "robots")
_FILE = "file://"


class MeshFiles:
    """Gives a URI to the meshes of formats that viewers read, in the folders of the models.

    That is the folder of a model file, the one above where it is called `urdf`, `mjcf`, `xml` or
    `robots`, and the ROS package around it: a viewer may hand what is named on over the network,
    and a stranger's model may name anything.

    Args:
        models: files of the robot, "", and of its members, by their names.
    """

    def __init__(self, models: Mapping[str, Path]) -> None:
        self._models = models
        self._folders = [folder for model in models.values() for folder in _own_folders(model)]
        self._refused: dict[str, list[str]] = {}

    def uri(self, found: Path | str) -> str:
        """Return the URI of a file, "" where it is refused."""
        file = Path(found).resolve()
        if file.suffix.lower() not in FORMATS:
            self.refuse(file.name, f"not of a format that viewers read ({', '.join(FORMATS)})")
        elif not any(file.is_relative_to(folder) for folder in self._folders):
            where = f"outside of {self._folders[0]}; put them there, or a package.xml above both"
            self.refuse(file.name, where)
        else:
            return file.as_uri()
        return ""

    def refuse(self, name: str, why: str) -> None:
        """Note that a mesh is not shown."""
        self._refused.setdefault(why, []).append(name)

    def told(self) -> list[str]:
        """Return what was refused, a text for each reason."""
        said = []
        for why, names in self._refused.items():
            first = names[0].encode(errors="replace").decode()
            said.append(f"{len(set(names))} visual meshes (first: {first}) are {why}")
        return said

    def opened(self, mesh: str, folder: str, file: str) -> str:
        """Return the URI of what MuJoCo opened for a mesh, "" where it is refused.

        Args:
            mesh: its name; of a member's, after `MEMBER/`.
            folder: `meshdir` of its model.
            file: as the model names it; since MuJoCo 3.17, where it was found.
        """
        member = mesh.partition("/")[0]
        models = dict.fromkeys((self._models.get(member, self._models[""]), *self._models.values()))
        folders = (each for model in models for each in model_folders(model))
        place = next((each / folder / file for each in folders if isfile(each / folder / file)), "")
        return self.uri(place) if place else self._absent(file)

    def named(self, name: str, path: Path, folder: Path) -> str:
        """Return the URI of what a URDF names, "" where it is refused or nothing is there.

        Args:
            name: `package://PACKAGE/PATH`, which stays where that package is installed; else a path
                or `file://`.
            path: of the URDF.
            folder: where it says that meshes lie.
        """
        with suppress(UniconError):
            if name.startswith(PACKAGE) and isfile(file := package_file(name, "mesh")):
                return name if name.lower().endswith(FORMATS) else self.uri(file)
        local = unquote(name.removeprefix(_FILE)) if name.startswith(_FILE) else name
        place = next((each for each in mesh_places(path, folder, local) if isfile(each)), None)
        return self.uri(place) if place else self._absent(name)

    def _absent(self, name: str) -> str:
        self.refuse(name, "absent; add the files")
        return ""


def _own_folders(path: Path) -> list[Path]:
    """Return the folders whose meshes are a model's, symbolic links resolved."""
    folder = path.resolve().parent
    package = (each for each in (folder, *folder.parents) if isfile(each / "package.xml"))
    return [folder.parent if folder.name in _PARTED else folder, next(package, folder)]


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
    by_name = {link.name: link for link in links}
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
    shape, origin, material = map(visual.find, ("geometry/*", "origin", "material"))
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
    figures = tuple(map(float, text.split()))
    if len(figures) != count or not all(map(math.isfinite, figures)):
        raise ValueError(text)
    return figures
