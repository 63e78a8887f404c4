"""Inverse kinematics, step by step: joints that bring end effectors to targets, for `reach`."""

from unicon_core.ik.chain import Chain
from unicon_core.ik.differential import DifferentialIk
from unicon_core.ik.tasks import Settings, Weights

__all__ = ["Chain", "DifferentialIk", "Settings", "Weights"]
