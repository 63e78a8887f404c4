"""RobotMessages: what shows a robot, as messages: its URDF and the frames of its links.

For the bridge, which publishes them, and for recordings, where nobody may publish them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

from numpy.typing import NDArray

from unicon_core.models.find import model_of
from unicon_core.models.kinematic_tree import tree_of
from unicon_core.models.urdf_write import urdf
from unicon_core.workflow import Program
from unicon_msgs_map import Encoder
from unicon_ros.bridge.transforms import LinkTransforms, static_transforms, tf_entry

__all__ = ["RobotMessages"]

RATE = 50.0
"""Rate of the links' transforms in [Hz]: what a viewer needs, whatever the tick."""


class RobotMessages:
    """Of the first robot, where there are many.

    Args:
        program: whose robot it is.
        stamp: `stamp_ns` as it is published, int64 scalar, read in place.
        frame_prefix: stands before the names of all frames; the description goes without, as
            robot_state_publisher's does, since viewers add it (RViz: "TF Prefix").

    Attributes:
        description: the URDF.
        update: brings the links of /tf up to date.

    Raises:
        UniconError: the robot has no model.
    """

    def __init__(self, program: Program, stamp: NDArray[Any], frame_prefix: str = "") -> None:
        links = tree_of(program.robot, model_of(program.platform, program.robot))
        self.description = urdf(links, program.robot)
        states = program.states
        joint_pos = states["joint_pos"] if states.num_robots is None else states["joint_pos"][0]
        self._poses = LinkTransforms(links, joint_pos)
        self._names = [link.name for link in links]
        self._stamp, self._prefix = stamp, frame_prefix
        self.update: Callable[[], None] = self._poses.update

    @cached_property
    def static(self) -> bytes:
        """The message of /tf_static; empty where no link is fixed to another."""
        fixed = self._poses.fixed
        return static_transforms(fixed, self._names, self._prefix) if fixed else b""

    @cached_property
    def links(self) -> Encoder | None:
        """Of /tf, with the moving links, after `update`; None where there are none."""
        poses = self._poses
        if not poses.moving:
            return None
        spec = tf_entry("/tf", poses.moving, self._names, RATE, self._prefix)
        arrays = {"stamp_ns": self._stamp, "positions": poses.positions, "quats": poses.quats}
        return Encoder.build(spec, arrays)
