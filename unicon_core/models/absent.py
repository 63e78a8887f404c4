"""Mends model files for the loader: absent meshes and textures, mistakes of URDF files."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from os.path import isfile
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import AnyDict, ModelError
from unicon_base.located_yaml import is_lfs_pointer
from unicon_base.packages import PACKAGE, share_folder

_MESHES = (".stl", ".obj", ".msh")  # what MuJoCo reads; COLLADA counts as absent
_ATTACHED = re.compile(r"""<model\s[^<>]*?\bfile\s*=\s*["']([^"'<>]+)["']""")


def mesh_places(path: Path, folder: Path, file: str) -> Iterator[Path]:
    """Yield where a mesh may be: in meshdir, beside the model, in the ROS package it names."""
    name = file.removeprefix(PACKAGE)
    yield folder / name
    yield path.parent / name
    yield folder / Path(name).name
    if name != file:
        package, _, rest = name.partition("/")
        share = share_folder(package)
        if share is not None:
            yield share / rest
        for above in path.parents:
            yield above / name
            if above.name == package:
                yield above / rest


def model_folders(path: Path) -> dict[Path, None]:
    """Return the folders of a model and of those that it attaches: each has its own meshes."""
    text = path.read_text("utf-8", "replace") if isfile(path) else ""
    return dict.fromkeys(
        path.parent / Path(file).parent for file in (".", *_ATTACHED.findall(text))
    )


def drop_absent_meshes(
    spec: Any, path: Path, floats: bool, shapes: dict[str, list[str]]
) -> list[str]:
    """Take the meshes without a file and their geoms out; return a line that says so, if any.

    Args:
        spec: the `MjSpec`.
        path: of the model.
        floats: the robot needs geoms that keep it on the floor.
        shapes: takes up, for each body, the absent files of its geoms that may collide.
    """
    urdf = path.suffix.lower() == ".urdf"
    folders = model_folders(path)
    absent: AnyDict = {}
    pointers = 0
    for mesh in spec.meshes:
        if not mesh.file or mesh.file in spec.assets:
            continue
        readable = Path(mesh.file).suffix.lower() in _MESHES
        folder = mesh.compiler.meshdir or spec.meshdir
        looked = (mesh_places(path, each / folder, mesh.file) for each in folders)
        there = [place for places in looked for place in places if isfile(place)]
        found = next((p for p in there if readable and not is_lfs_pointer(p)), None)
        if found is None:
            pointers += any(map(is_lfs_pointer, there))
            absent[mesh.name or Path(mesh.file).stem] = mesh
        elif mesh.file.startswith(PACKAGE) or (
            urdf and found != path.parent / folder / mesh.file  # where alone MuJoCo looks
        ):
            mesh.file = str(found.resolve())
    if not absent:
        return []
    dropped = colliding = 0
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    gone = set()
    for geom in list(spec.geoms):
        if geom.meshname in absent:
            dropped += 1
            if geom.contype or geom.conaffinity or geom.name in paired:
                colliding += 1
                shapes.setdefault(geom.parent.name, []).append(absent[geom.meshname].file)
            gone.add(geom.name)
            spec.delete(geom)
    for pair in list(spec.pairs):
        if {pair.geomname1, pair.geomname2} & gone - {""}:
            spec.delete(pair)
    for mesh in absent.values():
        spec.delete(mesh)
    note = (
        f"{len(absent)} mesh files are absent (first: {next(iter(absent.values())).file}): "
        f"{dropped} geoms left out, {colliding} of them may collide"
    )
    own = (g for g in spec.geoms if g.parent != spec.worldbody)
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    if floats and not any(g.contype or g.conaffinity or g.name in paired for g in own):
        note += "; nothing else of it does, so it falls through the floor: add the files"
    return [note + _pull(pointers)]


def drop_absent_textures(spec: Any, path: Path) -> list[str]:
    """Take the textures without a file out; return a line that says so, if any."""
    folder = path.parent / spec.texturedir
    pointers: set[Path] = set()

    def lacks(texture: Any) -> bool:
        files = [folder / file for file in (texture.file, *texture.cubefiles) if file]
        there = [file for file in files if file.is_file()]
        pointers.update(file for file in there if is_lfs_pointer(file))
        return len(there) < len(files) or not pointers.isdisjoint(files)

    absent = [texture for texture in spec.textures if lacks(texture)]
    if not absent:
        return []
    names = {texture.name or Path(texture.file).stem for texture in absent}
    for material in spec.materials:
        material.textures = ["" if name in names else name for name in material.textures]
    for texture in absent:
        spec.delete(texture)
    note = f"{len(names)} textures are absent ({', '.join(sorted(names))}): left out"
    return [note + _pull(len(pointers))]


def _pull(pointers: int) -> str:
    are = f"{pointers} of the files {'is a' if pointers == 1 else 'are'} Git LFS pointer"
    return f"; {are}{'s' * (pointers > 1)}: run 'git lfs pull'" if pointers else ""


_ONCE = ("origin", "geometry", "material", "inertial", "mass", "inertia")


_TERMS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def repaired_urdf(path: Path, notes: list[str]) -> str | None:
    """Return the text of a URDF with its mistakes mended, None where there are none.

    Mended are elements that stand twice (two materials in the visuals of Unitree's Go2), inertias
    that no body can have (Robotera's XHand repeats one figure six times; of a camera of ANYbotics'
    ANYmal C two principal moments sum to less than the third), and shapes without an extent.

    Args:
        path: the file.
        notes: gets one line for each kind of mistake.

    Raises:
        ModelError: the file is not XML, or declares entities: no robot needs any, and they may grow
            without end or name other files.
    """
    try:
        raw = path.read_bytes()
        if b"\0" in raw:  # else entities could hide in another encoding, which MuJoCo cannot read
            raise ModelError(f"model {path}: it is not UTF-8; save it as that")
        text = raw.decode("utf-8-sig", "replace")
        if "<!ENTITY" in text or "<!DOCTYPE" in text:
            raise ModelError(f"model {path}: it has a DOCTYPE or entities; take them out")
        root = ET.fromstring(text)  # whatever encoding it declares: MuJoCo reads UTF-8
    except (ET.ParseError, OSError, ValueError, LookupError) as error:
        raise ModelError(f"model {path}: {error}; correct the file") from error
    twice = _drop_repeated(root)
    bodies = _mend_inertias(root)
    flat = _drop_flat(root)
    if twice:
        notes.append(f"{len(twice)} elements stand twice in the URDF (first: {twice[0]})")
    if bodies:
        notes.append(
            f"the inertia of {', '.join(bodies)} is none that a body can have: "
            "its largest figure stands for all axes"
        )
    if flat:
        notes.append(f"shapes without an extent are left out: {', '.join(flat)}")
    try:
        return ET.tostring(root, encoding="unicode") if twice or bodies or flat else None
    except RecursionError as error:
        raise ModelError(f"model {path}: its elements are nested too deep") from error


def _drop_repeated(root: ET.Element) -> list[str]:
    dropped = []
    for parent in root.iter():
        if parent.tag not in ("visual", "collision", "inertial", "link"):
            continue
        seen: set[str] = set()
        for child in list(parent):
            if child.tag in _ONCE and child.tag in seen:
                parent.remove(child)
                dropped.append(f"{child.tag} of a {parent.tag}")
            seen.add(child.tag)
    return dropped


def _mend_inertias(root: ET.Element) -> list[str]:
    mended = []
    for link in root.findall("link"):
        inertia = link.find("inertial/inertia")
        if inertia is None:
            continue
        try:
            xx, yy, zz, xy, xz, yz = (float(inertia.get(term, "0")) for term in _TERMS)
        except ValueError:
            continue  # MuJoCo names the line
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if not np.isfinite(matrix).all():
            continue  # MuJoCo refuses it
        if not matrix.any():
            continue  # MuJoCo takes it from mass and shapes, or says so
        small, middle, large = np.linalg.eigvalsh(matrix)
        if small > 1e-9 * abs(matrix).max() and small + middle >= large:
            continue
        for term in _TERMS:
            inertia.set(term, repr(float(abs(matrix).max())) if term[1] == term[2] else "0")
        mended.append(str(link.get("name")))
    return mended


def _drop_flat(root: ET.Element) -> list[str]:
    """Take shapes with a radius, length or edge of 0 out; return what was dropped."""
    dropped = []
    for link in root.findall("link"):
        for element in (*link.findall("visual"), *link.findall("collision")):
            shape = element.find("geometry/*")
            sizes = () if shape is None else map(shape.get, ("radius", "length", "size"))
            try:
                flat = any(0.0 in map(float, size.split()) for size in sizes if size)
            except ValueError:
                continue  # MuJoCo names the line
            if shape is not None and flat:
                link.remove(element)
                dropped.append(f"{shape.tag} in a {element.tag} of {link.get('name')}")
    return dropped
