"""A model put where states say, without physics: heights above the floor, and feet, for checks."""

from __future__ import annotations

from functools import partial
from typing import Any

from numpy.typing import ArrayLike

from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.models.rows import index_of
from unicon_core.models.touching import floors, may_touch, on_floor

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
        self.loaded, self._mujoco = loaded, import_mujoco()
        self.data = self._mujoco.MjData(loaded.model)
        self._qpos, base = self.data.qpos, loaded.base
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
        data, model, qpos = self.data, self.loaded.model, self._qpos
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
        mujoco, model, data = self._mujoco, self.loaded.model, self.data
        planes = floors(model)
        found: dict[int, float] = {}
        for geom in on_floor(self.loaded):
            for floor in planes:
                if may_touch(model, floor, geom):
                    height = float(mujoco.mj_geomDistance(model, data, floor, geom, _FAR, None))
                    found[geom] = min(height, found.get(geom, _FAR))
        return found


def followers(loaded: LoadedModel) -> list[tuple[int, int, float, float, list[float]]]:
    """Return the joints that others pull along, drivers before what they drive.

    Each is its place in `qpos`, that of its driver or -1, both at rest, and the polynomial by which
    it follows (MuJoCo, XML reference, `equality/joint`).
    """
    model, kind = loaded.model, int(import_mujoco().mjtEq.mjEQ_JOINT)
    driven, found = {int(place) for place in loaded.addresses}, []
    left = [i for i in range(model.neq) if model.eq_type[i] == kind and model.eq_active0[i]]
    followers = {int(model.jnt_qposadr[model.eq_obj1id[i]]) for i in left} - driven
    while left:
        ready = []
        for i in left:
            joint, other = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
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
        body = next((b for b in map(partial(_body_of, model), _names_of(foot)) if b >= 0), None)
        if body is not None:
            found[foot] = body
    return found


def _names_of(foot: str) -> tuple[str, str]:
    stem = foot
    for ending in _ENDINGS:
        stem = stem.removesuffix(ending)
    return foot, stem


def _ids_of(model: Any, name: str) -> tuple[int, int, int]:
    """Return the geom, body and site of a name, -1 where there is none."""
    mujoco = import_mujoco()
    kinds = mujoco.mjtObj
    geom, body, site = (
        int(mujoco.mj_name2id(model, kind, name))
        for kind in (kinds.mjOBJ_GEOM, kinds.mjOBJ_BODY, kinds.mjOBJ_SITE)
    )
    return geom, body, site


def _body_of(model: Any, name: str) -> int:
    geom, body, site = _ids_of(model, name)
    if geom >= 0:
        return int(model.geom_bodyid[geom])
    return int(model.site_bodyid[site]) if body < 0 <= site else body


def _geoms_of(model: Any, name: str) -> list[int]:
    geom, body, _ = _ids_of(model, name)
    if geom >= 0:
        return [geom]
    body = _body_of(model, name)
    return [g for g in range(model.ngeom) if model.geom_bodyid[g] == body]
