"""Stand-in for isaaclab.scene."""

from isaaclab.lab import InteractiveScene, InteractiveSceneCfg

__all__ = ["InteractiveScene", "InteractiveSceneCfg"]
