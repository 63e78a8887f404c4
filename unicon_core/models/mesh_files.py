"""MeshFiles: URIs of the mesh files of a model, for robot_description; strangers' are refused."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from os.path import isfile
from pathlib import Path
from urllib.parse import unquote

from unicon_core.errors import UniconError
from unicon_core.models.absent import mesh_places, model_folders
from unicon_core.packages import PACKAGE, package_file

FORMATS = (".stl", ".dae", ".obj")
"""What RViz and Foxglove both read."""
_PARTED = ("urdf", "mjcf", "xml", "robots")
"""Folders of models alone: their meshes lie beside them, in `../meshes`."""
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
