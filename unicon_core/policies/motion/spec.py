"""MotionSpec: the key `motion` of a contract, for policies that follow a recorded motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from unicon_base import AnyDict
from unicon_base.schema.marks import Checked, Names, Text, Within, Write, twice
from unicon_base.schema.types import Here

AXES = {
    "x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0), "-y": (0.0, -1.0, 0.0), "-z": (0.0, 0.0, -1.0),
}  # fmt: skip
"""Word of `motion.chain` to the unit vector that it means."""


MotionTime = Annotated[float, Within(0.0, 86_400.0, "s")]
"""Within a motion, which is a day at most."""


@dataclass(frozen=True)
class MotionSpec:
    """The motion that a policy is to follow, and the body by which the robot is compared with it.

    Attributes:
        anchor_body: such as `torso_link`; a body of the robot's model.
        file: `.npz` or `.csv`, or None: outputs of the network are the reference.
        bodies: of the outputs `motion_body_pos_w` and `motion_body_quat_w`, in their order.
        align: `yaw` turns the motion about the vertical and shifts it, so that it begins where the
            robot stands; `none` leaves it in the robot's world.
        start: of what is played of it in [s].
        end: of what is played in [s], or None for all.
        hold: for so long in [s] the first frame is shown before the motion goes on; those who train
            with it hold it (amazon-far/holosoma: `freeze_at_timestep_zero_prob`).
        fps: frames in a second of a file, or None: as the file says, 30 of a `.csv`.
        joints: the file's joints in order, `policy`, `robot`, or None: as its format has it.
        duration: of a motion of which the policy sees no more than `motion_phase`, in [s], in place
            of `anchor_body`; or None.
        chain: joint to axis (`x`, `-y`, …) from the base to the anchor, for a robot without a
            model; empty: as the model has it.
    """

    anchor_body: Annotated[Text, Write("a body, as torso_link")] = ""
    file: Annotated[Path | None, Write("a .npz or .csv file")] = None
    bodies: Annotated[tuple[Text, ...], Checked(twice)] = ()
    align: Literal["yaw", "none"] = "yaw"
    start: MotionTime = 0.0
    end: MotionTime | None = None
    hold: MotionTime = 0.0
    fps: Annotated[float | None, Within(1.0, 10_000.0, "Hz")] = None
    joints: Literal["policy", "robot"] | Names | None = None
    chain: Mapping[str, Literal["x", "y", "z", "-x", "-y", "-z"]] = field(default_factory=dict)
    duration: MotionTime | None = None

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note an end before the start, and other than one of anchor_body and duration."""
        start = found.get("start", 0.0)
        for key in ("end", "duration"):
            end = found.get(key)
            if end is not None and end <= start:
                here.value(f"is {end:g} s and start {start:g} s; end after the start", key)
        said = {key for key, value in here.written.items() if value is not None}
        if "duration" not in said and "anchor_body" not in said:
            here.value(
                "needs anchor_body, or duration in [s] where the policy sees motion_phase alone"
            )
        elif "duration" in said and (more := said - {"duration", "start", "hold"}):
            here.value(f"stands beside {min(more)}; only start and hold go with it", "duration")
