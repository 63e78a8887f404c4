"""Scene: the robot, its path, contacts and velocities in one viewer's 3D view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from viser import _messages

from unicon_base import AnyDict
from unicon_base.arrays import Array, Float32, Float64
from unicon_core.models.frames import yaw_of
from unicon_core.models.loaded import floors, import_mujoco
from unicon_core.models.posed import PosedModel, foot_bodies, foot_geoms
from unicon_core.models.terrain import load_on
from unicon_lab.view.page.plots import COMMANDED, MEASURED
from unicon_lab.view.page.shapes import shapes_of
from unicon_lab.view.shown import Shown

_PATH = (90, 90, 200)
_FOOT = (214, 39, 40)
_GRID, _HALF = (200, 204, 212), 12  # [m] from the middle to the edge
_STEP, _LONGEST = 0.03, 2000  # [m] between points of the path, and points at most
TOUCHING = 0.005
"""A foot nearer to the floor stands on it, [m]."""

_STILL = 1e-5  # [m], and of a quaternion: what moved less stays where it is
_ABOVE = 0.2  # [m] from the highest joint to the arrows
_SURE = 0.5  # of `foot_contact`


class Pose:
    """Where everything is in one tick; the same for all viewers.

    Attributes:
        position: of the model's bodies in the world in [m], shape (bodies, 3).
        quat: of the bodies, wxyz, shape (bodies, 4).
        base: position of the base in [m], shape (3,).
        feet: foot to its place in the world, [m], shape (3,).
        touching: feet that stand.
        arrows: from and to of the commanded and of the measured velocity, shape (2, 2, 3).
    """

    def __init__(self, bodies: int) -> None:
        self.position, self.quat = np.zeros((bodies, 3)), np.zeros((bodies, 4))
        self.base = np.zeros(3)
        self.feet: dict[str, Float64] = {}
        self.touching: frozenset[str] = frozenset()
        self.arrows = np.zeros((2, 2, 3))


class Stage:
    """The model of a run and where it is.

    Args:
        shown: the run.

    Raises:
        UniconError: the model cannot be read.
    """

    def __init__(self, shown: Shown) -> None:
        self._robot, self._mujoco = shown.robot, import_mujoco()
        assert shown.model is not None
        loaded = load_on(shown.model, shown.robot, shown.terrain)
        self._posed, self._model = PosedModel(loaded), loaded.model
        self.shapes = shapes_of(loaded)
        self._floats = loaded.base is not None
        feet = tuple(shown.robot.feet)
        self._feet = foot_bodies(loaded.model, feet)
        self._soles = foot_geoms(loaded.model, feet)
        self._floors = floors(loaded.model)
        self._uneven = shown.terrain is not None
        if self._uneven:  # no distances to a field of heights: its contacts are looked at
            for geoms in self._soles.values():
                loaded.model.geom_margin[geoms] = TOUCHING
        base = loaded.base
        self._body = 1 if base is None else int(loaded.model.jnt_bodyid[base])
        self.size = float(np.clip(loaded.model.stat.extent, 0.3, 3.0))
        self.pose = Pose(loaded.model.nbody)
        self._path = np.zeros((_LONGEST, 3), np.float32)
        self._points, self._tick, self._above = 0, -1, 0.0

    @property
    def path(self) -> Float32:
        """Places of the base behind the robot, on the ground, [m], shape (m, 3)."""
        return self._path[: self._points]

    def put(self, tick: int, states: Mapping[str, Array]) -> Pose:
        """Put the robot where the states of a tick say; return where everything is."""
        pose = self.pose
        if tick == self._tick:
            return pose
        if tick < self._tick:
            self._points = 0
        self._tick = tick
        joints = np.nan_to_num(np.asarray(states["joint_pos"], float))
        place = self._base(states)
        data = self._posed.put(joints, place)
        if self._floats and not place[:3].any():  # nobody measures where it is: stand it up
            heights = self._posed.heights()
            if heights:
                place[2] -= min(heights.values())
                data = self._posed.put(joints, place)
        pose.position[...], pose.quat[...] = data.xpos, data.xquat
        pose.base[...] = data.xpos[self._body]
        if not self._above:
            bodies = self._model.body_rootid == self._model.body_rootid[self._body]
            self._above = float(data.xpos[bodies, 2].max() - pose.base[2]) + _ABOVE
        pose.feet = {foot: np.array(data.xpos[body]) for foot, body in self._feet.items()}
        pose.feet |= {foot: np.array(data.geom_xpos[g[0]]) for foot, g in self._soles.items()}
        pose.touching = self._contacts(states)
        self._arrows(states, pose)
        self._walk(pose.base)
        return pose

    def _base(self, states: Mapping[str, Array]) -> Float64:
        place = np.zeros(7)
        place[3] = 1.0
        if "base_pos_w" in states and np.isfinite(states["base_pos_w"]).all():
            place[:3] = states["base_pos_w"]
        quat = np.asarray(states["base_quat"], float) if "base_quat" in states else place[3:]
        length = float(np.linalg.norm(quat))
        if np.isfinite(length) and length > 1e-3:
            place[3:] = quat / length
        return place

    def _contacts(self, states: Mapping[str, Array]) -> frozenset[str]:
        """Feet that stand: as `foot_contact` tells, else those whose sole is near the floor."""
        if "foot_contact" in states:
            sure = states["foot_contact"].reshape(-1)
            return frozenset(foot for foot, value in zip(self._robot.feet, sure) if value > _SURE)
        if self._uneven:
            return self._on_ground()
        distance, model, data = self._mujoco.mj_geomDistance, self._model, self._posed.data
        return frozenset(
            foot
            for foot, geoms in self._soles.items()
            if any(
                distance(model, data, floor, geom, 1.0, None) < TOUCHING
                for floor, geom in product(self._floors, geoms)
            )
        )

    def _on_ground(self) -> frozenset[str]:
        """Feet that touch what stands still."""
        model, data = self._model, self._posed.data
        self._mujoco.mj_collision(model, data)
        pairs = np.array(data.contact.geom).reshape(-1, 2)
        met = pairs[(model.body_weldid[model.geom_bodyid[pairs]] == 0).any(axis=1)]
        return frozenset(foot for foot, own in self._soles.items() if np.isin(met, own).any())

    def _arrows(self, states: Mapping[str, Array], pose: Pose) -> None:
        """Draw both velocities over the base, 1 m/s as 0.6 m, along its heading."""
        yaw = yaw_of(pose.quat[self._body])
        heading = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        for row, state in enumerate(("velocity_command", "base_lin_vel")):
            start = pose.base + np.array((0.0, 0.0, self._above + 0.06 * row))
            pose.arrows[row, 0] = pose.arrows[row, 1] = start
            if state in states and np.isfinite(states[state]).all():
                pose.arrows[row, 1, :2] += 0.6 * heading @ np.asarray(states[state][:2], float)

    def _walk(self, base: Float64) -> None:
        here = np.array((base[0], base[1], 0.01), np.float32)
        if self._points and np.linalg.norm(here - self._path[self._points - 1]) < _STEP:
            return
        if self._points == _LONGEST:  # every other point: the beginning stays in sight
            self._path[: _LONGEST // 2] = self._path[::2]
            self._points = _LONGEST // 2
        self._path[self._points] = here
        self._points += 1


def move(node: Any, position: Sequence[float], quat: Sequence[float] | None = None) -> None:
    """Put a node of a scene where it has moved to.

    Its own properties compare with what was there, which took half of a viewer's time.

    Args:
        node: viser's handle.
        position: in its parent in [m], three numbers.
        quat: likewise, wxyz; None where it never turns.
    """
    inside = node._impl
    queue = inside.api._queue_scene_message
    queue(_messages.SetPositionMessage(inside.name, tuple(position)))
    if quat is not None:
        queue(_messages.SetOrientationMessage(inside.name, tuple(quat)))


class Scene:
    """What one viewer sees in 3D.

    Args:
        api: viser's scene of this viewer.
        stage: the model; None where there is none to draw.

    Attributes:
        follow: the robot stays in the middle, and the ground passes below it.
        arrows, contacts, path: whether they are shown.
    """

    def __init__(self, api: Any, stage: Stage | None) -> None:
        self._stage = stage
        self.follow = self.arrows = self.contacts = self.path = True
        api.set_up_direction("+z")
        # Shadows, reflections and viser's grid are dear where no GPU draws.
        api.configure_default_lights(True, False)
        api.configure_environment_map(None)
        for name, colour, place in (("sun", 2.2, (3.0, -4.0, 6.0)), ("sky", 1.2, (-4.0, 3.0, 2.0))):
            api.add_light_directional(f"/{name}", intensity=colour, position=place)
        api.add_light_ambient("/ambient", intensity=0.6)
        self._world = api.add_frame("/world", show_axes=False)
        api.add_frame("/world/origin", axes_length=0.3, axes_radius=0.006)
        self._ground = api.add_line_segments("/world/ground", _squares(), _GRID, line_width=1.5)
        self._bodies: dict[int, Any] = {}
        self._feet: AnyDict = {}
        self._drawn, self._middle = -1, (0.0, 0.0)
        if stage is None:
            return
        self._poses = np.full((len(stage.pose.position), 7), np.inf)
        for body in sorted({shape.body for shape in stage.shapes}):
            self._bodies[body] = api.add_frame(f"/world/body_{body}", show_axes=False)
        for number, shape in enumerate(stage.shapes):
            opacity = shape.rgba[3]
            api.add_mesh_simple(
                f"/world/body_{shape.body}/shape_{number}",
                shape.vertices,
                shape.faces,
                color=tuple(round(255 * x) for x in shape.rgba[:3]),
                opacity=None if opacity > 0.98 else opacity,
                flat_shading=True,
                side="double",
            )
        for foot in stage.pose.feet or stage._feet:
            self._feet[foot] = api.add_icosphere(
                f"/world/contact_{foot}", radius=0.03, color=_FOOT, opacity=0.75, visible=False
            )
        radius = 0.012
        self._lines = api.add_line_segments(
            "/world/path", np.zeros((1, 2, 3), np.float32), _PATH, line_width=3.0
        )
        self._velocity = [
            api.add_arrows(
                f"/world/{name}",
                np.zeros((1, 2, 3), np.float32),
                colour,
                shaft_radius=radius,
                head_radius=2.5 * radius,
                head_length=5.0 * radius,
            )
            for name, colour in (("commanded", COMMANDED), ("measured", MEASURED))
        ]

    def draw(self, pose: Pose, whole: bool) -> None:
        """Put everything where it is in a tick.

        Args:
            pose: the tick's.
            whole: draw the path too.
        """
        stage = self._stage
        if stage is None:
            return
        poses = np.hstack([pose.position, pose.quat])
        for body in np.flatnonzero(np.abs(poses - self._poses).max(axis=1) > _STILL).tolist():
            self._poses[body] = poses[body]
            if body in self._bodies:
                place = poses[body].tolist()
                move(self._bodies[body], place[:3], place[3:])
        x, y = pose.base[:2].tolist() if self.follow else (0.0, 0.0)
        if (x, y) != self._middle:
            self._middle = x, y
            move(self._world, (-x, -y, 0.0))
            move(self._ground, (float(round(x)), float(round(y)), 0.0))
        for foot, ball in self._feet.items():
            stands = self.contacts and foot in pose.touching
            if stands:
                move(ball, pose.feet[foot].tolist())
            if ball.visible != stands:
                ball.visible = stands
        for arrow, (start, end) in zip(self._velocity, pose.arrows):
            shows = self.arrows and float(np.linalg.norm(end - start)) > 0.03
            if arrow.visible != shows:
                arrow.visible = shows
            if shows:
                arrow.points = np.array([[start, end]], np.float32)
        points = stage.path
        if self._lines.visible != self.path:
            self._lines.visible = self.path
        if whole and self.path and len(points) > 1 and len(points) != self._drawn:
            self._lines.points = np.stack([points[:-1], points[1:]], axis=1)
        self._drawn = len(points)


def _squares() -> Float32:
    """Return lines on the ground 1 m apart, shape (lines, 2, 3)."""
    at = np.arange(-_HALF, _HALF + 1, dtype=np.float32)
    lines = np.zeros((2, len(at), 2, 3), np.float32)
    lines[0, :, :, 0] = lines[1, :, :, 1] = at[:, None]
    lines[0, :, :, 1] = lines[1, :, :, 0] = (-_HALF, _HALF)
    return lines.reshape(-1, 2, 3)
