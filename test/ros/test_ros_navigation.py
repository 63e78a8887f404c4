"""A Go2 is driven as Nav2 drives one: a smoother between who plans and `cmd_vel`, odometry back."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from unicon_core.flow import Block, Stage
from unicon_core.workflow import Program, load_document

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

SIDE = 1.5
SMOOTHED = np.array((1.5, 0.8, 3.0)) / 20.0
"""What the smoother changes its command by at most, see `peers/velocity_smoother.py`."""


class Seen:
    """What was so, tick by tick: place, velocity command, and the velocity with its estimate."""

    def __init__(self) -> None:
        self.places: list[Any] = []
        self.commands: list[Any] = []

    def hook(self, program: Program) -> dict[Stage, list[Block]]:
        states = program.states

        def truth() -> None:  # before an estimate takes its place
            self.places.append(states["base_pos_w"].copy())

        def command() -> None:
            self.commands.append(states["velocity_command"].copy())

        return {
            Stage.RECV: [Block("truth", truth, endless=True)],
            Stage.OBSERVE: [
                Block("command", command, reads=("velocity_command",), endless=True),
            ],
        }


def off_the_square(places: np.ndarray, side: float) -> np.ndarray:
    """Return how far each place is from the outline in [m], shape (n,)."""
    corners = np.array(((0, 0), (side, 0), (side, side), (0, side), (0, 0)), np.float64)
    distances = []
    for begin, end in itertools.pairwise(corners):
        way = end - begin
        share = np.clip((places - begin) @ way / (way @ way), 0.0, 1.0)
        distances.append(np.linalg.norm(places - begin - share[:, None] * way, axis=1))
    return np.asarray(np.min(distances, axis=0))


@pytest.mark.slow
@pytest.mark.parametrize("workflow", ["go2_teleop", "go2_nav"])
def test_a_velocity_smoother_drives_along_a_square(
    runs: Callable[..., Any], peers: Callable[..., Any], workflow: str
) -> None:
    """`go2_teleop` tells the simulator's odometry, `go2_nav` that of its own legs."""
    seen = Seen()
    tells = load_document(workflow).get("map", str)
    run = runs(workflow, hooks=[seen.hook], duration=200.0, map=tells)
    states, statistics = run.program.states, run.runner.statistics
    stood = round(2.5 / run.program.period)
    smoother = peers("velocity_smoother")
    smoother.wait_for(lambda: statistics.count >= stood, "a Go2 that stands")
    driver = peers("square_driver", str(SIDE))
    driver.wait_for(lambda: bool(driver.of("done")) or not run.alive, "the square", 90.0)
    assert run.alive, run.warnings
    # The smoother slows down and falls silent, as the driver has.
    driver.wait_for(lambda: not states.velocity_command.any(), "a Go2 that stands again", 10.0)
    report = run.end()
    assert report.faults == []
    assert not report.fell
    places = np.array(seen.places)[stood:, :2]
    assert off_the_square(places, SIDE).max() < 0.3
    for corner in ((SIDE, 0.0), (SIDE, SIDE), (0.0, SIDE), (0.0, 0.0)):
        assert np.linalg.norm(places - corner, axis=1).min() < 0.3
    changes = np.abs(np.diff(np.array(seen.commands), axis=0))
    assert changes.max() > 0.0
    # Two messages between two ticks at most: the smoother's rate is less than the workflow's.
    assert (changes <= 2.0 * SMOOTHED + 0.021).all()
    corners = driver.of("corner")
    assert len(corners) == 4
    if workflow == "go2_nav":
        of_place = [corner["of_place"] for corner in corners]
        assert of_place == sorted(of_place)
        assert 0.0 < of_place[0] < of_place[-1] < 0.3**2
        assert all(0.0 < corner["of_velocity"] < 0.1 for corner in corners)
