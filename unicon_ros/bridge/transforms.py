"""Transforms: link poses relative to their parents from joint positions, as /tf and /tf_static.

The pose of a link is its joint's fixed pose and one turn about (or shift along) the joint's axis,
so all moving links are one vectorized half-angle formula, 8 µs for 29 joints.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from unicon_base.arrays import Float32
from unicon_core.models.kinematic_tree import Link, multiply, rotate
from unicon_msgs_map import Encoder, FieldSpec, PublishSpec, Qos
from unicon_msgs_map.layout.messages import shared_messages
from unicon_msgs_map.layout.paths import parse_path, parse_reference

TF_MESSAGE = "tf2_msgs/msg/TFMessage"
FOOTPRINT = "base_footprint"


class LinkTransforms:
    """Poses of the moving links, one row each.

    Args:
        links: the tree.
        joint_pos: positions in the robot's order in [rad] or [m], shape (n,), read in place.

    Attributes:
        moving: the links that `positions` and `quats` are of: those of the robot's joints.
        fixed: all others but the root; their joints, if any, are taken at position 0.
        positions: link in its parent's frame in [m], shape (m, 3).
        quats: link to parent, wxyz, shape (m, 4).
    """

    def __init__(self, links: Sequence[Link], joint_pos: Float32) -> None:
        self.moving = [link for link in links if link.index >= 0]
        self.fixed = [link for link in links if link.index < 0 and link.parent >= 0]
        self._joint_pos = joint_pos
        self._index = np.array([link.index for link in self.moving], dtype=np.intp)
        self._origin = np.array([link.position for link in self.moving]).reshape(-1, 3)
        self.positions = self._origin.copy()
        self.quats = np.array([link.quat for link in self.moving]).reshape(-1, 4)
        axes = np.array([link.axis for link in self.moving]).reshape(-1, 3)
        # q0 (1, 0) and q0 (0, axis): the turned quaternion is cos(a/2) and sin(a/2) times these.
        self._cos = self.quats.copy()
        self._sin = multiply(self.quats, np.concatenate((np.zeros((len(axes), 1)), axes), axis=1))
        self._slides = [
            (row, rotate(link.quat, link.axis))
            for row, link in enumerate(self.moving)
            if link.sliding
        ]
        self._turning = np.array([0.0 if link.sliding else 0.5 for link in self.moving])

    def update(self) -> None:
        """Bring `positions` and `quats` up to date."""
        joint_pos = self._joint_pos[self._index].astype(np.float64)
        half = joint_pos * self._turning
        np.multiply(self._cos, np.cos(half)[:, None], out=self.quats)
        self.quats += self._sin * np.sin(half)[:, None]
        for row, direction in self._slides:
            self.positions[row] = self._origin[row] + joint_pos[row] * direction


def tf_entry(
    topic: str,
    links: Sequence[Link],
    names: Sequence[str],
    rate: float | None = None,
    prefix: str = "",
    footprint: bool = False,
) -> PublishSpec:
    """Return the entry of a message map for a topic that carries all these links.

    The arrays that it reads are `stamp_ns`, `positions` and `quats`, one row for each link.

    Args:
        topic: `/tf` or `/tf_static`.
        links: whose transforms are carried.
        names: names of all links, by number.
        rate: in [Hz], None for every tick.
        prefix: stands before all names.
        footprint: `base_footprint` too, below the root; read are `footprint_position` and
            `footprint_quat` then.
    """
    rows = [
        (names[e.parent], e.name, f"positions[{3 * i}:{3 * i + 3}]", f"quats[{4 * i}:{4 * i + 4}]")
        for i, e in enumerate(links)
    ]
    if footprint:
        rows.append((names[0], FOOTPRINT, "footprint_position", "footprint_quat"))
    fields: list[FieldSpec] = []
    for i, (parent, child, position, quat) in enumerate(rows):
        for path, source in (
            ("header.stamp", "stamp_ns"),
            ("header.frame_id", f"={prefix}{parent}"),
            ("child_frame_id", f"={prefix}{child}"),
            ("transform.translation", position),
            ("transform.rotation", quat),
        ):
            whole = f"transforms[{i}].{path}"
            fields.append(FieldSpec(whole, parse_path(whole), parse_reference(source), where=topic))
    types, qos = shared_messages(), Qos(depth=1)
    return PublishSpec(topic, TF_MESSAGE, tuple(fields), types, rate, qos, where=topic)


def static_transforms(links: Sequence[Link], names: Sequence[str], prefix: str = "") -> bytes:
    """Return the message of /tf_static that carries all these links; arguments as of `tf_entry`."""
    arrays = {
        "stamp_ns": np.zeros((), np.int64),
        "positions": np.array([link.position for link in links]),
        "quats": np.array([link.quat for link in links]),
    }
    return Encoder.build(tf_entry("/tf_static", links, names, prefix=prefix), arrays).encode()
