"""RobotMessages: what shows a robot, as messages: its URDF and the frames of its links.

For the bridge, which publishes them, and for recordings, where nobody may publish them.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

from numpy.typing import NDArray

from unicon_core.models.find import model_of
from unicon_core.models.footprint import Footprint
from unicon_core.models.looks import dressed
from unicon_core.models.urdf_write import urdf
from unicon_core.workflow import Program
from unicon_msgs_map import Encoder
from unicon_ros.bridge.bindings import arrays_of
from unicon_ros.bridge.transforms import FOOTPRINT, LinkTransforms, static_transforms, tf_entry

RATE = 50.0
"""Rate of the links' transforms in [Hz]: what a viewer needs, whatever the tick."""


class RobotMessages:
    """Of the first robot, where there are many.

    Args:
        program: whose robot it is.
        stamp: `stamp_ns` as it is published, int64 scalar, read in place.
        frame_prefix: stands before the names of all frames; the description goes without, as
            robot_state_publisher's does, since viewers add it (RViz: "TF Prefix").
        links, footprint, description: which of them are wanted.

    Attributes:
        description: the URDF; empty where it is not wanted.
        lacking: meshes that it has not, in one line; empty where all are there.
        reads: the states that /tf is made of.

    Raises:
        UniconError: the robot has no model.
    """

    def __init__(
        self,
        program: Program,
        stamp: NDArray[Any],
        frame_prefix: str = "",
        links: bool = True,
        footprint: bool = True,
        description: bool = True,
    ) -> None:
        robot, arrays = program.robot, arrays_of(program)
        loaded, tree, self.lacking = dressed(model_of(program.platform, robot), robot)
        self.description = urdf(tree, robot) if description else ""
        shown = tree if links else tree[:1]
        self._poses = LinkTransforms(shown, arrays["joint_pos"])
        self._names = [link.name for link in shown]
        self._stamp, self._prefix = stamp, frame_prefix
        self._footprint: Footprint | None = None
        self.reads: tuple[str, ...] = ("joint_pos", "stamp_ns")
        own = any(link.name == FOOTPRINT for link in tree)
        if footprint and not own and "base_quat" in arrays:
            below = Footprint.of(loaded, robot, arrays["joint_pos"], arrays["base_quat"])
            self._footprint = below
            self.reads = self.reads if below is None else ("base_quat", *self.reads)

    def update(self) -> None:
        """Bring the frames of /tf up to date."""
        if self._poses.moving:
            self._poses.update()
        if self._footprint is not None:
            self._footprint.update()

    @cached_property
    def static(self) -> bytes:
        """The message of /tf_static; empty where no link is fixed to another."""
        fixed = self._poses.fixed
        return static_transforms(fixed, self._names, self._prefix) if fixed else b""

    @cached_property
    def links(self) -> Encoder | None:
        """Of /tf: the moving links and the footprint, after `update`; None where there are none."""
        poses, footprint = self._poses, self._footprint
        if not poses.moving and footprint is None:
            return None
        arrays = {"stamp_ns": self._stamp, "positions": poses.positions, "quats": poses.quats}
        if footprint is not None:
            arrays |= {"footprint_position": footprint.position, "footprint_quat": footprint.quat}
        below = footprint is not None
        spec = tf_entry("/tf", poses.moving, self._names, RATE, self._prefix, below)
        return Encoder.build(spec, arrays)
