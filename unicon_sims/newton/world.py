"""A robot and its surroundings as Newton wants them, built link by link from the compiled model.

Newton has readers of URDF and MJCF of its own, but what a workflow simulates is the model that
`load_model` mended, and here no default of a file format comes between.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from unicon_base import AnyDict
from unicon_base.arrays import Float64
from unicon_core.models.kinematic_tree import Link, physical_links, read_tree
from unicon_core.models.loaded import import_mujoco, rotate, solid, still
from unicon_core.platforms.kit.base import rotation
from unicon_core.platforms.kit.joint_model import JointModel
from unicon_core.platforms.kit.start import Start
from unicon_core.robots import Robot

_RAW = 1  # of `solref_mode`: a pair as MuJoCo has it, not a stiffness and a damping
_WHOLE = ("solver", "integrator", "cone", "iterations", "ls_iterations")
_NUMBERS = ("impratio", "tolerance", "ls_tolerance", "density", "viscosity")
_WORLD = -1  # Newton's number of the body that does not move

# Kind of a geom to Newton's words for its sizes.
_SIZES = {
    "sphere": ("radius",),
    "box": ("hx", "hy", "hz"),
    "capsule": ("radius", "half_height"),
    "cylinder": ("radius", "half_height"),
    "ellipsoid": ("rx", "ry", "rz"),
}

# Newton's words for what MuJoCo has of geoms, joints, their friction and pairs, to its arrays.
_OF_GEOM = {word: f"geom_{word}" for word in ("contype", "conaffinity", "condim", "solref")} | {
    word: word for word in ("geom_priority", "geom_solmix", "geom_solimp")
}
_OF_JOINT = {"limit_margin": "jnt_margin", "solreflimit": "jnt_solref", "solimplimit": "jnt_solimp"}
_OF_DOF = {"solreffriction": "dof_solref", "solimpfriction": "dof_solimp"}
_PAIR = ("solref", "solreffriction", "solimp", "margin", "gap", "friction")
_OF_PAIR = {"pair_condim": "pair_dim"} | {f"pair_{word}": f"pair_{word}" for word in _PAIR}


def build_world(
    newton: Any, warp: Any, start: Start, robot: Robot, figures: JointModel
) -> tuple[Any, dict[str, int]]:
    """Return a `ModelBuilder` of one robot and what is around it, and where each joint stands.

    Args:
        newton: the module.
        warp: the module.
        start: has the model, and where the base is.
        robot: names the joints.
        figures: of its joints.

    Returns:
        The builder, and number of Newton's joint by name; "" is the free joint.
    """
    return _Builder(newton, warp, start, robot, figures).build()


def solver_options(start: Start) -> AnyDict:
    """Return the settings of the model's own solver, as `SolverMuJoCo` takes them."""
    option = start.loaded.model.opt
    single = getattr(import_mujoco().mjtDisableBit, "mjDSBL_MULTICCD", None)
    return {
        "enable_multiccd": single is not None and not option.disableflags & int(single),
        "wind": tuple(map(float, option.wind)),
        **{name: int(getattr(option, name)) for name in _WHOLE},
        **{name: float(getattr(option, name)) for name in _NUMBERS},
    }


def not_told(start: Start) -> list[str]:
    """Return what the model has and `build_world` leaves out, one line each.

    What `kit/joint_model.py` has a word for is not among it.
    """
    model = start.loaded.model
    field = int(import_mujoco().mjtGeom.mjGEOM_HFIELD)
    option = model.opt
    fields = int((model.geom_type == field).sum())
    found = {
        f"{model.ntendon} tendons": model.ntendon,
        f"{fields} height fields": fields,
        "forces against gravity on bodies (gravcomp)": model.body_gravcomp.any(),
        f"{option.noslip_iterations} iterations against slip": option.noslip_iterations,
        "what its options switch off or on (flag)": option.disableflags | option.enableflags,
    }
    return [f"left out: {what}" for what, there in found.items() if there]


@dataclass
class _Builder:
    newton: Any
    warp: Any
    start: Start
    robot: Robot
    figures: JointModel

    def __post_init__(self) -> None:
        self._model = self.start.loaded.model
        self._builder = self.newton.ModelBuilder(gravity=self.warp.vec3(*self.start.gravity))
        self.newton.solvers.SolverMuJoCo.register_custom_attributes(self._builder)
        self._shapes: dict[int, int] = {}  # geom -> shape

    def build(self) -> tuple[Any, dict[str, int]]:
        builder = self._builder
        model = self._model
        links = physical_links(read_tree(model, self.robot, colliding=True))
        bodies: list[int] = []
        joints: dict[str, int] = {}
        order = []
        for number, link in enumerate(links):
            if number == 0 and not self.start.floating:
                bodies.append(_WORLD)
            else:
                bodies.append(self._body(link))
                order.append(self._joint(link, bodies))
                if link.joint or number == 0:
                    joints[link.joint] = order[-1]
            for geom in dict.fromkeys(geom.number for geom in link.geoms):
                first = next(one for one in link.geoms if one.number == geom)
                self._shape(bodies[-1], geom, self._place(geom, first.position), first.quat)
        builder.add_articulation(order, label=self.robot.name)
        mujoco = import_mujoco()
        quat = np.zeros(4)
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        for geom in still(model):
            if geom not in self._shapes and solid(model, geom):
                mujoco.mju_mat2Quat(quat, data.geom_xmat[geom])
                self._shape(_WORLD, geom, data.geom_xpos[geom], quat)
        self._exclude()
        self._pair()
        return builder, joints

    def _body(self, link: Link) -> Any:
        turn = rotation(link.inertia_quat[None])[0]
        inertia = turn @ np.diag(link.inertia) @ turn.T
        return self._builder.add_link(
            mass=link.mass,
            com=self.warp.vec3(*link.centre),
            inertia=self.warp.mat33(*inertia.ravel()),
            label=link.name,
            lock_inertia=True,
        )

    def _joint(self, link: Link, bodies: list[int]) -> Any:
        builder = self._builder
        body = bodies[-1]
        if link.parent < 0:
            joint = builder.add_joint_free(body, label="base")
            w, x, y, z = self.start.quat
            self._begin(joint, *self.start.position, x, y, z, w)
            return joint
        where = {"parent_xform": self._transform(link.position, link.quat)}
        parent = bodies[link.parent]
        if not link.joint:
            return builder.add_joint_fixed(parent, body, **where)
        add = builder.add_joint_prismatic if link.sliding else builder.add_joint_revolute
        axis = self.warp.vec3(*link.axis)
        says = self._figures_of(link)
        joint = add(parent, body, **where, axis=axis, label=link.joint, **says)
        others = self._model.qpos0[self._model.jnt_qposadr[link.number]]
        self._begin(joint, self.start.joint_pos[link.index] if link.index >= 0 else others)
        return joint

    def _begin(self, joint: int, *coordinates: float) -> None:
        """Say where a joint begins, to which a reset leads back."""
        first = self._builder.joint_q_start[joint]
        for i, value in enumerate(coordinates):
            self._builder.joint_q[first + i] = float(value)

    def _figures_of(self, link: Link) -> AnyDict:
        """Return what Newton is told of a joint; it has no drive of its own."""
        model = self._model
        figures = self.figures
        at = link.index
        dof = int(model.jnt_dofadr[link.number])
        words = ("armature", "damping", "friction", "lower", "upper")
        if at >= 0:
            own = [getattr(figures, word)[at] for word in words]
        else:
            own = [model.dof_armature[dof], model.dof_damping[dof], model.dof_frictionloss[dof]]
            own += [link.lower, link.upper]
        told = ("armature", "damping", "friction", "limit_lower", "limit_upper")
        return {
            **dict(zip(told, map(float, own))),
            "stiffness": float(np.ravel(model.jnt_stiffness[link.number])[0]),
            "rest_q": float(model.qpos_spring[model.jnt_qposadr[link.number]]),
            "target_ke": 0.0,
            "target_kd": 0.0,
            "actuator_mode": self.newton.JointTargetMode.NONE,
            "custom_attributes": {
                **self._same(_OF_JOINT, link.number),
                **self._same(_OF_DOF, dof),
                "mujoco:solreflimit_mode": _RAW,
            },
        }

    def _place(self, geom: int, part: Float64) -> Float64:
        """Return where a geom is on its link, from where `read_tree` puts its first part."""
        model = self._model
        if self._kind(geom) in ("ellipsoid", "mesh"):
            return part - rotate(model.geom_quat[geom], np.array(model.geom_aabb[geom, :3]))
        return part

    def _kind(self, geom: int) -> str:
        """Return what a geom is, such as `box`."""
        kind: str = import_mujoco().mjtGeom(self._model.geom_type[geom]).name
        return kind.removeprefix("mjGEOM_").lower()

    def _shape(self, body: int, geom: int, position: Float64, quat: Float64) -> None:
        """Add a geom of the model, with its contacts' settings."""
        model, kind, sizes = self._model, self._kind(geom), AnyDict()
        if kind in _SIZES:
            sizes = dict(zip(_SIZES[kind], model.geom_size[geom].tolist()))
        elif kind == "plane":
            sizes = {"width": 0.0, "length": 0.0}
        elif kind == "mesh":
            kind, sizes = "convex_hull", {"mesh": self._mesh(geom)}
        else:
            return
        slide, turn, roll = map(float, model.geom_friction[geom])
        config = self.newton.ModelBuilder.ShapeConfig(
            density=0.0,
            mu=slide,
            mu_torsional=turn,
            mu_rolling=roll,
            margin=float(model.geom_margin[geom]),
            gap=float(model.geom_gap[geom]),
        )
        self._shapes[geom] = getattr(self._builder, f"add_shape_{kind}")(
            body=body,
            **sizes,
            xform=self._transform(position, quat),
            cfg=config,
            label=f"geom_{geom}",
            custom_attributes={
                **self._same(_OF_GEOM, geom),
                "mujoco:collision_mask_domain": 0,
                "mujoco:solref_mode": _RAW,
            },
        )

    def _mesh(self, geom: int) -> Any:
        model = self._model
        mesh = int(self._model.geom_dataid[geom])
        first = int(model.mesh_vertadr[mesh])
        count = int(model.mesh_vertnum[mesh])
        face = int(model.mesh_faceadr[mesh])
        faces = int(model.mesh_facenum[mesh])
        return self.newton.Mesh(
            np.array(model.mesh_vert[first : first + count], np.float32),
            np.array(model.mesh_face[face : face + faces], np.int32).ravel(),
            compute_inertia=False,
        )

    def _exclude(self) -> None:
        """Keep apart what MuJoCo does: links and their parents, and bodies that the model names.

        A body with two joints is two bodies in Newton, so that its parent is not its own.
        """
        model = self._model
        shapes = self._shapes
        welded = np.array(model.body_weldid)
        parents = welded[model.body_parentid[welded]]
        named = {(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature}
        for a, b in combinations(shapes, 2):
            one = int(model.geom_bodyid[a])
            other = int(model.geom_bodyid[b])
            own = int(welded[one])
            others = int(welded[other])
            near = own in (others, parents[other]) or others == parents[one]
            near = near and own > 0 and others > 0
            if near or (one, other) in named or (other, one) in named:
                self._builder.add_shape_collision_filter_pair(shapes[a], shapes[b])

    def _pair(self) -> None:
        """Add the `<pair>` elements of the model."""
        model = self._model
        shapes = self._shapes
        for i in range(model.npair):
            ends = int(model.pair_geom1[i]), int(model.pair_geom2[i])
            if not set(ends) <= shapes.keys():
                continue
            one, other = (shapes[end] for end in ends)
            where = {"mujoco:pair_world": 0, "mujoco:pair_geom1": one, "mujoco:pair_geom2": other}
            self._builder.add_custom_values(**where, **self._same(_OF_PAIR, i))

    def _transform(self, position: Float64, quat: Float64) -> Any:
        """Return a pose with the quaternion xyzw."""
        w, x, y, z = map(float, quat)
        place = self.warp.vec3(*map(float, position))
        return self.warp.transform(place, self.warp.quat(x, y, z, w))

    def _same(self, arrays: Mapping[str, str], place: int) -> AnyDict:
        """Return what arrays of the model have at a place, as Newton takes it.

        Args:
            arrays: Newton's words to names of the arrays.
            place: number of the geom, joint or pair.
        """
        warp = self.warp
        vectors = {2: warp.vec2, 5: warp.types.vector(5, warp.float32)}
        says = {}
        for word, array in arrays.items():
            value = getattr(self._model, array)[place]
            plain = value.tolist()
            says[f"mujoco:{word}"] = vectors[len(value)](*plain) if value.ndim else plain
        return says
