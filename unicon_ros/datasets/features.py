"""Features of a data set as LeRobot describes them: name to type, shape and names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from unicon_ros.datasets.columns import Column
from unicon_ros.datasets.pictures import Pictures
from unicon_ros.datasets.video import NAME, PIXELS, can_encode

TICK = "unicon.tick"
"""Feature with the number of the recording's tick, so that a frame is found again there."""


@dataclass(frozen=True)
class Feature:
    """One of them.

    Attributes:
        dtype: `float32`, …, `image` or `video`.
        shape: of one frame.
        names: of the elements or axes, None without.
        camera: that it shows, "" for numbers.
    """

    dtype: str
    shape: tuple[int, ...]
    names: tuple[str, ...] | None = None
    camera: str = ""

    def described(self) -> dict[str, Any]:
        """Return what the Hugging Face library wants to know of its column, {} without one."""
        if self.dtype == "video":
            return {}
        if self.dtype == "image":
            return {"_type": "Image"}
        value = {"dtype": self.dtype, "_type": "Value"}
        if self.shape == (1,):
            return value
        return {"feature": value, "length": self.shape[0], "_type": "Sequence"}


DEFAULTS = {
    "timestamp": Feature("float32", (1,)),
    "frame_index": Feature("int64", (1,)),
    "episode_index": Feature("int64", (1,)),
    "index": Feature("int64", (1,)),
    "task_index": Feature("int64", (1,)),
}
"""Those that every data set has, behind the others."""


def image_key(camera: str) -> str:
    """Return the feature of a camera."""
    return f"observation.images.{camera}"


def features_of(
    columns: list[Column], cameras: Mapping[str, Pictures], video: bool
) -> dict[str, Feature]:
    """Return the features of a data set, but for those that every one has.

    Args:
        columns: of its numbers.
        cameras: name to pictures.
        video: pictures are to be videos, where their size and what is installed allows it.
    """
    found = {each.key: Feature(each.dtype, (len(each.names),), each.names) for each in columns}
    found[TICK] = Feature("int64", (1,))
    for name, each in cameras.items():
        kind = "video" if video and can_encode(each.height, each.width) else "image"
        axes = ("height", "width", "channels")
        found[image_key(name)] = Feature(kind, (each.height, each.width, 3), axes, name)
    return found


def info_of(features: Mapping[str, Feature], fps: int) -> dict[str, Any]:
    """Return the features as `meta/info.json` has them."""
    found: dict[str, Any] = {}
    for key, each in features.items():
        names = None if each.names is None else list(each.names)
        found[key] = {"dtype": each.dtype, "shape": list(each.shape), "names": names}
        if each.dtype == "video":
            found[key]["info"] = {
                "video.height": each.shape[0],
                "video.width": each.shape[1],
                "video.codec": NAME,
                "video.pix_fmt": PIXELS,
                "video.is_depth_map": False,
                "video.fps": fps,
                "video.channels": 3,
                "has_audio": False,
            }
    return found
