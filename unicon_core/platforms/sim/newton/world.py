"""A robot and its surroundings as Newton wants them, built link by link from the compiled model.

Newton has readers of URDF and MJCF of its own, but what a workflow simulates is the model that
`load_model` mended, and here no default of a file format comes between.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.models.kinematic_tree import read_tree
from unicon_core.models.links import Link
from unicon_core.models.loaded import import_mujoco
from unicon_core.models.physical import physical_links
from unicon_core.models.quaternions import rotate
from unicon_core.models.touching import solid, still
from unicon_core.platforms.kit.base import rotation
from unicon_core.platforms.kit.joint_model import JointModel
from unicon_core.platforms.kit.start import Start
from unicon_core.robots import Robot

Float = NDArray[np.float64]

_RAW = 1  # of `solref_mode`: a pair as MuJoCo has it, not a stiffness and a damping
_WHOLE = ("solver", "integrator", "cone", "iterations", "ls_iterations")
_NUMBERS = ("impratio", "tolerance", "ls_tolerance", "density", "viscosity")
_WORLD = -1  # Newton's number of the body that does not move


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


def solver_options(start: Start) -> dict[str, Any]:
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
    model, field = start.loaded.model, int(import_mujoco().mjtGeom.mjGEOM_HFIELD)
    option, fields = model.opt, int((model.geom_type == field).sum())
    found = {
        f"{model.ntendon} tendons": model.ntendon,
        f"{fields} height fields": fields,
        "forces against gravity on bodies (gravcomp)": model.body_gravcomp.any(),
        f"{option.noslip_iterations} iterations against slip": option.noslip_iterations,
        "what its options switch off or on (flag)": option.disableflags | option.enableflags,
    }
    return [f"left out: {what}" for what, there in found.items() if there]


class _Builder:
    def __init__(
        self, newton: Any, warp: Any, start: Start, robot: Robot, figures: JointModel
    ) -> None:
        self._newton, self._warp, self._start = newton, warp, start
        self._model, self._figures, self._robot = start.loaded.model, figures, robot
        self._kinds = import_mujoco().mjtGeom
        self._builder = newton.ModelBuilder(gravity=warp.vec3(*start.gravity))
        newton.solvers.SolverMuJoCo.register_custom_attributes(self._builder)
        self._shapes: dict[int, int] = {}  # geom -> shape

    def build(self) -> tuple[Any, dict[str, int]]:
        builder, model = self._builder, self._model
        links = physical_links(read_tree(model, self._robot, colliding=True))
        bodies: list[int] = []
        joints: dict[str, int] = {}
        order = []
        for number, link in enumerate(links):
            if number == 0 and not self._start.floating:
                bodies.append(_WORLD)
            else:
                bodies.append(self._body(link))
                order.append(self._joint(link, bodies))
                if link.joint or number == 0:
                    joints[link.joint] = order[-1]
            for geom in dict.fromkeys(geom.number for geom in link.geoms):
                first = next(one for one in link.geoms if one.number == geom)
                self._shape(bodies[-1], geom, self._place(geom, first.position), first.quat)
        builder.add_articulation(order, label=self._robot.name)
        mujoco, quat = import_mujoco(), np.zeros(4)
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        for geom in still(model):
            if geom not in self._shapes and solid(model, geom):
                mujoco.mju_mat2Quat(quat, data.geom_xmat[geom])
                self._shape(_WORLD, geom, data.geom_xpos[geom], quat)
        self._exclude()
        self._pair()
        return builder, joints

    def _body(self, link: Link) -> int:
        turn = rotation(link.inertia_quat[None])[0]
        inertia = turn @ np.diag(link.inertia) @ turn.T
        body: int = self._builder.add_link(
            mass=link.mass,
            com=self._warp.vec3(*link.centre),
            inertia=self._warp.mat33(*inertia.ravel()),
            label=link.name,
            lock_inertia=True,
        )
        return body

    def _joint(self, link: Link, bodies: list[int]) -> int:
        builder, body = self._builder, bodies[-1]
        joint: int
        if link.parent < 0:
            joint = builder.add_joint_free(body, label="base")
            w, x, y, z = self._start.quat
            self._begin(joint, *self._start.position, x, y, z, w)
            return joint
        where = {"parent_xform": self._transform(link.position, link.quat)}
        parent = bodies[link.parent]
        if not link.joint:
            joint = builder.add_joint_fixed(parent, body, **where)
            return joint
        add = builder.add_joint_prismatic if link.sliding else builder.add_joint_revolute
        axis = self._warp.vec3(*link.axis)
        says = self._figures_of(link)
        joint = add(parent, body, **where, axis=axis, label=link.joint, **says)
        others = self._model.qpos0[self._model.jnt_qposadr[link.number]]
        self._begin(joint, self._start.joint_pos[link.index] if link.index >= 0 else others)
        return joint

    def _begin(self, joint: int, *coordinates: float) -> None:
        """Say where a joint begins, to which a reset leads back."""
        first = self._builder.joint_q_start[joint]
        for i, value in enumerate(coordinates):
            self._builder.joint_q[first + i] = float(value)

    def _figures_of(self, link: Link) -> dict[str, Any]:
        """Return what Newton is told of a joint; it has no drive of its own."""
        model, figures, at = self._model, self._figures, link.index
        dof = int(model.jnt_dofadr[link.number])
        if at >= 0:
            own = figures.armature[at], figures.damping[at], figures.friction[at]
            limits = figures.lower[at], figures.upper[at]
        else:
            own = model.dof_armature[dof], model.dof_damping[dof], model.dof_frictionloss[dof]
            limits = link.lower, link.upper
        armature, damping, friction = map(float, own)
        lower, upper = (float(limit) for limit in limits)
        spring = float(model.qpos_spring[model.jnt_qposadr[link.number]])
        return {
            "armature": armature,
            "damping": damping,
            "friction": friction,
            "limit_lower": lower,
            "limit_upper": upper,
            "stiffness": float(np.ravel(model.jnt_stiffness[link.number])[0]),
            "rest_q": spring,
            "target_ke": 0.0,
            "target_kd": 0.0,
            "actuator_mode": self._newton.JointTargetMode.NONE,
            "custom_attributes": {
                "mujoco:limit_margin": float(model.jnt_margin[link.number]),
                "mujoco:solreflimit": self._vector(model.jnt_solref[link.number]),
                "mujoco:solreflimit_mode": _RAW,
                "mujoco:solimplimit": self._vector(model.jnt_solimp[link.number]),
                "mujoco:solreffriction": self._vector(model.dof_solref[dof]),
                "mujoco:solimpfriction": self._vector(model.dof_solimp[dof]),
            },
        }

    def _place(self, geom: int, part: Float) -> Float:
        """Return where a geom is on its link, from where `read_tree` puts its first part."""
        model, kinds = self._model, self._kinds
        if int(model.geom_type[geom]) in (int(kinds.mjGEOM_ELLIPSOID), int(kinds.mjGEOM_MESH)):
            return part - rotate(model.geom_quat[geom], np.array(model.geom_aabb[geom, :3]))
        return part

    def _shape(self, body: int, geom: int, position: Float, quat: Float) -> None:
        """Add a geom of the model, with its contacts' settings."""
        builder, model, kinds = self._builder, self._model, self._kinds
        kind = int(model.geom_type[geom])
        size = model.geom_size[geom].tolist()
        slide, turn, roll = map(float, model.geom_friction[geom])
        config = self._newton.ModelBuilder.ShapeConfig(
            density=0.0,
            mu=slide,
            mu_torsional=turn,
            mu_rolling=roll,
            margin=float(model.geom_margin[geom]),
            gap=float(model.geom_gap[geom]),
        )
        says = {
            "xform": self._transform(position, quat),
            "cfg": config,
            "label": f"geom_{geom}",
            "custom_attributes": {
                "mujoco:contype": int(model.geom_contype[geom]),
                "mujoco:conaffinity": int(model.geom_conaffinity[geom]),
                "mujoco:collision_mask_domain": 0,
                "mujoco:condim": int(model.geom_condim[geom]),
                "mujoco:geom_priority": int(model.geom_priority[geom]),
                "mujoco:geom_solmix": float(model.geom_solmix[geom]),
                "mujoco:geom_solimp": self._vector(model.geom_solimp[geom]),
                "mujoco:solref": self._vector(model.geom_solref[geom]),
                "mujoco:solref_mode": _RAW,
            },
        }
        shape: int
        if kind == int(kinds.mjGEOM_PLANE):
            shape = builder.add_shape_plane(body=body, width=0.0, length=0.0, **says)
        elif kind == int(kinds.mjGEOM_SPHERE):
            shape = builder.add_shape_sphere(body, radius=size[0], **says)
        elif kind == int(kinds.mjGEOM_BOX):
            shape = builder.add_shape_box(body, hx=size[0], hy=size[1], hz=size[2], **says)
        elif kind == int(kinds.mjGEOM_CAPSULE):
            shape = builder.add_shape_capsule(body, radius=size[0], half_height=size[1], **says)
        elif kind == int(kinds.mjGEOM_CYLINDER):
            shape = builder.add_shape_cylinder(body, radius=size[0], half_height=size[1], **says)
        elif kind == int(kinds.mjGEOM_ELLIPSOID):
            axes = dict(zip(("rx", "ry", "rz"), size))
            shape = builder.add_shape_ellipsoid(body, **axes, **says)
        elif kind == int(kinds.mjGEOM_MESH):
            shape = builder.add_shape_convex_hull(body, mesh=self._mesh(geom), **says)
        else:
            return
        self._shapes[geom] = shape

    def _mesh(self, geom: int) -> Any:
        model, mesh = self._model, int(self._model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        return self._newton.Mesh(
            np.array(model.mesh_vert[first : first + count], np.float32),
            np.array(model.mesh_face[face : face + faces], np.int32).ravel(),
            compute_inertia=False,
        )

    def _exclude(self) -> None:
        """Keep apart what MuJoCo does: links and their parents, and bodies that the model names.

        A body with two joints is two bodies in Newton, so that its parent is not its own.
        """
        model, shapes = self._model, self._shapes
        welded = np.array(model.body_weldid)
        parents = welded[model.body_parentid[welded]]
        named = {(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature}
        for a, b in combinations(shapes, 2):
            one, other = int(model.geom_bodyid[a]), int(model.geom_bodyid[b])
            own, others = int(welded[one]), int(welded[other])
            near = own in (others, parents[other]) or others == parents[one]
            near = near and own > 0 and others > 0
            if near or (one, other) in named or (other, one) in named:
                self._builder.add_shape_collision_filter_pair(shapes[a], shapes[b])

    def _pair(self) -> None:
        """Add the `<pair>` elements of the model."""
        model, shapes = self._model, self._shapes
        for i in range(model.npair):
            ends = int(model.pair_geom1[i]), int(model.pair_geom2[i])
            if not set(ends) <= shapes.keys():
                continue
            says = {
                "world": 0,
                "geom1": shapes[ends[0]],
                "geom2": shapes[ends[1]],
                "condim": int(model.pair_dim[i]),
                "solref": self._vector(model.pair_solref[i]),
                "solreffriction": self._vector(model.pair_solreffriction[i]),
                "solimp": self._vector(model.pair_solimp[i]),
                "margin": float(model.pair_margin[i]),
                "gap": float(model.pair_gap[i]),
                "friction": self._vector(model.pair_friction[i]),
            }
            self._builder.add_custom_values(**{f"mujoco:pair_{k}": v for k, v in says.items()})

    def _transform(self, position: Float, quat: Float) -> Any:
        """Return a pose with the quaternion xyzw."""
        w, x, y, z = (float(value) for value in quat)
        place = self._warp.vec3(*(float(value) for value in position))
        return self._warp.transform(place, self._warp.quat(x, y, z, w))

    def _vector(self, values: Float) -> Any:
        kinds = {2: self._warp.vec2, 5: self._warp.types.vector(5, self._warp.float32)}
        return kinds[len(values)](*(float(value) for value in values))
