"""Leaves out of a model what refers to absent files: meshes and textures, for the loader."""

from __future__ import annotations

import re
from collections.abc import Iterator
from os.path import isfile
from pathlib import Path
from typing import Any

from unicon_base.packages import PACKAGE, share_folder
from unicon_core.file_kinds import is_lfs_pointer

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
    urdf, folders = path.suffix.lower() == ".urdf", model_folders(path)
    absent: dict[str, Any] = {}
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
