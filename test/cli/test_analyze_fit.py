"""`unicon analyze REAL --fit`: a record becomes a robot overlay, or one line says why not."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("mujoco")

from unicon_base.errors import UniconError
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import Program, load_document
from unicon_lab.diagnose.fit import Fit, Parameter, fit_record
from unicon_lab.recording import open_record
from unicon_ros.cli.main import main

WEAK = Path(__file__).resolve().parents[2] / "examples" / "weak_calf.yaml"
EXCITED = """\
robot: go2
platform: fake
rate: 50
flow: {{excite: {{signal: random, frequency: 2, duration: {seconds}, fade: 0.2, amplitude: 0.1}}}}
"""


def recorded(folder: Path, seconds: float) -> str:
    """Record a run; return the file."""
    workflow, record = folder / "excited.yaml", folder / f"real{seconds}.mcap"
    workflow.write_text(EXCITED.format(seconds=seconds))
    run = ["run", str(workflow), "--speed", "max", "--record", str(record), "--faults", "off"]
    assert main(run) == 0
    return str(record)


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    assert main(["analyze", *arguments]) == 1
    lines = capsys.readouterr().err.splitlines()
    errors = [line for line in lines if line.startswith("unicon: error: ")]
    assert len(errors) == 1
    return errors[0]


def test_what_cannot_be_fitted_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, garbage, empty = tmp_path / "out", tmp_path / "garbage.mcap", tmp_path / "empty.mcap"
    garbage.write_bytes(b"\x89MCAP0\r\n" + bytes(range(256)) * 10)
    empty.write_bytes(b"")
    to = ["--out", str(out)]
    assert "needs SIM, or --fit" in refused([str(garbage), *to], capsys)
    for path in (garbage, empty, tmp_path / "nothing.mcap", tmp_path):
        assert str(path) in refused([str(path), "--fit", *to], capsys)
    assert "unicon bag import" in refused(["uni.npz", "--fit", *to], capsys)
    short, full = recorded(tmp_path, 0.6), recorded(tmp_path, 2.0)
    assert "at least 8 windows" in refused([short, "--fit", "strength", *to], capsys)
    assert "no parameter 'mass'" in refused([full, "--fit", "mass", *to], capsys)
    assert "nothing to estimate" in refused([full, "--fit", ",", *to], capsys)
    assert "no joint like 'x'" in refused([full, "--fit", "--fit-joints", "x", *to], capsys)
    assert "--processes is -1" in refused([full, "--fit", "--processes", "-1", *to], capsys)
    other = refused([full, "--fit", "--robot", "g1_29dof", *to], capsys)
    assert "is of go2 with 12 joints, and robot g1_29dof has others" in other
    assert "cannot make the folder" in refused([full, "--fit", "--out", full], capsys)
    assert list(out.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
            f"{n}: &{n} [{', '.join([f'*{chr(ord(n) - 1)}'] * 9)}]\n" for n in "bcdefghi"
         ), "not valid YAML: the document holds more than 100000 values"),
        ("scene: !!python/object/apply:os.system [exit]", "tag 'tag:yaml.org,2002:python/object"),
        ("robot: [", "not valid YAML"),
        ("[" * 1000, "nested more than 64 deep"),
        ("scene: {model: [1]}", "[1]"),
        ("scene: {model: nowhere.xml}", "nowhere.xml"),
        ("scene: 7", "at least 8 windows"),
        ("robot: [1]", "at least 8 windows"),
        ("- a list", "at least 8 windows"),
    ],
)  # fmt: skip
def test_the_workflow_of_a_record_may_be_anybodys(tmp_path: Path, text: str, message: str) -> None:
    in_scene = "nowhere" in message or message == "[1]"  # asked for once there is a motion
    record = open_record(recorded(tmp_path, 2.0 if in_scene else 0.6))
    record.facts["workflow_effective"] = text
    with pytest.raises(UniconError) as caught:
        fit_record(record, "real.mcap")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("found", "after", "status", "said"),
    [
        ((Parameter("RL_calf_joint", "strength", 1.0, 0.5, 0.1),), 0.2, 1, ": NOT better"),
        ((), 0.1, 0, "explains more than noise would"),
    ],
)
def test_a_fit_that_is_not_better_writes_no_overlay(
    found: tuple[Parameter, ...],
    after: float,
    status: int,
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    record, out = recorded(tmp_path, 0.6), tmp_path / "out"
    fit = Fit(found, (), 0.1, 0.05, 0.1, after, (9, 3))
    monkeypatch.setattr(
        "unicon_lab.diagnose.fit.fit_record", lambda *_, **__: (fit, "schema: none")
    )
    capsys.readouterr()
    assert main(["analyze", record, "--fit", "--out", str(out)]) == status
    told = capsys.readouterr().out
    assert said in told
    assert ("NOT better" in told) == bool(status)
    assert "overlay  none\n" in told
    assert [path.name for path in out.iterdir()] == ["fit.json"]
    assert json.loads((out / "fit.json").read_text())["overlay"] is None
    (out / "go2_fitted.yaml").write_text("of old")
    assert main(["analyze", record, "--fit", "--out", str(out)]) == status
    assert f"overlay  none; {out}/go2_fitted.yaml is of an earlier fit" in capsys.readouterr().out
    assert (out / "go2_fitted.yaml").read_text() == "of old"


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_weak_calf_is_found_and_its_overlay_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record, out = tmp_path / "real.mcap", tmp_path / "out"
    run = ["run", str(WEAK), "--speed", "max", "--record", str(record), "--faults", "off"]
    assert main(run) == 3  # it falls
    capsys.readouterr()
    assert main(["analyze", str(record), "--fit", "--out", str(out), "--processes", "2"]) == 0
    said = capsys.readouterr().out
    assert "RL_calf_joint" in said
    assert "NOT better" not in said
    overlay = out / "go2_fitted.yaml"
    assert load_robot(overlay).simulated["RL_calf_joint"]["strength"] == pytest.approx(0.3, rel=0.1)
    assert json.loads((out / "fit.json").read_text())["better"] is True
    # Its simulator falls as the robot did, and as a twin it sees nothing to flag any more.
    alone = {"robot": str(overlay), "scene.joints": {}}
    report = Runner(Program(load_document(WEAK, alone)), RunOptions(speed="max", warn=str)).run()
    assert "the base leans" in report.faults[0]
    twin = Program(load_document(WEAK, {"robot": str(overlay)}))
    Runner(twin, RunOptions(speed="max", warn=str)).run()
    assert not twin.states["twin_flag"].any()
