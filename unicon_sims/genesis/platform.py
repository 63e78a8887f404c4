"""Genesis behind the platform contract, for workflows that say `platform: genesis`.

It has habits that stop at this module: a global `init`, an excepthook of its own that prints to
standard output, and a logger that does. What it mixes otherwise than MuJoCo the model is told.
"""

from __future__ import annotations

import copy
import logging
import os
import sys
from typing import Any

import numpy as np

from unicon_base import AnyDict, Fault, MissingDependencyError, ModelError, one_line
from unicon_core.models.loaded import contact_of, floors, may_touch, on_floor
from unicon_core.platforms.kit.stepped import (
    SIMULATED,
    Facts,
    Float64,
    JointModel,
    Passive,
    Robot,
    Scene,
    Setup,
    Start,
    States,
    SteppedSimulator,
    WorldPose,
    import_mujoco,
    patience,
    rotation,
    setup_of,
)


class GenesisPlatform(SteppedSimulator):
    """Robots in the surroundings of their model, each in a world of its own; built by `make`."""

    facts = Facts(
        "genesis",
        simulated=True,
        batch=True,
        writes=SIMULATED,
        physics=("strength", "friction", "armature", "delay"),
    )
    represents = (
        "armature",
        "damping",
        "friction",
        "limits",
        "self-collision",
        "meshes",
        "contact friction",
        "constraints",
        "terrain",
    )

    def __init__(self, genesis: Any, setup: Setup) -> None:
        count = setup.num_robots
        start = setup.start
        loaded = start.loaded
        self._begin = np.tile(start.qpos, (count, 1))
        self._broken = genesis.GenesisException
        try:
            model = adapted(start, setup.figures)
            self._scene, self._robots = built(genesis, model, setup.timestep, self._begin)
        except self._broken as error:
            raise ModelError(f"model {loaded.path}: Genesis says: {one_line(error)}") from error
        # Its coordinates are MuJoCo's: the same joints in the same order.
        model = loaded.model
        self._at = loaded.addresses
        self._rates = loaded.dofs
        at, rate = (
            (0, 0)
            if loaded.base is None
            else (int(array[loaded.base]) for array in (model.jnt_qposadr, model.jnt_dofadr))
        )
        self._place = slice(at, at + 3)
        self._turn = slice(at + 3, at + 7)
        self._linear = slice(rate, rate + 3)
        self._angular = slice(rate + 3, rate + 6)
        self._forces = np.zeros((count, model.nv))
        super().__init__(setup, otherwise(start))

    def place(self) -> None:
        self._scene.reset()
        self._robots.set_qpos(self._begin, zero_velocity=True)

    def joints(self) -> tuple[Float64, Float64]:
        return self._positions()[:, self._at], self._velocities()[:, self._rates]

    def base(self) -> WorldPose:
        pos, vel = self._positions(), self._velocities()
        quat = pos[:, self._turn]
        own = vel[:, self._angular, None]
        # As MuJoCo: velocity of the origin in the world, rates about the base's own axes.
        rates = (rotation(quat) @ own)[..., 0]
        return WorldPose(pos[:, self._place], quat, vel[:, self._linear], rates)

    def step(self, torque: Float64) -> None:
        self._forces[:, self._rates] = torque
        self._robots.control_dofs_force(self._forces)
        try:
            self._scene.step(update_visualizer=False)
        except self._broken as error:  # it looks every tenth step
            raise Fault(f"the physics blew up: Genesis says: {one_line(error)}") from error

    def add_velocity(self, velocity: Float64) -> None:
        vel = self._velocities()
        vel[:, self._linear] += velocity
        self._robots.set_dofs_velocity(vel)

    def close(self) -> None:
        self._scene.destroy()

    def _positions(self) -> Float64:
        """Return MuJoCo's `qpos` of all worlds, shape (N, nq), float64."""
        return np.asarray(self._robots.get_qpos().cpu().numpy(), np.float64)

    def _velocities(self) -> Float64:
        """Return the velocities of all degrees of freedom, shape (N, nv), float64."""
        return np.asarray(self._robots.get_dofs_velocity().cpu().numpy(), np.float64)


# Steps and resets after which nothing is left to be compiled.
_FIRST = 3


def begun() -> Any:
    """Return the genesis module, initialised.

    Where nobody has done so, it computes on the CPU in float64, as fast there as float32. Who has
    called `genesis.init` before has chosen otherwise.

    Raises:
        MissingDependencyError: it is not installed, or torch is not.
    """
    hook = sys.excepthook
    os.environ.setdefault("QD_ENABLE_PYBUF", "0")  # else it warns of notebooks and pytest
    try:
        import genesis
    except ImportError as error:
        name = "torch" if "torch" in str(error) else "genesis-world"
        install = "pip install 'unicon_ros[sim-genesis]'"
        raise MissingDependencyError("platform 'genesis'", name, install) from error
    finally:
        sys.excepthook = hook
    if not genesis._initialized:
        genesis.init(backend=genesis.cpu, precision="64", logging_level="error")
        for handler in logging.getLogger("genesis").handlers:
            if isinstance(handler, logging.StreamHandler) and handler.stream is sys.stdout:
                handler.setStream(sys.stderr)
    return genesis


def built(genesis: Any, model: Any, timestep: float, begin: Float64) -> tuple[Any, Any]:
    """Return a scene of N worlds with the model in each, and the model's entity.

    Args:
        genesis: the module, initialised.
        model: an `MjModel`, surroundings and all.
        timestep: of the physics in [s].
        begin: where its joints begin, as MuJoCo's `qpos`, shape (N, nq).
    """
    options = genesis.options
    scene = genesis.Scene(
        sim_options=options.SimOptions(dt=timestep, gravity=tuple(model.opt.gravity)),
        rigid_options=options.RigidOptions(**_solver(genesis, model)),
        profiling_options=options.ProfilingOptions(show_FPS=False),
        show_viewer=False,
    )

    class Compiled(genesis.morphs.MJCF):  # type: ignore[misc]
        """The reader takes an `MjModel`; only the morph asks for a file's ending."""

        def is_format(self, ending: str) -> bool:
            return bool(ending == ".xml")

        def _identifier(self) -> str:
            return "robot"

    morph = Compiled(
        file=model,
        visualization=False,
        default_armature=None,  # else 0.1 kg·m² where the model has none
        align=False,  # the base's frame stays where it is
        decimate=False,
        decompose_object_error_threshold=float("inf"),  # convex hulls, as MuJoCo has them
    )
    entity = scene.add_entity(morph)
    scene.build(n_envs=len(begin))
    still = np.zeros((len(begin), entity.n_dofs))
    for _ in range(_FIRST):  # the rest is compiled as it is used
        scene.reset()
        entity.set_qpos(begin)
        for _ in range(_FIRST):
            entity.control_dofs_force(still)
            scene.step(update_visualizer=False)
        entity.set_dofs_velocity(still)
        scene.step(update_visualizer=False)
    return scene, entity


def _solver(genesis: Any, model: Any) -> AnyDict:
    """Return the solver's settings as the model has them."""
    mujoco = import_mujoco()
    opt = model.opt
    elliptic = opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    euler = opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    conjugate = opt.solver == mujoco.mjtSolver.mjSOL_CG
    solver = genesis.constraint_solver
    cone = genesis.friction_cone
    dimensions = int(model.geom_condim.max(initial=1))
    return {
        "enable_mujoco_compatibility": True,
        "enable_neutral_collision": True,  # else what touches at joint positions 0 never does
        "integrator": genesis.integrator.Euler if euler else genesis.integrator.implicitfast,
        "constraint_solver": solver.CG if conjugate else solver.Newton,
        "iterations": int(opt.iterations),
        "ls_iterations": int(opt.ls_iterations),
        "noslip_iterations": 0 if elliptic else int(opt.noslip_iterations),
        "friction_cone": cone.elliptic if elliptic else cone.pyramidal,
        "impratio": float(opt.impratio),
        "enable_torsional_friction": dimensions > 3,
        "enable_rolling_friction": dimensions > 4,
        "constraint_timeconst": None,  # each geom and joint has the model's
    }


def adapted(start: Start, figures: JointModel) -> Any:
    """Return a copy of the model with the joints' figures, without limits that the kit applies.

    Args:
        start: has the model.
        figures: of the joints.
    """
    model = copy.copy(start.loaded.model)
    figures.tell(model, start.loaded)
    # Genesis clamps a joint's force by these; the servo limits it already.
    model.actuator_ctrllimited[:] = model.actuator_forcelimited[:] = model.jnt_actfrclimited[:] = 0
    _say_friction(model, start)
    return model


def otherwise(start: Start) -> list[str]:
    """Return what of the model Genesis reads, but does otherwise than MuJoCo, one line each."""
    mujoco = import_mujoco()
    model = start.loaded.model
    opt = model.opt
    integrator = mujoco.mjtIntegrator(opt.integrator).name.removeprefix("mjINT_")
    named = np.union1d(model.pair_geom1, model.pair_geom2).astype(int)
    only = named[(model.geom_contype[named] == 0) & (model.geom_conaffinity[named] == 0)]
    found = {
        f"integrator {integrator} became implicitfast": integrator == "RK4",
        "solver PGS became Newton": opt.solver == mujoco.mjtSolver.mjSOL_PGS,
        "left out: air or water around the robot": opt.density or opt.viscosity or opt.wind.any(),
        f"left out: {model.ntendon} tendons": model.ntendon,
        "left out: height fields": (model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD).any(),
        "equality constraints that begin inactive act all the time": not model.eq_active0.all(),
        f"left out: contacts of {len(only)} geoms that touch by pairs alone": len(only),
    }
    return [note for note, there in found.items() if there]


def _say_friction(model: Any, start: Start) -> None:
    """Give each geom the friction that MuJoCo uses between it and the floor.

    Genesis takes the larger coefficient of two geoms, whatever their priorities and pairs say.
    """
    planes = floors(model)
    wanted = {}
    for geom in on_floor(start.loaded):
        floor = next(plane for plane in planes if may_touch(model, plane, geom))
        contact = contact_of(model, floor, geom)
        if contact.dimensions == 1:  # no friction at all
            contact = contact._replace(friction=np.zeros(3))
        wanted[geom] = contact
    for geom, contact in wanted.items():
        model.geom_condim[geom], model.geom_friction[geom] = contact
    if wanted:
        model.geom_condim[planes], model.geom_friction[planes] = 1, 0.0


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    scene: Scene,
    timestep: float | None = None,
    passive: Passive = "keep",
) -> GenesisPlatform:
    """Build the platform.

    Args:
        states: with `num_robots` set, as many robots are simulated, each in a world of its own.
        robot: its joints are found in the model by name.
        period: of a tick in [s].
        scene: how it begins.
        timestep: physics step in [s], None for the model's.
        passive: damping of the joints in the model: `keep` it beside that of the command, or
            `replace` it by that.

    Raises:
        MissingDependencyError: Genesis is not installed.
        ModelError: Genesis does not take the model.
    """
    with patience("genesis: compiling its kernels, some 90 s the first time, 20 s from then on"):
        genesis = begun()
        setup = setup_of(states, robot, period, scene, timestep, passive)
        return GenesisPlatform(genesis, setup)
