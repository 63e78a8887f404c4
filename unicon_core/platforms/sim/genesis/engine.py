"""Genesis itself: imported, initialised once a process, and a scene of N worlds built in it.

It has habits that stop at this module: a global `init`, an excepthook of its own that prints to
standard output, and a logger that does.
"""

from __future__ import annotations

import logging
import os
import sys
from typing import Any

import numpy as np

from unicon_core.errors import MissingDependencyError
from unicon_core.models.loaded import import_mujoco
from unicon_core.platforms.kit.base import Float

_FIRST = 3
"""Steps and resets after which nothing is left to be compiled."""


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


def built(genesis: Any, model: Any, timestep: float, begin: Float) -> tuple[Any, Any]:
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


def _solver(genesis: Any, model: Any) -> dict[str, Any]:
    """Return the solver's settings as the model has them."""
    mujoco, opt = import_mujoco(), model.opt
    elliptic = opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    euler = opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    conjugate = opt.solver == mujoco.mjtSolver.mjSOL_CG
    solver, cone = genesis.constraint_solver, genesis.friction_cone
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
