"""The ledger of evidence claims no more than its tests show, for all that there is."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from unicon_base.errors import UniconError
from unicon_core.check.check import little_seen
from unicon_core.evidence import LEVELS, Evidence, load_evidence
from unicon_core.platforms.platform import Facts
from unicon_core.robots import load_robot, robot_names
from unicon_core.workflow.registry import known
from unicon_lab.evidence_report.report import SCHEMA
from unicon_lab.evidence_report.signed import read_report, sign, signature_of, signed_by, text_of
from unicon_ros.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
LEDGER = load_evidence()
ORDER = list(LEVELS)
SHOWN = sorted({each.test for each in LEDGER.values() if each.test})
REPORTS = ROOT / "config" / "evidence"
OURS = ("fake", "fake_robot", "replay", "ros")
"""Platforms that are neither a simulator of others nor a robot."""


def lies(each: Evidence) -> list[str]:
    """Return what an entry of the ledger claims and nothing shows."""
    found = []
    if each.level not in ("never", "hardware") and not each.test:
        found.append("no test shows it")
    if each.level == "hardware" or each.report:
        found += _of_report(each, REPORTS)
    if each.test:
        path = ROOT / each.test
        if not path.is_file():
            return [*found, f"{each.test} is not there"]
        shown = re.search(r"^EVIDENCE = (.+)$", path.read_text("utf-8"), re.MULTILINE)
        told = "never" if shown is None else ast.literal_eval(shown[1])
        level = told.get(each.kind, "never") if isinstance(told, dict) else told
        if ORDER.index(each.level) > ORDER.index(level):
            found.append(f"level {each.level}, and {each.test} shows {level}")
        if not re.fullmatch(r"20\d\d-\d\d-\d\d", each.date):
            found.append(f"date {each.date!r}")
        found += _of_git(each)
    return found


def _of_report(each: Evidence, folder: Path) -> list[str]:
    """Return what an entry claims and its report does not tell, or that it was changed."""
    path = folder / (each.report or "no report")
    if Path(path.name) != Path(each.report) or not path.is_file():
        return [f"no report tells of it: {path} is not there"]
    try:
        report = read_report(path)
        if signature_of(path).exists() and shutil.which("ssh-keygen") is not None:
            signed_by(path)
    except UniconError as error:
        return [str(error)]
    protocol = load_robot(each.name).transport.get("protocol")
    claimed = {"level": each.level, each.name: protocol, "date": each.date}
    told = {**report, **report["robots"]} if isinstance(report.get("robots"), dict) else report
    if each.commit and str(told.get("commit", each.commit)).startswith(each.commit):
        told["commit"] = each.commit
    claimed["commit"] = each.commit
    wrong = [name for name, value in claimed.items() if told.get(name) != value]
    return [f"{k} {claimed[k]!r} of a report that tells {told.get(k)!r}" for k in wrong]


def _of_git(each: Evidence) -> list[str]:
    """Return what is wrong with the commit of an entry; nothing without git."""
    if not (ROOT / ".git").exists() or shutil.which("git") is None:
        return []
    git = ["git", "-C", str(ROOT)]
    asked = [*git, "merge-base", "--is-ancestor", each.commit or "none", "HEAD"]
    if subprocess.run(asked, capture_output=True).returncode:
        return [f"commit {each.commit!r} is no ancestor of HEAD"]
    asked = [*git, "cat-file", "-e", f"{each.commit}:{each.test}"]
    if subprocess.run(asked, capture_output=True).returncode:
        return [f"commit {each.commit} has no {each.test}"]
    return []


@pytest.mark.parametrize("key", LEDGER, ids="/".join)
def test_an_entry_claims_no_more_than_its_test_shows(key: tuple[str, str]) -> None:
    assert lies(LEDGER[key]) == []


def test_all_that_there_is_has_an_entry_and_nothing_else() -> None:
    names = {kind: {n for of, n in LEDGER if of == kind} for kind, _ in LEDGER}
    assert names["robot"] == set(robot_names())
    simulators = {
        n for n, at in known("platforms").items() if not at.startswith("unicon_hardware.")
    }
    assert names["simulator"] == simulators - set(OURS)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"commit": "0" * 40}, "no ancestor of HEAD"),
        ({"commit": ""}, "no ancestor of HEAD"),
        ({"level": "hardware"}, "level hardware, and test/hardware/test_walks.py shows stand_in"),
        ({"level": "vendor"}, "level vendor"),
        ({"test": "test/hardware/test_gone.py"}, "is not there"),
        ({"test": "test/cli/test_known.py"}, "shows never"),
        ({"test": ""}, "no test shows it"),
        ({"date": "soon"}, "date 'soon'"),
    ],
)
def test_a_ledger_that_lies_is_found(changed: dict[str, str], said: str) -> None:
    if "commit" in changed and (not (ROOT / ".git").exists() or shutil.which("git") is None):
        pytest.skip("no git")
    honest = vars(LEDGER["robot", "h1"])
    assert any(said in each for each in lies(Evidence(**{**honest, **changed})))


HARDWARE = Evidence("robot", "go2", "hardware", "ours", "", "go2.yaml", "1234abcd", "2026-12-01")
REPORT = {
    "schema": SCHEMA,
    "level": "hardware",
    "robots": {"go2": "unitree_go"},
    "date": "2026-12-01",
    "commit": "1234abcd" * 5,
}


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({}, ""),
        ({"level": "stand_in"}, "level 'hardware' of a report that tells 'stand_in'"),
        ({"robots": {"go2": "unitree_hg"}}, "go2 'unitree_go' of a report that tells 'unitree_hg'"),
        ({"robots": {"h1": "unitree_go"}}, "go2 'unitree_go' of a report that tells None"),
        ({"robots": "other"}, "go2 'unitree_go' of a report that tells None"),
        ({"date": "2026-12-02"}, "date '2026-12-01' of a report that tells '2026-12-02'"),
        ({"commit": "f" * 40}, "commit '1234abcd' of a report that tells 'fff"),
        ({"schema": "unicon.robot/1"}, "go2.yaml is no report of a run"),
    ],
    ids=str,
)
def test_a_run_on_hardware_is_what_its_report_tells(
    tmp_path: Path, changed: dict[str, object], said: str
) -> None:
    (tmp_path / "go2.yaml").write_text(text_of({**REPORT, **changed}), "utf-8")
    found = _of_report(HARDWARE, tmp_path)
    assert len(found) == bool(said), found
    assert said in "".join(found)


def test_hardware_without_a_report_or_with_a_changed_one_is_found(tmp_path: Path) -> None:
    assert "no report tells of it" in lies(replace(HARDWARE, report=""))[0]
    assert "no report tells of it" in lies(replace(HARDWARE, report="../evidence.yaml"))[0]
    if shutil.which("ssh-keygen") is None:
        pytest.skip("no ssh-keygen: apt install openssh-client")
    report, key = tmp_path / "go2.yaml", tmp_path / "key"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(key)], check=True)
    report.write_text(text_of(REPORT), "utf-8")
    signature_of(report).write_bytes(sign(text_of(REPORT), key))
    assert _of_report(HARDWARE, tmp_path) == []
    report.write_text(f"{text_of(REPORT)}faults: []\n", "utf-8")
    assert "is not what go2.yaml.sig signs" in _of_report(HARDWARE, tmp_path)[0]


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("test", SHOWN)
def test_what_shows_it_runs_here_or_says_why_not(test: str) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-m", "", "-rs", "-x", test]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if (
        done.returncode == 5 or " passed" not in done.stdout
    ):  # nothing was collected, or all skipped
        assert "SKIPPED" in done.stdout, done.stdout
        pytest.skip(done.stdout.strip().splitlines()[-2])
    assert done.returncode == 0, done.stdout


def test_little_is_said_of_what_was_hardly_run() -> None:
    go2 = load_robot("go2")
    gazebo = Facts("gazebo", simulated=True)
    assert [each.level for each in little_seen(gazebo, go2)] == ["never"]
    assert little_seen(Facts("mujoco", simulated=True), go2) == []
    (seen,) = little_seen(Facts("unitree", simulated=False), go2)
    assert str(seen).startswith("run against the vendor's own: the official Python SDK")


def test_lists_say_what_was_never_run(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["platforms"]) == 0
    listed = capsys.readouterr().out
    for name in ("gazebo", "webots", "isaacgym", "isaaclab"):
        assert re.search(rf"^{name} .* never run$", listed, re.MULTILINE)
    assert re.search(r"^mujoco .* MuJoCo", listed, re.MULTILINE)


def test_a_ledger_that_is_malformed_names_the_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UNICON_PATH", str(tmp_path))
    (tmp_path / "evidence.yaml").write_text("robot:\n  go2: {level: seen, against: me}\n", "utf-8")
    with pytest.raises(UniconError, match=r"evidence\.yaml:2: give 'go2' as \{level: never\|"):
        load_evidence()
