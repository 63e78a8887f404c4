"""Stand-in for Webots' module controller: one robot in a world that Webots would have loaded.

Names and arguments are those of lib/controller/python/controller of Webots R2025a. Refused are
arguments of another type or length, which Webots' own module tells on stderr and drops, sensors
that are not enabled, steps that are not a multiple of the world's, and a push of some solids only.
Sensors tell NaN before the first step; motors follow positions until they are given torques.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from vendor_world import Refused, World, exact

__all__ = ["Supervisor"]


class Wbt:
    """A world file: the robot's URDF, and `basicTimeStep` in [ms]."""

    def __init__(self, urdf: str, step: float, fixed: bool, strongest: float = 1000.0) -> None:
        self.urdf = urdf
        self.step = step
        self.fixed = fixed
        self.strongest = strongest
        self.ended = False


# The one that Webots has loaded.
WORLD: list[Wbt] = []


class Device:
    def __init__(self, robot: Supervisor, name: str, joint: int) -> None:
        self._robot = robot
        self._name = name
        self._joint = joint
        self._tag = len(robot.devices) + 1

    def getName(self) -> str:
        return self._name


class Motor(Device):
    ROTATIONAL = 0
    LINEAR = 1

    def getType(self) -> int:
        return Motor.ROTATIONAL

    def getMaxTorque(self) -> float:
        return self._robot.wbt.strongest

    def setTorque(self, torque: float) -> None:
        exact(torque, float, "torque")
        self._robot.torque[self._joint] = np.clip(torque, -self.getMaxTorque(), self.getMaxTorque())


class PositionSensor(Device):
    value = np.nan
    period = 0

    def enable(self, p: int) -> None:
        exact(p, int, "p")
        self.period = p

    def getValue(self) -> float:
        if not self.period:
            raise Refused(f"sensor {self._name} is not enabled")
        return float(self.value)


class Field:
    """A field by name of the node that has it."""

    def __init__(self, robot: Supervisor, owner: str, name: str, joint: int = -1) -> None:
        self._robot = robot
        self._where = f"{owner}.{name}"
        self._joint = joint
        if self._where not in FIELDS:
            raise Refused(f"no field {self._where}")

    def _is(self, kind: str) -> None:
        if FIELDS[self._where] != kind:
            raise Refused(f"{self._where} is a {FIELDS[self._where]}")

    def getSFNode(self) -> Node | None:
        self._is("SFNode")
        kind = "JointParameters" if self._where.endswith("jointParameters") else "Solid"
        return Node(self._robot, kind, self._joint)

    def getMFNode(self, index: int) -> Node | None:
        self._is("MFNode")
        exact(index, int, "index")
        if self._where != "Group.children" or index:
            raise Refused(f"no node {index} in {self._where}")
        return Node(self._robot, "WorldInfo")

    def getCount(self) -> int:
        self._is("MFNode")
        return self._robot.contacts

    def importMFNodeFromString(self, position: int, nodeString: str) -> None:
        self._is("MFNode")
        exact(position, int, "position")
        found = re.fullmatch(
            r"ContactProperties \{ coulombFriction \[ ([\d.]+) \] bounce 0 \}", nodeString
        )
        if self._where != "WorldInfo.contactProperties" or found is None:
            raise Refused(f"{nodeString} into {self._where}")
        self._robot.contacts += 1
        self._robot.world.model.geom_friction[:, 0] = float(found[1])

    def setSFFloat(self, value: float) -> None:
        self._is("SFFloat")
        exact(value, float, "value")
        model = self._robot.world.model
        if self._where == "WorldInfo.gravity":
            model.opt.gravity = (0.0, 0.0, -value)
            return
        dof = self._robot.world._dofs[self._joint]
        joint = model.dof_jntid[dof]
        if self._where == "JointParameters.dampingConstant":
            model.dof_damping[dof] = value
            return
        if abs(value) > np.pi:
            raise Refused(f"{self._where} = {value}")
        model.jnt_range[joint, int(self._where == "JointParameters.maxStop")] = value
        model.jnt_limited[joint] = model.jnt_range[joint].all()

    def setSFVec3f(self, value: list[float]) -> None:
        self._is("SFVec3f")
        self._floats(value, 3)
        self._robot.put(value, self._robot.world.pose()[1], None)

    def setSFRotation(self, value: list[float]) -> None:
        self._is("SFRotation")
        self._floats(value, 4)
        half = 0.5 * value[3]
        quat = np.array((np.cos(half), *(np.sin(half) * np.array(value[:3]))))
        self._robot.put(self._robot.world.pose()[0], quat, None)

    def _floats(self, value: list[float], length: int) -> None:
        exact(value, list, "value")
        if len(value) != length or not all(type(each) is float for each in value):
            raise Refused(f"{self._where} = {value}")


FIELDS = {
    "Group.children": "MFNode",
    "WorldInfo.gravity": "SFFloat",
    "WorldInfo.contactProperties": "MFNode",
    "Robot.translation": "SFVec3f",
    "Robot.rotation": "SFRotation",
    "HingeJoint.jointParameters": "SFNode",
    "HingeJoint.endPoint": "SFNode",
    "JointParameters.dampingConstant": "SFFloat",
    "JointParameters.minStop": "SFFloat",
    "JointParameters.maxStop": "SFFloat",
}


class Node:
    def __init__(self, robot: Supervisor, kind: str, joint: int = -1) -> None:
        self._robot = robot
        self._kind = kind
        self._joint = joint

    def getField(self, name: str) -> Field:
        exact(name, str, "name")
        return Field(self._robot, self._kind, name, self._joint)

    def getParentNode(self) -> Node:
        self._must("RotationalMotor")
        return Node(self._robot, "HingeJoint", self._joint)

    def setJointPosition(self, position: float, index: int = 1) -> None:
        self._must("HingeJoint")
        exact(position, float, "position")
        self._robot.put(*self._robot.world.pose(), {self._joint: position})

    def getPosition(self) -> list[float]:
        self._must("Robot")
        return list(self._robot.world.pose()[0])

    def getOrientation(self) -> list[float]:
        self._must("Robot")
        return list(self._robot.world.turned().reshape(-1))

    def getVelocity(self) -> list[float]:
        self._must("Robot", "Solid")
        return [float(value) for value in np.hstack(self._robot.world.moves(at_centre=True))]

    def setVelocity(self, velocity: list[float]) -> None:
        self._must("Robot", "Solid")
        exact(velocity, list, "velocity")
        if len(velocity) != 6 or not all(type(value) is float for value in velocity):
            raise Refused(f"velocity {velocity}")
        self._robot.pushed[self._joint] = velocity

    def resetPhysics(self) -> None:
        self._must("Robot")
        self._robot.world.data.qvel[:] = 0.0

    def _must(self, *kinds: str) -> None:
        if self._kind not in kinds:
            raise Refused(f"not of a {self._kind}")


class Supervisor:
    def __init__(self) -> None:
        wbt = self.wbt = WORLD[-1]
        self.world = World(
            wbt.urdf, timestep=wbt.step * 1e-3, gravity=(0, 0, -9.81), friction=1.0, fixed=wbt.fixed
        )
        self.world.put((0, 0, 1), (1, 0, 0, 0), np.zeros(len(self.world.names)))
        self.world.model.jnt_limited[:] = 0  # stops are 0, and so none
        self.world.model.jnt_range[:] = 0.0
        self.contacts, self.pushed = 0, {}  # type: ignore[var-annotated]
        self.torque = np.full(len(self.world.names), np.nan)
        self.devices: dict[str, Device] = {}
        for i, name in enumerate(self.world.names):
            self.devices[name] = Motor(self, name, i)
            self.devices[f"{name}_sensor"] = PositionSensor(self, f"{name}_sensor", i)

    def getName(self) -> str:
        return "probe"

    def getDevice(self, name: str) -> Device | None:
        exact(name, str, "name")
        return self.devices.get(name)

    def getBasicTimeStep(self) -> float:
        return self.wbt.step

    def getRoot(self) -> Node:
        return Node(self, "Group")

    def getSelf(self) -> Node:
        return Node(self, "Robot")

    def getFromDevice(self, tag: int) -> Node:
        exact(tag, int, "tag")
        (device,) = [device for device in self.devices.values() if device._tag == tag]
        return Node(self, "RotationalMotor", device._joint)

    def step(self, time_step: int | None = None) -> int:
        exact(time_step, int, "time_step")
        if time_step != self.wbt.step:
            raise Refused(f"a step of {time_step} ms")
        if np.isnan(self.torque).any():
            raise Refused("motors that follow positions")
        if self.wbt.ended:
            return -1
        if self.pushed:
            if set(self.pushed) != {-1, *range(len(self.world.names))}:
                raise Refused("a push of some solids only")
            told = np.array(self.pushed.pop(-1))
            self.pushed.clear()
            self.world.move(told[:3], told[3:], at_centre=True)
        self.world.step(self.torque)
        for device in self.devices.values():
            if isinstance(device, PositionSensor) and device.period:
                device.value = self.world.joints()[0][device._joint]
        return 0

    def put(self, place: Any, quat: Any, joints: dict[int, float] | None) -> None:
        """Move things, and leave their velocities."""
        moves = self.world.data.qvel.copy()
        pos, _ = self.world.joints()
        for joint, value in (joints or {}).items():
            pos[joint] = value
        self.world.put(place, quat, pos)
        self.world.data.qvel[:] = moves
