"""What blocks that compute with a robot's model share: that model, and a tick for warm-ups."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from numpy.typing import NDArray

from unicon_core.errors import MissingDependencyError
from unicon_core.models.find import model_of
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel
from unicon_core.workflow.autowire import BuildContext

Views = Mapping[str, NDArray[Any]]
Made = TypeVar("Made")


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


def twice(
    make: Callable[[Views, Views], Made], views: Views, outs: Views
) -> tuple[Made, Made, Callable[[], None]]:
    """Return a tick, another one that runs the same code on copies, and what refreshes those.

    Args:
        make: makes a tick of what it reads and what it writes.
        views: states that it reads.
        outs: states that it writes.
    """
    copies = {name: view.copy() for name, view in views.items()}
    second = make(copies, {name: view.copy() for name, view in outs.items()})

    def refresh() -> None:
        for name, view in views.items():
            copies[name][...] = view

    return make(views, outs), second, refresh
