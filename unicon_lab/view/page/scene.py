"""Scene: the robot, its path, contacts and velocities in one viewer's 3D view."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from unicon_base import AnyDict
from unicon_base.arrays import Array, Float32, Float64
from unicon_core.models.frames import yaw_of
from unicon_core.models.loaded import import_mujoco
from unicon_core.models.posed import FootContacts, PosedModel, foot_bodies
from unicon_core.models.terrain import load_on
from unicon_core.platforms.kit.base import rotation
from unicon_core.states.standard import EXTERNAL_FORCE
from unicon_lab.view.page.plots import COMMANDED, MEASURED
from unicon_lab.view.page.shapes import Looks, move, shapes_of
from unicon_lab.view.shown import Shown

_PATH = (90, 90, 200)
_FOOT = (214, 39, 40)
_GRID, _HALF = (140, 146, 158), 12  # [m] from the middle to the edge
_STEP, _LONGEST = 0.03, 2000  # [m] between points of the path, and points at most
_ABOVE = 0.2  # [m] from the highest joint to the arrows
_BACK = 500_000_000  # [ns] by which time goes back at a reset; clocks of robots may jitter
_FORCE = 2  # its row of the arrows
_WHOLE = 30.0  # [N]: less than that is drawn as a shorter arrow
_SURE = 0.5  # of `foot_contact`


class Pose:
    """Where everything is in one tick; the same for all viewers.

    Attributes:
        position: of the model's bodies in the world in [m], shape (bodies, 3).
        quat: of the bodies, wxyz, shape (bodies, 4).
        base: position of the base in [m], shape (3,).
        feet: foot to its place in the world, [m], shape (3,).
        touching: feet that stand.
        arrows: from and to of the commanded and the measured velocity, and of the force of a
            viewer on a body, shape (3, 2, 3).
        newton: that force in [N].
    """

    def __init__(self, bodies: int) -> None:
        self.position, self.quat = np.zeros((bodies, 3)), np.zeros((bodies, 4))
        self.base = np.zeros(3)
        self.feet: dict[str, Float64] = {}
        self.touching: frozenset[str] = frozenset()
        self.arrows, self.newton = np.zeros((3, 2, 3)), 0.0


class Stage:
    """The model of a run and where it is.

    Args:
        shown: the run.

    Attributes:
        shapes: of its bodies.
        dragged: bodies that a viewer may drag, to their numbers in `Shown.bodies`.
        size: of the robot in its default pose, corner to corner, in [m].
        middle: of the robot then, from the point on the ground below its base, in [m], shape (3,).
        pose: of the newest tick.

    Raises:
        UniconError: the model cannot be read.
    """

    def __init__(self, shown: Shown) -> None:
        self._robot, self._mujoco = shown.robot, import_mujoco()
        assert shown.model is not None
        loaded = load_on(shown.model, shown.robot, shown.terrain)
        self._posed, self._model = PosedModel(loaded), loaded.model
        self.shapes = shapes_of(loaded)
        names = {name: number for number, name in enumerate(shown.bodies) if number and name}
        self.dragged = {
            body: number
            for body in range(1, loaded.model.nbody)
            if (number := names.get(loaded.model.body(body).name))
        }
        self._floats = loaded.base is not None
        feet = tuple(shown.robot.feet)
        self._feet = foot_bodies(loaded.model, feet)
        self._touching = FootContacts(self._posed, feet, shown.terrain is not None)
        base = loaded.base
        self._body = 1 if base is None else int(loaded.model.jnt_bodyid[base])
        self.pose, self._then = (Pose(loaded.model.nbody) for _ in range(2))
        self._target: PosedModel | None = None
        self._path = np.zeros((_LONGEST, 3), np.float32)
        self._points, self._tick, self._above = 0, -1, 0.0
        self._stamp = 0
        start = np.array((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
        data = self._stand(np.nan_to_num(shown.robot.default_joint_pos), start)
        own = loaded.model.body_rootid == loaded.model.body_rootid[self._body]
        seen = [
            data.xpos[shape.body] + shape.vertices @ data.xmat[shape.body].reshape(3, 3).T
            for shape in self.shapes
            if own[shape.body]
        ]
        corners = np.vstack(seen or [data.xpos])
        low, high = corners.min(axis=0), corners.max(axis=0)
        self.size = max(float(np.linalg.norm(high - low)), 0.1)
        self.middle = 0.5 * (low + high) - data.xpos[self._body] * (1.0, 1.0, 0.0)

    @property
    def path(self) -> Float32:
        """Places of the base behind the robot, on the ground, [m], shape (m, 3)."""
        return self._path[: self._points]

    def put(self, tick: int, states: Mapping[str, Array]) -> Pose:
        """Put the robot where the states of a tick say; return where everything is."""
        pose = self.pose
        if tick == self._tick:
            return pose
        stamp = int(states["stamp_ns"].item()) if "stamp_ns" in states else 0
        if tick < self._tick or stamp < self._stamp - _BACK:  # a reset
            self._points = 0
        self._tick, self._stamp = tick, stamp
        self._fill(pose, states)
        self._walk(pose.base)
        return pose

    def past(self, states: Mapping[str, Array]) -> Pose:
        """Return where everything was with other states; the newest pose and the path stay."""
        self._fill(self._then, states)
        return self._then

    def _fill(self, pose: Pose, states: Mapping[str, Array]) -> None:
        joints = np.nan_to_num(np.asarray(states["joint_pos"], float))
        data = self._stand(joints, self._base(states))
        pose.position[...], pose.quat[...] = data.xpos, data.xquat
        pose.base[...] = data.xpos[self._body]
        if not self._above:
            bodies = self._model.body_rootid == self._model.body_rootid[self._body]
            self._above = float(data.xpos[bodies, 2].max() - pose.base[2]) + _ABOVE
        pose.feet = {foot: np.array(data.xpos[body]) for foot, body in self._feet.items()}
        pose.feet |= {
            foot: np.array(data.geom_xpos[g[0]]) for foot, g in self._touching.soles.items()
        }
        pose.touching = self._contacts(states)
        self._arrows(states, pose)
        if EXTERNAL_FORCE in states:
            force, point = states[EXTERNAL_FORCE], states[f"{EXTERNAL_FORCE}_point"]
            pose.newton = float(np.linalg.norm(force))
            pose.arrows[_FORCE] = point, point + 0.4 * self.size * force / max(pose.newton, _WHOLE)

    def held(self, body: int, point: ArrayLike) -> Float64:
        """Return where a point of the world is in the frame of a body, in [m], shape (3,)."""
        turned = rotation(self.pose.quat[body])
        return np.asarray((np.asarray(point) - self.pose.position[body]) @ turned)

    def ghost(self, states: Mapping[str, Array], pose: Pose) -> tuple[Float64, Float64]:
        """Return positions and quaternions of bodies at `joint_pos_target`, on the base of a pose.

        Joints without stiffness, or without targets in a recording of others, are where they are
        measured.
        """
        if self._target is None:
            self._target = PosedModel(self._posed.loaded)
        measured = states["joint_pos"]
        target = np.asarray(states.get("joint_pos_target", measured), float)
        held = np.isfinite(target) & (states.get("joint_stiffness", 1.0) > 0.0)
        joints = np.where(held, target, np.nan_to_num(measured))
        base = self._body
        place = np.concatenate([pose.position[base], pose.quat[base]])
        data = self._target.put(joints, place)
        return data.xpos, data.xquat

    def _stand(self, joints: Float64, place: Float64) -> Any:
        """Put the model somewhere, on the ground where the base has no measured position."""
        data = self._posed.put(joints, place)
        if self._floats and not place[:3].any():
            heights = self._posed.heights()
            if heights:
                place[2] -= min(heights.values())
                data = self._posed.put(joints, place)
        return data

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
        return self._touching()

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


class Scene:
    """What one viewer sees in 3D.

    Args:
        api: viser's scene of this viewer.
        stage: the model; None where there is none to draw.

    Attributes:
        follow: the robot stays in the middle, and the ground passes below it.
        arrows, contacts, path, ghost: whether they are shown.
    """

    def __init__(self, api: Any, stage: Stage | None) -> None:
        self._stage, self._api = stage, api
        self.follow = self.arrows = self.contacts = self.path = True
        self.ghost = False
        self._ghost: Looks | None = None
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
        self._feet: AnyDict = {}
        self._drawn, self._middle = -1, (0.0, 0.0)
        if stage is None:
            return
        self._robot = Looks(api, stage.shapes, "body")
        for foot in stage.pose.feet or stage._feet:
            self._feet[foot] = api.add_icosphere(
                f"/world/contact_{foot}", radius=0.03, color=_FOOT, opacity=0.75, visible=False
            )
        self._lines = api.add_line_segments(
            "/world/path", np.zeros((1, 2, 3), np.float32), _PATH, line_width=3.0
        )
        points, radius = np.zeros((1, 2, 3), np.float32), 0.012
        self._newton = api.add_label("/world/newton", "", visible=False)
        self._velocity = [
            api.add_arrows(
                f"/world/{name}",
                points,
                colour,
                shaft_radius=radius,
                head_radius=2.5 * radius,
                head_length=5.0 * radius,
            )
            for name, colour in (("commanded", COMMANDED), ("measured", MEASURED), ("force", _FOOT))
        ]

    def draw(self, pose: Pose, states: Mapping[str, Array], whole: bool) -> None:
        """Put everything where it is in a tick.

        Args:
            pose: the tick's.
            states: of the tick.
            whole: draw the path too.
        """
        stage = self._stage
        if stage is None:
            return
        self._robot.put(pose.position, pose.quat)
        if self.ghost and self._ghost is None:
            self._ghost = Looks(self._api, stage.shapes, "ghost")
        if self._ghost is not None:
            self._ghost.root.visible = self.ghost
        if self._ghost is not None and self.ghost:
            self._ghost.put(*stage.ghost(states, pose))
        x, y = pose.base[:2].tolist() if self.follow else (0.0, 0.0)
        if (x, y) != self._middle:
            self._middle = x, y
            move(self._world, (-x, -y, 0.0))
            move(self._ground, (float(round(x)), float(round(y)), 0.0))
        for foot, ball in self._feet.items():
            stands = self.contacts and foot in pose.touching
            if stands:
                move(ball, pose.feet[foot].tolist())
            ball.visible = stands
        for row, (arrow, (start, end)) in enumerate(zip(self._velocity, pose.arrows)):
            long = float(np.linalg.norm(end - start)) > 0.03
            arrow.visible = shows = long and (self.arrows or row == _FORCE)
            if shows:
                arrow.points = np.array([[start, end]], np.float32)
        self._newton.visible = pose.newton > 0.0
        if pose.newton:
            self._newton.text = f"{pose.newton:.0f} N"
            move(self._newton, pose.arrows[_FORCE, 1].tolist())
        points = stage.path
        self._lines.visible = self.path
        if whole and self.path and len(points) > 1 and len(points) != self._drawn:
            self._lines.points = np.stack([points[:-1], points[1:]], axis=1)
        self._drawn = len(points)

    def grip(self, drag: Callable[[int, Any], None] | None) -> None:
        """Let the viewer drag bodies, or turn the view again where it held them.

        Args:
            drag: takes the body's number in the model and viser's event; None for no drags.
        """
        for body in () if self._stage is None else self._stage.dragged:
            for mesh in self._robot.meshes.get(body, ()):
                if drag is None:
                    mesh.remove_drag_callback()
                    continue

                async def dragged(event: Any, body: int = body) -> None:
                    drag(body, event)

                mesh.on_drag(dragged)

    def placed(self, point: Sequence[float]) -> Float64:
        """Return where a point of viser's scene is in the world, in [m], shape (3,)."""
        return np.add(point, (*self._middle, 0.0))


_PHONE, _SHEET, _BAR = 576, 0.2, 0.03
"""Width up to which viser shows panels as a sheet below [px]; by what parts of the view that sheet
moves the middle up, and elsewhere the e-stop moves it down."""
_FIELD, _SIDE = 0.75, np.array((0.64, -0.68, 0.35))
"""Angle of view [rad], and direction in which the camera stands."""


def aim(camera: Any, stage: Stage, taken: float) -> Float64:
    """Let the robot fill what panels leave of a viewer's view; return the camera's place.

    Args:
        camera: viser's, which knows the size of the view.
        stage: knows that of the robot.
        taken: of the view by a panel that comes, in [px].
    """
    width, height = int(camera.image_width), max(int(camera.image_height), 1)
    phone, slope = width <= _PHONE, float(np.tan(0.5 * _FIELD))
    aspect = max(width - (0 if phone else taken), 1) / height
    distance = 0.56 * stage.size / np.sin(np.arctan(slope * min(aspect, 1.0)))
    below = 2.0 * slope * distance * (_SHEET if phone else -_BAR)
    camera.fov = _FIELD
    camera.position = stage.middle + distance * _SIDE - (0.0, 0.0, below)
    camera.look_at = stage.middle - (0.0, 0.0, below)  # behind the position, which moves it
    return np.array(camera.position)


def _squares() -> Float32:
    """Return lines on the ground 1 m apart, shape (lines, 2, 3)."""
    at = np.arange(-_HALF, _HALF + 1, dtype=np.float32)
    lines = np.zeros((2, len(at), 2, 3), np.float32)
    lines[0, :, :, 0] = lines[1, :, :, 1] = at[:, None]
    lines[0, :, :, 1] = lines[1, :, :, 0] = (-_HALF, _HALF)
    return lines.reshape(-1, 2, 3)
