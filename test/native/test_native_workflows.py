"""All shipped workflows command the same in Python and natively, at full speed and in real time."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from unicon_base.errors import UniconError
from unicon_core.native.build import COMPILERS
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
@pytest.mark.skipif(not any(map(shutil.which, COMPILERS)), reason="no C++ compiler")
@pytest.mark.parametrize("name", sorted(p.stem for p in ROOT.glob("config/workflows/*.yaml")))
def test_a_shipped_workflow_commands_the_same(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    found = {}
    for speed in ("max", "real"):
        for native in (False, True):
            warnings: list[str] = []
            options = RunOptions(duration=4.0, speed=speed, native=native, warn=warnings.append)
            try:
                runner = Runner(load_workflow(name), options)
            except UniconError as missing:
                pytest.skip(str(missing))
            report = runner.run()
            assert not report.faults
            assert not any("native tick" in line for line in warnings)
            assert ("n0()" in runner.graph.source) is native
            found[speed, native] = report.sha256_commands
    assert len({*found.values()}) == 1, found
