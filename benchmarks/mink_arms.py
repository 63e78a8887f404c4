"""Both arms of a robot by mink, as the peer of our inverse kinematics; for `unicon bench reach`.

Its model has the arms' joints alone, so that its problem is as small as ours; all else stands at
the robot's default pose. Its solver is daqp, as ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.ik.chain import CAPSULE, FRAME, Pair, add_reaching
from unicon_core.ik.tasks import Pose
from unicon_core.models.loaded import import_mujoco
from unicon_core.robots import Robot


class MinkArms:
    """One step of mink in each call.

    Args:
        path: MJCF file of the robot, whose joints are called as in the robot file.
        robot: whose arms they are.
        effectors: names of its end effectors.
        moved: places of the moved joints in the robot's order, shape (k,).
        rate: largest speed of a joint in [rad/s].
        period: of a step in [s].
        pairs: of capsules that are kept apart; none for no such limit.
        apart: distance that they keep in [m].

    Attributes:
        pos: where the moved joints are commanded, in [rad], shape (k,).
    """

    def __init__(
        self,
        path: Path,
        robot: Robot,
        effectors: Sequence[str],
        moved: NDArray[np.intp],
        rate: float,
        period: float,
        pairs: Sequence[Pair] = (),
        apart: float = 0.02,
    ) -> None:
        import mink

        self._mink, self._period = mink, period
        names = [robot.joint_names[i] for i in moved]
        model = _arms_of(path, robot, effectors, names)
        self._configuration = mink.Configuration(model)
        self._tasks = [
            mink.FrameTask(FRAME + name, "body", position_cost=1.0, orientation_cost=0.3)
            for name in effectors
        ]
        posture = mink.PostureTask(model, cost=0.02, gain=0.01)
        posture.set_target(model.qpos0)
        self._all = [*self._tasks, posture]
        self._limits = [
            mink.ConfigurationLimit(model),
            mink.VelocityLimit(model, dict.fromkeys(names, rate)),
        ]
        if pairs:
            self._limits.append(
                mink.CollisionAvoidanceLimit(
                    model,
                    [([CAPSULE + one], [CAPSULE + other]) for one, other in pairs],
                    minimum_distance_from_collisions=apart,
                    collision_detection_distance=0.08 + apart,
                )
            )
        self._index = [int(model.joint(name).qposadr[0]) for name in names]
        self.begin(robot.default_joint_pos[moved])

    def begin(self, pos: NDArray[Any]) -> None:
        """Begin where the moved joints are, in [rad], shape (k,)."""
        start = np.zeros(len(self._index))
        start[self._index] = pos
        self._configuration.update(start)

    @property
    def pos(self) -> NDArray[np.float64]:
        found: NDArray[np.float64] = self._configuration.q[self._index]
        return found

    def __call__(self, targets: Sequence[Pose]) -> None:
        """Move on by one step towards a target of each end effector."""
        mink, configuration = self._mink, self._configuration
        for task, (position, quat) in zip(self._tasks, targets):
            task.set_target(mink.SE3(np.array([*quat, *position])))
        velocity = mink.solve_ik(
            configuration, self._all, self._period, "daqp", damping=1e-4, limits=self._limits
        )
        configuration.integrate_inplace(velocity, self._period)


def _arms_of(path: Path, robot: Robot, effectors: Sequence[str], names: Sequence[str]) -> Any:
    """Return the model with some joints alone; the others stand at the default pose."""
    mujoco = import_mujoco()
    spec = mujoco.MjSpec.from_file(str(path))
    add_reaching(spec, robot, effectors, path)
    for geom in spec.geoms:
        if geom.name.startswith(CAPSULE):  # mink leaves out what cannot touch
            geom.contype = geom.conaffinity = 1
    root = spec.worldbody.first_body()
    root.pos, root.quat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    for each in (*spec.actuators, *spec.sensors, *spec.keys):
        spec.delete(each)
    default = dict(zip(robot.joint_names, robot.default_joint_pos.tolist()))
    for joint in list(spec.joints):
        if joint.name in names:
            continue
        if joint.name in default:
            _turn(mujoco, joint.parent, joint.axis, default[joint.name])
        spec.delete(joint)
    return spec.compile()


def _turn(mujoco: Any, body: Any, axis: Any, angle: float) -> None:
    """Turn a body about an axis of its own, as its joint at the body's origin would."""
    turn, turned = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, np.asarray(axis, np.float64), angle)
    mujoco.mju_mulQuat(turned, np.asarray(body.quat, np.float64), turn)
    body.quat = turned
