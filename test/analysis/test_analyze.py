"""`unicon analyze`: what it finds in made-up runs, its files, and what it refuses in one line."""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_runs import CALF, LEGS, save, walk
from pages import answered, read_page
from replaying import cut_off

from unicon_lab.analysis.comparison import Comparison, compare_runs
from unicon_lab.analysis.paired_runs import bring_together
from unicon_lab.analysis.pictures import PICTURES
from unicon_lab.analysis.report import findings_of
from unicon_lab.analysis.run import read_run
from unicon_ros.cli.main import main

pytest.importorskip("matplotlib")


def compared(folder: Path, real: dict[str, Any], sim: dict[str, Any], **options: Any) -> Comparison:
    """Return the comparison of two runs, through files."""
    runs = [read_run(save(folder / f"{n}.npz", r)) for n, r in (("real", real), ("sim", sim))]
    return compare_runs(bring_together(runs[0], runs[1], **options))


def first(comparison: Comparison) -> str:
    return comparison.together.joints[comparison.order[0]]


@pytest.mark.slow
def test_the_report_names_the_weak_motor_and_needs_nothing_beside_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("unicon_lab.analysis.pictures.TOP", 2)
    real = walk(begin=0.74, seed=1)
    real["joint_pos"][:, CALF] -= 0.2
    real["joint_effort"][1:, CALF] = (
        0.5 * 40.0 * (real["joint_pos_target"][:-1, CALF] - real["joint_pos"][1:, CALF])
    )
    real["motor_temperature"] = 30.0 + np.linspace(0, 20, len(real["joint_pos"]))[:, None] * (
        np.arange(12) == CALF
    )
    sim = walk()
    sim["motor_temperature"] = np.full(sim["joint_pos"].shape, 30.0)
    files = [str(save(tmp_path / f"<{n}>.npz", r)) for n, r in (("real", real), ("sim", sim))]
    out = tmp_path / "new" / "report"
    assert main(["analyze", *files, "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert "RL_calf differs most" in said.out
    assert "(distance of the distributions of the tracking error (Wasserstein-1))" in said.out
    assert re.search(r"Less torque for what is asked, down to \d\d %: RL_calf\.", said.out)
    assert "Warms more, by up to 18 K: RL_calf." in said.out
    assert f"unicon analyze: reading {files[0]}" in said.err
    assert {path.name for path in out.iterdir()} == {
        *("report.html", "analysis.json"),
        *(f"{name}.png" for name in PICTURES),
    }
    result = json.loads((out / "analysis.json").read_text("utf-8"))
    assert result["schema"] == "unicon.analysis/1"
    assert [joint["rank"] for joint in result["joints"]] == list(range(1, 13))
    assert result["joints"][0]["name"] == "RL_calf"
    assert result["joints"][0]["strength"] == pytest.approx(0.5, abs=0.02)
    assert result["shift_samples"] == -37
    page = (out / "report.html").read_text("utf-8")
    assert "&lt;real&gt;.npz" in page
    assert "<real>" not in page
    shown, found = read_page(page), answered(page)
    assert found["Which joint"].startswith("RL_calf differs most, by 0.")
    assert found["When"].startswith("differs most from ")
    assert 'href="./../../%3Creal%3E.npz"' in page
    assert list(shown.pictures) == [heading for _, heading, _ in PICTURES.values()]
    assert min(shown.pictures.values()) > 30
    for name in PICTURES:
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_runs_that_are_one_differ_in_nothing(tmp_path: Path) -> None:
    found = compared(tmp_path, walk(), walk())
    assert findings_of(found) == ["No joint differs."]
    assert found.to_json()["shift_samples"] == 0
    for name, figures in found.to_json()["states"].items():
        assert set(figures.values()) == {0.0}, name
    json.dumps(found.to_json(), allow_nan=False)


def test_joints_that_differ_alike_make_no_headline(tmp_path: Path) -> None:
    """Two runs that differ by noise alone: some joint is always first, by a thousandth."""
    real, sim = walk(seed=1), walk(seed=2)
    noise = np.random.default_rng(3).normal(0.0, 0.05, real["joint_pos"].shape)
    real["joint_pos"] = real["joint_pos"] + noise
    found = compared(tmp_path, real, sim)
    headline = findings_of(found)[0]
    assert headline.startswith("No joint stands out: "), headline
    assert " differ alike, by 0.0" in headline
    assert "times as much as" not in headline
    assert "tracking error (Wasserstein-1)" in headline
    real["joint_pos"][:, CALF] += 0.1
    assert findings_of(compared(tmp_path, real, sim))[0].startswith("RL_calf differs most, by 0.")


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("swap", "FR_calf and FL_calf look swapped"),
        ("sign", "A sign seems to be turned: RR_thigh."),
        ("late", "Later than the other joints, by up to 60 ms: RL_calf."),
        ("gain", "Moves less far, down to 0.50 times as far: RL_calf."),
        ("zero", "Off by a constant, up to 0.10 rad (a wrong zero, or a weak motor): FL_hip."),
        ("fall", "The real robot fell at 4.00 s of its run, the simulated one did not fall."),
    ],
)
def test_each_fault_is_told_for_what_it_is(tmp_path: Path, fault: str, said: str) -> None:
    real, sim = walk(seed=1), walk(seed=2)
    pos = real["joint_pos"]
    if fault == "swap":
        pos[:, [2, 5]] = pos[:, [5, 2]]
    elif fault == "sign":
        pos[:, LEGS.index("RR_thigh")] *= -1.0
    elif fault == "late":
        pos[3:, CALF] = pos[:-3, CALF].copy()
    elif fault == "gain":
        pos[:, CALF] *= 0.5
    elif fault == "zero":
        pos[:, LEGS.index("FL_hip")] += 0.1
    else:
        real["projected_gravity"][200:] = [1.0, 0.0, 0.0]
        pos[200:] = 0.0
    found = compared(tmp_path, real, sim)
    assert any(text.startswith(said) for text in findings_of(found)), findings_of(found)
    if fault == "fall":
        assert int(found.together.aligned.overlap) == 200
        # A shift may hide a fall, which is one more reason to cut there.
        whole = compared(tmp_path, real, sim, whole=True, max_shift=0.0)
        assert float(whole.joints["gap"].max()) > 10 * float(found.joints["gap"].max())


def test_who_hardly_moves_is_not_judged(tmp_path: Path) -> None:
    """Two stands: one settles, the other sways a little against it."""
    real, sim = walk(seed=1), walk(seed=2)
    sim["joint_pos"] = 0.5 + 0.3 * np.exp(-np.arange(300) / 30.0)[:, None] * np.ones(12)
    real["joint_pos"] = 0.5 - 0.01 * sim["joint_pos"]
    said = findings_of(compared(tmp_path, real, sim, max_shift=0.0))
    assert not [text for text in said if text.startswith(("A sign", "Moves", "Later"))]
    [still] = [text for text in said if text.startswith("Hardly moves")]
    assert still.startswith(
        "Hardly moves (below 0.02 rad rms in a run): sign, range and lag not judged: "
    )
    assert still.endswith(" and 8 more.")


def test_joints_are_matched_by_their_names(tmp_path: Path) -> None:
    real, sim = walk(seed=1), walk(seed=2)
    order = np.random.default_rng(0).permutation(12)
    for name, values in sim.items():
        if name.startswith("joint_"):
            sim[name] = values[..., order]
    sim["joint_names"] = np.array([*sim["joint_names"][:-1], "tail"])
    found = compared(tmp_path, real, sim)
    assert len(found.together.joints) == 11
    assert float(found.joints["position_rmse"].max()) < 0.01
    missing = LEGS[order[-1]]
    assert f"Only real.npz has {missing}: left out." in found.together.notes
    assert "Only sim.npz has tail: left out." in found.together.notes


def test_another_rate_and_another_clock_find_the_same_shift(tmp_path: Path) -> None:
    real, sim = walk(rate=500.0, begin=0.74, seed=1), walk(rate=50.0)
    shaken = real["stamp_ns"] + np.random.default_rng(0).integers(-400_000, 400_000, 3000)
    found = compared(tmp_path, {**real, "stamp_ns": shaken}, sim)
    both = found.together
    assert both.period == pytest.approx(0.02)
    assert int(both.aligned.shift) == -37
    assert float(found.joints["position_rmse"].max()) < 0.01
    assert both.method == (
        "the real run (500 Hz) and the simulated one (50 Hz) were resampled to 50 Hz, linearly; "
        "before that the real one was averaged over each new period"
    )
    assert compared(tmp_path, real, sim, rate=100.0).together.period == 0.01
    long = compared(tmp_path, real, sim, max_shift=0.2).together
    assert abs(int(long.aligned.shift)) <= 10


def test_a_long_run_is_thinned_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("unicon_lab.analysis.paired_runs.LONGEST", 200)
    found = compared(tmp_path, walk(begin=0.3), walk())
    assert int(found.together.aligned.overlap) <= 201
    assert "200 samples are compared at most" in found.together.method


def test_what_is_not_a_number_is_left_out_and_told(tmp_path: Path) -> None:
    real = walk()
    real["joint_effort"][10:20, 4] = np.nan
    found = compared(tmp_path, real, walk())
    assert "strength" not in found.joints
    [note] = [note for note in found.together.notes if "nan" in note]
    assert note == (
        "real.npz: joint_effort is nan in 10 samples from 0.20 to 0.38 s, first in FL_thigh; "
        "it was left out."
    )
    real["joint_pos"][100:110, 0] = np.inf
    save(tmp_path / "real.npz", real)
    cut = read_run(tmp_path / "real.npz", (0.0, 1.9))
    assert (len(cut.time), cut.begins) == (96, 0.0)


def test_records_and_unicons_keys_are_read(tmp_path: Path) -> None:
    path = cut_off("go2_stand", tmp_path, 60, overrides={"platform": "fake"}).path
    run = read_run(path)
    assert run.about["robot"] == "go2"
    assert run.joints[0] == "FR_hip_joint"
    assert run.states["joint_pos"].shape == (60, 12)
    assert run.clock == "the robot's own time, stamp_ns"
    assert np.diff(run.time) == pytest.approx(0.02)
    ours = walk()
    theirs = {
        "states_q": np.vstack([ours["joint_pos"], np.zeros((50, 12))]).astype(np.float32),
        "states_q_ctrl": np.vstack([ours["joint_pos_target"], np.zeros((50, 12))]),
        "states_rpy": np.tile([0.1, 0.2, 1.0], (350, 1)),
        "ts": np.concatenate([100.0 + 0.02 * np.arange(300), np.zeros(50)]).astype(np.float32),
        "len": 299,
    }
    run = read_run(save(tmp_path / "unicon.npz", theirs))
    assert run.clock == "ts"
    np.testing.assert_allclose(run.states["joint_pos"], ours["joint_pos"], atol=1e-6)
    down = [np.sin(0.2), -np.sin(0.1) * np.cos(0.2), -np.cos(0.1) * np.cos(0.2)]
    np.testing.assert_allclose(run.states["projected_gravity"][0], down)
    found = compared(tmp_path, theirs, ours)
    assert "real.npz names no joints: the same order was assumed in both." in found.together.notes


def test_a_quaternion_tells_which_way_is_down(tmp_path: Path) -> None:
    run = walk()
    del run["projected_gravity"]
    half = 0.3
    run["base_quat"] = np.tile([np.cos(half), np.sin(half), 0.0, 0.0], (300, 1))  # roll of 0.6
    read = read_run(save(tmp_path / "run.npz", run))
    np.testing.assert_allclose(
        read.states["projected_gravity"][0], [0.0, -np.sin(0.6), -np.cos(0.6)], atol=1e-12
    )


GOOD = walk(seconds=1.0)


def changed(**values: Any) -> dict[str, Any]:
    return {key: value for key, value in {**GOOD, **values}.items() if value is not None}


def ending(count: int) -> dict[str, Any]:
    return {key: v if key == "joint_names" else v[:count] for key, v in GOOD.items()}


NAN = GOOD["joint_pos"].copy()
NAN[12:, 3] = np.nan


@pytest.mark.parametrize(
    ("real", "more", "message"),
    [
        (changed(joint_pos=None), [], "real.npz has no joint_pos; it has joint_vel, "),
        (changed(joint_pos=NAN), [], "joint_pos is nan in 38 samples from 0.24 to 0.98 s, first "
         "in FL_hip; cut it there (--from, --to; --sim-from, --sim-to), or fill it in"),
        (ending(1), [], "real.npz has 1 samples; at least 16 tell something"),
        (ending(0), [], "real.npz has 0 samples; at least 16 tell something"),
        (changed(stamp_ns=None), [], "real.npz has no clock that goes on, only []; in an .npz, dt"),
        (changed(stamp_ns=GOOD["stamp_ns"][::-1]), [], "no clock that goes on, only ['stamp_ns']"),
        (changed(joint_names=np.array(LEGS[:3])), [], "names 3 joints, its joint_pos has 12"),
        (changed(joint_names=np.array(["a"] * 12)), [], "real.npz names a joint twice: a, a, "),
        (changed(joint_names=np.array(list("abcdefghijkl"))), [],
         "no joint of {real} (a, b, c, …) is in {sim} (FR_hip, FR_thigh, FR_calf, …); give two "),
        (changed(joint_names=None, **{k: GOOD[k][:, :3] for k in GOOD if k.startswith("joint_")
                                      and k != "joint_names"}), [],
         "{real} has 3 joints, {sim} 12, and not both name them: put joint_names into the .npz"),
        (changed(joint_vel=np.zeros((50, 5))), [], "joint_vel has shape (50, 5), not (50, 12)"),
        (changed(joint_pos=np.zeros(50)), [], "joint_pos has shape (50,) and type float64; give "),
        (changed(joint_pos=np.full((50, 12), "x")), [], "has shape (50, 12) and type <U1; give "),
        (changed(joint_pos=np.full((50, 12), None)), [], "real.npz is not an .npz of arrays: Obj"),
        (changed(stamp_ns=None, dt=[1.0, 2.0]), [], "dt is float64 of shape (2,); give one number"),
        (changed(joint_names=np.array([{}])), [], "real.npz is not an .npz of arrays: Object"),
        (changed(projected_gravity=None, states_rpy=np.zeros((50, 2))), [],
         "states_rpy has shape (50, 2) and type float64; give numbers of shape (frames, 3)"),
        (changed(stamp_ns=np.full(50, np.inf)), [], "no clock that goes on, only ['stamp_ns']"),
        (changed(stamp_ns=None, ts=np.zeros(50, complex)), [], "no clock that goes on, only []"),
        (changed(stamp_ns=None, dt=np.nan), [], "no clock that goes on, only ['dt']"),
        (GOOD, ["--from", "7"], "real.npz has 0 samples from 7 to inf s; it lasts 0.98 s: choose"),
        (GOOD, ["--from", "0.5", "--to", "0.6"], "has 6 samples from 0.5 to 0.6 s"),
        (GOOD, ["--rate", "2"], "has 2 samples at 2 Hz; at least 16 tell something: give a higher"),
    ],
)  # fmt: skip
def test_what_cannot_be_compared_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], real: Any, more: list[str], message: str
) -> None:
    files = {n: save(tmp_path / f"{n}.npz", r) for n, r in (("real", real), ("sim", GOOD))}
    names = {name: str(path) for name, path in files.items()}
    assert main(["analyze", *names.values(), "--out", str(tmp_path / "out"), *more]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("unicon: error: ")
    assert message.format(**names) in error


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("garbage.npz", b"garbage", "is not an .npz of arrays: "),
        ("empty.npz", b"", "is not an .npz of arrays: "),
        ("garbage.mcap", b"garbage", "is not a "),
        ("missing.npz", None, "cannot read "),
        ("missing.mcap", None, "cannot read "),
        ("pipe.npz", "pipe", "is neither a file nor a folder; give a recording"),
    ],
)
def test_what_is_not_a_run_is_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    name: str,
    content: Any,
    message: str,
) -> None:
    path = tmp_path / name
    if content == "pipe":
        os.mkfifo(path)
    elif content is not None:
        path.write_bytes(content)
    assert main(["analyze", str(path), str(path), "--out", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("unicon: error: ")
    assert str(path) in error
    assert message in error


def test_a_folder_that_cannot_be_written_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out").write_text("a file")
    run = str(save(tmp_path / "run.npz", GOOD))
    assert main(["analyze", run, run, "--out", str(tmp_path / "out")]) == 1
    assert "cannot make the folder" in capsys.readouterr().err


def test_without_matplotlib_nothing_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["analyze", "missing", "missing", "--out", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err
    assert "unicon analyze needs matplotlib: pip install 'unicon_ros[plots]'" in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("option", ["--from", "--max-shift", "--rate"])
@pytest.mark.parametrize("value", ["nan", "-1", "soon"])
def test_what_is_not_a_time_is_wrong_usage(option: str, value: str) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["analyze", "a", "b", "--out", "c", f"{option}={value}"])
    assert ended.value.code == 2
