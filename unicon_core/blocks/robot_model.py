"""`model_for`: a robot's model for blocks that compute with it, loaded once for all of them."""

from __future__ import annotations

from unicon_core.errors import MissingDependencyError
from unicon_core.models.find import model_of
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel
from unicon_core.workflow.autowire import BuildContext


def model_for(block: str, context: BuildContext) -> LoadedModel:
    """Return the model that the platform simulates; of a robot, or of what it carries, its own.

    Blocks compute with an `MjData` of their own and leave the model as it is.

    Args:
        block: that asks, for the message.
        context: with which it is built.

    Raises:
        ModelError: there is none, or it lacks a joint of the robot.
        MissingDependencyError: MuJoCo, which computes the kinematics, is not installed.
    """
    robot = context.robot
    path = model_of(None if context.carried else context.platform, robot)
    found: LoadedModel | None = context.models.get((robot.name, path))
    if found is None:
        try:
            found = load_model(path, robot, quiet=True)
        except MissingDependencyError as error:
            raise MissingDependencyError(
                f"block {block!r}", "mujoco", "pip install 'unicon_ros[sim]'"
            ) from error
        context.models[robot.name, path] = found
    return found
