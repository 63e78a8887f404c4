"""Stand-in for isaaclab.sim."""

from isaaclab.lab import (
    ArticulationRootPropertiesCfg,
    CollisionPropertiesCfg,
    CuboidCfg,
    RigidBodyMaterialCfg,
    RigidBodyPropertiesCfg,
    SimulationCfg,
    SimulationContext,
    UrdfFileCfg,
    create_new_stage,
)

__all__ = [
    "ArticulationRootPropertiesCfg",
    "CollisionPropertiesCfg",
    "CuboidCfg",
    "RigidBodyMaterialCfg",
    "RigidBodyPropertiesCfg",
    "SimulationCfg",
    "SimulationContext",
    "UrdfFileCfg",
    "create_new_stage",
]
