"""`unicon show --html`: one page with graph, states, phases, gates, joints and policies."""

from __future__ import annotations

from pathlib import Path

import pytest
from pages import Page, looked_at, read_page

from unicon_core.flow import blocks_of
from unicon_core.show.svg import show_page
from unicon_core.workflow import Program, load_document
from unicon_ros.cli.main import main


@pytest.fixture(scope="module")
def shown() -> tuple[Page, Program]:
    program = Program(load_document("go2_walk"), dry=True)
    try:
        return read_page(show_page(program)), program
    finally:
        program.close()


def test_it_draws_every_block_and_explains_what_is_drawn(shown: tuple[Page, Program]) -> None:
    page, program = shown
    assert list(page.pictures) == ["Graph of a tick"]
    assert page.pictures["Graph of a tick"] > len(blocks_of(program.root))
    for block in blocks_of(program.root):
        assert block.name in page.text
    assert "critical path: the command of this tick depends on it" in page.text
    assert "⇠ reads · ⇢ writes · ± amends" in page.text


def test_its_tables_have_every_state_joint_gate_and_phase(shown: tuple[Page, Program]) -> None:
    page, program = shown
    states = page.table("state")
    assert states[0][3:7] == ["unit", "frame", "writer", "readers"]
    assert [row[0] for row in states[1:]] == list(program.states)
    named = {row[0]: row for row in states[1:]}
    assert named["base_ang_vel"][3:6] == ["rad/s", "base", "recv"]
    assert "policy" in named["velocity_command"][6]
    joints = page.table("joint (vendor's motor order)")
    assert joints[0][2:6] == ["lowerrad", "upperrad", "velocityrad/s", "effortN·m"]
    robot = program.robot
    for k, row in enumerate(joints[1:]):
        assert row[:2] == [robot.joint_names[k], str(k)]
        assert float(row[2]) == pytest.approx(robot.lower[k], rel=1e-3)
        assert float(row[5]) == pytest.approx(robot.effort_limit[k], rel=1e-3)
    phases = [row[0] for row in page.table("wait")]
    assert phases == ["wait", "approach", "run", "soft", "damp", "off"]
    assert [row[0] for row in page.table("data")] == [gate.name for gate in program.gates]
    assert [row[1] for row in page.table("#")[1:]] == list(program.policies["walk"].joints)
    terms = [row[0] for row in page.table("term")[1:]]
    assert terms == [term.name for term in program.policies["walk"].terms]


def test_names_of_a_workflow_are_no_html(tmp_path: Path) -> None:
    file = tmp_path / "strange.yaml"
    file.write_text(
        "schema: unicon.workflow/1\nname: strange\ndescription: <script>x</script> & more\n"
        "robot: go2\nplatform: fake\nrate: 50\nflow: hold\n"
    )
    page = tmp_path / "page.html"
    assert main(["show", str(file), "--html", str(page)]) == 0
    assert "<script>x</script> & more" in read_page(page.read_text("utf-8")).texts


def test_a_page_that_cannot_be_written_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for option in ("--html", "--svg"):
        path = tmp_path / "none" / "page"
        assert main(["show", "go2_stand", option, str(path)]) == 1
        assert f"cannot write {path}: No such file" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", ["go2_walk", "g1_skills"])
def test_a_browser_shows_it_in_silence(
    name: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if name == "g1_skills":
        request.getfixturevalue("assets")
    page = tmp_path / "page.html"
    assert main(["show", name, "--html", str(page)]) == 0
    told, console = looked_at(page.read_text("utf-8"), tmp_path)
    assert console == []
    assert [label for label, *_ in told["pictures"]] == ["Graph of a tick"]
    assert told["wide"] <= 1200
    assert told["rows"] > 60
