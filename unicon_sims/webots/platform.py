"""Webots behind the platform contract, for workflows that say `platform: webots`.

Webots runs a world with the robot in it, and unicon is the robot's `<extern>` controller, a
supervisor. Written against Webots' own modules of R2025a in `lib/controller/python/controller/`:
`robot.py`, `supervisor.py`, `node.py`, `field.py`, `motor.py`, `position_sensor.py`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from unicon_base import Fault, MissingDependencyError, PlatformError, alternatives
from unicon_core.platforms.kit.stepped import (
    SIMULATED,
    Facts,
    Float64,
    JointModel,
    Passive,
    Robot,
    Scene,
    Setup,
    Start,
    States,
    SteppedSimulator,
    WorldPose,
    ground_friction,
    import_mujoco,
    setup_of,
)

INSTALL = "install Webots, and put $WEBOTS_HOME/lib/controller/python on PYTHONPATH"

SENSOR = "{}_sensor"
"""Name of a joint's position sensor, as urdf2webots has it; the motor has that of the joint."""


class WebotsPlatform(SteppedSimulator):
    """The robot of a world that Webots runs; built by `make`.

    Webots tells no velocities of joints: they are changes of positions over a physics step, and so
    is that of the base's origin.
    """

    facts = Facts(
        "webots",
        simulated=True,
        writes=SIMULATED,
        physics=("strength", "delay"),
        notes=("written against the vendor's modules, not run against Webots",),
    )
    represents = ("damping", "limits")

    def __init__(self, supervisor: Any, setup: Setup) -> None:
        self._supervisor = supervisor
        self._step_ms = round(setup.timestep * 1e3)
        self._mat2quat = import_mujoco().mju_mat2Quat
        self._open = True
        self._find(setup.robot, setup.figures)
        self._node = supervisor.getSelf()
        self._limp()
        notes = []
        if _tell_world(supervisor, setup.start):
            notes.append("contact friction is that of the world's contactProperties")
        if self._unstopped:
            far = ", ".join(self._unstopped)
            notes.append(f"left out: stops beyond ±π, which Webots does not have, of {far}")
        super().__init__(setup, notes)

    def _find(self, robot: Robot, figures: JointModel) -> None:
        """Look up motors, sensors and joints by name."""
        supervisor = self._supervisor
        self._force: list[Any] = []
        self._sensors: list[Any] = []
        self._joint_nodes: list[Any] = []
        self._solids: list[Any] = []
        self._unstopped: list[str] = []
        for i, name in enumerate(robot.joint_names):
            motor, sensor = (self._device(word) for word in (name, SENSOR.format(name)))
            linear = motor.getType() == motor.LINEAR
            strongest = motor.getMaxForce() if linear else motor.getMaxTorque()
            if strongest < robot.effort_limit[i]:
                raise PlatformError(
                    f"platform 'webots': motor {name} gives at most {strongest:.4g} N·m, and the "
                    f"robot file says {robot.effort_limit[i]:.4g}; raise its maxTorque in the world"
                )
            self._force.append(motor.setForce if linear else motor.setTorque)
            sensor.enable(self._step_ms)
            self._sensors.append(sensor)
            joint = supervisor.getFromDevice(motor._tag).getParentNode()
            parameters = joint.getField("jointParameters").getSFNode()
            if parameters is None:
                raise PlatformError(
                    f"platform 'webots': joint {name} has no jointParameters; add them to the world"
                )
            parameters.getField("dampingConstant").setSFFloat(float(figures.damping[i]))
            self._stop(parameters, name, float(figures.lower[i]), float(figures.upper[i]))
            self._joint_nodes.append(joint)
            self._solids.append(joint.getField("endPoint").getSFNode())

    def _stop(self, parameters: Any, name: str, lower: float, upper: float) -> None:
        """Put stops at a joint's limits."""
        if not (np.isfinite(lower) and np.isfinite(upper)):
            return
        if lower < -np.pi or upper > np.pi:
            self._unstopped.append(name)
            return
        parameters.getField("minStop").setSFFloat(lower)
        parameters.getField("maxStop").setSFFloat(upper)

    def _device(self, name: str) -> Any:
        supervisor = self._supervisor
        known = tuple(supervisor.devices)
        if name not in known:
            raise PlatformError(
                f"platform 'webots': robot {supervisor.getName()!r} has no device {name!r}; "
                f"{alternatives(name, known)}; name motors as the joints and sensors JOINT_sensor"
            )
        return supervisor.getDevice(name)

    def place(self) -> None:
        start = self.start
        w, *vector = map(float, start.quat)
        length = float(np.linalg.norm(vector))
        axis = [value / length for value in vector] if length > 1e-12 else [0.0, 0.0, 1.0]
        self._node.getField("translation").setSFVec3f(start.position.tolist())
        self._node.getField("rotation").setSFRotation([*axis, 2.0 * float(np.arctan2(length, w))])
        for joint, angle in zip(self._joint_nodes, start.joint_pos):
            joint.setJointPosition(float(angle))
        self._node.resetPhysics()
        self._limp()
        # Sensors tell nothing before a step.
        self._pos = start.joint_pos[None].copy()
        self._vel = np.zeros((1, len(start.joint_pos)))
        self._place = start.position[None].copy()
        self._quat = start.quat[None].copy()
        self._moves = np.zeros((1, 3))
        self._rate = np.zeros((1, 3))

    def joints(self) -> tuple[Float64, Float64]:
        return self._pos, self._vel

    def base(self) -> WorldPose:
        return WorldPose(self._place, self._quat, self._moves, self._rate)

    def step(self, torque: Float64) -> None:
        for push, value in zip(self._force, torque[0]):
            push(float(value))
        if self._supervisor.step(self._step_ms) == -1:
            raise Fault("Webots ended the simulation")
        pos = np.array([[sensor.getValue() for sensor in self._sensors]])
        self._vel = (pos - self._pos) / self.timestep
        self._pos = pos
        if self.start.floating:
            place = np.array([self._node.getPosition()])
            self._moves = (place - self._place) / self.timestep
            self._place = place
            self._quat = np.zeros((1, 4))
            self._mat2quat(self._quat[0], np.array(self._node.getOrientation()))
            self._rate = np.array([self._node.getVelocity()[3:]])

    def add_velocity(self, velocity: Float64) -> None:
        # Each solid has a velocity of its own.
        for solid in (self._node, *self._solids):
            now = solid.getVelocity()
            linear = np.add(now[:3], velocity[0]).tolist()
            solid.setVelocity([*linear, *now[3:]])
        self._moves = self._moves + velocity

    def _limp(self) -> None:
        for push in self._force:
            push(0.0)

    def close(self) -> None:
        if self._open:
            self._open = False
            self._limp()
            _HELD.clear()


def _tell_world(supervisor: Any, start: Start) -> bool:
    """Set gravity, and friction where the world says none; return whether it does."""
    x, y, z = map(float, start.gravity)
    if x or y or z > 0.0:
        raise PlatformError(f"platform 'webots': gravity {x}, {y}, {z} does not point down")
    world = supervisor.getRoot().getField("children").getMFNode(0)
    world.getField("gravity").setSFFloat(-z)
    properties = world.getField("contactProperties")
    if properties.getCount():
        return True
    friction = f"ContactProperties {{ coulombFriction [ {ground_friction(start):.6g} ] bounce 0 }}"
    properties.importMFNodeFromString(0, friction)
    return False


# Of which a process has one, for ever.
_SUPERVISORS: list[Any] = []

# Whether a platform has it.
_HELD: list[bool] = []


def _supervisor() -> Any:
    """Return this process's supervisor.

    Raises:
        MissingDependencyError: Webots' module is not there.
        PlatformError: it is in use.
    """
    try:
        from controller import Supervisor
    except (ImportError, KeyError, OSError) as error:  # WEBOTS_HOME is not set, or not there
        how = f"{INSTALL} ({error})"
        raise MissingDependencyError(
            "platform 'webots'", "Webots' module controller", how
        ) from error
    if _HELD:
        raise PlatformError(
            "platform 'webots': a process is the controller of one robot, and is so already; close "
            "that first"
        )
    if not _SUPERVISORS:
        _SUPERVISORS.append(Supervisor())
    return _SUPERVISORS[0]


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    scene: Scene,
    timestep: float | None = None,
    passive: Passive = "replace",
) -> WebotsPlatform:
    """Build the platform; Webots waits with the world.

    Args:
        states: of one robot.
        robot: its joints are found among the devices by name.
        period: of a tick in [s].
        scene: how it begins.
        timestep: physics step in [s]; None takes the world's `basicTimeStep`.
        passive: damping of the joints in the model: `keep` it beside that of the command, or
            `replace` it by that.
    """
    if states.num_robots is not None:
        raise PlatformError("platform 'webots' has one robot; leave num_robots out")
    supervisor = _supervisor()
    step = supervisor.getBasicTimeStep()
    if step != round(step) or (timestep is not None and abs(1e3 * timestep - step) > 1e-6):
        asked = "whole milliseconds" if timestep is None else f"{1e3 * timestep:g} ms"
        raise PlatformError(
            f"platform 'webots': the world's basicTimeStep is {step:g} ms, not {asked}; correct "
            "it in the world, or platforms.webots.timestep"
        )
    setup = setup_of(states, robot, period, scene, step * 1e-3, passive)
    platform = WebotsPlatform(supervisor, setup)
    _HELD.append(True)
    return platform
