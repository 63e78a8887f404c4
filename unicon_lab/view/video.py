"""Film: a recording as a video: the robot, the ghost of its targets, plots and the time."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from unicon_base import UniconError, alternatives, cannot, imported
from unicon_base.arrays import Float64, UInt8
from unicon_core.drawing import MARK, PALE, as_png, drawn
from unicon_core.models.camera import drawing_mujoco, offscreen
from unicon_core.models.loaded import import_mujoco
from unicon_core.page import ROOM
from unicon_core.signals import SIGNALS
from unicon_core.terrain.ground import ground_of
from unicon_lab.datasets.pictures import Video
from unicon_lab.recording import Record
from unicon_lab.view.recorded import RecordedSource, shown_in

CODECS: dict[str, tuple[str, dict[str, str]]] = {
    ".mp4": ("libx264", {"crf": "21", "preset": "fast"}),
    ".webm": ("libvpx-vp9", {"crf": "32", "b": "0", "deadline": "realtime", "cpu-used": "8"}),
    ".webp": ("libwebp_anim", {"quality": "70"}),
    ".gif": ("", {}),
}
"""Ending of a file to FFmpeg's encoder and its options; Pillow writes GIF."""
MOST = 36_000
"""Frames of a video: 20 minutes at 30 a second."""
_SHARE = 0.22  # of the height that a plot takes
_ROOM = 40  # [pixels] that a plot needs
_NAMED = 6  # lines of a plot at most that a legend names
_EASE = 0.25  # [s] in which the camera follows the base
_SUN = np.array((2.0, -3.0, 6.0))  # [m] from what the camera looks at
_GHOST = (0.27, 0.51, 0.9, 0.35)
_SAME = 2e-3  # [m], and of a quaternion: a target that near hides nothing
_GROUND = (0.70, 0.73, 0.70, 1.0)


class Film:
    """Draws the frames of a recording.

    Args:
        record: it.
        size: width and height of a frame, [pixels].
        ghost: draw the targets of the joints, too.
        plots: `STATE` or `STATE:ELEMENT` each, drawn below the robot.

    Attributes:
        notes: what could not be shown, one line each.
        end: time of the last tick in [s]; the first one is at 0.

    Raises:
        UniconError: there is nothing to draw, or no such state or element.
        MissingDependencyError: viser, Pillow, or for plots matplotlib is not installed.
    """

    def __init__(
        self, record: Record, size: tuple[int, int], ghost: bool, plots: Sequence[str]
    ) -> None:
        drawing_mujoco("unicon video")
        imported("viser", "unicon video", "video")
        self._image = imported("PIL.Image", "unicon video", "video", "pillow")
        from unicon_lab.view.page.scene import Stage

        record.need("sent", ["joint_pos", *(["joint_pos_target"] if ghost else ())])
        shown, self.notes = shown_in(record)
        if shown.model is None:
            why = "; ".join(self.notes) or "its file names no model"
            raise UniconError(f"unicon video: robot {shown.robot.name} cannot be drawn: {why}")
        self._source, self._record = RecordedSource(record, shown), record
        self.end = self._source.span[1]
        place = "base_pos_w"
        if shown.robot.floats and not (
            place in record.layout.specs and np.isfinite(record.states(place)).any()
        ):
            self.notes.append(f"the record has no {place}: the robot stays in its place")
        self._curves = [_curve(record, each) for each in plots]
        self._size, self._ghost = size, ghost
        rows = round(min(_SHARE * len(plots), 0.6) * size[1])
        if plots and (rows < _ROOM * len(plots) + 12 or size[0] < 96):
            given = f"--size {size[0]}x{size[1]}"
            raise UniconError(f"{given} has no room for the plots; give a larger one")
        self._view = size[0], size[1] - rows
        self._stage = Stage(shown)
        floor = 0.0 if shown.terrain is None else ground_of(shown.terrain).floor - 1e-3
        self._model = _model(self._stage, self._view, ghost, floor)
        self._data = import_mujoco().MjData(self._model)

    def frames(self, begin: float, end: float, step: float) -> Iterator[UInt8]:
        """Yield a frame each step of the recording's time, shape (height, width, 3).

        Args:
            begin: time of the first frame in [s].
            end: no frame is later, in [s].
            step: time between two in [s].

        Raises:
            UniconError: there is no offscreen OpenGL.
        """
        self._renderer = offscreen(self._model, self._view, "unicon video")
        stage, camera = self._stage, _camera(self._stage, self._view)
        offset, look = np.array(camera.lookat), np.full(3, np.nan)
        below = self._plots(begin, end) if self._curves else None
        for k in range(int((end - begin) / step + 1e-6) + 1):
            moment = begin + k * step
            self._source.seek(moment)
            tick = self._source.latest()
            assert tick is not None
            pose = stage.put(tick.tick, tick.states)
            if k == 0:
                look, height = pose.base.copy(), pose.base[2]
            look += (pose.base - look) * min(step / _EASE, 1.0)
            camera.lookat = offset + look - (0.0, 0.0, height)
            poses = [np.hstack([pose.position, pose.quat])]
            if self._ghost:
                target = np.hstack(stage.ghost(tick.states, pose))
                target[np.abs(target - poses[0]).max(axis=1) < _SAME, 2] -= 1e3  # out of sight
                poses.append(target)
            picture = self._draw(np.vstack(poses), camera)
            pixels = picture if below is None else np.vstack([picture, below[0]])
            if below is not None:
                left, right = below[1]
                at = round(left + (right - left) * (moment - begin) / max(end - begin, 1e-9))
                pixels[self._view[1] :, max(at - 1, 0) : at + 1] = (214, 39, 40)
            yield self._stamped(pixels, f"{moment:.2f} s")

    def _draw(self, poses: Float64, camera: Any) -> UInt8:
        """Return the picture of the bodies in their places, position and quaternion each."""
        data, mujoco = self._data, import_mujoco()
        data.mocap_pos[...], data.mocap_quat[...] = poses[:, :3], poses[:, 3:]
        mujoco.mj_kinematics(self._model, data)
        data.light_xpos[...], data.light_xdir[...] = camera.lookat + _SUN, -_SUN / 7.0
        self._renderer.update_scene(data, camera)
        picture: UInt8 = self._renderer.render()
        return picture

    def _stamped(self, pixels: UInt8, text: str) -> UInt8:
        draws, fonts = (imported(f"PIL.{name}", "", "video") for name in ("ImageDraw", "ImageFont"))
        image = self._image.fromarray(pixels)
        size = max(self._size[1] // 22, 11)
        font = fonts.load_default(size)
        draws.Draw(image).text((size // 2, size // 3), text, fill=(30, 30, 30), font=font)
        return np.asarray(image)

    def _plots(self, begin: float, end: float) -> tuple[UInt8, tuple[float, float]]:
        """Return the picture of the plots, and where its axes begin and end, [pixels]."""
        ends = [0.0, 0.0]
        width, height = self._size[0], self._size[1] - self._view[1]

        def fill(figure: Any) -> bool:
            figure.set_size_inches(width / figure.dpi, height / figure.dpi)
            every = figure.subplots(len(self._curves), 1, sharex=True, squeeze=False)[:, 0]
            seen = (self._source.times >= begin - 1.0) & (self._source.times <= end + 1.0)
            for axes, (label, unit, names, *lines) in zip(every, self._curves):
                for values, colour in zip(lines, (MARK, PALE) if len(lines) > 1 else (None,)):
                    axes.plot(self._source.times[seen], values[seen], color=colour)
                if 1 < len(names) <= _NAMED:
                    axes.legend(
                        names,
                        loc="upper right",
                        ncols=len(names),
                        fontsize=6,
                        handlelength=1,
                        borderpad=0,
                        borderaxespad=0,
                    )
                axes.set_title(f"{label} [{unit}]" if unit else label, fontsize=6, loc="left")
                axes.tick_params(labelsize=7)
            every[0].set_xlim(begin, max(end, begin + 1e-6))
            figure.draw_without_rendering()
            ends[:] = every[0].bbox.x0, every[0].bbox.x1
            return True

        figure = drawn(fill)
        assert figure is not None
        image = self._image.open(io.BytesIO(as_png(figure))).convert("RGB")
        return np.asarray(image.resize((width, height))), (ends[0], ends[1])


def _curve(record: Record, what: str) -> tuple[Any, ...]:
    """Return label, unit, names and values of a plot, shape (ticks, …); those of a target, too."""
    imported("matplotlib", "--plot", "video")
    name, _, element = what.partition(":")
    record.need("sent", [name])
    layout = record.layout
    spec = layout.specs[name]
    values = [record.states(name).reshape(len(record.ticks), -1)[:, : spec.size]]
    names = [each.partition(".")[2] for each in layout.elements(name)][: spec.size]
    if element:
        numbers = {str(number): number for number in range(len(names))}
        at = ({each: k for k, each in enumerate(names)} | numbers).get(element)
        if at is None:
            raise UniconError(
                f"--plot {what}: {name} has no element {element!r}; {alternatives(element, names)}"
            )
        if f"{name}_target" in layout.specs:
            values.append(record.states(f"{name}_target").reshape(len(record.ticks), -1))
        values = [each[:, at] for each in values]
        names = ["measured", "target"][: len(values)]
    return what.replace(":", " "), spec.unit, names, *(each.astype(np.float64) for each in values)


def _model(stage: Any, size: tuple[int, int], ghost: bool, floor: float) -> Any:
    """Return an `MjModel` of a stage's shapes on a floor at a height in [m]; bodies are put."""
    mujoco = import_mujoco()
    spec = mujoco.MjSpec.from_file(str(Path(__file__).with_name("video.xml")))
    vis, world = spec.visual, spec.worldbody
    vis.global_.offwidth, vis.global_.offheight = size
    vis.map.shadowclip = 2.0 * stage.size
    spec.geom("floor").pos[2] = floor
    for copy in range(1 + ghost):
        bodies = [world.add_body(mocap=True) for _ in stage.pose.position]
        for number, shape in enumerate(stage.shapes):
            if copy and not shape.body:
                continue
            mesh = spec.add_mesh(name=f"{copy}_{number}")
            mesh.uservert, mesh.userface = shape.vertices.ravel(), shape.faces.ravel()
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            geom = bodies[shape.body].add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name)
            geom.contype = geom.conaffinity = 0  # else MuJoCo makes hulls
            geom.rgba = _GHOST if copy else shape.rgba if shape.body else _GROUND
    return spec.compile()


def _camera(stage: Any, size: tuple[int, int]) -> Any:
    """Return a camera that stands as that of the live page, of a robot over the origin."""
    from unicon_lab.view.page.scene import aim

    mujoco = import_mujoco()
    page: Any = SimpleNamespace(image_width=size[0] * 100, image_height=size[1] * 100)
    aim(page, stage, 0.0)
    ahead = page.look_at - page.position
    camera = mujoco.MjvCamera()
    camera.distance = float(np.linalg.norm(ahead))
    camera.azimuth = float(np.degrees(np.arctan2(ahead[1], ahead[0])))
    camera.elevation = float(np.degrees(np.arcsin(ahead[2] / camera.distance)))
    camera.lookat = page.look_at
    return camera


def write_video(path: Path, frames: Iterable[UInt8], fps: float) -> int:
    """Write a video beside its place and give it its name when it is whole; return its frames.

    Args:
        path: ends in one of `CODECS`.
        frames: shape (height, width, 3) each.
        fps: frames a second.

    Raises:
        UniconError: it cannot be written.
        Interrupted: a signal asked to end.
    """
    half, count = path.with_name(f".{os.getpid()}.{path.name}"), 0
    codec, options = CODECS[path.suffix.lower()]
    if codec:
        av = imported("av", f"a video {path.suffix}", "video")
        if codec not in av.codecs_available:
            raise UniconError(
                f"cannot write {path}: PyAV has no encoder {codec} here; give a name in .gif"
            )
    video: Any = None
    try:
        with cannot(f"write {path}", ROOM):
            for frame in frames:
                SIGNALS.check()
                height, width = frame.shape[:2]
                if video is None and codec:
                    video = Video(half, fps, height, width, codec, options)
                video = video or _Gif(half, fps)
                video.add(frame)
                count += 1
            video.close()
            half.replace(path)
    finally:
        with suppress(OSError):
            half.unlink(missing_ok=True)
    return count


class _Gif:
    """A GIF that is being written, with the colours of its first frame; as `Video`.

    Pillow would keep all frames to the end. Of each only the part that differs is written.
    """

    def __init__(self, path: Path, fps: float) -> None:
        self._gif = imported("PIL.GifImagePlugin", "unicon video", "video", "pillow")
        self._file, self._seen, self._first = path.open("wb"), np.zeros(0, np.uint8), None
        self._info = {"duration": 1000.0 / fps, "loop": 0}

    def add(self, pixels: UInt8) -> None:
        image, box = self._gif.Image.fromarray(pixels), (0, 0, *pixels.shape[1::-1])
        image = image.quantize(255, palette=self._first, dither=0)
        seen, self._seen = self._seen, np.asarray(image)
        if self._first is None:
            self._first = image
            self._file.writelines(self._gif.getheader(image, info=self._info)[0])
        else:
            box = self._gif.Image.fromarray(seen ^ self._seen).getbbox() or (0, 0, 1, 1)
            self._info["transparency"] = 255  # no colour of the first frame has that number
            image = self._gif.Image.fromarray(
                np.where(seen == self._seen, np.uint8(255), self._seen)
            )
        self._file.writelines(self._gif.getdata(image.crop(box), box[:2], **self._info))

    def close(self) -> None:
        self._file.write(b";")
        self._file.close()
