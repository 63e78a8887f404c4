"""The service ~/swap: from a plain process and from `unicon call`, with the reason of a refusal."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from unicon_ros.cli.main import main

pytest.importorskip("onnxruntime", reason="pip install onnxruntime")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]

WORKFLOW = """\
robot: go2
platform: fake
policies: {walk: go2_velocity}
shadow: {walk: {path: go2_velocity, bound: 3.0, limit: 1.0}}
flow: {policy: walk}
safety: [finite]
"""


def test_a_swap_by_service_is_answered_with_what_happens(
    runs: Callable[..., Any],
    peers: Callable[..., Any],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "w.yaml"
    path.write_text(WORKFLOW)
    run = runs(path)
    peer = peers("caller", "unicon", "wait=2.0", "swap")
    status, errors = peer.end()
    assert status == 0, errors
    (answer,) = peer.lines
    assert (answer["success"], answer["message"]) == (True, "shadow_walk takes over from walk")
    share = run.program.states["shadow_walk_share"]
    peer.wait_for(lambda: share == 1.0, "the end of the blend")
    assert main(["call", "swap"]) == 0
    assert "back to walk\n" in capsys.readouterr().out
    peer.wait_for(lambda: share == 0.0, "the blend back")
    assert main(["call", "swap"]) == 1
    assert "refused: shadow_walk has been fit for" in capsys.readouterr().out
    assert run.end().faults == []


def test_a_workflow_without_a_shadow_says_so(
    runs: Callable[..., Any], react: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs(react)
    assert main(["call", "swap"]) == 1
    assert "this workflow has no shadow" in capsys.readouterr().out
