"""Isaac Lab on Isaac Sim, for workflows that say `platform: isaaclab` or `platform: isaacsim`.

Written against the sources of isaaclab 2.3.2 (`isaaclab/assets/articulation/articulation.py`,
`isaaclab/scene/interactive_scene.py`, `isaaclab/sim/simulation_context.py`), and for the order of
quaternions those of 3.0.0 (`isaaclab/assets/articulation/base_articulation_data.py`).
"""

from __future__ import annotations

import atexit
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np

from unicon_base import MissingDependencyError, PlatformError
from unicon_base.schema.marks import Matches
from unicon_core.models.kinematic_tree import physical_urdf
from unicon_core.platforms.kit.stepped import (
    SIMULATED,
    Facts,
    Float64,
    Passive,
    Robot,
    Scene,
    Setup,
    States,
    SteppedSimulator,
    WorldPose,
    ground_friction,
    setup_of,
)

INSTALL = (
    "pip install 'isaaclab[isaacsim,all]==2.3.2.post1' in Python 3.11, from NVIDIA's own index "
    "(Isaac Lab's installation guide names it)"
)

_FAST, _STRONG = 1000.0, 1e6  # [m/s], [rad/s] and [N·m]: nothing is held back
Device = Annotated[str, Matches("cpu|cuda.*", "cpu or cuda:0")]
_APART = 3.0  # [m] between robots, which do not meet


class IsaacLabPlatform(SteppedSimulator):
    """Robots on a floor, each in an environment that the others do not touch; built by `make`."""

    facts = Facts(
        "isaaclab",
        simulated=True,
        batch=True,
        writes=SIMULATED,
        physics=("strength", "friction", "armature", "delay"),
        notes=("written against the vendor's sources, not run against its modules",),
    )
    represents = ("armature", "damping", "friction", "limits")

    def __init__(self, device: str, setup: Setup) -> None:
        self._torch = import_module("torch")
        self._device = device
        self._sim: Any = None
        self._folder = TemporaryDirectory()  # the importer's USD files are made in it
        try:
            self._build(setup)
            super().__init__(setup)
        except BaseException:
            self.close()
            raise

    def _build(self, setup: Setup) -> None:
        robot = setup.robot
        start = setup.start
        lab = import_module("isaaclab.sim")
        assets = import_module("isaaclab.assets")
        scene = import_module("isaaclab.scene")
        friction = ground_friction(start)
        material = lab.RigidBodyMaterialCfg(  # of all that has none of its own
            static_friction=friction, dynamic_friction=friction, restitution=0.0
        )
        if lab.SimulationContext.instance() is not None:
            raise PlatformError(
                "platform 'isaaclab': Isaac Sim has one simulation in a process, and there is one; "
                "close it first, or give num_robots"
            )
        lab.create_new_stage()
        self._sim = lab.SimulationContext(
            lab.SimulationCfg(
                dt=setup.timestep,
                device=self._device,
                gravity=tuple(map(float, start.gravity)),
                physics_material=material,
            )
        )
        worlds = scene.InteractiveSceneCfg(num_envs=setup.num_robots, env_spacing=_APART)
        # A box: the ground plane is a file of NVIDIA's servers.
        worlds.floor = assets.AssetBaseCfg(
            prim_path="/World/floor",
            spawn=lab.CuboidCfg(
                size=(1000.0, 1000.0, 1.0),
                collision_props=lab.CollisionPropertiesCfg(),
                physics_material=material,
            ),
            init_state=assets.AssetBaseCfg.InitialStateCfg(pos=(0.0, 0.0, -0.5)),
            collision_group=-1,
        )
        worlds.robot = self._articulation(lab, assets, setup)
        self._scene = scene.InteractiveScene(worlds)
        self._sim.reset()
        self._robot = self._scene["robot"]
        # 3.0 tells x, y, z, w; its methods by index came with that.
        self._w_last = hasattr(self._robot, "write_root_link_pose_to_sim_index")
        names = list(self._robot.joint_names)
        self._robot_from_lab = [names.index(name) for name in robot.joint_names]
        self._origins = self._read(self._scene.env_origins)

    def _articulation(self, lab: Any, assets: Any, setup: Setup) -> Any:
        robot = setup.robot
        start = setup.start
        file = Path(self._folder.name) / f"{robot.name}.urdf"
        file.write_text(physical_urdf(start.loaded, robot), "utf-8")
        drive = lab.UrdfFileCfg.JointDriveCfg
        by_name = {
            word: dict(zip(robot.joint_names, map(float, getattr(setup.figures, word))))
            for word in ("armature", "damping", "friction")
        }
        motors = import_module("isaaclab.actuators").ImplicitActuatorCfg(
            joint_names_expr=list(robot.joint_names),
            stiffness=0.0,
            damping=by_name["damping"],  # towards a velocity target of 0
            armature=by_name["armature"],
            friction=by_name["friction"],
            dynamic_friction=by_name["friction"],
            effort_limit_sim=_STRONG,  # the servo limits them
            velocity_limit_sim=_FAST,
        )
        return assets.ArticulationCfg(
            prim_path="{ENV_REGEX_NS}/Robot",
            spawn=lab.UrdfFileCfg(
                asset_path=str(file),
                usd_dir=self._folder.name,
                force_usd_conversion=True,
                fix_base=not start.floating,
                merge_fixed_joints=False,
                self_collision=False,
                joint_drive=drive(
                    gains=drive.PDGainsCfg(stiffness=0.0, damping=0.0), target_type="none"
                ),
                rigid_props=lab.RigidBodyPropertiesCfg(
                    linear_damping=0.0,
                    angular_damping=0.0,
                    max_linear_velocity=_FAST,
                    max_angular_velocity=np.rad2deg(_FAST),
                ),
                articulation_props=lab.ArticulationRootPropertiesCfg(enabled_self_collisions=False),
            ),
            actuators={"motors": motors},
        )

    def place(self) -> None:
        start = self.start
        count = self.num_robots
        self._pose = np.zeros((count, 7))
        self._twist = np.zeros((count, 6))
        self._pose[:, :3], self._pose[:, 3:] = start.position, start.quat
        self._pos = np.tile(start.joint_pos, (count, 1))
        self._vel = np.zeros_like(self._pos)
        robot = self._robot
        robot.reset()
        pose = self._pose.copy()
        pose[:, :3] += self._origins
        if self._w_last:
            pose[:, 3:] = np.roll(pose[:, 3:], -1, axis=1)
        robot.write_root_link_pose_to_sim(self._tensor(pose))
        robot.write_root_link_velocity_to_sim(self._tensor(self._twist))
        told = [self._tensor(self._in_lab(values)) for values in (self._pos, self._vel)]
        robot.write_joint_state_to_sim(*told)

    def joints(self) -> tuple[Float64, Float64]:
        return self._pos, self._vel

    def base(self) -> WorldPose:
        pose = self._pose
        twist = self._twist
        return WorldPose(pose[:, :3], pose[:, 3:], twist[:, :3], twist[:, 3:])

    def step(self, torque: Float64) -> None:
        robot = self._robot
        data = self._robot.data
        robot.set_joint_effort_target(self._tensor(self._in_lab(torque)))
        self._scene.write_data_to_sim()
        self._sim.step(render=False)
        self._scene.update(self.timestep)
        pose, self._twist = self._read(data.root_link_pose_w), self._read(data.root_link_vel_w)
        quat = np.roll(pose[:, 3:], 1, axis=1) if self._w_last else pose[:, 3:]
        quat = quat / np.linalg.norm(quat, axis=1, keepdims=True)
        self._pose = np.hstack((pose[:, :3] - self._origins, quat))
        self._pos = self._read(data.joint_pos)[:, self._robot_from_lab]
        self._vel = self._read(data.joint_vel)[:, self._robot_from_lab]

    def add_velocity(self, velocity: Float64) -> None:
        self._twist = self._twist + np.hstack((velocity, np.zeros_like(velocity)))
        self._robot.write_root_link_velocity_to_sim(self._tensor(self._twist))

    def _in_lab(self, values: Float64) -> Float64:
        """Return values in the order of Isaac Lab's joints, shape (N, n)."""
        ordered = np.zeros_like(values)
        ordered[:, self._robot_from_lab] = values
        return ordered

    def _tensor(self, values: Float64) -> Any:
        return self._torch.from_numpy(values.astype(np.float32)).to(self._device)

    @staticmethod
    def _read(values: Any) -> Float64:
        """Return a copy of a tensor, which 3.0 wraps."""
        tensor = getattr(values, "torch", values)
        return np.array(tensor.cpu().numpy(), np.float64)

    def close(self) -> None:
        sim = self._sim
        self._sim = None
        if sim is not None:
            # As environments of Isaac Lab close; `stop` renders until somebody plays again.
            if hasattr(sim, "clear_all_callbacks"):  # 2.3
                sim.clear_all_callbacks()
            sim.clear_instance()
        self._folder.cleanup()


# Isaac Sim's application, of which a process has one.
_APP: list[Any] = []


def _launch(device: str, headless: bool) -> None:
    """Start Isaac Sim, before anything else of it is imported.

    Raises:
        MissingDependencyError: it is not installed.
    """
    if _APP:
        return
    try:
        from isaaclab.app import AppLauncher
    except ImportError as error:
        how = f"{INSTALL} ({error})"
        raise MissingDependencyError("platform 'isaaclab'", "isaaclab", how) from error
    _APP.append(AppLauncher(headless=headless, device=device).app)
    atexit.register(_APP[0].close)  # it ends the process


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    scene: Scene,
    timestep: float = 0.005,
    passive: Passive = "replace",
    device: Device = "cpu",
    headless: bool = True,
) -> IsaacLabPlatform:
    """Build the platform.

    Args:
        states: with `num_robots` set, as many robots are simulated, each in a world of its own.
        robot: its joints are found in the articulation by name.
        period: of a tick in [s].
        scene: how it begins.
        timestep: physics step in [s].
        passive: damping of the joints in the model: `keep` it beside that of the command, or
            `replace` it by that.
        device: `cpu`, or `cuda:0` for physics and tensors on a GPU.
        headless: without Isaac Sim's window.
    """
    setup = setup_of(states, robot, period, scene, timestep, passive)
    _launch(device, headless)
    return IsaacLabPlatform(device, setup)
