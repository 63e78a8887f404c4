"""Reads a data set with LeRobot's own reader, in whichever Python has it: `FOLDER OUT.npz`."""

from __future__ import annotations

import os
import sys
from typing import Any

os.environ["HF_HUB_OFFLINE"] = "1"

import av
import numpy as np
import torch
import torchvision
from lerobot.datasets.lerobot_dataset import LeRobotDataset


class VideoReader:
    """What torchvision's reader was, until 0.26 took it out: frames with their times, by PyAV."""

    def __init__(self, path: str, stream: str) -> None:
        self.container = av.open(path)
        self._stream = self.container.streams.video[0]

    def seek(self, time: float, keyframes_only: bool = False) -> None:
        self.container.seek(int(time / self._stream.time_base), stream=self._stream)

    def __iter__(self) -> Any:
        for frame in self.container.decode(self._stream):
            pixels = torch.from_numpy(frame.to_ndarray(format="rgb24")).permute(2, 0, 1)
            yield {"data": pixels, "pts": float(frame.pts * frame.time_base)}


if not hasattr(torchvision.io, "VideoReader"):
    torchvision.io.VideoReader = VideoReader
    torchvision.set_video_backend = lambda _: None

folder, out = sys.argv[1:]
dataset = LeRobotDataset("unicon/test", root=folder, video_backend="pyav")
items = [dataset[row] for row in range(len(dataset))]
found: dict[str, Any] = {
    key: np.stack([np.asarray(item[key]) for item in items]) for key in items[0] if key != "task"
}
found["task"] = np.array([item["task"] for item in items])
for key, each in dataset.meta.stats.items():
    found |= {f"stats/{key}/{name}": np.asarray(value) for name, value in each.items()}
for key in dataset.meta.episodes.column_names:
    found[f"episodes/{key}"] = np.array([str(episode[key]) for episode in dataset.meta.episodes])
# Statistics of single episodes, which the reader leaves out.
found["fps"], found["robot"] = np.array(dataset.fps), np.array(dataset.meta.robot_type)
for key, feature in dataset.meta.features.items():
    found[f"features/{key}"] = np.array(f"{feature['dtype']} {feature['shape']} {feature['names']}")
np.savez(out, **found)
