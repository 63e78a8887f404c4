"""Stepped ground for training and its measurement: boxes in the model, heights for the scan.

Kinds and boxes are those of the shipped terrain words (`unicon_core.terrain`).
"""

from __future__ import annotations

import copy
import sys

import contract
import mujoco
import numpy as np
from physics import Physics, randomise, training_spec

sys.path.insert(0, str(contract.CONFIG.parent))
from unicon_core.terrain.ground import Ground, ground_of
from unicon_core.terrain.words import read_terrain

HALF = 7.0  # from the start to the edge of the ground in [m]
CELL = 0.025  # of the heights that training looks up in [m]
BOXES = 40  # in each model, so that all models have the same sizes
RISES = np.linspace(0.0, 0.12, 13)  # of a step in [m]: one level of the curriculum each
ROBOTS = 5  # random robots on each ground
COLLIDE = ("head_lower", *(f"{leg}_shin" for leg in contract.LEGS))  # beside feet: they hit edges
SHARES = (0.5, 0.15, 0.2, 0.15)  # of robots on each kind of ground
CLIMBS = (0, 2)  # kinds that go up first: they decide on the level
GROUNDS = len(SHARES)  # of each level


def stairs(rise: float, run: float, steps: int, landing: float, flat: float = 2.0) -> Ground:
    """Flights of steps in front of the start, in [m]."""
    figures = {"rise": rise, "run": run, "steps": steps, "landing": landing, "flat": flat}
    return ground_of(read_terrain({"stairs": {**figures, "extent": 2 * HALF}}, 0))


def random_ground(rise: float, kind: int, rng: np.random.Generator) -> Ground:
    """Steps of about one height: up first, down first, a pit, or boxes strewn on the floor."""
    run, flat = rng.uniform(0.25, 0.5), rng.uniform(1.0, 1.5)
    rise *= rng.uniform(0.9, 1.0)
    if rise == 0.0:
        return Ground(0.0)
    if kind < 2:
        steps, landing = int(rng.integers(3, 9)), rng.uniform(0.6, 1.5)
        return stairs(-rise if kind == 1 else rise, run, steps, landing, flat)
    if kind == 2:
        figures = {"rise": rise, "run": run, "steps": BOXES // 4, "flat": flat}
        return ground_of(read_terrain({"pyramid": {**figures, "extent": 2 * HALF}}, 0))
    figures = {"height": [rise / 2, rise], "size": [0.4, 1.5], "density": BOXES / (4 * HALF**2)}
    seed = int(rng.integers(10_000))
    return ground_of(
        read_terrain({"obstacles": {**figures, "extent": 2 * HALF, "flat": flat}}, seed)
    )


def heights(ground: Ground, points: np.ndarray) -> np.ndarray:
    """Height of the ground under x, y in [m], shape (...) of points (..., 2)."""
    found = np.full(points.shape[:-1], ground.floor)
    for box in ground.boxes:
        inside = (np.abs(points - box.centre[:2]) <= box.half[:2]).all(axis=-1)
        top = box.centre[2] + box.half[2]
        found = np.where(inside, np.maximum(found, top), found)
    return found


def raster(ground: Ground, axis: np.ndarray) -> np.ndarray:
    """`heights` at all pairs of x and y from `axis`, shape (n, n)."""
    tops = np.full((len(axis), len(axis)), ground.floor, np.float32)
    for (x, y, z), (dx, dy, dz) in ((box.centre, box.half) for box in ground.boxes):
        columns = slice(*np.searchsorted(axis, [x - dx, x + dx]))
        rows = slice(*np.searchsorted(axis, [y - dy, y + dy]))
        tops[columns, rows] = np.maximum(tops[columns, rows], z + dz)
    return tops


def lay(spec: mujoco.MjSpec, ground: Ground, count: int = 0) -> None:
    """Put the ground into a model; boxes below all of it make up for those missing to `count`."""
    floor = spec.geom("floor")
    floor.pos[2] = ground.floor
    shapes = [(box.centre, box.half) for box in ground.boxes]
    shapes += [((0.1 * i, 0.0, -50.0), (0.01,) * 3) for i in range(count - len(shapes))]
    for centre, half in shapes:
        geom = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=centre, size=half)
        geom.contype, geom.conaffinity, geom.friction = 1, 0, floor.friction


class TerrainPhysics(Physics):
    """`Physics` on grounds of all levels; a robot changes its ground by `move`.

    Attributes:
        level: of the curriculum of each robot, shape (num_envs,).
    """

    elliptic = 0.0  # a third of the time on two cores, and steps need all of it

    def __init__(
        self,
        num_envs: int,
        timestep: float,
        rng: np.random.Generator,
        threads: int,
        pool: int,
        feet_only: bool = True,
    ) -> None:
        collide = COLLIDE if feet_only else ()

        def model(ground: Ground) -> mujoco.MjModel:
            spec = training_spec(timestep, feet_only, collide)
            lay(spec, ground, BOXES)
            return spec.compile()

        super().__init__(num_envs, timestep, rng, threads, 1, base=model(Ground(0.0)))
        axis = np.arange(-HALF, HALF, CELL) + CELL / 2
        self.tops, self.pool = np.zeros((len(RISES), GROUNDS, len(axis), len(axis)), np.float32), []
        for level, rise in enumerate(RISES):
            for kind in range(GROUNDS):
                ground = random_ground(rise, kind, rng)
                self.tops[level, kind] = raster(ground, axis)
                flat = model(ground)
                for _ in range(ROBOTS):
                    self.pool.append(copy.copy(flat))
                    randomise(self.pool[-1], self.base, rng, self.elliptic)
        self.level = np.zeros(num_envs, np.int64)
        self.kind = np.zeros(num_envs, np.int64)
        self.move(np.arange(num_envs), self.level, rng)

    def move(self, ids: np.ndarray, level: np.ndarray, rng: np.random.Generator) -> None:
        """Put robots on a random ground of their level, each as another random robot."""
        self.level[ids] = level
        self.kind[ids] = rng.choice(len(SHARES), len(ids), p=SHARES)
        robot = rng.integers(0, ROBOTS, len(ids))
        for i, index in zip(ids, (self.level[ids] * GROUNDS + self.kind[ids]) * ROBOTS + robot):
            self.models[i] = self.pool[index]

    def ground(self, points: np.ndarray, ids: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Height under x, y in [m], shape (num_envs, n) of points (num_envs, n, 2)."""
        cells = np.clip((points + HALF) / CELL, 0, self.tops.shape[2] - 1).astype(np.int64)
        level, kind = self.level[ids, None], self.kind[ids, None]
        return self.tops[level, kind, cells[..., 0], cells[..., 1]]
