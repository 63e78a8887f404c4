"""Healthy robots walk with every safety block, and none trips."""

from __future__ import annotations

from pathlib import Path

import pytest
from long_walks import missing, soak


@pytest.fixture(params=["go2", "g1"])
def walker(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param == "g1":
        assets: Path = request.getfixturevalue("assets")
        monkeypatch.setenv("UNICON_ASSETS", str(assets))
    return str(request.param)


def test_a_soak_has_every_safety_block_that_can_see_something() -> None:
    assert missing() == {
        "hardware_stop",  # simulators tell of no motors
        "remote_stop",  # nor of a remote
        "observation_stop",  # needs the bounds of a run before
        "power_stop",  # needs a limit of one's own
        "height_stop",  # likewise
        "rate_limit",  # a policy's steps are as large as it was trained to make them
        "button_stop",  # nobody presses one
        "velocity_limits",  # for wheels
        "twin_stop",  # needs a `twin:`; test/examples counts its flags in sound runs
    }


def test_ten_seconds_with_noise_and_pushes_trip_nothing() -> None:
    walked = soak("go2", 10.0, seed=11)
    assert (walked.trips, walked.falls, walked.ticks) == ([], 0, 500)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_an_hour_with_noise_and_pushes_trips_nothing(walker: str) -> None:
    walked = soak(walker, 3600.0)
    assert walked.trips == []
    assert walked.ticks == 180_000
    assert walked.falls <= 60
