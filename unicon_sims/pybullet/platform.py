"""PyBullet behind the platform contract, for workflows that say `platform: pybullet`."""

from __future__ import annotations

from collections.abc import Sequence
from tempfile import NamedTemporaryFile
from typing import Any

import numpy as np

from unicon_base import imported
from unicon_core.models.kinematic_tree import physical_urdf
from unicon_core.platforms.kit.stepped import (
    BODY_PHYSICS,
    SIMULATED,
    DampedSimulator,
    Facts,
    Float64,
    Passive,
    Robot,
    Scene,
    Setup,
    States,
    WorldPose,
    ground_friction,
    quiet,
    setup_of,
)


class PybulletPlatform(DampedSimulator):
    """Robots on planes, each in a world of its own; built by `make`."""

    facts = Facts(
        "pybullet",
        simulated=True,
        batch=True,
        writes=SIMULATED,
        physics=("strength", "friction", "delay", *BODY_PHYSICS),
    )
    represents = ("damping", "friction", "limits")

    def __init__(self, clients: Sequence[Any], setup: Setup) -> None:
        description = physical_urdf(setup.start.loaded, setup.robot)
        self._worlds = [_World(client, description, setup) for client in clients]
        super().__init__(setup)

    def damp(self, damping: Float64) -> None:
        for world in self._worlds:
            world.damp(damping)

    def place(self) -> None:
        for world in self._worlds:
            world.place()

    def joints(self) -> tuple[Float64, Float64]:
        told = np.array([world.joints() for world in self._worlds])
        return told[:, 0], told[:, 1]

    def base(self) -> WorldPose:
        poses = [world.base() for world in self._worlds]
        return WorldPose(*map(np.array, zip(*poses)))

    def step(self, torque: Float64) -> None:
        for world, own in zip(self._worlds, torque):
            world.step(own)

    def add_velocity(self, velocity: Float64) -> None:
        for world, own in zip(self._worlds, velocity):
            world.add_velocity(own)

    def close(self) -> None:
        for world in self._worlds:
            world.close()


class _World:
    """One robot on a plane, which does not collide with itself."""

    def __init__(self, client: Any, description: str, setup: Setup) -> None:
        self._client = client
        self._description = description
        self._setup = setup
        self._torque_control = client.TORQUE_CONTROL

    def place(self) -> None:
        """Build the world anew: what contacts and motors remember goes with the old one."""
        client = self._client
        start = self._setup.start
        figures = self._setup.figures
        friction = ground_friction(start)
        client.resetSimulation()
        client.setPhysicsEngineParameter(
            fixedTimeStep=self._setup.timestep, deterministicOverlappingPairs=1
        )
        client.setGravity(*start.gravity)
        plane = client.createMultiBody(0.0, client.createCollisionShape(client.GEOM_PLANE))
        client.changeDynamics(plane, -1, lateralFriction=1.0)  # two coefficients are multiplied
        how = {"useFixedBase": not start.floating, "flags": client.URDF_USE_INERTIA_FROM_FILE}
        with NamedTemporaryFile("w", suffix=".urdf") as file:
            print(self._description, file=file, flush=True)
            self._body = body = client.loadURDF(file.name, **how)
        names = [client.getJointInfo(body, i)[1].decode() for i in range(client.getNumJoints(body))]
        self._joints = [names.index(name) for name in self._setup.robot.joint_names]
        for link in range(-1, len(names)):
            client.changeDynamics(body, link, lateralFriction=friction)
            # By itself: in one call a link keeps its friction (0.5).
            client.changeDynamics(body, link, linearDamping=0.0, angularDamping=0.0)
        self.damp(figures.damping)
        self._centre = client.getDynamicsInfo(body, -1)[3:5]  # of mass, in the base's frame
        self._base_from_centre = client.invertTransform(*self._centre)
        base = start.position, np.roll(start.quat, -1)
        centre = client.multiplyTransforms(*base, *self._centre)
        client.resetBasePositionAndOrientation(body, *centre)
        client.resetBaseVelocity(body, (0, 0, 0), (0, 0, 0))
        for joint, angle, brake in zip(self._joints, start.joint_pos, figures.friction):
            client.resetJointState(body, joint, angle, 0.0)
            # The engine's own motor brakes with this torque, as dry friction does.
            client.setJointMotorControl2(body, joint, 0, force=brake)

    def damp(self, damping: Float64) -> None:
        """Give the joints damping [N·m·s/rad], shape (n,)."""
        for joint, value in zip(self._joints, damping):
            self._client.changeDynamics(self._body, joint, jointDamping=value)

    def joints(self) -> tuple[Any, Any]:
        """Return positions and velocities, n each."""
        pos, vel, _, _ = zip(*self._client.getJointStates(self._body, self._joints))
        return pos, vel

    def base(self) -> tuple[Any, ...]:
        """Return the values of a `WorldPose`, each with 3 or 4 numbers."""
        client, centre = self._client, self._client.getBasePositionAndOrientation(self._body)
        place, (x, y, z, w) = client.multiplyTransforms(*centre, *self._base_from_centre)
        linear, (p, q, r) = client.getBaseVelocity(self._body)
        a, b, c = (end - start for end, start in zip(place, centre[0]))
        u, v, w_ = linear
        # v + ω × (from the centre of mass to the base's origin)
        moved = (u + q * c - r * b, v + r * a - p * c, w_ + p * b - q * a)
        return place, (w, x, y, z), moved, (p, q, r)

    def step(self, torque: Float64) -> None:
        """Apply torques [N·m], shape (n,), and step the physics."""
        client = self._client
        client.setJointMotorControlArray(
            self._body, self._joints, self._torque_control, forces=torque
        )
        client.stepSimulation()

    def add_velocity(self, velocity: Float64) -> None:
        """Add to the base's velocity [m/s] in the world, shape (3,)."""
        linear, angular = self._client.getBaseVelocity(self._body)
        self._client.resetBaseVelocity(self._body, np.add(linear, velocity), angular)

    def close(self) -> None:
        """Let go; twice is fine."""
        if self._client.isConnected():
            self._client.disconnect()


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    scene: Scene,
    timestep: float = 0.0005,
    passive: Passive = "replace",
) -> PybulletPlatform:
    """Build the platform.

    Args:
        states: with `num_robots` set, as many robots are simulated, each in a world of its own.
        robot: its joints are found in the model by name.
        period: of a tick in [s].
        scene: how it begins.
        timestep: physics step in [s]. At 1 ms a G1 falls, whose light joints have no armature here.
        passive: damping of the joints in the model: `keep` it beside that of the command, or
            `replace` it by that.
    """
    what = "platform 'pybullet'", "sim-pybullet", "pybullet"
    bullet = imported("pybullet_utils.bullet_client", *what)
    setup = setup_of(states, robot, period, scene, timestep, passive)
    with quiet():  # it says "argv[0]=" at each connection
        clients = [bullet.BulletClient(bullet.pybullet.DIRECT) for _ in range(setup.num_robots)]
    return PybulletPlatform(clients, setup)
