"""`unicon transfer`: the table, its files, and simulators that end badly."""

from __future__ import annotations

import json
import math
import os
import resource
import signal
import subprocess
import sys
import time
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import answered, read_page

from unicon_base.resources import sha256_of
from unicon_core.robots import load_robot
from unicon_lab.analysis.run import read_run
from unicon_lab.transfer.report import PICTURES
from unicon_lab.transfer.results import COLUMNS, cell, spread
from unicon_lab.transfer.rollout import make_plan, simulators
from unicon_ros.cli.main import main

STAND = ("transfer", "go2_stand", "--duration", "1.0")
NOISE = ("--set", "scene.noise.joint_vel=0.1")


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["transfer", *arguments]) == 1
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1
    return told.err.removeprefix("unicon: error: ").rstrip("\n")


def read(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "transfer.json").read_text("utf-8")))


def rows(result: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {each["platform"]: each for each in result["platforms"]}


# -- what is decided before anything runs --------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("nothing_such",), "nothing_such"),
        (("go2_stand", "--platforms", "mujoko"), "did you mean 'mujoco'?"),
        (("go2_stand", "--platforms", "unitree"), "'unitree' is a robot"),
        (("go2_stand", "--platforms", ","), "names none"),
        (("go2_stand", "--platforms", "mujoco pybullet"), "put commas between names"),
        (("go2_teleop", "--platforms", "mujoco"), "give --duration S"),
        (("go2_stand", "--set", "num_robots=4"), "one robot; add --set num_robots=null"),
        (("go2_stand", "--set", "scene.seed=x"), "scene.seed is 'x'"),
        (("go2_stand", "--out", "/dev/full"), "/dev/full is not a folder"),
        (("go2_stand", "--out", "/dev/full/x"), "give another to --out"),
        (("go2_stand", "--out", ""), "--out has no name"),
    ],
)
def test_what_cannot_be_compared_is_refused_in_one_line(
    arguments: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert told in refused(capsys, *arguments)


@pytest.mark.parametrize("seeds", ["0", "-1", "1.5", "many", "1001"])
def test_seeds_are_a_number(seeds: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["transfer", "go2_stand", "--seeds", seeds])
    assert ended.value.code == 2
    assert "--seeds" in capsys.readouterr().err


def test_seeds_count_only_where_something_is_drawn_from_them() -> None:
    still = make_plan("go2_stand", (), "fake,mujoco,fake", 4, None, 60.0)
    assert (still.platforms, still.seeds) == (("fake", "mujoco"), (0,))
    assert "fake is named more than once" in still.notes[0]
    assert "neither noise nor push" in still.notes[1]
    noisy = make_plan("go2_stand", (NOISE[1], "scene.seed=5"), "fake", 4, 2.0, 60.0)
    assert (noisy.seeds, noisy.notes) == ((5, 6, 7, 8), ())
    assert noisy.rows()[1].settings[-2:] == ("platform=fake", "scene.seed=6")
    pushed = make_plan("go2_stand", ("scene.push={every: 1.0, velocity: 0.2}",), "fake", None, 2, 9)
    assert pushed.seeds == (0, 1, 2)


def test_all_simulators_are_the_default_and_the_workflows_own_is_the_first() -> None:
    every = simulators()
    assert {"mujoco", "pybullet", "mjx"} <= set(every)
    assert not {"fake", "fake_robot", "replay", "ros", "unitree"} & set(every)
    plan = make_plan("go2_stand", ("platform=pybullet",), None, None, None, 60.0)
    assert plan.platforms == ("pybullet", *(name for name in every if name != "pybullet"))
    robot = make_plan("go2_stand", ("platform=unitree",), None, None, None, 60.0)
    assert robot.platforms == every
    assert robot.notes == ("Platform unitree, the workflow's, is a robot and was left out.",)


def test_spread_is_over_what_is_there() -> None:
    assert spread([1.0, None, 3.0, math.nan]) == {"mean": 2.0, "std": math.sqrt(2.0), "runs": 2}
    assert spread([4.0]) == {"mean": 4.0, "std": None, "runs": 1}
    assert spread([None]) == {"mean": None, "std": None, "runs": 0}
    assert cell(spread([1.0, 3.0])) == "2.00 ± 1.4"
    assert cell(spread([0.5]), 100.0) == "50.0"
    assert cell(spread([])) == "–"


# -- runs ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def transfer(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, str]:
    """The folder that a transfer leaves, and what it prints and says meanwhile."""
    pytest.importorskip("pybullet")
    pytest.importorskip("matplotlib")
    out = tmp_path_factory.mktemp("transfer") / "out"
    with redirect_stdout(StringIO()) as printed, redirect_stderr(StringIO()) as said:
        assert main([*STAND, "--platforms", "mujoco,pybullet", "--out", str(out)]) == 0
    return out, printed.getvalue(), said.getvalue()


def test_a_table_in_one_command(
    transfer: tuple[Path, str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    out, printed, said = transfer
    assert said == ""  # no progress where nobody looks
    assert "unfolded MSE [rad²]" in printed
    result = read(out)
    assert result["schema"] == "unicon.transfer/1"
    assert result["first"] == "mujoco"
    both = rows(result)
    assert list(both) == ["mujoco", "pybullet"]
    for row in both.values():
        assert (row["outcome"], row["runs_done"], row["falls"]) == ("ran", 1, 0)
        assert row["figures"]["wall_per_simulated_s"]["mean"] > 0.0
    figures = both["pybullet"]["figures"]
    assert 1e-8 < figures["mse"]["mean"] < 0.01
    assert 0.0 < figures["unfolded_mse"]["mean"] <= 24 * figures["mse"]["mean"] * (1 + 1e-9)
    assert both["mujoco"]["figures"]["mse"]["mean"] is None
    # A second transfer into the same folder replaces nothing.
    before = (out / "transfer.json").read_bytes()
    assert "has a transfer already" in refused(capsys, *STAND[1:], "--out", str(out))
    assert (out / "transfer.json").read_bytes() == before


@pytest.mark.slow
def test_a_simulator_that_ends_badly_is_a_row_that_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    odd = ("killed", "stopped", "falls", "exits", "floods", "not_a_number")
    names = [f"odd_simulators:{name}" for name in odd]
    told = ("--platforms", ",".join(["fake", *names]), "--timeout", "8", "--out", str(tmp_path))
    assert main([*STAND, *told]) == 3
    result = rows(read(tmp_path))
    expected = {
        "killed": ("crashed", "ended by SIGKILL: the engine said this"),
        "stopped": ("timeout", "no end within 8 s"),
        "falls": ("fell", "fell at 0.80 s"),
        "exits": ("crashed", "exit status 7"),
        "floods": ("crashed", "printed more than 10 MB"),
        "not_a_number": ("fault", "a measured state is not a number from 0.80 s on"),
    }
    for name, (outcome, text) in expected.items():
        row = result[f"odd_simulators:{name}"]
        assert row["outcome"] == outcome, name
        assert text in row["troubles"][0], name
    assert result["odd_simulators:falls"]["falls"] == 1
    assert result["odd_simulators:not_a_number"]["figures"]["mse"]["mean"] == pytest.approx(0.0)
    assert result["fake"]["outcome"] == "ran"
    assert "the engine said this" in capsys.readouterr().out
    assert "the engine said this" in (tmp_path / "report.html").read_text("utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["mujoco", "pybullet"])
def test_a_robot_that_is_pushed_over_falls_in_each_run(platform: str, tmp_path: Path) -> None:
    push = ("--set", "scene.push={every: 0.5, velocity: 6.0}", "--seeds", "2")
    out = ("--platforms", platform, "--out", str(tmp_path))
    assert main(["transfer", "go2_walk", "--duration", "8", *push, *out]) == 3  # of tilt_stop
    row = rows(read(tmp_path))[platform]
    assert row["falls"] == 2
    assert row["figures"]["distance_m"]["mean"] == 0.0  # it lay before it was commanded
    assert "allowed are 1.00" in row["troubles"][0]


@pytest.mark.slow
def test_where_nothing_can_be_run_or_written_the_exit_status_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = (*STAND, "--platforms", "replay")
    assert main([*told]) == 1
    assert "needs a recording" in capsys.readouterr().out
    assert main(["transfer", "go2_stand", "--platforms", "fake", "--duration", "0.001"]) == 1
    assert "it has no tick" in capsys.readouterr().out
    full = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, full[1]))  # as a full disk
    try:
        assert main([*STAND, "--platforms", "fake", "--out", str(tmp_path / "full")]) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, full)
    told_of = capsys.readouterr()
    assert "seed_0.npz: File too large" in told_of.out
    assert "report.html: File too large" in told_of.err


@pytest.mark.slow
def test_noise_differs_by_seed_and_repeats_with_it(tmp_path: Path) -> None:
    hashes = []
    for name in ("one", "two"):
        out = tmp_path / name
        told = ("--platforms", "mujoco", "--seeds", "2", *NOISE, "--out", str(out))
        assert main(["transfer", "go2_walk", "--duration", "5", *told]) == 0
        runs = rows(read(out))["mujoco"]["runs"]
        hashes.append([run["sha256_commands"] for run in runs])
        assert [run["seed"] for run in runs] == [0, 1]
    assert hashes[0] == hashes[1]
    assert len(set(hashes[0])) == 2


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_done_and_ends_the_run_at_hand(tmp_path: Path) -> None:
    out = tmp_path / "out"
    odd = ("--platforms", "fake,odd_simulators:stopped,mujoco", "--out", str(out))
    paths = os.pathsep.join(sys.path)
    process = subprocess.Popen(
        [sys.executable, "-m", "unicon_ros", *STAND, *odd],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": paths},
    )
    child = 0
    try:
        end = time.monotonic() + 40.0
        log = out / "runs" / "odd_simulators_stopped" / "seed_0.log"
        while not log.exists() and time.monotonic() < end:
            time.sleep(0.1)
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        child = int(children.read_text().split()[0])
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        printed, _ = process.communicate(timeout=20)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 128 + signal.SIGINT
    assert not Path(f"/proc/{child}").exists()
    result = read(out)
    assert result["interrupted"]
    assert rows(result)["fake"]["outcome"] == "ran"
    assert rows(result)["odd_simulators:stopped"]["outcome"] == "interrupted"
    assert "It was interrupted" in printed


# -- the page --------------------------------------------------------------------------------------


def test_the_page_needs_nothing_beside_it_and_tells_what_it_shows(
    transfer: tuple[Path, str, str],
) -> None:
    out = transfer[0]
    page = (out / "report.html").read_text("utf-8")
    shown, found = read_page(page), answered(page)
    assert "differs most from" in found["Which joint"]
    assert "(95 %: " in found["Did it fall"]
    assert page.count('<a href="./runs/') == 2
    assert list(shown.pictures) == [heading for _, heading, _ in PICTURES.values()]
    assert min(shown.pictures.values()) > 30
    for heading, unit, meaning in COLUMNS.values():
        assert f"<th>{heading}<br><small>{unit}</small></th>" in page
        assert f"[{unit}] {meaning}" in page
    assert "prefers-color-scheme: dark" in page
    assert (out / "joints.png").read_bytes().startswith(b"\x89PNG")


def test_the_json_is_plain_and_names_what_was_run(transfer: tuple[Path, str, str]) -> None:
    out = transfer[0]
    text = (out / "transfer.json").read_text("utf-8")
    result = json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))
    workflow = result["workflow"]
    assert workflow["sha256"] == sha256_of(Path(workflow["file"]))
    assert result["robot"] == "go2"
    for row in result["platforms"]:
        run = row["runs"][0]
        assert run["ticks"] == 50
        with np.load(out / run["file"]) as kept:
            assert kept["joint_pos"].shape == (50, 12)
            assert kept["velocity_command"].shape == (50, 3)
            assert kept["joint_names"][0] == load_robot("go2").joint_names[0]


def test_the_runs_are_read_by_analyze(transfer: tuple[Path, str, str]) -> None:
    files = [str(path) for path in sorted((transfer[0] / "runs").glob("*/seed_0.npz"))]
    assert len(files) == 2
    real, sim = (read_run(Path(file), (0.0, 0.7)) for file in files)
    assert real.joints == sim.joints == load_robot("go2").joint_names
    np.testing.assert_allclose(real.states["joint_pos"], sim.states["joint_pos"], atol=0.1)
