"""Isaac Gym behind the platform contract, for workflows that say `platform: isaacgym`.

Written against the documentation of Isaac Gym Preview 4: docs/api/python/gym_py.html for the calls,
docs/programming/tensors.html for their order, docs/programming/simsetup.html for collision groups.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from unicon_base import MissingDependencyError, PlatformError
from unicon_core.models.kinematic_tree import physical_urdf
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
    cross,
    ground_friction,
    rotation,
    setup_of,
)

INSTALL = (
    "unpack NVIDIA's Isaac Gym Preview 4 and pip install -e isaacgym/python; its modules are for "
    "Python 3.6 to 3.8"
)

_FAST = 1000.0  # [m/s], [rad/s]: nothing is held back
_FILTER = 1  # one bit that all shapes of a robot have: they do not collide with each other


class IsaacGymPlatform(SteppedSimulator):
    """Robots on a plane, each in a collision group of its own; built by `make`."""

    facts = Facts(
        "isaacgym",
        simulated=True,
        batch=True,
        writes=SIMULATED,
        physics=("strength", "armature", "delay"),
        notes=("written against the vendor's documentation, not run against its module",),
    )
    represents = ("armature", "damping", "limits")

    def __init__(self, modules: tuple[Any, Any, Any], device: str, setup: Setup) -> None:
        api, self._interop, self._torch = modules
        self._device = device
        self._on_gpu = device != "cpu"
        gym = self._gym = api.acquire_gym()
        self._sim: Any = gym.create_sim(
            int(device.partition(":")[2] or 0), -1, api.SIM_PHYSX, _params(api, setup, device)
        )
        if self._sim is None:
            raise PlatformError(
                f"platform 'isaacgym': no simulation on {device}; correct "
                "platforms.isaacgym.device: cpu or cuda:0"
            )
        try:
            self._build(api, setup)
        except BaseException:
            self.close()
            raise
        super().__init__(setup)

    def _build(self, api: Any, setup: Setup) -> None:
        gym = self._gym
        sim = self._sim
        robot = setup.robot
        start = setup.start
        friction = ground_friction(start)
        count = setup.num_robots
        plane = api.PlaneParams()
        plane.normal = api.Vec3(0.0, 0.0, 1.0)
        plane.static_friction = plane.dynamic_friction = friction
        gym.add_ground(sim, plane)
        asset = self._asset(api, robot, start)
        names = gym.get_asset_dof_names(asset)
        self._robot_from_dof = [names.index(name) for name in robot.joint_names]
        pose = api.Transform()
        pose.p = api.Vec3(*map(float, start.position))
        pose.r = api.Quat(*map(float, np.roll(start.quat, -1)))
        nowhere = api.Vec3(0.0, 0.0, 0.0)  # all in one place: they do not meet
        for k in range(count):
            env = gym.create_env(sim, nowhere, nowhere, count)
            actor = gym.create_actor(env, asset, pose, robot.name, k, _FILTER, 0)
            self._tell(api, env, actor, setup.figures, friction)
        centre = gym.get_actor_rigid_body_properties(env, actor)[0].com
        self._centre = np.array((centre.x, centre.y, centre.z))
        self._damping = setup.figures.damping
        gym.prepare_sim(sim)
        self._root_tensor = gym.acquire_actor_root_state_tensor(sim)
        self._dof_tensor = gym.acquire_dof_state_tensor(sim)
        self._root = self._interop.wrap_tensor(self._root_tensor)
        self._dof = self._interop.wrap_tensor(self._dof_tensor)

    def _asset(self, api: Any, robot: Robot, start: Start) -> Any:
        options = api.AssetOptions()
        options.fix_base_link = not start.floating
        options.collapse_fixed_joints = False
        options.default_dof_drive_mode = int(api.DOF_MODE_EFFORT)
        options.linear_damping = options.angular_damping = 0.0
        options.max_linear_velocity = options.max_angular_velocity = _FAST
        with TemporaryDirectory() as folder:
            file = Path(folder) / f"{robot.name}.urdf"
            file.write_text(physical_urdf(start.loaded, robot), "utf-8")
            asset = self._gym.load_asset(self._sim, folder, file.name, options)
        if asset is None:
            raise PlatformError(f"platform 'isaacgym' does not load {start.loaded.path}")
        return asset

    def _tell(self, api: Any, env: Any, actor: int, figures: JointModel, friction: float) -> None:
        """Set properties of joints and shapes of one robot."""
        gym = self._gym
        into = self._robot_from_dof
        joints = gym.get_actor_dof_properties(env, actor)
        joints["driveMode"].fill(api.DOF_MODE_EFFORT)
        for name in ("stiffness", "damping", "friction"):
            joints[name].fill(0.0)
        joints["velocity"].fill(_FAST)
        joints["effort"].fill(1e6)  # the servo limits them
        joints["armature"][into] = figures.armature
        limited = np.isfinite(figures.lower) & np.isfinite(figures.upper)
        joints["hasLimits"][into] = limited
        joints["lower"][into] = np.where(limited, figures.lower, 0.0)
        joints["upper"][into] = np.where(limited, figures.upper, 0.0)
        gym.set_actor_dof_properties(env, actor, joints)
        shapes = gym.get_actor_rigid_shape_properties(env, actor)
        for shape in shapes:  # friction of two is averaged
            shape.friction = friction
            shape.restitution = 0.0
        gym.set_actor_rigid_shape_properties(env, actor, shapes)

    def place(self) -> None:
        start = self.start
        count = self.num_robots
        root, dof = np.zeros((count, 13), np.float32), self._zeros(2)
        root[:, :3], root[:, 3:7] = start.position, np.roll(start.quat, -1)
        dof[:, self._robot_from_dof, 0] = start.joint_pos
        # Until the next step these are what the tensors would tell.
        self._roots = root
        self._dofs = dof
        self._push_states()

    def joints(self) -> tuple[Float64, Float64]:
        told = self._dofs[:, self._robot_from_dof].astype(np.float64)
        return told[..., 0], told[..., 1]

    def base(self) -> WorldPose:
        root = self._roots.astype(np.float64)
        quat = np.roll(root[:, 3:7], 1, axis=1)
        quat /= np.linalg.norm(quat, axis=1, keepdims=True)
        rate = root[:, 10:]
        # PhysX tells the velocity of the centre of mass.
        around = cross(rate, rotation(quat) @ self._centre)
        return WorldPose(root[:, :3], quat, root[:, 7:10] - around, rate)

    def step(self, torque: Float64) -> None:
        gym = self._gym
        sim = self._sim
        force = self._zeros()
        force[:, self._robot_from_dof] = torque - self._damping * self.joints()[1]
        gym.set_dof_actuation_force_tensor(sim, self._tensor(force))
        gym.simulate(sim)
        if not self._on_gpu:
            gym.fetch_results(sim, True)
        gym.refresh_actor_root_state_tensor(sim)
        gym.refresh_dof_state_tensor(sim)
        self._roots = np.array(self._root.cpu().numpy())
        self._dofs = np.array(self._dof.cpu().numpy()).reshape(self._dofs.shape)

    def add_velocity(self, velocity: Float64) -> None:
        self._roots[:, 7:10] += velocity.astype(np.float32)
        self._push_states()

    def _push_states(self) -> None:
        gym = self._gym
        sim = self._sim
        gym.set_actor_root_state_tensor(sim, self._tensor(self._roots))
        gym.set_dof_state_tensor(sim, self._tensor(self._dofs))

    def _zeros(self, *shape: int) -> np.ndarray[Any, np.dtype[np.float32]]:
        return np.zeros((self.num_robots, len(self._robot_from_dof), *shape), np.float32)

    def _tensor(self, values: np.ndarray[Any, Any]) -> Any:
        """Return gym's descriptor; the memory behind it must live until the call returns."""
        flat = values.reshape(-1, values.shape[-1]) if values.ndim > 2 else values
        self._kept = self._torch.from_numpy(np.ascontiguousarray(flat)).to(self._device)
        return self._interop.unwrap_tensor(self._kept)

    def close(self) -> None:
        sim = self._sim
        self._sim = None
        if sim is not None:
            self._gym.destroy_sim(sim)


def _params(api: Any, setup: Setup, device: str) -> Any:
    params = api.SimParams()
    params.dt = setup.timestep
    params.substeps = 1
    params.up_axis = api.UP_AXIS_Z
    params.gravity = api.Vec3(*map(float, setup.start.gravity))
    params.use_gpu_pipeline = params.physx.use_gpu = device != "cpu"
    params.physx.solver_type = 1  # TGS
    params.physx.num_position_iterations = 4
    params.physx.num_velocity_iterations = 1
    params.physx.contact_offset = 0.01
    params.physx.rest_offset = 0.0
    return params


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    scene: Scene,
    timestep: float = 0.005,
    passive: Passive = "replace",
    device: str = "cpu",
) -> IsaacGymPlatform:
    """Build the platform.

    Args:
        states: with `num_robots` set, as many robots are simulated, each in a world of its own.
        robot: its joints are found in the asset by name.
        period: of a tick in [s].
        scene: how it begins.
        timestep: physics step in [s].
        passive: damping of the joints in the model: `keep` it beside that of the command, or
            `replace` it by that.
        device: `cpu`, or `cuda:0` for physics and tensors on a GPU.
    """
    try:
        # In this order: it refuses a PyTorch that came before it.
        from isaacgym import gymapi, gymtorch  # isort: skip
        import torch  # isort: skip
    except (ImportError, RuntimeError) as error:
        how = f"{INSTALL} ({error})"
        raise MissingDependencyError("platform 'isaacgym'", "isaacgym", how) from error
    setup = setup_of(states, robot, period, scene, timestep, passive)
    return IsaacGymPlatform((gymapi, gymtorch, torch), device, setup)
