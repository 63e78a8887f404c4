"""What of a model may touch the floor, and which meshes are absent; for the check and the twin."""

from __future__ import annotations

from typing import Any

from unicon_core.check.result import CheckResult
from unicon_core.check.subject import listed
from unicon_core.models.loaded import LoadedModel
from unicon_core.models.posed import foot_bodies, foot_geoms
from unicon_core.models.touching import floors, on_floor
from unicon_core.robots import Robot


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
    touching, model = on_floor(loaded), loaded.model
    geoms = foot_geoms(model, robot.feet) if robot.walks else {}
    bodies = foot_bodies(model, robot.feet) if robot.walks else {}
    lost = {foot: loaded.absent_shapes.get(model.body(i).name, []) for foot, i in bodies.items()}
    feet = [foot for foot in bodies if foot in geoms or lost[foot]]  # else its shape may be another
    blind = [foot for foot in feet if not {*geoms.get(foot, ())} & {*touching}]
    if not touching:
        what = "nothing of the robot collides with the floor: it falls through"
    elif feet and len(blind) == len(feet):
        what = f"its feet ({listed(blind)}) do not collide with the floor: it sinks to its shins"
    else:
        return
    files = dict.fromkeys(file for foot in blind for file in lost[foot])
    what += f"; mesh files that are their shapes are absent: {listed(files)}" if files else ""
    result.find(
        "model.collision",
        f"model {loaded.path}, collision geometry",
        what,
        "add the mesh files, or give the feet geoms with contype and conaffinity or a <pair>",
        where,
    )
