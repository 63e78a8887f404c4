"""Engine `batch`: the same table as engine `local`, whatever dies, hangs or cannot be batched."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import pytest

from unicon_core.policies.networks import onnx
from unicon_core.policies.networks.onnx import OnnxNetwork, share_sessions
from unicon_lab.sweep import pool
from unicon_lab.sweep.engines import LocalEngine, Wish, engine_of
from unicon_lab.sweep.figures import COLUMNS
from unicon_lab.sweep.plan import Plan, Row
from unicon_lab.sweep.results import Results
from unicon_lab.sweep.sweep_file import read_sweep
from unicon_lab.sweep.worker import RowRunner
from unicon_ros.cli.main import main

pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")
pytest.importorskip("pyarrow")

DIES = """\
import os
from unicon_core.flow import Tick

def dies() -> Tick:
    def tick():
        print("no more", flush=True)
        os._exit(7)
    return tick
"""


@pytest.fixture
def plan(done: Path) -> Plan:
    return Plan(read_sweep(done.parent / "sweep.yaml"))


@pytest.fixture
def runner(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> Callable[..., RowRunner]:
    """Makes what runs rows side by side, in this process."""
    monkeypatch.setattr(onnx, "_shared", WeakValueDictionary())
    return lambda batch: RowRunner(plan.task() | {"batch": batch})


def figures(results: Results, index: int) -> dict[str, Any]:
    row = results.row(index)
    return {name: row[name] for name in COLUMNS}


def together(runner: RowRunner, rows: list[Row], stagger: int) -> dict[int, dict[str, Any]]:
    """Run rows side by side, one begun some ticks behind the other."""
    left, found = list(rows), dict[int, dict[str, Any]]()
    while left or len(runner):
        if left and len(runner) < runner.batch:
            row = left.pop(0)
            if (refused := runner.begin(row.index, list(row.settings))) is not None:
                found[row.index] = refused["row"]
        for _ in range(stagger if left else 1):
            found |= {index: told["row"] for index, told in runner.tick()}
    return found


@pytest.mark.parametrize(("rows", "stagger"), [((3, 0, 17, 9, 1, 18), 1), ((17, 18, 19, 9), 7)])
def test_a_row_does_not_depend_on_who_is_beside_it(
    done: Path,
    plan: Plan,
    runner: Callable[..., RowRunner],
    rows: tuple[int, ...],
    stagger: int,
) -> None:
    results, three = Results(done), runner(3)
    found = together(three, [plan.row(i) for i in rows], stagger)
    assert found == {i: figures(results, i) for i in rows}
    assert three.programs.built == 3
    three.programs.close()


def test_what_cannot_be_batched_runs_as_local_does(
    plan: Plan, done: Path, runner: Callable[..., RowRunner]
) -> None:
    three = runner(3)
    fake = ("platform=fake", "scene=null", "policies={}", "flow={pose: {to: stand}}")
    rows = [plan.row(0), plan.row(1), plan.row(2), plan.row(3)]
    rows[1] = replace(rows[1], settings=(*rows[1].settings, *fake, "commands=[]"))
    rows[2] = replace(rows[2], settings=(*rows[2].settings, "scene.nothing=1"))
    found = together(three, rows, 4)
    one = RowRunner(plan.task())
    assert found[1] == one(list(rows[1].settings))["row"]
    assert found[2]["outcome"] == "refused"
    assert {i: found[i] for i in (0, 3)} == {i: figures(Results(done), i) for i in (0, 3)}
    assert three.programs.why_not == "platform 'fake' cannot begin in another scene"
    for each in (one, three):
        each.programs.close()


def test_the_command_makes_the_same_table(done: Path, tmp_path: Path) -> None:
    file, out = str(done.parent / "sweep.yaml"), tmp_path / "out"
    batch = ["--workers", "1", "--engine", "batch", "--batch", "3"]
    assert main(["sweep", file, "--out", str(out), *batch]) == 0
    assert Results(out).sha256 == Results(done).sha256


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--engine", "bath"), "--engine 'bath'; did you mean 'batch'?"),
        (("--batch", "3"), "engine 'local' runs one row at a time in each process; add --engine"),
    ],
)
def test_a_wrong_engine_is_told(
    done: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], told: str
) -> None:
    assert main(["sweep", str(done.parent / "sweep.yaml"), *arguments]) == 1
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1


def test_sessions_are_shared_where_it_is_asked_for(
    plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = Path("config/policies/go2_velocity/policy.onnx").resolve()
    assert OnnxNetwork(model)._session is not OnnxNetwork(model)._session
    monkeypatch.setattr(onnx, "_shared", None)
    share_sessions()
    first = OnnxNetwork(model)
    share_sessions()  # what is there stays
    assert OnnxNetwork(model)._session is first._session
    assert OnnxNetwork(model, threads=2)._session is not first._session


def test_rows_that_may_have_ended_a_worker_are_given_alone(plan: Plan, tmp_path: Path) -> None:
    engine = LocalEngine(plan.task(), 1, 60.0, tmp_path, batch=3)
    engine._fill()
    (worker,) = engine._workers
    again = [(plan.row(0), 2), (plan.row(1), 1)]
    try:
        worker.give((plan.row(3), 1))
        assert engine._next(worker, again[:1]) is None  # it is not empty
        assert engine._next(worker, again[:]) == again[1]
        worker.rows.clear()
        assert engine._next(worker, again[:]) == again[0]
        assert engine._wants(worker)
        worker.give(again[0])
        assert not engine._wants(worker)
    finally:
        engine.close()


@pytest.mark.slow
def test_a_row_that_ends_or_stops_its_worker_takes_no_other_with_it(
    done: Path, plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool, "START_S", 20.0)
    (tmp_path / "mod_batch.py").write_text(DIES)
    rows = list(plan)
    setting = "commands=[{call: 'mod_batch:dies'}]"
    rows[1] = replace(rows[1], settings=(*rows[1].settings, setting))
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    engine = engine_of(plan, Wish("batch", workers=2, batch=3), len(plan), tmp_path)
    assert isinstance(engine, LocalEngine)
    engine._timeout = 3.0
    found: dict[int, dict[str, Any]] = {}
    try:
        for result in engine.run(rows):
            assert result.index not in found
            found[result.index] = result.figures
            if len(found) == 3:
                os.kill(engine.pids[0], signal.SIGKILL)
            if len(found) == 8:
                os.kill(engine.pids[-1], signal.SIGSTOP)
    finally:
        engine.close()
    assert sorted(found) == list(range(20))
    assert found[1]["text"] == "3 times: exit status 7: no more"
    for index in set(found) - {1}:
        assert found[index] == figures(Results(done), index), index


@pytest.mark.slow
def test_mjx_rows_run_by_themselves_and_are_the_same(
    plan: Plan, runner: Callable[..., RowRunner]
) -> None:
    pytest.importorskip(
        "mujoco.mjx", reason="mujoco-mjx is not installed: pip install 'unicon_ros[sim-mjx]'"
    )
    settings = [(*plan.row(i).settings, "platform=mjx") for i in (0, 1)]
    rows = [replace(plan.row(i), settings=each) for i, each in enumerate(settings)]
    three, one = runner(3), RowRunner(plan.task())
    found = together(three, rows, 1)
    assert found == {i: one(list(each))["row"] for i, each in enumerate(settings)}
    assert found[0]["ticks"] > 0
    assert three.programs.why_not == "platform 'mjx' cannot begin in another scene"
    for each in (one, three):
        each.programs.close()
