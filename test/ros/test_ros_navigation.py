"""A Go2 is driven as Nav2 drives one: a smoother between who plans and `cmd_vel`, odometry back."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_core.flow import Block, Stage
from unicon_core.workflow import HookBlocks, Program, load_document

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

SIDE = 1.5
SMOOTHED = np.array((1.5, 0.8, 3.0)) / 20.0
"""What the smoother changes its command by at most, see `peers/velocity_smoother.py`."""


class Seen:
    """What was so, tick by tick: place, velocity command, and the velocity with its estimate."""

    def __init__(self) -> None:
        self.places: list[Any] = []
        self.commands: list[Any] = []

    def hook(self, program: Program) -> HookBlocks:
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
    tells = load_document(workflow).get("map")
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


ODOMETRY_IN = """\
schema: unicon.workflow/1
robot: go1
platform: blind_platform:make
rate: 50
states: {odometry_stamp_ns: {shape: [], dtype: int64, unit: ns}}
flow: {chain: [{loop: {do: hold, until: "base_lin_vel[0] > 0.4 and base_pos_w[0] > 0.3"}}, hold]}
safety: [finite, {stale_stop: {timeout: 2.0, states: {stamp_ns: odometry_stamp_ns}}}]
map: odometry_in
ros: true
"""
BLIND = """
from dataclasses import replace

from unicon_core.platforms.fake import FakePlatform, make as fake

TOLD = tuple(n for n in FakePlatform.facts.writes if n not in ("base_lin_vel", "base_pos_w"))
FACTS = replace(FakePlatform.facts, name="blind", writes=TOLD)


def make(states, robot, period):
    made = fake(states, robot, period)
    told = [id(states[name]) for name in TOLD]
    made._outputs = [(view, value) for view, value in made._outputs if id(view) in told]
    made.facts = FACTS
    return made


make.facts = FACTS
"""


@pytest.mark.slow
def test_odometry_of_somebody_else_comes_in_and_its_silence_is_a_fault(
    runs: Callable[..., Any],
    peers: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "blind_platform.py").write_text(BLIND, "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    path = tmp_path / "odometry_in.yaml"
    path.write_text(ODOMETRY_IN, "utf-8")
    talker = peers("odometry_talker", "3.0")
    talker.wait_for(lambda: bool(talker.of("ready")), "the talker")
    run = runs(path, map="odometry_in")
    states = run.program.states
    talker.wait_for(lambda: states.base_pos_w[0] > 0.3, "odometry")
    assert states.base_lin_vel.tolist() == [0.5, 0.0, 0.0]
    talker.wait_for(lambda: not run.alive, "a fault")
    assert talker.of("silent")
    (fault,) = run.end().faults
    assert "stale" in fault
    assert states.base_pos_w[0] > 1.0  # held, and not a jump to the origin
