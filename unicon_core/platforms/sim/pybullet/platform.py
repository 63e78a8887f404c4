"""PyBullet behind the platform contract, for workflows that say `platform: pybullet`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from tempfile import NamedTemporaryFile
from typing import Any

import numpy as np

from unicon_core.errors import MissingDependencyError
from unicon_core.models.physical import physical_urdf
from unicon_core.platforms.kit.base import Float, WorldPose
from unicon_core.platforms.kit.passive import Passive, known_passive
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.kit.start import Start, start_of
from unicon_core.platforms.kit.stepped import GRAVITY, SteppedSimulator
from unicon_core.platforms.platform import SIMULATED, Facts
from unicon_core.robots import Robot
from unicon_core.states import States


class PybulletPlatform(SteppedSimulator):
    """One robot on a plane, which does not collide with itself; built by `make`."""

    facts = Facts(
        "pybullet", simulated=True, writes=SIMULATED, physics=("strength", "friction", "delay")
    )

    def __init__(
        self,
        client: Any,
        states: States,
        robot: Robot,
        period: float,
        step: float,
        start: Start,
        passive: Passive = "replace",
    ) -> None:
        self._client, self._passive = client, known_passive(passive)
        client.setPhysicsEngineParameter(fixedTimeStep=step)
        client.setGravity(*GRAVITY)
        client.createMultiBody(0.0, client.createCollisionShape(client.GEOM_PLANE))
        how = {"useFixedBase": not start.floating, "flags": client.URDF_USE_INERTIA_FROM_FILE}
        with NamedTemporaryFile("w", suffix=".urdf") as file:
            print(physical_urdf(start.loaded, robot), file=file, flush=True)
            self._body = body = client.loadURDF(file.name, **how)
        names = [client.getJointInfo(body, i)[1].decode() for i in range(client.getNumJoints(body))]
        self._joints = [names.index(name) for name in robot.joint_names]
        rubber = {"lateralFriction": 1.2, "linearDamping": 0.0, "angularDamping": 0.0}
        for link in range(-1, len(names)):  # friction: times the plane's 0.5
            client.changeDynamics(body, link, **rubber)
        model = start.loaded.model
        own = model.dof_damping[model.jnt_dofadr[start.loaded.joints]]
        self.passive_damping = own * (passive == "keep")
        self._damp(self.passive_damping)
        self._centre = client.getDynamicsInfo(body, -1)[3:5]  # of mass, in the base's frame
        super().__init__(states, robot, period, step, start)

    def _damp(self, damping: Float) -> None:
        for joint, value in zip(self._joints, damping):
            self._client.changeDynamics(self._body, joint, jointDamping=value)

    @contextmanager
    def undamped(self) -> Iterator[None]:
        """Do without the joints' own damping for a while, as with `passive: replace`."""
        self._damp(np.zeros_like(self.passive_damping))
        try:
            yield
        finally:
            self._damp(self.passive_damping)

    def info(self) -> dict[str, Any]:
        return super().info() | {"passive": self._passive}

    def place(self) -> None:
        base = self.start.position, np.roll(self.start.quat, -1)
        centre = self._client.multiplyTransforms(*base, *self._centre)
        self._client.resetBasePositionAndOrientation(self._body, *centre)
        self._client.resetBaseVelocity(self._body, (0, 0, 0), (0, 0, 0))
        friction = np.nan_to_num(self.start.physics.friction)
        for joint, angle, brake in zip(self._joints, self.start.joint_pos, friction):
            self._client.resetJointState(self._body, joint, angle, 0.0)
            # The engine's own motor brakes with this torque, as dry friction does.
            self._client.setJointMotorControl2(self._body, joint, 0, force=brake)

    def joints(self) -> tuple[Float, Float]:
        pos, vel, _, _ = zip(*self._client.getJointStates(self._body, self._joints))
        return np.array(pos), np.array(vel)

    def base(self) -> WorldPose:
        client, centre = self._client, self._client.getBasePositionAndOrientation(self._body)
        place, quat = client.multiplyTransforms(*centre, *client.invertTransform(*self._centre))
        linear, angular = np.array(client.getBaseVelocity(self._body))
        linear += np.cross(angular, np.subtract(place, centre[0]))
        return WorldPose(np.array(place), np.roll(quat, 1), linear, angular)

    def step(self, torque: Float) -> None:
        mode = self._client.TORQUE_CONTROL
        self._client.setJointMotorControlArray(self._body, self._joints, mode, forces=torque)
        self._client.stepSimulation()

    def push(self, velocity: Float) -> None:
        linear, angular = self._client.getBaseVelocity(self._body)
        self._client.resetBaseVelocity(self._body, np.add(linear, (*velocity, 0.0)), angular)

    def close(self) -> None:
        if self._client.isConnected():
            self._client.disconnect()


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    scene: Scene,
    timestep: float = 0.001,
    passive: Passive = "replace",
) -> PybulletPlatform:
    """Build the platform.

    Args:
        states: without a batch axis.
        robot: its joints are found in the model by name.
        period: of a tick in [s].
        scene: how it begins.
        timestep: physics step in [s].
        passive: damping of the joints in the model: `keep` it beside that of the command, or
            `replace` it by that.
    """
    try:
        from pybullet_utils.bullet_client import BulletClient, pybullet
    except ImportError as error:
        install = "pip install 'unicon_ros[sim-pybullet]'"
        raise MissingDependencyError("platform 'pybullet'", "pybullet", install) from error
    start = start_of(robot, scene)
    client = BulletClient(pybullet.DIRECT)
    return PybulletPlatform(client, states, robot, period, timestep, start, passive)
