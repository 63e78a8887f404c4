"""Writers: a LeRobot data set, format v3.0, by pyarrow and PyAV; or by LeRobot's own package.

    meta/info.json, meta/stats.json, meta/tasks.parquet
    meta/episodes/chunk-000/file-000.parquet      where each episode stands, and its statistics
    data/chunk-000/file-000.parquet               all numbers, a row for each frame
    videos/observation.images.front/chunk-000/file-000.mp4

The layout is that of LeRobot 0.4 (codebase_version v3.0), whose own reader opens it:
https://huggingface.co/docs/lerobot/lerobot-dataset-v3
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from importlib import import_module
from importlib import metadata as packages
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import AnyDict, AnyMapping, MissingDependencyError, UniconError, imported, one_line
from unicon_base.arrays import Array
from unicon_lab.datasets.columns import DEFAULTS, Episode, Feature, info_of
from unicon_lab.datasets.pictures import Video
from unicon_lab.datasets.statistics import Statistics, joined, of_pictures, of_values

CHUNK = 1000
"""Files of a folder `chunk-000`."""


class Files:
    """Files of one kind, one after the other.

    Args:
        root: of the data set.
        pattern: of their names below it.
        largest: behind the episode that goes beyond so many MiB a next one begins.

    Attributes:
        began: the last `next_path` was that of another file than before.
    """

    def __init__(self, root: Path, pattern: str, largest: int) -> None:
        self._root, self._pattern, self._largest = root, pattern, largest << 20
        self._number, self.began = -1, False
        self._path = root

    def next_path(self) -> tuple[Path, AnyDict]:
        """Return the file for the next episode, and its place for `meta/episodes`."""
        # An encoder looks far ahead before it writes its first byte.
        there = self._number >= 0 and self._path.exists()
        self.began = self._number < 0 or (there and self._path.stat().st_size >= self._largest)
        self._number += self.began
        chunk, file = divmod(self._number, CHUNK)
        place = {"chunk_index": chunk, "file_index": file}
        if self.began:
            self._path = self._root / self._pattern.format(**place)
            self._path.parent.mkdir(parents=True, exist_ok=True)
        return self._path, place


TASK_INDEX = Path(__file__).with_name("task_index.json")
"""What lets pandas take the tasks for the index of their numbers."""


def write_json(path: Path, content: AnyMapping) -> None:
    """Write a file of `meta`; its folder is made.

    Raises:
        OSError: it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=4, ensure_ascii=False), "utf-8")


VERSION = "v3.0"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
DATA_MB, VIDEO_MB = 100, 200
"""Where a next file begins in [MiB]: behind the episode that goes beyond."""


def import_pyarrow() -> Any:
    """Return pyarrow with its Parquet.

    Raises:
        MissingDependencyError: it is not installed.
    """
    pyarrow = imported("pyarrow", "a LeRobot data set", "lerobot")
    import_module("pyarrow.parquet")
    return pyarrow


class DatasetWriter:
    """The data set.

    Args:
        root: folder, which does not exist.
        fps: frames a second.
        features: of a frame, but for those that every data set has.
        robot: its name.

    Raises:
        OSError: it cannot be written.
        MissingDependencyError: pyarrow is not installed.
    """

    name = "pyarrow"

    def __init__(self, root: Path, fps: int, features: Mapping[str, Feature], robot: str) -> None:
        self._arrow = import_pyarrow()
        self._root, self._fps, self._robot = root, fps, robot
        self._features = {**features, **DEFAULTS}
        self._data = Files(root, DATA, DATA_MB)
        self._videos = {
            key: Files(root, VIDEO.replace("{video_key}", key), VIDEO_MB)
            for key, feature in features.items()
            if feature.dtype == "video"
        }
        self._table: Any = None
        self._open: dict[str, Video] = {}
        self._tasks: dict[str, int] = {}
        self._rows: list[AnyDict] = []
        self._statistics: list[dict[str, Statistics]] = []
        self._frames = 0

    def add(self, episode: Episode, values: Mapping[str, Array], task: str) -> None:
        """Add an episode.

        Args:
            episode: has the pictures.
            values: feature to its numbers, shape (frames, elements).
            task: what was done, in words.

        Raises:
            OSError: it cannot be written.
        """
        number, count = len(self._rows), len(episode.rows)
        frames = np.arange(count)
        every = {
            **values,
            "timestamp": (frames / self._fps).astype(np.float32),
            "frame_index": frames,
            "episode_index": np.full(count, number),
            "index": frames + self._frames,
            "task_index": np.full(count, self._tasks.setdefault(task, len(self._tasks))),
        }
        row = {"episode_index": number, "tasks": [task], "length": count}
        statistics: dict[str, Statistics] = {}
        for key, feature in self._features.items():
            if feature.camera:
                statistics[key] = of_pictures(episode.shown[feature.camera])
            else:
                statistics[key] = of_values(every[key].reshape(count, -1))
        row |= self._write_table(episode, every)
        row["dataset_from_index"], row["dataset_to_index"] = self._frames, self._frames + count
        for key in self._videos:
            row |= self._write_video(key, episode)
        for key, found in statistics.items():
            row |= {f"stats/{key}/{name}": value.tolist() for name, value in found.items()}
        row |= {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
        self._rows.append(row)
        self._statistics.append(statistics)
        self._frames += count

    def finish(self) -> None:
        """Write what stands in `meta`.

        Raises:
            OSError: it cannot be written.
        """
        arrow = self._arrow
        if self._table is not None:
            self._table.close()
        for video in self._open.values():
            video.close()
        episodes = self._root / EPISODES.format(chunk_index=0, file_index=0)
        episodes.parent.mkdir(parents=True)
        arrow.parquet.write_table(arrow.Table.from_pylist(self._rows), episodes)
        tasks = arrow.table(
            {"task_index": [*self._tasks.values()], "__index_level_0__": [*self._tasks]},
            metadata={"pandas": TASK_INDEX.read_text("utf-8")},
        )
        arrow.parquet.write_table(tasks, self._root / "meta/tasks.parquet")
        found = joined(self._statistics)
        plain = {k: {name: v.tolist() for name, v in each.items()} for k, each in found.items()}
        write_json(self._root / "meta/stats.json", plain)
        totals = {
            "codebase_version": VERSION,
            "robot_type": self._robot,
            "total_episodes": len(self._rows),
            "total_frames": self._frames,
            "total_tasks": len(self._tasks),
            "chunks_size": CHUNK,
            "data_files_size_in_mb": DATA_MB,
            "video_files_size_in_mb": VIDEO_MB,
            "fps": self._fps,
            "splits": {"train": f"0:{len(self._rows)}"},
            "data_path": DATA,
            "video_path": VIDEO if self._videos else None,
            "features": info_of(self._features, self._fps),
        }
        write_json(self._root / "meta/info.json", totals)

    def _write_table(self, episode: Episode, every: Mapping[str, Array]) -> AnyDict:
        """Write the numbers as one row group; return where they are."""
        arrow = self._arrow
        arrays, fields = [], []
        for key, feature in self._features.items():
            if feature.dtype == "video":
                continue
            if feature.dtype == "image":
                shown = episode.shown[feature.camera]
                packed = [{"bytes": shown.encoded(k), "path": None} for k in range(len(shown))]
                parts = [("bytes", arrow.binary()), ("path", arrow.string())]
                array = arrow.array(packed, arrow.struct(parts))
            else:
                flat = np.ascontiguousarray(every[key].astype(feature.dtype, copy=False))
                array, width = arrow.array(flat.reshape(-1)), feature.shape[0]
                if width > 1:
                    array = arrow.FixedSizeListArray.from_arrays(array, width)
            arrays.append(array)
            fields.append(arrow.field(key, array.type))
        described = {k: told for k, f in self._features.items() if (told := f.described())}
        metadata = {"huggingface": json.dumps({"info": {"features": described}})}
        schema = arrow.schema(fields, metadata=metadata)
        path, place = self._data.next_path()
        if self._data.began or self._table is None:
            if self._table is not None:
                self._table.close()
            self._table = arrow.parquet.ParquetWriter(path, schema)
        self._table.write_table(arrow.Table.from_arrays(arrays, schema=schema))
        return {f"data/{name}": value for name, value in place.items()}

    def _write_video(self, key: str, episode: Episode) -> AnyDict:
        """Write the pictures of a camera behind those before; return where they are."""
        feature, files = self._features[key], self._videos[key]
        path, place = files.next_path()
        if files.began:
            if key in self._open:
                self._open[key].close()
            self._open[key] = Video(path, self._fps, feature.shape[0], feature.shape[1])
        video = self._open[key]
        first = video.frames
        shown = episode.shown[feature.camera]
        for number in range(len(shown)):
            video.add(shown.rgb(number))
        place |= {"from_timestamp": first / self._fps, "to_timestamp": video.frames / self._fps}
        return {f"videos/{key}/{name}": value for name, value in place.items()}


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

    def add(self, episode: Episode, values: Mapping[str, Array], task: str) -> None:
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
            frame = {key: each[number] for key, each in typed.items()}
            for key, feature in self._features.items():
                if feature.camera:
                    frame[key] = np.array(episode.shown[feature.camera].rgb(number))
            self._set.add_frame(frame | {"task": task})
        self._set.save_episode()

    def finish(self) -> None:
        """Write what is left."""
        self._set.finalize()
