"""The preflight twin: a workflow in MuJoCo before it meets the robot."""

from unicon_core.check.twin.check import check_twin

__all__ = ["check_twin"]
