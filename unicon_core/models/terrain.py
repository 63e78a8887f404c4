"""Lays ground under a robot: boxes or a field of heights beside the floor of its model.

Ground touches the robot as the floor of its model did, or as a patch of other friction.
`SceneGround` says how high the ground is at given points, for height scans: terrain of a scene and
a model's level floor are computed; of other surroundings rays are cast.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import AnyDict, AnyMapping, ModelError
from unicon_base.arrays import Float64
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel, around, floors, import_mujoco
from unicon_core.models.posed import PosedModel
from unicon_core.robots import Robot
from unicon_core.terrain.ground import THICK, Ground, ground_of
from unicon_core.terrain.height_map import GroundHeights, Heights
from unicon_core.terrain.words import Terrain

TERRAIN = "terrain"
"""Its geoms and its field are called so, with a number behind."""

PAIRS = 20_000
"""`<pair>` elements of ground and robot."""

_EVEN = 1e-6  # [m]; a field needs a height, even where it has none


def load_on(
    path: Path,
    robot: Robot,
    terrain: Terrain | None,
    timestep: float | None = None,
    *,
    flat: LoadedModel | None = None,
    prepare: Callable[[Any], None] | None = None,
) -> LoadedModel:
    """Read and compile a model with ground under it; see `load_model`.

    Joints and bodies are those of the model alone, numbers included; geoms are more.

    Args:
        path: MJCF or URDF file.
        robot: whose joints must all be there.
        terrain: the ground, None for flat.
        timestep: physics step in [s], None for the model's own.
        flat: the model without it, where somebody has read it.
        prepare: changes the `MjSpec` before it is compiled.

    Raises:
        ModelError: the file is wrong, or has other surroundings than a floor.
    """
    if terrain is None:
        return load_model(path, robot, timestep, quiet=True, prepare=prepare)
    lay = laying(flat or load_model(path, robot, quiet=True), ground_of(terrain))

    def both(spec: Any) -> None:
        lay(spec)
        if prepare is not None:
            prepare(spec)

    return load_model(path, robot, timestep, quiet=True, prepare=both)


class Models:
    """Reads a model once, and once for each ground; who asks again gets a copy.

    Args:
        path: MJCF or URDF file.
        robot: whose joints must all be there.
        timestep: physics step in [s], None for the model's own.

    Raises:
        ModelError: the file is wrong, or lacks a joint of the robot.
    """

    def __init__(self, path: Path, robot: Robot, timestep: float | None) -> None:
        self._path = path
        self._robot = robot
        self._timestep = timestep
        self.flat = load_model(path, robot, timestep)
        self._laid: tuple[Terrain, LoadedModel] | None = None

    def on(self, terrain: Terrain | None) -> LoadedModel:
        """Return a model that may be changed, on flat ground or on this; see `load_on`.

        Raises:
            ModelError: the model has other surroundings than a floor.
        """
        if terrain is None:
            return replace(self.flat, model=copy(self.flat.model))
        if self._laid is None or self._laid[0] != terrain:
            laid = load_on(self._path, self._robot, terrain, self._timestep, flat=self.flat)
            self._laid = terrain, laid
        return replace(self._laid[1], model=copy(self._laid[1].model))


def laying(loaded: LoadedModel, ground: Ground) -> Callable[[Any], None]:
    """Return what lays ground into the `MjSpec` of a model; `prepare` of `load_model`.

    The floor stays, lowered to the lowest ground, and is what lies beyond. Everything else touches
    the robot as the floor did: by its bits and by the `<pair>` elements that name it. A patch goes
    before what it touches (`priority`), with the friction that the floor had there times its own
    factor.

    Args:
        loaded: the model as its file has it.
        ground: what is laid.

    Raises:
        ModelError: it has not one level floor and nothing else around.
    """
    floor, height = floor_of(loaded)
    patched = any(box.friction != 1.0 for box in ground.boxes)
    contact = floor_contact(loaded, floor) if patched else None
    rank = int(loaded.model.geom_priority.max()) + 1

    def lay(spec: Any) -> None:
        kind = import_mujoco().mjtGeom.mjGEOM_PLANE
        plane = next(geom for geom in spec.geoms if geom.type == kind)
        pairs = [p for p in spec.pairs if plane.name in (p.geomname1, p.geomname2) and plane.name]
        if len(pairs) * len(ground.boxes) > PAIRS:
            raise ModelError(
                f"model {loaded.path} names its floor in {len(pairs)} pairs, and scene.terrain has "
                f"{len(ground.boxes)} boxes; give it a smaller extent or larger parts"
            )
        own = _geoms(spec, plane, ground, height)
        for geom, friction in own:
            if contact is not None:
                give_patch(geom, contact, friction, rank)
            for pair in pairs:
                give_pair(spec, pair, plane.name, geom.name, friction)
        plane.pos = [plane.pos[0], plane.pos[1], plane.pos[2] + ground.floor]
        # Cameras see from a hundredth of the extent on, and windows show all of it.
        for word in ("extent", "meansize", "center"):
            setattr(spec.stat, word, getattr(loaded.model.stat, word))

    return lay


def floor_of(loaded: LoadedModel) -> tuple[int, float]:
    """Return the one level plane that lies around a robot, and its height in [m]."""
    mujoco = import_mujoco()
    model = loaded.model
    planes = floors(model)
    others = around(loaded)
    if others:
        names = ", ".join(model.geom(g).name or f"geom {g}" for g in others[:3])
        raise ModelError(
            f"model {loaded.path} has surroundings of its own ({names}): scene.terrain needs a "
            "floor alone; leave one of the two out"
        )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    bodies = model.geom_bodyid[planes]  # the floor is lowered in its body's frame
    upright = (*data.geom_xmat[planes, 8], *data.xmat[bodies, 8])
    if len(planes) != 1 or min(upright) < 1.0 - 2e-12:
        raise ModelError(
            f"model {loaded.path} has {len(planes)} planes: scene.terrain needs one level floor; "
            "leave terrain out, or name another model (scene: {model: PATH})"
        )
    return planes[0], float(data.geom_xpos[planes[0], 2])


def _geoms(spec: Any, plane: Any, ground: Ground, height: float) -> list[tuple[Any, float]]:
    """Add all geoms, the floor's material on them; return each with its factor of friction."""
    kinds = import_mujoco().mjtGeom
    same = {word: getattr(plane, word) for word in (*TOUCH, "contype", "conaffinity", "priority")}
    same |= {word: getattr(plane, word) for word in ("solmix", "group", "material", "rgba")}
    found = []
    for number, box in enumerate(ground.boxes):
        x, y, z = box.centre
        place = {"pos": [x, y, z + height], "quat": box.quat, "size": box.half}
        geom = spec.worldbody.add_geom(
            name=f"{TERRAIN}_{number}", type=kinds.mjGEOM_BOX, **place, **same
        )
        found.append((geom, box.friction))
    if ground.field is not None:
        heights = ground.field.heights
        half = ground.field.half
        low = float(heights.min())
        high = float(heights.max())
        rows, columns = heights.shape
        spec.add_hfield(
            name=TERRAIN,
            size=[half, half, max(high - low, _EVEN), THICK],
            nrow=rows,
            ncol=columns,
            userdata=heights.ravel(),
        )
        geom = spec.worldbody.add_geom(
            name=f"{TERRAIN}_0",
            type=kinds.mjGEOM_HFIELD,
            hfieldname=TERRAIN,
            pos=[0.0, 0.0, low + height],
            **same,
        )
        found.append((geom, 1.0))
    return found


TOUCH = ("condim", "friction", "solref", "solimp", "margin", "gap")
"""What a geom and a pair say of a contact."""
_SINK = 0.001  # [m] by which the robot is put into the floor to see what a contact is like


def floor_contact(loaded: LoadedModel, floor: int) -> AnyDict:
    """Return what the floor and the robot's lowest part make of a contact; else the floor's own.

    Returns:
        `condim`, `friction`, `solref` and `solimp`, as of a geom.
    """
    mujoco = import_mujoco()
    model, base = loaded.model, loaded.base
    words = ("condim", "friction", "solref", "solimp")
    own = {word: getattr(model, f"geom_{word}")[floor].copy() for word in words}
    posed = PosedModel(loaded)
    data = posed.data
    mujoco.mj_forward(model, data)
    heights = posed.heights()
    if base is None or not heights:
        return own
    data.qpos[int(model.jnt_qposadr[base]) + 2] -= min(heights.values()) + _SINK
    mujoco.mj_forward(model, data)
    for contact in data.contact:
        if floor in contact.geom:
            sliding, _, turning, rolling, _ = contact.friction
            return {
                "condim": contact.dim,
                "friction": np.array((sliding, turning, rolling)),
                "solref": np.array(contact.solref),
                "solimp": np.array(contact.solimp),
            }
    return own


def give_patch(geom: Any, contact: AnyMapping, friction: float, rank: int) -> None:
    """Give a patch the contact that the floor had, with its own friction, before what it touches.

    MuJoCo takes the larger of two geoms' friction, or that of the higher priority
    (https://mujoco.readthedocs.io/en/stable/modeling.html#contact-parameters).
    """
    for word, value in contact.items():
        setattr(geom, word, value)
    geom.friction = contact["friction"] * friction
    geom.priority = rank
    geom.material = ""
    shade = 0.35 + 0.5 * round(min(friction, 1.0), 1)  # the more slippery, the bluer
    geom.rgba = [shade, shade, 0.85, 1.0]


def give_pair(spec: Any, pair: Any, floor: str, name: str, friction: float) -> None:
    """Let what touches the floor by a pair touch other ground in the same way."""
    ends = {key: getattr(pair, key) for key in ("geomname1", "geomname2")}
    ends = {key: name if end == floor else end for key, end in ends.items()}
    same = {word: getattr(pair, word) for word in (*TOUCH, "solreffriction")}
    same["friction"] = np.array(pair.friction) * friction
    spec.add_pair(**ends, **same)


NO_GROUND = -1000.0
"""Height where there is none in [m]."""


class SceneGround:
    """The ground of a scene; things that move are no ground, as they are none in Isaac Lab.

    Args:
        loaded: the model without terrain.
        terrain: of the scene, None for what the model has.

    Raises:
        ModelError: terrain needs a level floor, and the model has none.
    """

    def __init__(self, loaded: LoadedModel, terrain: Terrain | None) -> None:
        self._loaded = loaded
        self._terrain: tuple[Terrain | None, ...] = ()
        self.lay(terrain)

    def lay(self, terrain: Terrain | None) -> None:
        """Be the ground of another terrain."""
        if self._terrain == (terrain,):
            return
        self._heights: Heights
        try:
            height = floor_of(self._loaded)[1]
            ground = Ground(0.0) if terrain is None else ground_of(terrain)
            self._heights = GroundHeights(ground, height)
        except ModelError:
            if terrain is not None:
                raise
            self._heights = RayHeights(self._loaded)
        self._terrain = (terrain,)

    def __call__(self, points: Float64) -> Float64:
        """Return the heights in [m], shape (n,), of points (2, n)."""
        return self._heights(points)


class RayHeights:
    """The height of all that stands still and can be touched around a robot, by rays.

    `mj_multiRay` has one origin: it is put `UP` above the points, so that a ray is off its point by
    at most (height · radius of the points / UP), 5 µm at a height of 5 m within a radius of 1 m.

    Args:
        loaded: the model.
    """

    UP = 1e6

    def __init__(self, loaded: LoadedModel) -> None:
        mujoco = import_mujoco()
        model = self._model = copy(loaded.model)
        model.geom_group[:] = 1
        ground = [*floors(model), *around(loaded)]
        model.geom_group[ground] = 0
        model.geom_matid[ground], model.geom_rgba[ground, 3] = -1, 1.0  # rays pass what is unseen
        self._data = mujoco.MjData(model)
        mujoco.mj_forward(model, self._data)
        self._cast = mujoco.mj_multiRay
        self._groups = np.array((1, 0, 0, 0, 0, 0), np.uint8)

    def __call__(self, points: Float64) -> Float64:
        """Return the heights in [m], shape (n,), of points (2, n)."""
        count = points.shape[1]
        origin = np.array((*np.add.reduce(points, axis=1) / count, self.UP))
        rays = np.full((count, 3), -self.UP)
        np.subtract(points.T, origin[:2], out=rays[:, :2])
        geoms, far = np.zeros(count, np.int32), np.zeros(count)
        self._cast(
            self._model, self._data, origin, rays.reshape(-1), self._groups, True, -1,
            geoms, far, None, count, 2.0 * self.UP,
        )  # fmt: skip
        return np.where(geoms < 0, NO_GROUND, self.UP * (1.0 - far))
