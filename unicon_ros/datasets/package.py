"""PackageWriter: the same data set through LeRobot's own package, where it is installed."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from importlib import import_module
from importlib import metadata as packages
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import MissingDependencyError, UniconError, one_line
from unicon_ros.datasets.episodes import Episode
from unicon_ros.datasets.features import Feature, info_of
from unicon_ros.datasets.writer import VERSION

MODULE = "lerobot.datasets.lerobot_dataset"


def import_lerobot() -> Any:
    """Return the module of LeRobot's data sets.

    Raises:
        MissingDependencyError: it is not installed.
        UniconError: it writes another version of the format, or cannot be imported.
    """
    os.environ.setdefault("SVT_LOG", "0")  # else its encoder tells its settings
    try:
        module = import_module(MODULE)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "lerobot":
            raise UniconError(
                f"lerobot lacks {error.name}: pip install {error.name}, or --writer own"
            ) from error
        raise MissingDependencyError("--writer lerobot", "lerobot", "pip install lerobot") from None
    except Exception as error:  # whatever its import raises
        raise UniconError(
            f"lerobot cannot be imported: {one_line(error)}; mend it, or give --writer own"
        ) from error
    version = getattr(module, "CODEBASE_VERSION", "another format")
    if version != VERSION:
        raise UniconError(
            f"the installed lerobot writes {version}, not {VERSION}: pip install -U lerobot, or "
            "give --writer own"
        )
    return module


class PackageWriter:
    """The data set, as `DatasetWriter`.

    Args:
        root: folder, which does not exist.
        fps: frames a second.
        features: of a frame, but for those that every data set has.
        robot: its name.

    Attributes:
        name: of the package with its version.
    """

    def __init__(self, root: Path, fps: int, features: Mapping[str, Feature], robot: str) -> None:
        module = import_lerobot()
        self.name = "lerobot"
        with suppress(packages.PackageNotFoundError):
            self.name += f" {packages.version('lerobot')}"
        self._features = features
        self._module = module
        described = info_of(features, fps)
        for each in described.values():  # told by the package itself
            each.pop("info", None)
            each["shape"] = tuple(each["shape"])
        video = any(feature.dtype == "video" for feature in features.values())
        import_module("datasets").disable_progress_bars()
        self._set = module.LeRobotDataset.create(
            f"unicon/{root.name}", fps, described, root=root, robot_type=robot, use_videos=video
        )

    def add(self, episode: Episode, values: Mapping[str, NDArray[Any]], task: str) -> None:
        """Add an episode.

        Args:
            episode: has the pictures.
            values: feature to its numbers, shape (frames, elements).
            task: what was done, in words.
        """
        typed = {
            key: values[key].astype(feature.dtype, copy=False)
            for key, feature in self._features.items()
            if not feature.camera
        }
        for number in range(len(episode.rows)):
            frame: dict[str, Any] = {key: each[number] for key, each in typed.items()}
            for key, feature in self._features.items():
                if feature.camera:
                    frame[key] = np.array(episode.shown[feature.camera].rgb(number))
            self._set.add_frame(frame | {"task": task})
        self._set.save_episode()

    def finish(self) -> None:
        """Write what is left."""
        self._set.finalize()
