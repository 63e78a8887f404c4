"""What of a model may touch the floor, and which meshes are absent; for the check and the twin."""

from __future__ import annotations

from typing import Any

from unicon_core.check.result import CheckResult
from unicon_core.check.subject import listed
from unicon_core.models.loaded import LoadedModel
from unicon_core.models.posed import foot_geoms
from unicon_core.models.touching import floors, on_floor
from unicon_core.robots import Robot

__all__ = ["check_collision"]


def check_collision(loaded: LoadedModel, robot: Robot, result: CheckResult, where: Any) -> None:
    """Find a robot that would fall through the floor; note meshes that are absent.

    Args:
        loaded: the model that is simulated.
        robot: the robot.
        result: is added to.
        where: `file:line` of what chose the model.
    """
    for path, line in loaded.absent.items():
        result.note("model.meshes", f"model {path}", line, "add the files", where)
    if loaded.base is None or not floors(loaded.model):
        return
    touching = on_floor(loaded)
    feet = foot_geoms(loaded.model, robot.feet) if robot.walks else {}
    blind = [foot for foot, geoms in feet.items() if not {*geoms} & {*touching}]
    if not touching:
        what = "nothing of the robot collides with the floor: it falls through"
    elif feet and len(blind) == len(feet):
        what = f"its feet ({listed(blind)}) do not collide with the floor: it sinks to its shins"
    else:
        return
    result.find(
        "model.collision",
        f"model {loaded.path}, collision geometry",
        what,
        "add the mesh files, or give the feet geoms with contype and conaffinity or a <pair>",
        where,
    )
