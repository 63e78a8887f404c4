"""`unicon sweep`: rows that are the same however they are run, gates, reports, comparisons."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import answered, looked_at, read_page

from benchmarks.samples import random_policy
from unicon_base.errors import MissingDependencyError, UniconError
from unicon_core.robots import load_robot
from unicon_lab.analysis.run import read_run
from unicon_lab.sweep import pool
from unicon_lab.sweep.engines import LocalEngine
from unicon_lab.sweep.figures import COLUMNS
from unicon_lab.sweep.folder import Folder
from unicon_lab.sweep.plan import Plan
from unicon_lab.sweep.pool import HOPELESS, Result
from unicon_lab.sweep.report import bins_of, fall_words, write_report
from unicon_lab.sweep.results import Results
from unicon_lab.sweep.sweep_file import read_gate, read_sweep
from unicon_lab.sweep.worker import RowRunner
from unicon_ros.cli.main import main

pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")
pytest.importorskip("pyarrow")


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert main(["sweep", *map(str, arguments)]) == 1
    told = capsys.readouterr()
    assert told.err.count("\n") == 1
    return told.err.removeprefix("unicon: error: ").rstrip("\n")


def plan_of(folder: Path, *overrides: str) -> Plan:
    return Plan(read_sweep(folder.parent / "sweep.yaml", overrides))


def rows_of(results: Results) -> list[dict[str, Any]]:
    return [results.row(place) for place in range(len(results))]


# -- rows ------------------------------------------------------------------------------------------


def test_a_fixed_base_has_no_falls_and_no_distance(tmp_path: Path) -> None:
    (tmp_path / "arm.yaml").write_text(
        "robot: arx_x5\nplatform: mujoco\nrate: 50\nflow: {hold: {}}\n", "utf-8"
    )
    text = "workflow: arm.yaml\nduration: 0.1\nearly_stop: fall\nvary: {scene.seed: [0, 1]}\n"
    (tmp_path / "sweep.yaml").write_text(text, "utf-8")
    plan = Plan(read_sweep(tmp_path / "sweep.yaml"))
    runner, folder = RowRunner(plan.task()), Folder(tmp_path / "out", plan, "made")
    for index in (0, 1):
        folder.add(index, runner(list(plan.row(index).settings))["row"])
    runner.programs.close()
    folder.flush()
    folder.close()
    results = Results(tmp_path / "out")
    assert len(results.good) == 2
    for row in rows_of(results):
        assert row["outcome"] == "duration"
        assert row["energy_j"] is not None
        for name in ("fell", "fall_s", "tilt_deg", "distance_m", "speed_error"):
            assert row[name] is None, name
    assert fall_words(results).startswith("no fall is known: the base is fixed")
    assert not results.holds(read_gate("fall<0.5"))


def test_every_row_has_its_figures(done: Path) -> None:
    results = Results(done)
    assert (len(results), results.lacking, results.failed) == (20, 0, 0)
    assert {row["outcome"] for row in rows_of(results)} >= {"duration"}
    strong = [row for row in rows_of(results) if row["set.scene.push.velocity"] == 4.0]
    assert any(row["fell"] for row in strong)
    for row in rows_of(results):
        assert row["fell"] == (row["fall_s"] is not None)
        assert row["fault"] == (row["outcome"] == "fault") == (row["fault_block"] is not None)
        assert row["duration_s"] == pytest.approx(row["ticks"] * 0.02)
        assert row["energy_j"] > 0.0
        assert len(row["sha256_commands"]) == 64
        assert row["unfolded_mse"] is None


def test_one_process_by_itself_has_the_same_rows(done: Path) -> None:
    runner, results, plan = RowRunner(plan_of(done).task()), Results(done), plan_of(done)
    for index in (7, 0, 19, 7):  # in another order than the workers had
        told = runner(list(plan.row(index).settings))["row"]
        row = results.row(index)
        assert {name: row[name] for name in COLUMNS} == told
    assert runner.programs.built == 1
    runner.programs.close()


def test_the_commands_of_the_worst_run_them_again_to_the_bit(done: Path, tmp_path: Path) -> None:
    results = Results(done)
    worst = results.worst(20)
    outcomes = [results.row(place)["outcome"] for place in worst]
    falls = [place for place in worst if results.row(place)["outcome"] == "fell"][:1]
    faults = [place for place in worst if results.row(place)["outcome"] == "fault"][:1]
    assert outcomes[0] in ("fault", "fell")
    for place in {*worst[:1], *falls, *faults, worst[-1]}:
        words = shlex.split(results.command(place))
        assert words[:3] == ["unicon", "run", "go2_walk"]
        main([*words[1:], "--quiet", "--faults", "off", "--report", str(tmp_path / "report.json")])
        report = json.loads((tmp_path / "report.json").read_text())
        row = results.row(place)
        assert report["sha256_commands"] == row["sha256_commands"]
        assert report["ticks"] == row["ticks"]
        assert bool(report["faults"]) == row["fault"]


def test_the_same_command_again_runs_nothing(
    done: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path.name: path.stat().st_mtime_ns for path in done.glob("shard-*")}
    assert main(["sweep", str(done.parent / "sweep.yaml"), "--out", str(done)]) == 0
    assert Results(done).sha256 in capsys.readouterr().out
    assert {path.name: path.stat().st_mtime_ns for path in done.glob("shard-*")} == before


def test_a_row_that_cannot_be_built_is_told_and_the_rest_goes_on(done: Path) -> None:
    runner = RowRunner(plan_of(done).task())
    settings = list(plan_of(done).row(0).settings)
    for wrong, told in (
        ("scene.push.velocity=-1", "scene.push"),
        ("policies.walk=nothing_such", "unknown policy 'nothing_such'"),
        ("scene.nothing=1", "scene: unknown key 'nothing'"),
        ("platform=fake", "scene.push is"),
    ):
        row = runner([*settings, wrong])["row"]
        assert row["outcome"] == "refused", row
        assert told in row["text"] or wrong == "platform=fake"
    good = runner(settings)["row"]
    assert good["sha256_commands"] == Results(done).row(0)["sha256_commands"]
    runner.programs.close()


def test_two_policies_are_built_once_each(done: Path, tmp_path: Path) -> None:
    copy = tmp_path / "other"
    shutil.copytree(Path("config/policies/go2_velocity").resolve(), copy)
    runner = RowRunner(plan_of(done).task())
    settings = list(plan_of(done).row(0).settings)
    first = runner(settings)
    other = runner([*settings, f"policies.walk={copy}"])
    assert runner.programs.built == 2
    for name in ("program", "sha256_commands"):  # other files that say the same
        assert first["row"][name] == other["row"][name]
    for _ in range(2):
        runner(settings)
        runner([*settings, f"policies.walk={copy}"])
    assert runner.programs.built == 2
    assert set(first["facts"][first["row"]["program"]]) >= {"robot", "model", "network walk"}
    runner.programs.close()


def test_other_ground_is_laid_in_the_same_program(done: Path) -> None:
    runner = RowRunner(plan_of(done).task())
    settings = list(plan_of(done).row(0).settings)
    grounds = ["flat", "{rough: {extent: 8}}", "{stairs: {rise: 0.05}}", "{rough: {height: -1}}"]
    told = [runner([*settings, f"scene.terrain={ground}"])["row"] for ground in grounds]
    assert [row["outcome"] for row in told] == ["duration"] * 3 + ["refused"]
    assert "scene.terrain.rough.height is -1; write a number from 0 to 1 [m]" in told[3]["text"]
    assert runner.programs.built == 1
    runner.programs.close()


def test_the_reference_is_compared(done: Path, tmp_path: Path) -> None:
    runner = RowRunner(plan_of(done).task())
    settings = list(plan_of(done).row(0).settings)
    runner(settings)
    (kept,) = runner.programs._kept
    rollouts = kept.rollouts
    place = rollouts.program.states.offset("joint_pos")
    names = np.array(rollouts.program.robot.joint_names)
    positions = rollouts._rows[:30, place : place + 12][:, ::-1]
    np.savez(tmp_path / "r.npz", joint_pos=positions, joint_names=names[::-1], dt=0.02)
    task = plan_of(done).task() | {"reference": str(tmp_path / "r.npz")}
    row = RowRunner(task)(settings)["row"]
    assert row["unfolded_mse"] == pytest.approx(0.0, abs=1e-9)
    other = RowRunner(task)(list(plan_of(done).row(4).settings))["row"]
    assert other["unfolded_mse"] > 1e-5
    np.savez(tmp_path / "r.npz", joint_pos=positions, joint_names=names[::-1], dt=0.01)
    assert (
        "has 100 samples a second and the workflow 50 ticks"
        in RowRunner(task)(settings)["row"]["text"]
    )


def test_states_are_kept_of_every_row(done: Path, tmp_path: Path) -> None:
    results = Results(done)
    for row in rows_of(results):
        with np.load(done / "kept" / f"row_{row['row']:06d}.npz") as kept:
            assert kept["joint_pos"].shape == (row["ticks"], 12)
            assert kept["joint_pos"].dtype == kept["projected_gravity"].dtype == np.float32
    longest = max(rows_of(results), key=lambda row: row["ticks"])
    run = read_run(done / "kept" / f"row_{longest['row']:06d}.npz")
    assert run.about == {"robot": "go2", "workflow": "go2_walk", "platform": "mujoco"}
    (tmp_path / "kept").touch()  # where they cannot be written the sweep ends
    runner = RowRunner(plan_of(done).task(tmp_path))
    with pytest.raises(UniconError, match=r"cannot write .*kept/row_000000.npz: "):
        runner(list(plan_of(done).row(0).settings), "row_000000")


@pytest.mark.parametrize(
    ("name", "told"),
    [("joint_poz", "did you mean 'joint_pos'"), ("stamp_ns", "is int64; float32 ones are kept")],
)
def test_a_state_that_cannot_be_kept_is_told(
    name: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = f"workflow: go2_stand\nvary: {{scene.seed: [0]}}\nkeep: [{name}]\n"
    (tmp_path / "s.yaml").write_text(text)
    assert told in refused(capsys, tmp_path / "s.yaml", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    told = refused(capsys, tmp_path / "s.yaml", "--engine", "ray")
    assert "keep is of engine local or batch; take it out, or --engine local" in told


# -- workers that die ------------------------------------------------------------------------------


def engine_of(done: Path, tmp_path: Path, **changed: Any) -> LocalEngine:
    how = {"workers": 2, "timeout": 60.0} | changed
    return LocalEngine(plan_of(done).task(), how["workers"], how["timeout"], tmp_path)


@pytest.mark.slow
def test_a_worker_that_is_killed_or_stopped_loses_no_row(done: Path, tmp_path: Path) -> None:
    engine, results = engine_of(done, tmp_path, timeout=2.0), Results(done)
    found: dict[int, Result] = {}
    try:
        for result in engine.run(plan_of(done)):
            assert result.index not in found
            found[result.index] = result
            if len(found) == 3:
                os.kill(engine.pids[0], signal.SIGKILL)
            if len(found) == 6:
                os.kill(engine.pids[0], signal.SIGSTOP)  # the other one hangs: its row is late
    finally:
        engine.close()
    assert sorted(found) == list(range(20))
    for index, result in found.items():
        row = results.row(index)
        assert {name: row[name] for name in COLUMNS} == result.figures


@pytest.mark.slow
def test_a_row_that_kills_each_worker_is_told_as_crashed(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool, "TRIES", 2)  # a worker takes a second to come up
    bad = "import os\nfrom unicon_core.flow import Tick\n\n\ndef dies() -> Tick:\n"
    bad += "    def tick():\n        print('no more', flush=True)\n        os._exit(7)\n"
    bad += "    return tick\n"
    (tmp_path / "mod_dies.py").write_text(bad)
    rows = list(plan_of(done))[:3]
    from dataclasses import replace

    setting = "commands=[{call: 'mod_dies:dies'}]"
    rows[1] = replace(rows[1], settings=(*rows[1].settings, setting))
    sys.path.append(str(tmp_path))
    try:
        engine = engine_of(done, tmp_path, workers=1)
        try:
            found = {result.index: result.figures for result in engine.run(rows)}
        finally:
            engine.close()
    finally:
        sys.path.remove(str(tmp_path))
    assert found[1]["outcome"] == "crashed"
    assert found[1]["text"] == "2 times: exit status 7: no more"
    assert found[0]["sha256_commands"] == Results(done).row(0)["sha256_commands"]
    assert found[2]["sha256_commands"] == Results(done).row(2)["sha256_commands"]


def test_workers_that_never_come_up_end_the_sweep(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    engine = engine_of(done, tmp_path)
    with pytest.raises(UniconError, match=f"{HOPELESS} workers ended one after the other, .*exit"):
        list(engine.run(plan_of(done)))
    engine.close()


def test_a_missing_package_is_no_row_but_the_end(
    done: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    runner = RowRunner(plan_of(done).task())
    with pytest.raises(MissingDependencyError, match="pip install 'unicon_ros"):
        runner(list(plan_of(done).row(0).settings))


# -- the command -----------------------------------------------------------------------------------


def test_gates_decide_the_exit_status(done: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", "report", str(done), "--gate", "fall<0.01"]) == 1
    assert "gate fall<0.01: 0." in (told := capsys.readouterr().out)
    assert "BROKEN" in told
    good = ["--gate", "fall.lower<=0.9", "--gate", "distance_m.p05>-9", "--gate", "fault<1.1"]
    assert main(["sweep", "report", str(done), *good]) == 0
    assert capsys.readouterr().out.count("holds") == 3


def test_a_gate_for_each_value_names_the_worst(
    done: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results, each = Results(done), " for each scene.push.velocity"
    found = dict(results.compared(read_gate(f"fall<0.5{each}")))
    assert set(found) == {0.2, 4.0}
    together = results.compared(read_gate("fall<0.5"))
    assert together == [(None, pytest.approx(np.mean(list(found.values()))))]
    assert [value for value, _ in results.compared(read_gate(f"fall>0.5{each}"))] == [0.2, 4.0]
    assert main(["sweep", "report", str(done), "--gate", f"fall<{found[4.0] / 2}{each}"]) == 1
    assert f"{found[4.0]:.4g} at 4.0, BROKEN" in capsys.readouterr().out
    assert main(["sweep", "report", str(done), "--gate", f"fall<=1{each}"]) == 0


def test_a_gate_for_each_of_what_is_not_varied_is_told_before_anything_runs(
    done: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gate = ["--gate", "fall<1 for each scene.seat"]
    for words in (["report", str(done)], [str(done.parent / "sweep.yaml"), "--dry"]):
        assert main(["sweep", *words, *gate]) == 1
        told = capsys.readouterr().err
        assert "'scene.seat' is not varied; did you mean 'scene.seed'?" in told


def test_no_gate_is_known_or_holds_while_a_row_lacks(done: Path, tmp_path: Path) -> None:
    out = shutil.copytree(done, tmp_path / "out")
    said = json.loads((out / "sweep.json").read_text())
    said["identity"]["repeat"] = 2
    (out / "sweep.json").write_text(json.dumps(said))
    assert Results(out).lacking == 20
    assert not Results(out).holds(read_gate("fall<2"))
    assert Results(out).verdict(read_gate("fall<2")) == "gate fall<2: not known yet"
    assert Results(done).holds(read_gate("fall<2"))


def run_here(folder: Path, *overrides: str) -> Path:
    """Run a sweep in this process, by the code of a worker."""
    plan = Plan(read_sweep(folder / "walks.yaml", overrides))
    runner = RowRunner(plan.task())
    out = Folder(folder / f"out{len(list(folder.iterdir()))}", plan, "")
    for row in plan:
        told = runner(list(row.settings))
        out.know(told.get("facts", {}))
        out.add(row.index, told["row"])
    out.flush()
    out.close()
    runner.programs.close()
    return out.path


def test_a_worse_policy_is_found_by_gate_and_comparison(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("scipy")
    random_policy(tmp_path / "worse", load_robot("go2"))  # it has learned nothing
    text = "workflow: go2_walk\nduration: 1.2\n"
    text += "set: {flow: {policy: walk}, scene.initial_pose: 'policy:walk', commands: "
    text += "[{velocity_command: {constant: [0.8, 0.0, 0.0]}}]}\n"
    text += "vary: {scene.noise.joint_vel: {linspace: [0.0, 0.1, 8]}}\n"
    (tmp_path / "walks.yaml").write_text(text)
    good = run_here(tmp_path)
    worse = run_here(tmp_path, f"policies.walk={tmp_path / 'worse'}")
    assert main(["sweep", "report", str(good), "--gate", "distance_m.p05>0.3"]) == 0
    assert main(["sweep", "report", str(worse), "--gate", "distance_m.p05>0.3"]) == 1
    assert "BROKEN" in capsys.readouterr().out
    assert main(["sweep", "compare", str(good), str(worse)]) == 0
    told = capsys.readouterr().out
    assert "8 rows with the same values, pair by pair (McNemar, Wilcoxon)" in told
    way = next(line for line in told.splitlines() if line.startswith("distance_m"))
    assert way.split()[-1] == "differs", told
    assert "set differs" in told
    assert "only B has policy walk" in told


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("nothing.yaml",), "nothing.yaml"),
        (("report",), "report"),
        (("report", "a", "b"), "is not a sweep; write SWEEP.yaml, report FOLDER, or compare A B"),
        (("report", "nowhere"), "has no sweep.json"),
        (("compare", "nowhere", "b"), "has no sweep.json"),
        (("a.yaml", "--gate", "fall"), "is not a condition"),
    ],
)
def test_a_wrong_command_is_told(
    arguments: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert told in refused(capsys, *arguments)


def test_a_robot_is_refused(done: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = refused(capsys, done.parent / "sweep.yaml", "--set", "platform=unitree")
    assert "platform 'unitree' is a robot, and a sweep simulates; write set: {platform" in told
    runner = RowRunner(plan_of(done).task())
    row = runner([*plan_of(done).row(0).settings, "platform=unitree", "scene=null"])["row"]
    assert row["outcome"] == "refused"  # and nothing was opened
    assert "is a robot, and a sweep simulates" in row["text"]


def test_dry_tells_the_plan_and_writes_nothing(
    done: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["sweep", str(done.parent / "sweep.yaml"), "--dry", "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "20 rollouts of 0.6 s at most: grid of 20 points" in told
    assert "… and 15 more" in told
    assert not out.exists()


# -- the page --------------------------------------------------------------------------------------


def test_the_report_is_one_page_with_all_that_matters(done: Path) -> None:
    page = read_page((done / "report.html").read_text("utf-8"))
    results, found = Results(done), answered((done / "report.html").read_text("utf-8"))
    worst = results.row(results.worst(1)[0])
    assert f"row {worst['row']}, the worst" in found["Which joint"]
    assert f"row {worst['row']}, the worst" in found["When"]
    assert found["Did it fall"] == fall_words(results)
    assert found["Where is it recorded"].endswith(results.command(results.worst(1)[0]))
    assert results.command(results.worst(1)[0]) in page.text
    for words in ("Falls over each parameter", "Worst cases", results.sha256, "20 rollouts"):
        assert words in page.text
    assert len(page.table("row")) == 21


def test_bins_hold_every_row_once() -> None:
    values = list(np.random.default_rng(0).normal(size=1000))
    for each in (bins_of("x", values, 8), bins_of("x", [1, 2] * 10, 8), bins_of("x", "abc" * 9, 2)):
        assert each.places.min() >= 0
        assert each.places.max() < len(each.labels)
    assert len(bins_of("x", values, 8).labels) == 8
    assert np.bincount(bins_of("x", values, 8).places).min() == 125
    assert bins_of("x", [str(i) for i in range(40)], 8).labels[-1] == "others"
    assert len(bins_of("x", [5.0] * 20, 8).labels) == 1


def test_texts_of_others_are_shown_to_the_letter(tmp_path: Path) -> None:
    text = "workflow: go2_stand\nduration: 0.1\n"
    words = ["$$", "a$b^$", "$", "</svg><script>alert(1)</script>"]
    text += f"vary: {{description: {words}, scene.delay: [0, 1]}}\n"
    (tmp_path / "walks.yaml").write_text(text)
    page = write_report(Results(run_here(tmp_path))).read_text("utf-8")
    assert "<script" not in page
    assert [row[1] for row in read_page(page).table("parameter")[1:5]] == [
        each[-24:] for each in words
    ]
    assert "→" not in page  # eight places of one rollout each are no map


def test_maps_are_drawn_where_places_have_numbers_enough(tmp_path: Path) -> None:
    text = "workflow: go2_stand\nduration: 0.02\nsample: random\nrollouts: {}\n"
    text += "vary: {{scene.noise.joint_vel: {{uniform: [0, 1]}}, scene.delay: [0, 1]}}\n"
    for count, maps in ((39, 0), (48, 1)):
        (tmp_path / str(count)).mkdir()
        (tmp_path / str(count) / "walks.yaml").write_text(text.format(count))
        page = write_report(Results(run_here(tmp_path / str(count)))).read_text("utf-8")
        assert page.count("→") == maps
        assert "a place has a colour from 10 rollouts on" in page
    cells = [cell for row in read_page(page).table("scene.delay")[1:] for cell in row[1:]]
    assert sum(int(cell.split("/")[1]) for cell in cells) == 48
    enough = sum(int(cell.split("/")[1]) >= 10 for cell in cells)
    assert page.count("<span style=") == enough > 0
    assert (tmp_path / "48").exists()


@pytest.mark.slow
def test_a_browser_shows_the_report(done: Path, tmp_path: Path) -> None:
    told, console = looked_at((done / "report.html").read_text("utf-8"), tmp_path)
    assert console == []
    assert told


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["local", "batch"])
def test_kills_at_random_moments_lose_and_repeat_no_row(engine: str, tmp_path: Path) -> None:
    text = "workflow: go2_walk\nduration: 2\nset:\n  flow: {policy: walk}\n"
    text += "  scene.terrain: {rough: {extent: 8}}\n"
    text += "vary: {scene.noise.joint_vel: {uniform: [0, 1]}}\nsample: random\nrollouts: 60\n"
    (tmp_path / "s.yaml").write_text(text)
    command = [sys.executable, "-m", "unicon_ros", "sweep", str(tmp_path / "s.yaml")]
    subprocess.run([*command, "--out", str(tmp_path / "a")], check=True, capture_output=True)
    random = np.random.default_rng(0)
    for sign in (signal.SIGKILL, signal.SIGTERM, signal.SIGKILL, signal.SIGINT, None):
        process = subprocess.Popen(
            [*command, "--out", str(tmp_path / "b"), "--workers", "2", "--engine", engine],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        if sign is None:
            assert process.wait(300) == 0
        else:
            time.sleep(4.0 + 2.0 * random.random())
            process.send_signal(sign)
            process.wait(60)
    assert Results(tmp_path / "a").sha256 == Results(tmp_path / "b").sha256
