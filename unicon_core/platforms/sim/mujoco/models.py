"""The models of a MuJoCo platform: as the file has it, and with the ground of a scene."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from pathlib import Path

from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel
from unicon_core.models.terrain import load_on
from unicon_core.robots import Robot
from unicon_core.terrain.words import Terrain


class Models:
    """Reads a model once, and once for each ground; who asks again gets a copy.

    Args:
        path: MJCF or URDF file.
        robot: whose joints must all be there.
        timestep: physics step in [s], None for the model's own.

    Raises:
        ModelError: the file is wrong, or lacks a joint of the robot.
    """

    def __init__(self, path: Path, robot: Robot, timestep: float | None) -> None:
        self._path, self._robot, self._timestep = path, robot, timestep
        self.flat = load_model(path, robot, timestep)
        self._laid: tuple[Terrain, LoadedModel] | None = None

    def on(self, terrain: Terrain | None) -> LoadedModel:
        """Return a model that may be changed, on flat ground or on this; see `load_on`.

        Raises:
            ModelError: the model has other surroundings than a floor.
        """
        if terrain is None:
            return replace(self.flat, model=copy(self.flat.model))
        if self._laid is None or self._laid[0] != terrain:
            laid = load_on(self._path, self._robot, terrain, self._timestep, flat=self.flat)
            self._laid = terrain, laid
        return replace(self._laid[1], model=copy(self._laid[1].model))
