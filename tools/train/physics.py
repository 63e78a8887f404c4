"""Batched, randomised MuJoCo physics of our Go2 for training: one rollout call per policy step.

The shipped model's torque motors become position actuators with the policy's gains and the effort
limits, which is the deployed PD with torque clip evaluated in C at every physics step.
"""

from __future__ import annotations

import copy

import contract
import mujoco
import numpy as np
from mujoco import rollout

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
QPOS, QVEL = slice(1, 20), slice(20, 38)  # after the time


def training_spec(
    timestep: float, feet_only: bool = True, collide: tuple[str, ...] = ()
) -> mujoco.MjSpec:
    """Our Go2 with PD position actuators; only its feet and the geoms `collide` collide, or all.

    Leaving out the other contacts is what makes 30,000 policy steps a second on two cores; an
    episode ends before anything else could touch the floor.
    """
    spec = mujoco.MjSpec.from_file(str(contract.MODEL_PATH))
    for geom in list(spec.geoms):
        geom.material = ""
        if feet_only and geom.name not in (*contract.LEGS, *collide, "floor"):
            spec.delete(geom)
    for group in (spec.textures, spec.materials, spec.keys, spec.sensors):
        for item in list(group):
            spec.delete(item)
    for actuator, effort in zip(spec.actuators, contract.EFFORT_LIMIT):
        actuator.gainprm[0] = contract.STIFFNESS
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.biasprm[:3] = [0.0, -contract.STIFFNESS, -contract.DAMPING]
        actuator.forcerange = [-effort, effort]
        actuator.forcelimited, actuator.ctrllimited = 1, 0
    for leg in contract.LEGS:
        spec.site(f"{leg}_foot").size[0] = 0.03  # the touch sensor's volume holds the foot sphere
    for kind in ("FRAMEPOS", "FRAMELINVEL", "TOUCH"):
        for leg in contract.LEGS:
            spec.add_sensor(
                name=f"{leg}_{kind}",
                type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"),
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                objname=f"{leg}_foot",
            )
    for actuator in spec.actuators:
        spec.add_sensor(
            name=f"{actuator.name}_torque",
            type=mujoco.mjtSensor.mjSENS_ACTUATORFRC,
            objtype=mujoco.mjtObj.mjOBJ_ACTUATOR,
            objname=actuator.name,
        )
    spec.compiler.fusestatic = True
    spec.option.timestep = timestep
    spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_PYRAMIDAL, 1.0
    spec.option.iterations, spec.option.ls_iterations = 6, 10
    return spec


def randomise(
    model: mujoco.MjModel, base: mujoco.MjModel, rng: np.random.Generator, elliptic: float = 0.3
) -> None:
    """Draw one robot and floor into `model` in place; ranges are documented in the README.

    A share `elliptic` of the floors has an elliptic friction cone.
    """
    feet = [model.geom(leg).id for leg in contract.LEGS]
    model.geom_friction[feet, 0] = rng.uniform(0.3, 1.25)
    model.geom_solref[feet, 0] = rng.uniform(0.012, 0.03)
    round_ = rng.random() < elliptic
    model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC if round_ else mujoco.mjtCone.mjCONE_PYRAMIDAL
    # A ratio of 10 at a 5 ms step throws robots about (joints at 150 rad/s), and so do fewer
    # iterations than MuJoCo's own: with 20 and 10, 9 of 330 robots fell, with these 1 did.
    model.opt.impratio = 10 ** rng.uniform(0, 0.6) if round_ else 1.0
    model.opt.iterations, model.opt.ls_iterations = (100, 50) if round_ else (6, 10)
    scale = rng.uniform(0.9, 1.1, model.nbody)
    model.body_mass[:] = base.body_mass * scale
    model.body_inertia[:] = base.body_inertia * scale[:, None]
    model.body_mass[1] += rng.uniform(-0.8, 2.0)
    model.body_ipos[1] = base.body_ipos[1] + rng.uniform(-1, 1, 3) * (0.04, 0.025, 0.03)
    model.dof_damping[6:] = rng.uniform(0.0, 0.4) * rng.uniform(0.8, 1.2, 12)
    model.dof_frictionloss[6:] = rng.uniform(0.0, 0.4) * rng.uniform(0.8, 1.2, 12)
    model.dof_armature[6:] = rng.uniform(0.005, 0.02)
    stiffness = contract.STIFFNESS * rng.uniform(0.88, 1.12) * rng.uniform(0.95, 1.05, 12)
    damping = contract.DAMPING * rng.uniform(0.75, 1.3) * rng.uniform(0.95, 1.05, 12)
    model.actuator_gainprm[:, 0] = stiffness
    model.actuator_biasprm[:, 1] = -stiffness
    model.actuator_biasprm[:, 2] = -damping
    model.actuator_forcerange[:] = base.actuator_forcerange * rng.uniform(0.85, 1.0)
    mujoco.mj_setConst(model, mujoco.MjData(model))


class Physics:
    """`num_envs` robots stepped together; a pool of random models is shared among them.

    `elliptic` is the share of floors with an elliptic friction cone.

    Attributes:
        state: full physics state before the next step, shape (num_envs, 38): time, qpos, qvel.
        foot_pos, foot_vel: world frame in [m], [m/s], shape (num_envs, 4, 3).
        foot_force: largest normal force of the last policy step in [N], shape (num_envs, 4).
        torque: joint torques of every physics step in [N·m], shape (num_envs, decimation, 12).
    """

    elliptic = 0.3

    def __init__(
        self,
        num_envs: int,
        timestep: float,
        rng: np.random.Generator,
        threads: int,
        pool: int,
        feet_only: bool = True,
        base: mujoco.MjModel | None = None,
    ) -> None:
        self.base = base or training_spec(timestep, feet_only).compile()
        self.decimation = round(contract.PERIOD / timestep)
        self.pool = [copy.copy(self.base) for _ in range(min(pool, num_envs))]
        for model in self.pool:
            randomise(model, self.base, rng, self.elliptic)
        self.models = [self.pool[i % len(self.pool)] for i in range(num_envs)]
        self.state = np.zeros((num_envs, mujoco.mj_stateSize(self.base, STATE)))
        assert self.state.shape[1] == 38
        shape = (num_envs, self.decimation)
        self._states = np.zeros((*shape, 38))
        self._sensors = np.zeros((*shape, self.base.nsensordata))
        self._datas = [mujoco.MjData(self.base) for _ in range(threads)]
        self._rollout = rollout.Rollout(nthread=threads)
        self._next = 0

    def refresh(self, rng: np.random.Generator, count: int = 2) -> None:
        """Draw `count` models of the pool anew, so that the pool never becomes a fixed set."""
        for _ in range(count):
            randomise(self.pool[self._next], self.base, rng, self.elliptic)
            self._next = (self._next + 1) % len(self.pool)

    def step(self, targets: np.ndarray) -> None:
        """Advance one policy step; targets in [rad], shape (num_envs, decimation, 12)."""
        self._rollout.rollout(
            self.models,
            self._datas,
            self.state,
            targets,
            state=self._states,
            sensordata=self._sensors,
        )
        self.state[:] = self._states[:, -1]
        last = self._sensors[:, -1]
        n = len(last)
        self.foot_pos = last[:, 0:12].reshape(n, 4, 3)
        self.foot_vel = last[:, 12:24].reshape(n, 4, 3)
        self.foot_force = self._sensors[:, :, 24:28].max(axis=1)
        self.torque = self._sensors[:, :, 28:40]
