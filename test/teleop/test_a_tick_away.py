"""Hands led from a workstation a tick away, at full speed: both parts in step in one process."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import scripted_headset  # noqa: F401  found by the workflow
from teleop_runs import ROOT, SIDES

from unicon_core.flow import compile_graph
from unicon_core.workflow.document import load_document
from unicon_core.workflow.program import Program

pytest.importorskip("mujoco", reason="G1 walks in MuJoCo")
pytest.importorskip("daqp", reason="pip install 'unicon_ros[ik]'")

TICKS, BEGIN = 800, 250


def errors(folder: Path, divided: bool) -> np.ndarray:
    """Run a session; return how far the hands were from their targets in [m]."""
    text = (ROOT / "config" / "workflows" / "g1_vr.yaml").read_text("utf-8")
    operator = "{function: 'scripted_headset:scripted', ahead: 0.22, radius: 0.06}"
    text = text.replace("webxr: {}", f"call: {operator}")
    text = text.replace("{zmq: tcp://127.0.0.1:5600}", f"{{shm: tick-away-{os.getpid()}}}")
    text = text.replace("after: 0.2", "after: 60.0")  # parts are built while the other stands still
    if divided:
        text = text.replace("&where robot", "&where workstation")
    path = folder / f"g1_{divided}.yaml"
    path.write_text(text, "utf-8")
    programs = [Program(load_document(path), part="robot" if divided else "")]
    graphs, found = [compile_graph(programs[0].root)], []
    try:
        for number in range(TICKS):
            graphs[0].step()
            graphs[0].deferred()
            if divided and number == 0:
                programs.append(Program(load_document(path), part="workstation"))
                graphs.append(compile_graph(programs[1].root))
            for graph in graphs[1:]:
                graph.step()
                graph.deferred()
            if number < BEGIN:
                continue
            states = programs[0].states
            for side in SIDES:
                age = 1e-9 * float(states["stamp_ns"] - states[f"{side}_target_stamp_ns"])
                wanted = states[f"{side}_target"][:3] + age * states[f"{side}_target_velocity"][:3]
                found.append(np.linalg.norm(states[f"{side}_pose"][:3] - wanted))
            assert 0.009 < age < (0.031 if divided else 0.011)
        assert programs[0].states["base_pos_w"][2] > 0.6
    finally:
        for program in reversed(programs):
            program.close()
    return np.array(found)


@pytest.mark.slow
@pytest.mark.usefixtures("assets")
def test_hands_are_as_near_to_their_targets_as_on_the_robot(tmp_path: Path) -> None:
    here, away = (np.percentile(errors(tmp_path, each), [50, 95]) for each in (False, True))
    print("error local and away [mm]:", (1e3 * here).round(1), (1e3 * away).round(1))
    assert (away <= 1.5 * here).all()
