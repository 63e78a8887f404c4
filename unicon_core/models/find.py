"""Finds the model file that a workflow or a robot file names, for simulators and viewers."""

from __future__ import annotations

import os
import pkgutil
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Protocol, runtime_checkable

from unicon_base import MissingDependencyError, ModelError, alternatives, imported, one_line
from unicon_base.resources import find_resource
from unicon_core.robots import Robot
from unicon_core.robots.robot import MODEL_FORMATS
from unicon_core.terrain.words import Terrain

_PREFIX = "robot_descriptions:"
_PACKAGE = "robot_descriptions"


@runtime_checkable
class Modelled(Protocol):
    """A platform that simulates a model file: frames, cameras, feet and checks read the same one.

    Attributes:
        model_path: MJCF or URDF, as `find_model` found it.
    """

    model_path: Path


def model_of(platform: object, robot: Robot) -> Path:
    """Return the file that a platform simulates; of a platform without one the robot's own MJCF.

    Raises:
        ModelError: there is none.
    """
    return platform.model_path if isinstance(platform, Modelled) else pick_model(robot)


def terrain_of(platform: object) -> Terrain | None:
    """Return the ground that a platform simulates; None for flat, and where it tells none."""
    found = getattr(platform, "terrain", None)
    return found if isinstance(found, Terrain) else None


def pick_model(
    robot: Robot, given: str | Path | None = None, relative_to: Path | None = None
) -> Path:
    """Return the model file for a robot: the one given, else the best one of its robot file.

    Args:
        robot: says its own.
        given: as for `find_model`; None for the robot's own.
        relative_to: folder of the file that gives it.

    Raises:
        ModelError: there is none.
    """
    if given is not None:
        return find_model(given, relative_to)
    if robot.members:
        base, *others = robot.members
        loose = [member for member in others if member not in robot.mounts]
        if loose:
            places = ", ".join(f"{member}: …" for member in robot.members)
            raise ModelError(
                f"robot {robot.name} is made of members, and nothing says where {loose[0]} sits on "
                f"{robot.members[base].name}; let the workflow say it: scene: {{mounts: "
                f"{{{loose[0]}: {{body: …}}}}}}, name a model of the whole: scene: {{model: "
                f"PATH}}, or give each member a platform: platform: {{{places}}}"
            )
        return pick_model(robot.members[base])
    found = next((robot.models[kind] for kind in MODEL_FORMATS if kind in robot.models), None)
    if found is None:
        raise ModelError(
            f"robot {robot.name} names no model ({' or '.join(MODEL_FORMATS)}); put one beside "
            f"{robot.path} and add models: {{mjcf: FILE}} ({{urdf: FILE}} for a URDF), or let the "
            "workflow name one anywhere: scene: {model: PATH}"
        )
    return find_model(found, robot.path.parent)


def find_model(reference: str | Path, relative_to: Path | None = None) -> Path:
    """Return the MJCF or URDF file that a reference means.

    Args:
        reference: a path, `assets:PATH`, `package://PACKAGE/PATH`, or `robot_descriptions:NAME`
            for a description of that package (robot-descriptions/robot_descriptions.py: a module
            for each, with `MJCF_PATH` or `URDF_PATH`), which it downloads when it is used for the
            first time.
        relative_to: folder of the file that names it, for a relative path.

    Raises:
        ModelError: nothing there, or it could not be downloaded.
        MissingDependencyError: robot_descriptions is asked for and not installed.
    """
    text = str(reference)
    if not text.startswith(_PREFIX):
        return find_resource(text, "model", error=ModelError, relative_to=relative_to)
    name = text.removeprefix(_PREFIX)
    if not name.isidentifier():
        raise ModelError(f"model {text!r} is not a description; write {_PREFIX}go2_mj_description")
    module = _description(name, f"model {text!r}")
    for key in ("MJCF_PATH", "URDF_PATH"):
        path = Path(str(getattr(module, key, "")))
        if os.path.isfile(path):
            return path.resolve()
    raise ModelError(
        f"model {text!r}: the description has no MJCF or URDF file; choose one that has, such as "
        "go2_mj_description"
    )


def _description(name: str, what: str) -> ModuleType:
    package = imported(_PACKAGE, what)
    try:
        return import_module(f"{_PACKAGE}.{name}")
    except ModuleNotFoundError as error:
        if error.name != f"{_PACKAGE}.{name}":
            missing = str(error.name)
            raise MissingDependencyError(what, missing, f"pip install {missing}") from error
        found = [module.name for module in pkgutil.iter_modules(package.__path__)]
        known = [each for each in found if each.endswith("_description")]
        raise ModelError(f"{what}: no such description; {alternatives(name, known)}") from error
    except Exception as error:  # whatever its download raises: git, the network, the disk
        raise ModelError(
            f"{what}: robot_descriptions could not fetch it: {one_line(error)[:200]}; "
            "connect to the network, or give a file by path"
        ) from error
