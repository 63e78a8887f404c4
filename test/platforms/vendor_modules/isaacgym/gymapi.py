"""Stand-in for isaacgym.gymapi: its names, arguments and order of calls; MuJoCo is its physics.

Signatures are those of Isaac Gym Preview 4 (docs/api/python/gym_py.html, struct_py.html), which
isaacgym-stubs 1.1rc4 repeats. What it refuses:

- an attribute that a structure does not have, an argument of another type or too many of them,
- actors after `prepare_sim`, tensors and torques before it,
- `simulate` without the `fetch_results` of the step before, on the CPU,
- tensors that are not float32 of the right size; anything after `destroy_sim`.

A tensor tells what was last refreshed. Velocities of roots are those of the centre of mass.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from vendor_world import Refused, World, exact

from isaacgym.structures import (
    DOF,
    DOF_MODE_EFFORT,
    SIM_PHYSX,
    UP_AXIS_Z,
    AssetOptions,
    Descriptor,
    DofDriveMode,
    PhysXParams,
    PlaneParams,
    Quat,
    RigidBodyProperties,
    RigidShapeProperties,
    SimParams,
    SimType,
    Transform,
    UpAxis,
    Vec3,
)

__all__ = [
    "DOF",
    "DOF_MODE_EFFORT",
    "LIVE",
    "SIM_PHYSX",
    "UP_AXIS_Z",
    "Asset",
    "AssetOptions",
    "Descriptor",
    "DofDriveMode",
    "Env",
    "Gym",
    "PhysXParams",
    "PlaneParams",
    "Quat",
    "RigidBodyProperties",
    "RigidShapeProperties",
    "Sim",
    "SimParams",
    "SimType",
    "Transform",
    "UpAxis",
    "Vec3",
    "acquire_gym",
]

# Simulations that are there.
LIVE: list[Sim] = []


class Asset:
    def __init__(self, path: Path, options: AssetOptions) -> None:
        self.text = path.read_text(encoding="utf-8")
        self.options = options
        self.names = World(
            self.text, timestep=0.001, gravity=(0, 0, 0), friction=1.0, fixed=True
        ).names


class Env:
    def __init__(self) -> None:
        self.asset: Asset | None = None
        self.group = -2
        self.pose: Transform | None = None
        self.dofs: Any = None
        self.shapes = [RigidShapeProperties()]
        self.world: World | None = None


class Sim:
    def __init__(self, params: SimParams) -> None:
        self.params, self.envs, self.plane = params, [], None  # type: ignore[var-annotated]
        self.prepared = self.pending = False
        self.root = self.dof = self.force = np.zeros(0)


class Gym:
    def create_sim(
        self,
        compute_device: int = 0,
        graphics_device: int = 0,
        type: SimType = SimType.SIM_FLEX,
        params: SimParams | None = None,
    ) -> Sim | None:
        exact(compute_device, int, "compute_device")
        exact(graphics_device, int, "graphics_device")
        exact(params, SimParams, "params")
        assert params is not None
        if type is not SIM_PHYSX:
            raise Refused("tensors are of PhysX alone")
        if params.use_gpu_pipeline or params.physx.use_gpu:
            return None  # no GPU here
        if params.up_axis is not UP_AXIS_Z:
            raise Refused("y is up")
        LIVE.append(Sim(params))
        return LIVE[-1]

    def add_ground(self, sim: Sim, params: PlaneParams) -> None:
        _live(sim, prepared=False)
        exact(params, PlaneParams, "params")
        if (params.normal.x, params.normal.y, params.normal.z) != (0.0, 0.0, 1.0):
            raise Refused("the floor is a wall")
        sim.plane = params

    def load_asset(
        self, sim: Sim, rootpath: str, filename: str, options: AssetOptions | None = None
    ) -> Asset | None:
        _live(sim, prepared=False)
        exact(rootpath, str, "rootpath")
        exact(filename, str, "filename")
        exact(options, AssetOptions, "options")
        assert options is not None
        if options.linear_damping or options.angular_damping:
            raise Refused("the air brakes")
        path = Path(rootpath) / filename
        return Asset(path, options) if path.is_file() else None

    def get_asset_dof_names(self, arg0: Asset, /) -> list[str]:
        exact(arg0, Asset, "asset")
        return list(arg0.names)

    def create_env(self, arg0: Sim, arg1: Vec3, arg2: Vec3, arg3: int, /) -> Env:
        _live(arg0, prepared=False)
        exact(arg1, Vec3, "lower")
        exact(arg2, Vec3, "upper")
        exact(arg3, int, "num_per_row")
        arg0.envs.append(Env())
        return arg0.envs[-1]

    def get_env_origin(self, arg0: Env, /) -> Vec3:
        exact(arg0, Env, "env")
        return Vec3()

    def create_actor(
        self,
        env: Env,
        asset: Asset,
        pose: Transform,
        name: str | None = None,
        group: int = -1,
        filter: int = -1,
        segmentationId: int = 0,
    ) -> int:
        sim = _sim_of(env)
        _live(sim, prepared=False)
        exact(asset, Asset, "asset")
        exact(pose, Transform, "pose")
        exact(name, str, "name")
        if group < 0 or group in [other.group for other in sim.envs]:
            raise Refused(f"actors of group {group} collide with others")
        if not filter & 1:
            raise Refused("links collide with each other")
        env.asset = asset
        env.pose = pose
        env.group = group
        env.dofs = np.zeros(len(asset.names), DOF)
        return 0

    def get_actor_dof_properties(self, arg0: Env, arg1: int, /) -> Any:
        _actor(arg0, arg1)
        return arg0.dofs.copy()

    def set_actor_dof_properties(self, arg0: Env, arg1: int, arg2: Any, /) -> bool:
        _actor(arg0, arg1)
        if arg2.dtype != DOF or arg2.shape != arg0.dofs.shape:
            raise Refused("properties of another shape")
        arg0.dofs = arg2.copy()
        return True

    def get_actor_rigid_shape_properties(
        self, arg0: Env, arg1: int, /
    ) -> list[RigidShapeProperties]:
        _actor(arg0, arg1)
        return arg0.shapes

    def set_actor_rigid_shape_properties(
        self, arg0: Env, arg1: int, arg2: list[RigidShapeProperties], /
    ) -> bool:
        _actor(arg0, arg1)
        exact(arg2, list, "properties")
        arg0.shapes = arg2
        return True

    def get_actor_rigid_body_properties(self, arg0: Env, arg1: int, /) -> list[RigidBodyProperties]:
        _actor(arg0, arg1)
        told = RigidBodyProperties()
        told.com = Vec3(*_world(_sim_of(arg0), arg0).centre)
        return [told]

    def prepare_sim(self, arg0: Sim, /) -> bool:
        _live(arg0, prepared=False)
        if arg0.plane is None:
            raise Refused("there is no floor")
        for env in arg0.envs:
            env.world = _world(arg0, env)
            p = env.pose.p
            r = env.pose.r
            env.world.put((p.x, p.y, p.z), (r.w, r.x, r.y, r.z), np.zeros(len(env.dofs)))
        count = sum(len(env.dofs) for env in arg0.envs)
        arg0.root = np.full((len(arg0.envs), 13), np.nan, np.float32)
        arg0.dof = np.full((count, 2), np.nan, np.float32)
        arg0.force = np.zeros(count, np.float32)
        arg0.prepared = True
        return True

    def acquire_actor_root_state_tensor(self, arg0: Sim, /) -> Descriptor:
        _live(arg0)
        return Descriptor(arg0.root)

    def acquire_dof_state_tensor(self, arg0: Sim, /) -> Descriptor:
        _live(arg0)
        return Descriptor(arg0.dof)

    def refresh_actor_root_state_tensor(self, arg0: Sim, /) -> bool:
        _live(arg0)
        for row, env in zip(arg0.root, arg0.envs):
            row[:3], quat = env.world.pose()
            row[3:7] = np.roll(quat, -1)
            row[7:10], row[10:] = env.world.moves(at_centre=True)
        return True

    def refresh_dof_state_tensor(self, arg0: Sim, /) -> bool:
        _live(arg0)
        arg0.dof[...] = np.vstack([np.array(env.world.joints()).T for env in arg0.envs])
        return True

    def set_actor_root_state_tensor(self, arg0: Sim, arg1: Descriptor, /) -> bool:
        _live(arg0)
        for row, env in zip(_float32(arg1, arg0.root.shape), arg0.envs):
            if not env.world.fixed:
                joints = env.world.joints()
                env.world.put(row[:3], np.roll(row[3:7], 1), *joints)
                env.world.move(row[7:10], row[10:], at_centre=True)
        return True

    def set_dof_state_tensor(self, arg0: Sim, arg1: Descriptor, /) -> bool:
        _live(arg0)
        told = _float32(arg1, arg0.dof.shape).reshape(len(arg0.envs), -1, 2)
        for rows, env in zip(told, arg0.envs):
            place = env.world.pose()
            moves = env.world.moves(at_centre=True)
            env.world.put(*place, rows[:, 0], rows[:, 1])
            if not env.world.fixed:
                env.world.move(*moves, at_centre=True)
        return True

    def set_dof_actuation_force_tensor(self, arg0: Sim, arg1: Descriptor, /) -> bool:
        _live(arg0)
        arg0.force = _float32(arg1, arg0.force.shape).copy()
        return True

    def simulate(self, arg0: Sim, /) -> None:
        _live(arg0)
        if arg0.pending:
            raise Refused("simulate without fetch_results")
        arg0.pending = True
        torques = np.split(arg0.force, max(len(arg0.envs), 1))
        for env, torque in zip(arg0.envs, torques):
            if (env.dofs["driveMode"] != DOF_MODE_EFFORT).any():
                raise Refused("DOFs that take no efforts")
            limit = env.dofs["effort"]
            env.world.step(np.clip(torque, -limit, limit))
        arg0.force = np.zeros_like(arg0.force)  # of this step alone

    def fetch_results(self, arg0: Sim, arg1: bool, /) -> None:
        _live(arg0)
        exact(arg1, bool, "wait")
        if not arg0.pending or not arg1:
            raise Refused("nothing was simulated, or nobody waits for it")
        arg0.pending = False

    def destroy_sim(self, arg0: Sim, /) -> None:
        _live(arg0, prepared=None)
        LIVE.remove(arg0)


def acquire_gym() -> Gym:
    return Gym()


def _live(sim: Sim, prepared: bool | None = True) -> None:
    exact(sim, Sim, "sim")
    if sim not in LIVE:
        raise Refused("the simulation was destroyed")
    if prepared is not None and sim.prepared != prepared:
        raise Refused("after prepare_sim" if sim.prepared else "before prepare_sim")


def _sim_of(env: Env) -> Sim:
    exact(env, Env, "env")
    (sim,) = [sim for sim in LIVE if env in sim.envs]
    return sim


def _actor(env: Env, actor: int) -> None:
    exact(env, Env, "env")
    exact(actor, int, "actor")
    if env.asset is None or actor != 0:
        raise Refused(f"no actor {actor}")


def _float32(tensor: Descriptor, shape: tuple[int, ...]) -> Any:
    exact(tensor, Descriptor, "tensor")
    if tensor.array.dtype != np.float32 or tensor.array.size != np.prod(shape):
        raise Refused(f"a tensor {tensor.array.dtype} {tensor.array.shape}, not float32 {shape}")
    if not tensor.array.flags.c_contiguous:
        raise Refused("a tensor with gaps")
    return tensor.array.reshape(shape)


def _world(sim: Sim, env: Env) -> World:
    """Return the robot of an actor, as its properties have it."""
    params = sim.params
    asset = env.asset
    assert asset is not None
    assert sim.plane is not None
    gravity = params.gravity
    dofs = dict(zip(asset.names, env.dofs))
    friction = 0.5 * (sim.plane.dynamic_friction + env.shapes[0].friction)  # average mode
    return World(
        asset.text,
        timestep=params.dt,
        gravity=(gravity.x, gravity.y, gravity.z),
        friction=friction,
        fixed=asset.options.fix_base_link,
        armature={name: float(dof["armature"]) for name, dof in dofs.items()},
    )
