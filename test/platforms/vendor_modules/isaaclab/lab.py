"""What the stand-ins of isaaclab's modules share: configurations, context, scene, articulation.

Names, arguments and defaults are those of isaaclab 2.3.2 (sim/simulation_cfg.py,
sim/simulation_context.py, scene/interactive_scene.py, assets/articulation/articulation.py). Refused
are modules before the app, data before `reset`, a step without `write_data_to_sim`, tensors of
another shape, a second context beside one. Data tell what `update` has read.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from vendor_world import Refused, World, exact

import isaaclab
from isaaclab.app import AppLauncher

if not AppLauncher.launched:
    raise Refused("modules of Isaac Sim before the app")

MISSING: Any = object()


@dataclass
class RigidBodyMaterialCfg:
    static_friction: float = 0.5
    dynamic_friction: float = 0.5
    restitution: float = 0.0
    friction_combine_mode: str = "average"
    restitution_combine_mode: str = "average"


@dataclass
class SimulationCfg:
    physics_prim_path: str = "/physicsScene"
    device: str = "cuda:0"
    dt: float = 1.0 / 60.0
    render_interval: int = 1
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    use_fabric: bool = True
    physics_material: RigidBodyMaterialCfg = field(default_factory=RigidBodyMaterialCfg)


@dataclass
class CollisionPropertiesCfg:
    collision_enabled: bool | None = None
    contact_offset: float | None = None
    rest_offset: float | None = None


@dataclass
class RigidBodyPropertiesCfg:
    disable_gravity: bool | None = None
    linear_damping: float | None = None
    angular_damping: float | None = None
    max_linear_velocity: float | None = None
    max_angular_velocity: float | None = None


@dataclass
class ArticulationRootPropertiesCfg:
    enabled_self_collisions: bool | None = None
    fix_root_link: bool | None = None


@dataclass
class CuboidCfg:
    size: tuple[float, float, float] = MISSING
    rigid_props: RigidBodyPropertiesCfg | None = None
    collision_props: CollisionPropertiesCfg | None = None
    physics_material: RigidBodyMaterialCfg | None = None


@dataclass
class PDGainsCfg:
    stiffness: Any = MISSING
    damping: Any = None


@dataclass
class JointDriveCfg:
    drive_type: str = "force"
    target_type: str = "position"
    gains: PDGainsCfg = field(default_factory=PDGainsCfg)


JointDriveCfg.PDGainsCfg = PDGainsCfg  # type: ignore[attr-defined]


@dataclass
class UrdfFileCfg:
    asset_path: str = MISSING
    usd_dir: str | None = None
    usd_file_name: str | None = None
    force_usd_conversion: bool = False
    make_instanceable: bool = True
    fix_base: bool = MISSING
    merge_fixed_joints: bool = True
    joint_drive: JointDriveCfg | None = None
    self_collision: bool = False
    replace_cylinders_with_capsules: bool = False
    rigid_props: RigidBodyPropertiesCfg | None = None
    articulation_props: ArticulationRootPropertiesCfg | None = None


UrdfFileCfg.JointDriveCfg = JointDriveCfg  # type: ignore[attr-defined]


@dataclass
class ImplicitActuatorCfg:
    joint_names_expr: list[str] = MISSING
    effort_limit: Any = None
    velocity_limit: Any = None
    effort_limit_sim: Any = None
    velocity_limit_sim: Any = None
    stiffness: Any = MISSING
    damping: Any = MISSING
    armature: Any = None
    friction: Any = None
    dynamic_friction: Any = None
    viscous_friction: Any = None


@dataclass
class InitialStateCfg:
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rot: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


@dataclass
class AssetBaseCfg:
    prim_path: str = MISSING
    spawn: Any = None
    init_state: InitialStateCfg = field(default_factory=InitialStateCfg)
    collision_group: int = 0


AssetBaseCfg.InitialStateCfg = InitialStateCfg  # type: ignore[attr-defined]


@dataclass
class ArticulationCfg(AssetBaseCfg):
    soft_joint_pos_limit_factor: float = 1.0
    actuators: dict[str, ImplicitActuatorCfg] = MISSING


@dataclass
class InteractiveSceneCfg:
    num_envs: int = MISSING
    env_spacing: float = MISSING
    lazy_sensor_update: bool = True
    replicate_physics: bool = True
    filter_collisions: bool = True


def create_new_stage() -> object:
    if SimulationContext.instance() is not None:
        raise Refused("a new stage below a context")
    return object()


class SimulationContext:
    instances: list[SimulationContext] = []  # noqa: RUF012

    def __init__(self, cfg: SimulationCfg | None = None) -> None:
        exact(cfg, SimulationCfg, "cfg")
        assert cfg is not None
        if cfg.device != "cpu":
            raise Refused(f"no device {cfg.device}")
        if SimulationContext.instance() is not None:
            raise Refused("a second context")
        SimulationContext.instances.append(self)
        self.cfg, self.scenes, self.playing = cfg, [], False  # type: ignore[var-annotated]

    @classmethod
    def instance(cls) -> SimulationContext | None:
        return cls.instances[-1] if isaaclab.SINGLE and cls.instances else None

    def reset(self, soft: bool = False) -> None:
        for scene in self.scenes:
            scene["robot"].begin(self.cfg)
        self.playing = True

    def step(self, render: bool = True) -> None:
        if render or not self.playing:
            raise Refused("a step that renders, or before reset")
        for scene in self.scenes:
            scene["robot"].step()

    def stop(self) -> None:
        raise Refused("it renders until somebody plays again")

    def clear_all_callbacks(self) -> None:
        self.playing = False

    def clear_instance(self) -> None:
        if self.playing:
            raise Refused("cleared before its callbacks")
        SimulationContext.instances.remove(self)


class InteractiveScene:
    def __init__(self, cfg: InteractiveSceneCfg) -> None:
        exact(cfg, InteractiveSceneCfg, "cfg")
        context = SimulationContext.instances[-1]
        if context.playing:
            raise Refused("a scene after reset")
        context.scenes.append(self)
        floor, robot = cfg.floor, cfg.robot  # type: ignore[attr-defined]
        exact(floor, AssetBaseCfg, "floor")
        exact(floor.spawn, CuboidCfg, "floor.spawn")
        top = floor.init_state.pos[2] + 0.5 * floor.spawn.size[2]
        if floor.collision_group != -1 or floor.spawn.collision_props is None or top:
            raise Refused("a floor that does not hold all robots at 0")
        exact(robot, ArticulationCfg, "robot")
        if not robot.prim_path.startswith("{ENV_REGEX_NS}/"):
            raise Refused("a robot outside of its environments")
        side = cfg.env_spacing * np.arange(cfg.num_envs, dtype=np.float32)
        self._origins = np.stack((side, -side, 0 * side), axis=1)
        self._robot = Articulation(robot, self._origins, floor.spawn.physics_material)

    def __getitem__(self, key: str) -> Articulation:
        if key != "robot":
            raise KeyError(key)
        return self._robot

    @property
    def env_origins(self) -> torch.Tensor:
        return torch.Tensor(self._origins)

    def write_data_to_sim(self) -> None:
        self._robot.write_data_to_sim()

    def update(self, dt: float) -> None:
        self._robot.update(dt)


class Proxy:
    """3.0's ProxyArray: a tensor stands behind `torch`."""

    def __init__(self, tensor: torch.Tensor) -> None:
        self.torch = tensor


class Data:
    """What the last `update` has read."""

    def __init__(self, values: dict[str, Any]) -> None:
        wrap = Proxy if isaaclab.QUAT == "xyzw" else lambda tensor: tensor
        for name, value in values.items():
            setattr(self, name, wrap(torch.Tensor(np.array(value, np.float32))))


class Articulation:
    def __init__(
        self, cfg: ArticulationCfg, origins: Any, material: RigidBodyMaterialCfg | None
    ) -> None:
        self._cfg = cfg
        self._origins = origins
        self._material = material
        self._worlds: list[World] = []
        self._target: Any = None
        self._written: Any = None
        self._data: Data | None = None
        if isaaclab.QUAT == "xyzw":
            self.write_root_link_pose_to_sim_index = self.write_root_link_pose_to_sim

    def begin(self, cfg: SimulationCfg) -> None:
        spawn, (motors,) = self._cfg.spawn, self._cfg.actuators.values()
        drive = spawn.joint_drive
        exact(spawn, UrdfFileCfg, "spawn")
        if drive is None or drive.target_type != "none" or motors.stiffness != 0.0:
            raise Refused("the joints are driven to positions")
        if spawn.rigid_props.linear_damping != 0.0 or spawn.rigid_props.angular_damping != 0.0:
            raise Refused("the air brakes")
        floor = self._material or cfg.physics_material
        self._worlds = [
            World(
                Path(spawn.asset_path).read_text(encoding="utf-8"),
                timestep=cfg.dt,
                gravity=cfg.gravity,
                friction=0.5 * (floor.dynamic_friction + cfg.physics_material.dynamic_friction),
                fixed=spawn.fix_base,
                armature=motors.armature,
                damping=motors.damping,
                dry=motors.dynamic_friction,
            )
            for _ in self._origins
        ]
        self._target = np.zeros((len(self._worlds), len(self.joint_names)), np.float32)
        for world in self._worlds:
            world.put((0, 0, 1), (1, 0, 0, 0), np.zeros(len(world.names)))

    @property
    def joint_names(self) -> list[str]:
        self._there()
        return list(self._worlds[0].names)

    @property
    def data(self) -> Any:
        self._there()
        return self

    def __getattr__(self, name: str) -> Any:
        told = self.__dict__.get("_data")
        if name not in ("root_link_pose_w", "root_link_vel_w", "joint_pos", "joint_vel"):
            raise AttributeError(name)
        if told is None:
            raise Refused(f"{name} before update")
        return getattr(told, name)

    def reset(self, env_ids: Any = None) -> None:
        self._there()
        self._target[...] = 0.0

    def write_root_link_pose_to_sim(self, root_pose: Any, env_ids: Any = None) -> None:
        for row, world, origin in zip(self._rows(root_pose, 7), self._worlds, self._origins):
            quat = np.roll(row[3:], 1) if isaaclab.QUAT == "xyzw" else row[3:]
            world.put(row[:3] - origin, quat, *world.joints())

    def write_root_link_velocity_to_sim(self, root_velocity: Any, env_ids: Any = None) -> None:
        for row, world in zip(self._rows(root_velocity, 6), self._worlds):
            if not world.fixed:
                world.move(row[:3], row[3:], at_centre=False)

    def write_joint_state_to_sim(
        self, position: Any, velocity: Any, joint_ids: Any = None, env_ids: Any = None
    ) -> None:
        count = len(self.joint_names)
        told = zip(self._rows(position, count), self._rows(velocity, count), self._worlds)
        for pos, vel, world in told:
            place = world.pose()
            moves = world.moves(at_centre=False)
            world.put(*place, pos, vel)
            if not world.fixed:
                world.move(*moves, at_centre=False)

    def set_joint_effort_target(
        self, target: Any, joint_ids: Any = None, env_ids: Any = None
    ) -> None:
        self._target[...] = self._rows(target, len(self.joint_names))

    def write_data_to_sim(self) -> None:
        self._there()
        self._written = self._target.copy()

    def step(self) -> None:
        if self._written is None:
            raise Refused("a step without write_data_to_sim")
        for torque, world in zip(self._written, self._worlds):
            world.step(torque)
        self._written = None

    def update(self, dt: float) -> None:
        self._there()
        exact(dt, float, "dt")
        poses = [world.pose() for world in self._worlds]
        turn = -1 if isaaclab.QUAT == "xyzw" else 0
        joints = [world.joints() for world in self._worlds]
        self._data = Data(
            {
                "root_link_pose_w": [
                    [*(place + origin), *np.roll(quat, turn)]
                    for (place, quat), origin in zip(poses, self._origins)
                ],
                "root_link_vel_w": [np.hstack(world.moves(False)) for world in self._worlds],
                "joint_pos": [pos for pos, _ in joints],
                "joint_vel": [vel for _, vel in joints],
            }
        )

    def _there(self) -> None:
        if not self._worlds:
            raise Refused("an articulation before reset")

    def _rows(self, tensor: Any, width: int) -> Any:
        self._there()
        exact(tensor, torch.Tensor, "tensor")
        rows = tensor.numpy()
        if rows.dtype != np.float32 or rows.shape != (len(self._worlds), width):
            raise Refused(f"a tensor {rows.dtype} {rows.shape}")
        return rows
