"""Loads a model file (MJCF or URDF) whatever it lacks: meshes, a floor, a floating base, motors."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from unicon_core.errors import ModelError
from unicon_core.models.absent import drop_absent_meshes, drop_absent_textures
from unicon_core.models.actuators import mend_actuators
from unicon_core.models.attach import attach_members
from unicon_core.models.bounded import refuse_endless, refuse_not_finite
from unicon_core.models.find import pick_model
from unicon_core.models.ground import mend_floor
from unicon_core.models.joints import find_joints
from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.models.urdf_repair import repaired_urdf
from unicon_core.models.welded import weld_absent
from unicon_core.robots import Robot

_log = logging.getLogger(__name__)

_URDF_TIMESTEP = 0.002  # [s]; MuJoCo's own default, said here since a URDF cannot say it


def load_model(
    path: Path,
    robot: Robot,
    timestep: float | None = None,
    *,
    quiet: bool = False,
    prepare: Callable[[Any], None] | None = None,
) -> LoadedModel:
    """Read and compile a model for a robot.

    Visual and collision meshes whose files are absent are left out, which `absent` tells; mistakes
    of public URDF files that ROS reads over are mended. A URDF of a robot that walks gets a free
    joint; a walking robot without surroundings gets a floor, by the name that its pairs give it; a
    robot joint without a motor gets one. Joints that the robot calls weldable may be absent: they
    stand still. Of a robot made of members the models of those that have a mount, and whose joints
    the file lacks, are attached to it.

    Args:
        path: MJCF or URDF file.
        robot: whose joints must all be there, found by name.
        timestep: physics step in [s], None for the model's own.
        quiet: log nothing: somebody else has loaded it and told.
        prepare: changes the `MjSpec`, mended, before it is compiled.

    Raises:
        ModelError: the file is wrong, or lacks a joint of the robot.
    """
    mujoco = import_mujoco()
    notes: list[str] = []
    absent: dict[Path, str] = {}
    shapes: dict[str, list[str]] = {}

    def read(path: Path, notes: list[str], floats: bool) -> Any:
        spec = _read(mujoco, path, notes)
        lacking = drop_absent_meshes(spec, path, floats, shapes)
        for note in lacking:
            absent[path] = note
            if not quiet:
                _log.info("model %s: %s", path, note)
        notes += [*lacking, *drop_absent_textures(spec, path)]
        return spec

    spec = read(path, notes, robot.floats)
    if path.suffix.lower() == ".urdf":
        spec.option.timestep = _URDF_TIMESTEP
        # A URDF has no armature: with Euler's step the vendor's damping blows an A1 up.
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        if robot.floats:
            _add_free_joint(mujoco, spec, notes)
    if timestep is not None:
        spec.option.timestep = float(timestep)
    if robot.floats:
        mend_floor(mujoco, spec, notes)
    if robot.mounts and robot.members:

        def member(own: Robot, told: list[str]) -> Any:
            return read(pick_model(own), told, floats=False)

        with _told(path):
            attach_members(mujoco, spec, robot, path, member, notes)
    if prepare is not None:
        prepare(spec)
    with _told(path):
        model = spec.compile()
    welded = weld_absent(mujoco, spec, model, robot, notes) if robot.weldable else ()
    if welded:
        with _told(path):
            model = spec.compile()
    joints = find_joints(mujoco, model, robot, path)
    if mend_actuators(mujoco, spec, model, joints, robot.joint_names, notes):
        with _told(path):
            model = spec.compile()
    refuse_not_finite(path, model)
    arm = np.zeros(3)
    if robot.imu is not None:
        arm[...] = np.nan_to_num(robot.imu.position)
    return LoadedModel(model, path, joints, notes, welded, absent, shapes, arm)


def _read(mujoco: Any, path: Path, notes: list[str]) -> Any:
    refuse_endless(path)
    is_urdf = path.suffix.lower() == ".urdf"
    text = repaired_urdf(path, notes) if is_urdf else None
    with _told(path):
        if text is None:
            spec = mujoco.MjSpec.from_file(str(path))
        else:
            spec = mujoco.MjSpec.from_string(text)
            spec.modelfiledir = f"{path.parent}/"  # a text has no folder to look for meshes in
    if is_urdf:
        spec.compiler.fusestatic = False  # fixed links keep their names: feet and sensor frames
    return spec


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Tell what MuJoCo finds wrong in a file as a ModelError."""
    try:
        yield
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise ModelError(f"model {path}: {reason}; correct the file") from error
    except (RuntimeError, MemoryError) as error:  # of C++, which has no words for it
        raise ModelError(
            f"model {path}: MuJoCo gives it up, most likely for want of memory; make it smaller"
        ) from error


def _add_free_joint(mujoco: Any, spec: Any, notes: list[str]) -> None:
    root = spec.worldbody.first_body()
    if root is not None and not list(root.joints):
        root.add_freejoint(name="floating_base")
        root.pos = [0.0, 0.0, 1.0]
        notes.append(f"a URDF has no floating base: body {root.name!r} got a free joint")
