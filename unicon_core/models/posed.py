"""A model put where states say: heights above the floor, feet, footprint and weight.

For checks, odometry and the block `gravity`; there is no physics.
"""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from unicon_base.arrays import Array, Bool, Float64
from unicon_core.models.loaded import (
    LoadedModel,
    bodies_above,
    floors,
    import_mujoco,
    index_of,
    may_touch,
    on_floor,
    solid,
)
from unicon_core.robots import Robot

_FAR = 100.0  # [m]
_ENDINGS = ("_foot", "_link", "_sphere", "_toe")


class PosedModel:
    """A robot's model whose joints and base stand where somebody put them.

    Joints that no motor drives but others pull along, such as the ends of a hand's fingers, follow
    by the constraints of the model.

    Attributes:
        loaded: the model.
        data: its `MjData`; kinematics are up to date after `put`.
    """

    def __init__(self, loaded: LoadedModel) -> None:
        self.loaded = loaded
        self._mujoco = import_mujoco()
        self.data = self._mujoco.MjData(loaded.model)
        self._qpos = self.data.qpos
        base = loaded.base
        self._joints = index_of(loaded.addresses.tolist())
        self._base = None if base is None else int(loaded.model.jnt_qposadr[base])
        self._followers = followers(loaded)

    def put(self, joint_pos: ArrayLike, base: ArrayLike | None = None) -> Any:
        """Put the robot somewhere; return `data`.

        Args:
            joint_pos: in the robot's order in [rad] or [m], shape (n,).
            base: position in the world in [m], and base to world, wxyz, shape (7,); None leaves it
                where it is. A fixed base does not move.
        """
        data = self.data
        model = self.loaded.model
        qpos = self._qpos
        qpos[self._joints] = joint_pos
        for joint, driver, offset, start, (a, b, c, d, e) in self._followers:
            turned = float(qpos[driver]) - start if driver >= 0 else 0.0
            # Numbers: polyval takes 5 µs, and two hands have twelve such joints.
            qpos[joint] = offset + a + turned * (b + turned * (c + turned * (d + turned * e)))
        if self._base is not None and base is not None:
            qpos[self._base : self._base + 7] = base
        self._mujoco.mj_kinematics(model, data)
        self._mujoco.mj_comPos(model, data)
        return data

    def heights(self) -> dict[int, float]:
        """Return the height of each geom of the robot above the floor, [m]; empty without a floor.

        Geoms that do not collide with the floor are left out; none is higher than 100 m.
        """
        mujoco = self._mujoco
        model = self.loaded.model
        data = self.data
        planes = floors(model)
        found: dict[int, float] = {}
        for geom in on_floor(self.loaded):
            for floor in planes:
                if may_touch(model, floor, geom):
                    height = float(mujoco.mj_geomDistance(model, data, floor, geom, _FAR, None))
                    found[geom] = min(height, found.get(geom, _FAR))
        return found


TOUCHING = 0.005
"""A foot nearer to the floor stands on it, [m]."""


class FootContacts:
    """Which feet stand on the floor or on other ground, by their distance.

    Args:
        posed: where the robot is.
        feet: names; those without geoms never stand.
        uneven: the ground is a field of heights, to which there are no distances: MuJoCo's own
            contacts count, and margins of the model's feet are set for them.

    Attributes:
        posed: the same.
        soles: geoms of each foot.
    """

    def __init__(self, posed: PosedModel, feet: tuple[str, ...], uneven: bool) -> None:
        self.posed, self._uneven = posed, uneven
        self._mujoco, model = import_mujoco(), posed.loaded.model
        self.soles = foot_geoms(model, feet)
        self._floors = floors(model)
        for geoms in self.soles.values() if uneven else ():
            model.geom_margin[geoms] = TOUCHING

    def __call__(self) -> frozenset[str]:
        """Return the feet that stand, after `PosedModel.put`."""
        model, data = self.posed.loaded.model, self.posed.data
        if self._uneven:
            self._mujoco.mj_collision(model, data)
            pairs = np.array(data.contact.geom).reshape(-1, 2)
            met = pairs[(model.body_weldid[model.geom_bodyid[pairs]] == 0).any(axis=1)]
            return frozenset(foot for foot, own in self.soles.items() if np.isin(met, own).any())
        distance = self._mujoco.mj_geomDistance
        return frozenset(
            foot
            for foot, geoms in self.soles.items()
            if any(
                distance(model, data, floor, geom, 1.0, None) < TOUCHING
                for floor, geom in product(self._floors, geoms)
            )
        )


def followers(loaded: LoadedModel) -> list[tuple[int, int, float, float, list[float]]]:
    """Return the joints that others pull along, drivers before what they drive.

    Each is its place in `qpos`, that of its driver or -1, both at rest, and the polynomial by which
    it follows (MuJoCo, XML reference, `equality/joint`).
    """
    model = loaded.model
    kind = int(import_mujoco().mjtEq.mjEQ_JOINT)
    driven = {int(place) for place in loaded.addresses}
    found = []
    left = [i for i in range(model.neq) if model.eq_type[i] == kind and model.eq_active0[i]]
    followers = {int(model.jnt_qposadr[model.eq_obj1id[i]]) for i in left} - driven
    while left:
        ready = []
        for i in left:
            joint = int(model.eq_obj1id[i])
            other = int(model.eq_obj2id[i])
            place = int(model.jnt_qposadr[joint])
            driver = int(model.jnt_qposadr[other]) if other >= 0 else -1
            if driver in followers and driver != place:
                continue
            ready.append(i)
            if place in followers:
                start = float(model.qpos0[driver]) if driver >= 0 else 0.0
                offset = float(model.qpos0[place])
                found.append((place, driver, offset, start, model.eq_data[i, :5].tolist()))
        if not ready:  # they drive each other
            break
        followers -= {place for place, *_ in found}
        left = [i for i in left if i not in ready]
    return found


def foot_geoms(model: Any, feet: tuple[str, ...]) -> dict[str, list[int]]:
    """Return the geoms of each foot: of the body, site or geom of its name, or of its stem.

    Args:
        model: an `MjModel`.
        feet: names; those that the model does not have are left out.
    """
    found = {}
    for foot in feet:
        geoms = next(filter(None, (_geoms_of(model, name) for name in _names_of(foot))), None)
        if geoms:
            found[foot] = geoms
    return found


def foot_bodies(model: Any, feet: tuple[str, ...]) -> dict[str, int]:
    """Return the body of each foot, or the one that carries it, found as by `foot_geoms`.

    It may have no geoms, as where meshes are absent.
    """
    geoms = foot_geoms(model, feet)
    found = {}
    for foot in feet:
        if foot in geoms:
            found[foot] = int(model.geom_bodyid[geoms[foot][0]])
            continue
        bodies = (_part_of(model, name)[1] for name in _names_of(foot))
        body = next((each for each in bodies if each >= 0), None)
        if body is not None:
            found[foot] = body
    return found


def _names_of(foot: str) -> tuple[str, str]:
    stem = foot
    for ending in _ENDINGS:
        stem = stem.removesuffix(ending)
    return foot, stem


def _part_of(model: Any, name: str) -> tuple[int, int]:
    """Return the geom of a name, and the body that has it or is called so; -1 for none."""
    mujoco = import_mujoco()
    kinds = mujoco.mjtObj
    geom, body, site = (
        mujoco.mj_name2id(model, kind, name)
        for kind in (kinds.mjOBJ_GEOM, kinds.mjOBJ_BODY, kinds.mjOBJ_SITE)
    )
    if geom >= 0:
        body = int(model.geom_bodyid[geom])
    elif body < 0 <= site:
        body = int(model.site_bodyid[site])
    return geom, body


def _geoms_of(model: Any, name: str) -> list[int]:
    geom, body = _part_of(model, name)
    return [geom] if geom >= 0 else [g for g in range(model.ngeom) if model.geom_bodyid[g] == body]


class Weight:
    """What the joints of a model have to give so that it stays where it is, with nothing in touch.

    The torques of M(q) q̈ + h(q, q̇) = τ at rest, τ = h(q, 0), by one pass of the recursive
    Newton-Euler algorithm (Featherstone, Rigid Body Dynamics Algorithms, 2008, 5.3): of each joint
    it is the weight of all that it carries.

    Args:
        loaded: the model.

    Attributes:
        floats: the base moves, and is turned as it is said to be; a fixed one is turned as the
            model says.
    """

    def __init__(self, loaded: LoadedModel) -> None:
        self._model = loaded.model
        self._posed = PosedModel(loaded)
        self._mujoco = import_mujoco()
        self.floats = loaded.base is not None
        self._dofs = index_of(loaded.dofs.tolist())
        self._asked = np.zeros(loaded.model.nv)
        self._base = np.array((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))

    def __call__(self, joint_pos: ArrayLike, out: Float64, quat: ArrayLike | None = None) -> None:
        """Write the torques in [N·m], or forces in [N], in the robot's order, shape (n,).

        Args:
            joint_pos: in [rad] or [m], shape (n,).
            out: shape (n,).
            quat: base to world, wxyz, shape (4,); None leaves it as it is.
        """
        if quat is not None:
            self._base[3:] = quat
        data = self._posed.put(joint_pos, self._base)
        self._mujoco.mj_rne(self._model, data, 0, self._asked)  # its velocities are 0 for ever
        out[:] = self._asked[self._dofs]


def bearing_joints(loaded: LoadedModel, robot: Robot) -> Bool:
    """Return which joints stand between the base and a foot, in the robot's order, shape (n,).

    Those of a robot that does not walk, such as the fingertips of a hand, bear nothing.
    """
    model = loaded.model
    feet = foot_bodies(model, robot.feet if robot.walks else ()).values()
    bodies = {body for foot in feet for body in bodies_above(model, foot)}
    return np.isin(model.jnt_bodyid[loaded.joints], [*bodies])


ORIGIN = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


class Footprint:
    """The frame `base_footprint` in the base's frame; build it with `of`.

    The floor is where the lowest foot is, the origin the mean of the feet projected on it; x points
    where the base points, z up. That needs joint positions and the base's orientation only.

    Args:
        loaded: a model with a free base.
        feet: geoms of each foot.
        joint_pos: in the robot's order in [rad] or [m], shape (n,), read in place.
        base_quat: base to world, wxyz, shape (4,), read in place.

    Attributes:
        position: in the base's frame in [m], shape (3,).
        quat: footprint to base, wxyz, shape (4,).
    """

    def __init__(
        self, loaded: LoadedModel, feet: dict[str, list[int]], joint_pos: Array, base_quat: Array
    ) -> None:
        mujoco = import_mujoco()
        model = loaded.model
        self._posed = PosedModel(loaded)
        self._joint_pos = joint_pos
        self._base_quat = base_quat
        groups = [[g for g in group if solid(model, g)] or group for group in feet.values()]
        geoms = self._geoms = np.array([geom for group in groups for geom in group], np.intp)
        # Of the mean of the feet each foot is one part, however many geoms it has.
        self._weights = np.array([1.0 / len(g) / len(groups) for g in groups for _ in g])
        # What reaches beyond the middle of a geom: half edges of its box, or a radius.
        kinds = model.geom_type[geoms]
        self._radius = np.zeros(len(geoms))
        self._middle = np.array(model.geom_aabb[geoms, :3])
        self._half = np.array(model.geom_aabb[geoms, 3:])
        sphere = kinds == int(mujoco.mjtGeom.mjGEOM_SPHERE)
        capsule = kinds == int(mujoco.mjtGeom.mjGEOM_CAPSULE)
        self._radius[sphere | capsule] = model.geom_size[geoms[sphere | capsule], 0]
        self._half[sphere | capsule] = 0.0
        self._half[capsule, 2] = model.geom_size[geoms[capsule], 1]
        self.position = np.zeros(3)
        self.quat = np.array((1.0, 0.0, 0.0, 0.0))

    @classmethod
    def of(
        cls, loaded: LoadedModel, robot: Robot, joint_pos: Array, base_quat: Array
    ) -> Footprint | None:
        """Return that of a robot; None where it has no feet in its model, or a fixed base."""
        feet = foot_geoms(loaded.model, robot.feet)
        if robot.kind == "hand" or not feet or loaded.base is None:
            return None
        return cls(loaded, feet, joint_pos, base_quat)

    def update(self) -> None:
        """Bring `position` and `quat` up to date; keeps them where `base_quat` is not one."""
        w, x, y, z = map(float, self._base_quat)
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        if not 0.5 < norm < 2.0:
            return
        w, x, y, z = w / norm, x / norm, y / norm, z / norm
        # The world's z in the base's frame.
        up = np.array((2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)))
        data = self._posed.put(self._joint_pos, ORIGIN)
        turns = data.geom_xmat[self._geoms].reshape(-1, 3, 3)
        places = data.geom_xpos[self._geoms] + np.einsum("gij,gj->gi", turns, self._middle)
        reach = (np.abs(np.einsum("gij,i->gj", turns, up)) * self._half).sum(axis=1) + self._radius
        floor = float((places @ up - reach).min())
        mean = self._weights @ places
        position = mean + (floor - float(mean @ up)) * up
        if not np.isfinite(position).all():
            return
        self.position[:] = position
        # Base to world is yaw · rest, so footprint to base is (yaw⁻¹ · base)⁻¹.
        half = 0.5 * math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        c = math.cos(half)
        s = math.sin(half)
        self.quat[:] = (c * w + s * z, -(c * x + s * y), -(c * y - s * x), -(c * z - s * w))
