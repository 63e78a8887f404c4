"""Places on a body: where it carries its hands, and what it reaches with, for robot files.

mounts:
  dex3_left: {body: left_wrist_yaw_link, position: [0.0415, 0.003, 0.0], quat: [1, 0, 0, 0]}
end_effectors:
  left_hand: {body: left_wrist_yaw_link, position: [0.12, 0.0, 0.0]}
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from unicon_core.schema.marks import Point, Quat, Text, Write


@dataclass(frozen=True)
class Place:
    """A frame that is fixed to a body of the robot's model.

    Attributes:
        body: body of the model that carries it.
        position: in the frame of that body in [m].
        quat: rotation of the frame to that body, unit quaternion wxyz.
    """

    body: Text
    position: Point = (0.0, 0.0, 0.0)
    quat: Quat = (1.0, 0.0, 0.0, 0.0)


Places = Annotated[
    dict[str, Place],
    Write("{left_hand: {body: left_wrist_yaw_link, position: [x, y, z], quat: [w, x, y, z]}}"),
]
"""Name to place."""
