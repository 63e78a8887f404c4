"""The C-level floor, where ddsperf is installed."""

from __future__ import annotations

import re
import shutil

import pytest

from unicon_ros.bench.rounds import c_level_floor


def test_without_ddsperf_there_is_no_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    assert c_level_floor(57) is None


@pytest.mark.skipif(shutil.which("ddsperf") is None, reason="ddsperf (cyclonedds-tools) is absent")
def test_the_floor_is_told_in_microseconds() -> None:
    floor = c_level_floor(57)
    assert floor is not None
    assert re.fullmatch(r"p50 [\d.]+ µs, p99 [\d.]+ µs", floor)
