"""A compiled model and where a robot's joints are in it, for simulators, checks and viewers."""

from __future__ import annotations

import importlib
import logging
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import MissingDependencyError
from unicon_core.models.joints import free_joint

_log = logging.getLogger(__name__)

_GL = "MUJOCO_GL"
_CONTEXTS = ("mujoco.rendering.classic.gl_context", "mujoco.gl_context")
"""Where `GLContext` is, in newer versions of MuJoCo and in older ones."""


def import_mujoco() -> Any:
    """Return the mujoco module.

    It comes without its window library, which takes a sixth of its import (glfw asks a process of
    its own for its version): what draws asks for that by itself, as `mujoco.Renderer` and
    `mujoco.viewer` do. A `MUJOCO_GL` that is set is left as it is.

    Raises:
        MissingDependencyError: it is not installed.
    """
    try:
        mujoco = sys.modules.get("mujoco") or _imported()
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            "platform 'mujoco'", "mujoco", "pip install 'unicon_ros[sim]'"
        ) from error
    if mujoco.get_mju_user_warning() is None:  # else MuJoCo writes MUJOCO_LOG.TXT where we stand
        mujoco.set_mju_user_warning(_log.info)
    return mujoco


def _imported() -> Any:
    if os.environ.get(_GL):
        return importlib.import_module("mujoco")
    os.environ[_GL] = "disabled"
    try:
        mujoco: Any = importlib.import_module("mujoco")
    finally:
        del os.environ[_GL]
    context: Any = next((sys.modules[name] for name in _CONTEXTS if name in sys.modules), None)
    if context is not None:

        def late(name: str) -> Any:
            """Return what drawing asks for, as `import mujoco` would have left it."""
            if name != "GLContext":
                raise AttributeError(f"mujoco has no attribute {name!r} here")
            found: Any = vars(importlib.reload(context))[name]
            del context.__getattr__, mujoco.__getattr__
            mujoco.GLContext = found
            return found

        context.__getattr__ = mujoco.__getattr__ = late
    return mujoco


@dataclass
class LoadedModel:
    """A compiled model and how it was found.

    Attributes:
        model: the `MjModel`.
        path: its file.
        joints: joint id of each robot joint, in the robot's order, length n.
        notes: what was changed or left out, one line each.
        welded: joints of the robot that the model lacks and that stand still.
        absent: file of the model, or of a member's, to a line that says what was left out of it
            since mesh files are absent.
        absent_shapes: body to the mesh files, absent, of its geoms that may collide.
        imu_position: where the robot's IMU is, from the base's origin along its axes in [m], shape
            (3,); 0 where the robot file does not say.
    """

    model: Any
    path: Path
    joints: list[int]
    notes: list[str] = field(default_factory=list)
    welded: tuple[str, ...] = ()
    absent: Mapping[Path, str] = field(default_factory=dict)
    absent_shapes: Mapping[str, list[str]] = field(default_factory=dict)
    imu_position: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    @property
    def base(self) -> int | None:
        """Id of the free joint that carries the robot, None for a fixed base."""
        return free_joint(import_mujoco(), self.model, self.joints[0])

    @property
    def addresses(self) -> NDArray[np.intp]:
        """Where each robot joint stands in `qpos`, shape (n,)."""
        return np.array(self.model.jnt_qposadr[self.joints], dtype=np.intp)

    def key_poses(self) -> dict[str, NDArray[np.float64]]:
        """Return key frame to joint positions in the robot's order, [rad] or [m], shape (n,)."""
        model = self.model
        return {model.key(i).name: model.key_qpos[i][self.addresses] for i in range(model.nkey)}
