"""Structures of the stand-in for isaacgym.gymapi: docs/api/python/struct_py.html."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, ClassVar

import numpy as np
from vendor_world import exact


class SimType(IntEnum):
    SIM_PHYSX = 0
    SIM_FLEX = 1


class DofDriveMode(IntEnum):
    DOF_MODE_NONE = 0
    DOF_MODE_POS = 1
    DOF_MODE_VEL = 2
    DOF_MODE_EFFORT = 3


class UpAxis(IntEnum):
    UP_AXIS_Y = 0
    UP_AXIS_Z = 1


SIM_PHYSX = SimType.SIM_PHYSX
UP_AXIS_Z = UpAxis.UP_AXIS_Z
DOF_MODE_EFFORT = DofDriveMode.DOF_MODE_EFFORT


class _Structure:
    """Has the attributes that it begins with, of their types."""

    known: ClassVar[dict[str, Any]] = {}

    def __init__(self) -> None:
        for name, value in self.known.items():
            super().__setattr__(name, value() if isinstance(value, type) else value)

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in self.known:
            raise AttributeError(f"{type(self).__name__} has no {name}")
        now = getattr(self, name)
        kind = (int, float) if type(now) is float else type(now)
        exact(value, kind, f"{type(self).__name__}.{name}")
        super().__setattr__(name, value)


class Vec3:
    def __init__(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, /) -> None:
        self.x, self.y, self.z = (float(np.float32(value)) for value in (x, y, z))


class Quat:
    """x, y, z, w: https://… docs/programming/math.html."""

    def __init__(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, w: float = 1.0, /) -> None:
        self.x, self.y, self.z, self.w = (float(np.float32(value)) for value in (x, y, z, w))


class Transform(_Structure):
    known: ClassVar[dict[str, Any]] = {"p": Vec3, "r": Quat}


class PhysXParams(_Structure):
    known: ClassVar[dict[str, Any]] = {
        "use_gpu": False,
        "solver_type": 1,
        "num_threads": 0,
        "num_position_iterations": 4,
        "num_velocity_iterations": 1,
        "contact_offset": 0.02,
        "rest_offset": 0.001,
        "bounce_threshold_velocity": 0.2,
        "max_depenetration_velocity": 100.0,
    }


class SimParams(_Structure):
    known: ClassVar[dict[str, Any]] = {
        "dt": 1.0 / 60.0,
        "substeps": 2,
        "up_axis": UpAxis.UP_AXIS_Y,
        "gravity": Vec3,
        "use_gpu_pipeline": False,
        "physx": PhysXParams,
    }


class PlaneParams(_Structure):
    known: ClassVar[dict[str, Any]] = {
        "normal": Vec3,
        "distance": 0.0,
        "static_friction": 1.0,
        "dynamic_friction": 1.0,
        "restitution": 0.0,
    }


class AssetOptions(_Structure):
    known: ClassVar[dict[str, Any]] = {
        "fix_base_link": False,
        "collapse_fixed_joints": False,
        "disable_gravity": False,
        "default_dof_drive_mode": 0,
        "linear_damping": 0.0,
        "angular_damping": 0.5,
        "max_linear_velocity": 1000.0,
        "max_angular_velocity": 64.0,
        "armature": 0.0,
        "thickness": 0.02,
        "replace_cylinder_with_capsule": False,
        "override_inertia": False,
        "override_com": False,
    }


class RigidShapeProperties(_Structure):
    known: ClassVar[dict[str, Any]] = {
        "friction": 1.0,
        "rolling_friction": 0.0,
        "restitution": 0.0,
        "filter": 0,
    }


class RigidBodyProperties(_Structure):
    known: ClassVar[dict[str, Any]] = {"mass": 0.0, "com": Vec3}


DOF = np.dtype(
    [
        ("hasLimits", "?"),
        ("lower", "f4"),
        ("upper", "f4"),
        ("driveMode", "i4"),
        ("velocity", "f4"),
        ("effort", "f4"),
        ("stiffness", "f4"),
        ("damping", "f4"),
        ("friction", "f4"),
        ("armature", "f4"),
    ]
)


class Descriptor:
    """A tensor of gym's own: memory and shape."""

    def __init__(self, array: np.ndarray[Any, Any]) -> None:
        self.array = array
