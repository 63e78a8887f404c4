"""What `unicon check` prints: findings first, the verdict twice, in 80 columns, all of it."""

from __future__ import annotations

import re
import sys
import unicodedata
from collections.abc import Callable
from pathlib import Path

import pytest
from check_helpers import check, write_workflow

from unicon_core.check import check_workflow
from unicon_core.text_table import (
    WIDTH,
    aligned,
    display_width,
    near,
    terminal_width,
    word_parts,
    wrapped,
)
from unicon_core.workflow import load_document, workflow_names
from unicon_ros.cli.main import main

pytest.importorskip("mujoco", reason="most workflows simulate")
NEGATIVE_ZERO = re.compile(r"(?<![\w.])-0(\.0*)?(?![\w.])")


def widest(text: str) -> int:
    return max(map(display_width, text.splitlines()))


def test_findings_and_notes_stand_before_the_tables_and_the_verdict_also_at_the_end(
    tmp_path: Path,
) -> None:
    result = check(tmp_path / "toy", {"stiffness": [500.0] * 12})
    text = result.text()
    assert not result.clean
    heads = ("check toy: ", "\n\nFindings\n  1. ", "\n\nNotes\n  · ", "\n\n1 finding\n\nJoints\n")
    places = [text.index(head) for head in heads]
    assert places == sorted(places)
    assert text.endswith("\n\n1 finding")
    assert text.count("\n\n1 finding") == 2


def test_what_has_no_tables_has_one_verdict(tmp_path: Path) -> None:
    lines = check(tmp_path / "toy", inputs=46).text().splitlines()
    assert [line for line in lines if "finding" in line.lower()] == ["Findings", "1 finding"]
    assert lines[-1] == "1 finding"


@pytest.mark.parametrize("name", workflow_names())
def test_a_shipped_workflow_takes_80_columns_and_loses_nothing(
    name: str, request: pytest.FixtureRequest, at_hand: Callable[[str], object]
) -> None:
    if "assets:" in load_document(name).path.read_text(encoding="utf-8"):
        request.getfixturevalue("assets")
        at_hand(name)
    result = check_workflow(name)
    text = result.text()
    assert widest(text) <= WIDTH, max(text.splitlines(), key=display_width)
    assert not NEGATIVE_ZERO.search(text)
    cells = [cell for section in result.sections for row in section.rows for cell in row]
    heads = [head for section in result.sections for head in section.columns]
    prose = [str(found) for found in (*result.findings, *result.notes)]
    for said in {near(each) for each in (*cells, *heads, *prose)}:
        for part in (part for word in said.split() for part in word_parts(word)):
            assert part in text, said
    wide = result.text(1000)
    assert all(near(each) in wide for each in cells)
    assert all(" ".join(near(each).split()) in wide for each in prose)


def test_the_json_has_whole_paths_and_ranges(tmp_path: Path) -> None:
    result = check(tmp_path / "toy")
    rows = {s["title"]: s["rows"] for s in result.to_json()["sections"]}
    assert rows["Files"][0][1] == str(tmp_path / "toy" / "toy.yaml")
    assert rows["Action of policy walk"][0][5] == "-1.047 … 1.047"


# Tables and prose


ROWS = [
    ("block", "reads", "limits [rad]"),
    ("policy", "joint_pos joint_vel base_ang_vel projected_gravity", "-1.5 … 1.5"),
    ("hold", "joint_pos", "?"),
]


@pytest.mark.parametrize(
    ("width", "lines"),
    [
        (
            55,  # a list goes on in the next line, a range does not
            [
                "block   reads                              limits [rad]",
                "──────  ─────────────────────────────────  ────────────",
                "policy  joint_pos joint_vel base_ang_vel   -1.5 … 1.5",
                "        projected_gravity",
                "hold    joint_pos                          ?",
            ],
        ),
        (
            33,  # narrow gaps and ranges
            [
                "block  reads             limits",
                "                         [rad]",
                "────── ───────────────── ────────",
                "policy joint_pos         -1.5…1.5",
                "       joint_vel",
                "       base_ang_vel",
                "       projected_gravity",
                "hold   joint_pos         ?",
            ],
        ),
        (
            26,  # two tables
            [
                "block   reads",
                "──────  ──────────────────",
                "policy  joint_pos",
                "        joint_vel",
                "        base_ang_vel",
                "        projected_gravity",
                "hold    joint_pos",
                "",
                "block   limits [rad]",
                "──────  ────────────",
                "policy  -1.5 … 1.5",
                "hold    ?",
            ],
        ),
        (
            20,  # two columns of words that cannot be broken stand out, and only those
            [
                "block  reads",
                "────── ─────────────────",
                "policy joint_pos",
                "       joint_vel",
                "       base_ang_vel",
                "       projected_gravity",
                "hold   joint_pos",
                "",
                "block   limits [rad]",
                "──────  ────────────",
                "policy  -1.5 … 1.5",
                "hold    ?",
            ],
        ),
    ],
)
def test_a_table_that_is_too_wide_is_folded_or_split(width: int, lines: list[str]) -> None:
    assert aligned(ROWS, width=width) == lines


def test_heads_are_folded_before_gaps_and_ranges_become_narrow() -> None:
    rows = [("joint", "position, model", "effort, model"), ("hip", "-1 … 1", "8")]
    assert aligned(rows, width=28) == [
        "joint  position,  effort,",
        "       model      model",
        "─────  ─────────  ──────────",
        "hip    -1 … 1     8",
    ]
    assert aligned(rows, width=23)[-1] == "hip   -1…1      8"


def test_a_unit_is_not_broken() -> None:
    rows = [("contract", "rate [rad/s]"), ("as given", "4.9")]
    assert aligned(rows, width=1)[:2] == ["contract rate", "         [rad/s]"]
    rows = [("joint", "torque/unit"), ("hip", "0.25")]
    assert aligned(rows, width=1)[:2] == ["joint torque/", "      unit"]


def test_columns_that_are_right_aligned_stay_so_in_a_split_table() -> None:
    rows = [("name", "first", "second"), ("long_name_of_a_joint", "1", "2")]
    assert aligned(rows, right=(1, 2), underlined=False, width=28) == [
        "name                  first",
        "long_name_of_a_joint      1",
        "",
        "name                  second",
        "long_name_of_a_joint       2",
    ]


def test_wide_letters_and_marks_are_counted_in_columns_of_the_display() -> None:
    composed, marked = "é", unicodedata.normalize("NFD", "é")
    assert [display_width(text) for text in ("hip", "左髋", composed, marked)] == [3, 4, 1, 1]
    rows = [("joint", "kp"), ("左髋", "40"), (f"{marked}paule", "8"), ("hip", "1")]
    lines = aligned(rows, underlined=False)
    cells = ("kp", "40", "8", "1")
    assert {display_width(line[: line.index(cell)]) for line, cell in zip(lines, cells)} == {8}
    lines = wrapped("左髋 " * 30, 20, "  1. ", "     ")
    assert max(map(display_width, lines)) == 19
    assert all(line.startswith("     左") for line in lines[1:])


def test_a_long_path_breaks_at_its_slashes_and_a_long_name_stands_out() -> None:
    path = "/" + "/".join(f"folder_{i}" for i in range(30)) + "/file.yaml"
    lines = wrapped(f"model {path}: wrong", WIDTH, "  · ", "    ")
    assert max(map(len, lines)) <= WIDTH
    assert "".join(line.strip(" ·") for line in lines) == f"model {path}: wrong"
    name = "n" * 100
    assert wrapped(f"joint {name} is wrong", WIDTH, "  · ", "    ") == [
        "  · joint",
        f"    {name}",
        "    is wrong",
    ]


def test_paths_are_shown_from_the_working_folder_or_from_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "home" / "work").mkdir(parents=True)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path / "home" / "work")
    here, home = tmp_path / "home" / "work", tmp_path / "home"
    assert near(f"model {here}/a.xml, {home}/b.xml") == "model a.xml, ~/b.xml"
    other = f"/x{here}/a.xml {here}s/a.xml {tmp_path}/c.xml"
    assert near(other) == other.replace(f" {home}/", " ~/")
    monkeypatch.chdir("/")
    assert near("/etc/hosts") == "/etc/hosts"


# The terminal


@pytest.mark.parametrize(
    ("terminal", "columns", "width"), [(False, 200, 80), (True, 200, 200), (True, 60, 80)]
)
def test_the_width_is_that_of_a_terminal_that_is_wider(
    terminal: bool, columns: int, width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal)
    assert terminal_width() == width


def test_the_command_prints_it_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_workflow(tmp_path / "toy")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")
    assert main(["check", "toy/toy.yaml"]) == 0
    told = capsys.readouterr().out
    assert widest(told) <= WIDTH
    assert "\n  toy/toy.yaml\n" in told or "toy/toy.yaml\n" in told.splitlines(True)[0]
    assert told.endswith("\n\nclean\n")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert main(["check", str(path)]) == 0
    assert WIDTH < widest(capsys.readouterr().out) <= 300
