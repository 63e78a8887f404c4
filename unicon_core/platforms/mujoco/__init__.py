"""MuJoCo as a platform: a robot file, a model found by name and torque servos computed in C."""

from unicon_core.platforms.mujoco.platform import MujocoPlatform, make

__all__ = ["MujocoPlatform", "make"]
