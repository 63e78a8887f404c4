"""Where a robot has the body by which motions are compared: forward kinematics from its base.

A humanoid measures the orientation of its pelvis, and motions are compared by the torso: three
joints are between.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from unicon_base.errors import PolicyError, alternatives
from unicon_core.models.frames import Quat, Vector, multiply, rotate, turned
from unicon_core.models.kinematic_tree import BASE, frame_of, read_tree
from unicon_core.models.load import load_model
from unicon_core.policies.contract import AXES
from unicon_core.robots import Robot


@dataclass(frozen=True)
class Step:
    """A link on the way from base to anchor: where it stands, and what its joint does to it.

    Attributes:
        position: in the parent's frame in [m].
        quat: link to parent at joint position 0, wxyz.
        index: of its joint in the robot's order, -1 where it is fixed.
        axis: unit vector in the link's frame.
        sliding: moves along the axis and does not turn about it.
    """

    position: Vector
    quat: Quat
    index: int
    axis: Vector
    sliding: bool = False


@dataclass(frozen=True)
class Chain:
    """The way from the base to a body.

    Attributes:
        steps: from the base outwards; empty where the base itself is meant.
        placed: whether positions are known; of axes alone they are not.
    """

    steps: tuple[Step, ...]
    placed: bool = True

    def __call__(
        self, position: Vector, quat: Quat, joints: Sequence[float]
    ) -> tuple[Vector, Quat]:
        """Return where the body is in the world, [m], and its orientation, body to world, wxyz.

        Args:
            position: of the base in the world in [m].
            quat: base to world, wxyz.
            joints: positions in the robot's order in [rad] or [m].
        """
        for step in self.steps:
            x, y, z = rotate(quat, step.position)
            position = (position[0] + x, position[1] + y, position[2] + z)
            quat = multiply(quat, step.quat)
            if step.index < 0:
                continue
            if step.sliding:
                way, axis = joints[step.index], step.axis
                x, y, z = rotate(quat, (axis[0] * way, axis[1] * way, axis[2] * way))
                position = (position[0] + x, position[1] + y, position[2] + z)
            else:
                quat = multiply(quat, turned(step.axis, joints[step.index]))
        return position, quat


def chain_of_axes(axes: Mapping[str, str], joints: Sequence[str], what: str) -> Chain:
    """Return a chain of joints that turn about axes of the base, as a contract may say it.

    Args:
        axes: joint to `x`, `y`, `z`, `-x`, `-y` or `-z`, from the base outwards.
        joints: of the robot.
        what: the policy, for messages.

    Raises:
        PolicyError: a joint that the robot lacks.
    """
    steps = []
    for joint, axis in axes.items():
        if joint not in joints:
            raise PolicyError(
                f"{what}: motion.chain names {joint!r}; {alternatives(joint, joints)}"
            )
        index = list(joints).index(joint)
        steps.append(Step((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), index, AXES[axis]))
    return Chain(tuple(steps), placed=not steps)


def chain_in_model(robot: Robot, path: Path, body: str, what: str) -> Chain:
    """Return the chain to a body of a model.

    Args:
        robot: gives joint names and the base.
        path: MJCF or URDF.
        body: its name in the model.
        what: the policy, for messages.

    Raises:
        PolicyError: the model has no such body.
        UniconError: the model cannot be read.
    """
    model = load_model(path, robot, quiet=True).model
    links = read_tree(model, robot)
    base = (BASE, robot.base_frame)
    own = {model.body(number).name for number in range(model.nbody)}
    names = [link.name if link.name in (*base, *own) else "" for link in links]
    if body not in names:
        known = alternatives(body, [name for name in names if name])
        raise PolicyError(f"{what}: motion.anchor_body {body!r} is not a body of {path}; {known}")
    steps: list[Step] = []
    if body not in base:  # a link's origin is at its joint, a body's is not
        origin = frame_of(model, robot, model.body(body).id)
        assert origin is not None
        x, y, z = map(float, -origin[1])
        steps.append(Step((x, y, z), (1.0, 0.0, 0.0, 0.0), -1, AXES["z"]))
    place = names.index(body)
    while place >= 0:
        link = links[place]
        (x, y, z), (w, i, j, k) = map(float, link.position), map(float, link.quat)
        a, b, c = map(float, link.axis)
        steps.insert(0, Step((x, y, z), (w, i, j, k), link.index, (a, b, c), link.sliding))
        place = link.parent
    return Chain(tuple(steps))
