"""Stand-in for isaaclab.assets."""

from isaaclab.lab import ArticulationCfg, AssetBaseCfg

__all__ = ["ArticulationCfg", "AssetBaseCfg"]
