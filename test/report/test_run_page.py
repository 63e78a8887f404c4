"""`unicon run --report FILE.html`: one page with what the run did, whatever it did."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pages import Page, answered, looked_at, read_page

from unicon_base.errors import Fault
from unicon_core import Amends, Loop, Zip, block
from unicon_core.drawing import drawings
from unicon_core.flow import Block, Stage, Tick
from unicon_core.robots import load_robot
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.runtime.phases import Phase
from unicon_core.workflow import HookBlocks, Program
from unicon_lab.report import run_samples
from unicon_lab.report.pictures import PICTURES
from unicon_lab.report.run_page import Pictured
from unicon_ros.cli.main import main

RUN = ["run", "go2_walk", "--no-ros", "--speed", "max", "--quiet"]
LARGEST = 600_000
SOME = ("base", "path")


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, dict[str, Any]]:
    """A page, and the report of the same run as figures."""
    folder = tmp_path_factory.mktemp("walked")
    page, report = folder / "new" / "run.html", folder / "run.json"
    # 40 rows for 100 ticks: each row stands for four.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_samples, "ROWS", 40)
        some = {name: PICTURES[name] for name in SOME}  # drawing takes its time
        patch.setattr("unicon_lab.report.run_page.PICTURES", some)
        assert main([*RUN, "--duration", "2", "--report", str(page)]) == 0
    assert main([*RUN, "--duration", "2", "--report", str(report)]) == 0
    return page.read_text("utf-8"), json.loads(report.read_text("utf-8"))


def test_the_page_needs_nothing_beside_it_and_has_its_pictures(
    walked: tuple[str, dict[str, Any]],
) -> None:
    text, report = walked
    page = read_page(text)
    assert list(page.pictures) == [PICTURES[name][1] for name in SOME]
    assert min(page.pictures.values()) > 20
    assert page.headings[0] == "go2_walk on go2 (mujoco)"
    axes = ("[m/s]", "[rad/s]", "x [m]", "time [s]", "commanded", "measured", "start", "end")
    drawn = page.text if not page.panels else f"{page.text} {page.scripts} [m/s] [rad/s]"
    for words in axes:
        assert words in drawn
    assert report["sha256_commands"] in page.text
    assert report["ended"] == "duration"
    assert "Ended: duration, after 2.00 s of ticks, no fault." in page.text
    for joint in load_robot("go2").joint_names:
        assert joint in page.text
    assert len(text) < LARGEST


def test_its_figures_are_those_of_the_run(
    walked: tuple[str, dict[str, Any]],
) -> None:
    page, states = read_page(walked[0]), Kept()
    program = Program(load(), hooks=[states.hook])
    report = Runner(program, RunOptions(duration=2.0, speed="max")).run()
    assert report.sha256_commands == walked[1]["sha256_commands"]
    robot = program.robot
    pos, vel, effort = (np.stack(states.rows[name]) for name in Kept.NAMES)
    told = page.table("joint")
    assert [row[0] for row in told[1:]] == list(robot.joint_names)
    figures = np.array([[float(cell) for cell in row[1:]] for row in told[1:]])
    wanted = [pos.min(0), pos.max(0), robot.lower, robot.upper]
    wanted += [abs(vel).max(0), robot.velocity_limit, abs(effort).max(0), robot.effort_limit]
    np.testing.assert_allclose(figures, np.stack(wanted, 1), rtol=6e-3, atol=1e-6)
    blocks = page.table("block")
    assert [row[0] for row in blocks[1:] if "kept" not in row[0]] == list(walked[1]["blocks"])
    assert page.table("phase")[1][:3] == ["run", "0.00", "100"]


class Kept:
    """All ticks of a run, kept another way."""

    NAMES = ("joint_pos", "joint_vel", "joint_effort")

    def __init__(self) -> None:
        self.rows: dict[str, list[NDArray[Any]]] = {name: [] for name in self.NAMES}

    def hook(self, program: Program) -> HookBlocks:
        def keep() -> None:
            for name in self.NAMES:
                self.rows[name].append(program.states[name].copy())

        return {Stage.OBSERVE: [Block("all", keep, reads=self.NAMES)]}


def load() -> Any:
    from unicon_core.workflow import load_document

    return load_document("go2_walk")


def built(tick: Any, page: str | Path = "") -> tuple[Program, Pictured]:
    """Return a robot of which a function ticks beside what holds its joints."""
    keeper = Pictured(None, page)
    flow = Loop(Zip(block("hold"), tick))
    hooks = [keeper.hook]
    return Program(robot="go2", platform="fake", rate=500, flow=flow, hooks=hooks), keeper


def ran(path: Path, tick: Any, ticks: int, pictures: str = "") -> tuple[Page, Report, str]:
    """Run it, and return its page; with these pictures alone, as drawing takes its time."""
    program, keeper = built(tick, path)
    runner = Runner(program, RunOptions(duration=ticks * program.period, speed="max"))
    keeper.attach(runner)
    report = runner.run()
    with pytest.MonkeyPatch.context() as patch:
        some = {name: PICTURES[name] for name in pictures.split()}
        patch.setattr("unicon_lab.report.run_page.PICTURES", some)
        keeper.write(report)
    text = path.read_text("utf-8")
    assert len(text) < LARGEST
    return read_page(text), report, text


def test_a_fault_in_the_first_tick_is_told_first_with_its_traceback(tmp_path: Path) -> None:
    def broken() -> None:
        raise ZeroDivisionError("<b>no</b>")

    page, report, text = ran(tmp_path / "run.html", broken, 10, "timing")
    assert report.faults
    assert page.text.count("Fault: ZeroDivisionError: <b>no</b>") == 1
    assert "<b>" not in text
    assert "Traceback (most recent call last)" in page.text
    assert "could not be drawn" not in page.text


def test_what_is_not_a_number_leaves_gaps_and_is_told(tmp_path: Path) -> None:
    count = [0]

    def spoiled(joint_pos: Amends, base_lin_vel: Amends) -> Tick:
        def spoil() -> None:
            count[0] += 1
            if count[0] > 5:
                joint_pos[3] = np.nan
                base_lin_vel[:] = np.inf

        return spoil

    page, _, text = ran(tmp_path / "run.html", block(spoiled), 12, "joints torque")
    assert "could not be drawn" not in page.text
    assert not re.search(r"\bnan\b", text.lower())
    for state in ("joint_pos", "base_lin_vel"):
        assert f"{state} was not a number, first at 0.01 s: a gap in the curves." in page.text
    assert "joint_vel was" not in page.text
    assert page.table("joint")[4][1] != "–"  # of the ticks before it


def test_a_run_without_a_number_claims_nothing(tmp_path: Path) -> None:
    def lost(
        joint_pos: Amends, joint_vel: Amends, joint_effort: Amends, base_pos_w: Amends
    ) -> Tick:
        def lose() -> None:
            for state in (joint_pos, joint_vel, joint_effort, base_pos_w):
                state[:] = np.nan

        return lose

    page, report, text = ran(tmp_path / "run.html", block(lost), 12)
    assert answered(text)["Which joint"] == "not known: no joint has a number"
    assert "place not known, tilted up to 0°" in page.text
    assert "nan" not in report.summary()
    report.write(tmp_path / "run.json")
    strict: Any = json.loads((tmp_path / "run.json").read_text(), parse_constant=pytest.fail)
    assert strict["base_displacement_m"] == [None] * 3


def test_joints_beyond_limits_are_named_with_amount_time_and_meaning(tmp_path: Path) -> None:
    robot, count = load_robot("go2"), [0]

    def pressed(joint_pos: Amends, joint_effort: Amends) -> Tick:
        def press() -> None:
            count[0] += 1
            joint_pos[:] = robot.default_joint_pos
            joint_effort[:] = 0.0
            if count[0] > 6:
                joint_pos[1] = robot.upper[1] + 0.02
            joint_effort[2] = -1.1 * robot.effort_limit[2]
            joint_effort[3] = robot.effort_limit[3]  # at its limit, not beyond

        return press

    page, report, text = ran(tmp_path / "run.html", block(pressed), 12)
    assert not report.faults
    assert "no fault." in page.text
    names = robot.joint_names
    (said,) = re.findall(r"<li>(Beyond a limit: .*?)</li>", text)
    rest = f"its upper limit of {robot.upper[1]:.4g} rad, first at 0.01 s, in 50% of the samples; "
    assert f"{names[1]} was 0.02 rad above {rest}" in said
    past = 0.1 * robot.effort_limit[2]
    assert f"{names[2]} was {past:.2g} N·m above its effort limit of " in said
    assert "no safety block stopped the run for it. A real joint meets its stop" in said
    assert names[3] not in said
    found = answered(text)
    assert found["Which joint"].startswith(f"{names[2]}: ")
    assert "beyond its limit of" in found["Which joint"]
    assert found["When"] == "at 0.00 s of 0.02 s"


def test_nothing_is_said_of_limits_that_were_kept(tmp_path: Path) -> None:
    robot = load_robot("go2")

    def rest(joint_pos: Amends) -> Tick:
        def stand() -> None:
            joint_pos[:] = robot.default_joint_pos

        return stand

    page, _, text = ran(tmp_path / "run.html", block(rest), 12)
    assert "Beyond a limit" not in page.text
    assert "nearest to its limit" in answered(text)["Which joint"]


def test_one_tick_is_enough_for_a_page(tmp_path: Path) -> None:
    page, report, _ = ran(tmp_path / "run.html", lambda: None, 1, "base")
    assert report.ticks == 1
    assert "could not be drawn" not in page.text


def test_a_fault_says_where_its_ticks_are(tmp_path: Path) -> None:
    def fallen() -> None:
        raise Fault("tilt_stop: leans by 1.2 rad")

    _, report, _ = ran(tmp_path / "run.html", fallen, 3)
    report.extra["fault_record"] = "faults/x.mcap"
    program, keeper = built(fallen, tmp_path / "2.html")
    runner = Runner(program, RunOptions(speed="max"))
    keeper.attach(runner)
    keeper.write(report)  # and of a run that never ticked
    runner.close()
    page = read_page(text := (tmp_path / "2.html").read_text("utf-8"))
    assert answered(text)["When"] == "–, before the flow"
    assert "The last ticks before the fault are in faults/x.mcap" in page.text


def test_phases_beside_the_run_are_marked() -> None:
    program, keeper = built(lambda: None)
    runner = Runner(program, RunOptions(duration=0.02, speed="max"))
    keeper.attach(runner)
    assert runner.run().ticks == 10
    assert keeper.beside_the_run() == []
    keeper.phases = [(0, Phase.APPROACH), (4, Phase.RUN), (9, Phase.DAMP)]
    assert keeper.beside_the_run() == [
        (pytest.approx(-0.008), 0.0),
        (pytest.approx(0.01), pytest.approx(0.012)),
    ]
    assert keeper.time()[0] == pytest.approx(-0.008)


def test_long_runs_keep_their_peaks_in_the_same_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_samples, "ROWS", 64)
    count = [0]

    def wave(joint_pos: Amends) -> Tick:
        def move() -> None:
            count[0] += 1
            joint_pos[:] = 0.1 * np.sin(0.1 * count[0])
            if count[0] == 777:
                joint_pos[2], joint_pos[3] = 0.9, -0.9

        return move

    program, keeper = built(block(wave))
    runner = Runner(program, RunOptions(duration=2.0, speed="max"))
    keeper.attach(runner)
    runner.run()
    assert keeper.ticks == 1000
    assert keeper.stride == 16
    assert len(keeper.time()) == -(-1000 // 16)
    time, values = keeper.curve("joint_pos")  # the lowest and the highest of each row
    assert values[2 * (776 // 16) + 1, 2] == pytest.approx(0.9)
    assert values[2 * (776 // 16), 3] == pytest.approx(-0.9)
    low, high = keeper.reached("joint_pos")
    assert (low[3], high[2]) == pytest.approx((-0.9, 0.9))
    assert keeper.largest("joint_pos")[2:4] == pytest.approx(0.9)
    assert time[-1] == pytest.approx((len(keeper.time()) - 1) * 16 * 0.002)


def test_without_matplotlib_the_run_does_not_begin_for_a_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    page = tmp_path / "run.html"
    assert main([*RUN, "--report", str(page)]) == 1
    needs = "--report FILE.html needs matplotlib: pip install 'unicon_ros[plots]'"
    assert needs in capsys.readouterr().err
    assert not page.exists()


def test_a_page_that_cannot_be_written_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("unicon_lab.report.run_page.PICTURES", {})
    (tmp_path / "file").write_text("")
    fake = [*RUN, "--set", "platform=fake", "--duration", "0.1"]
    for path in (tmp_path / "file" / "run.html", Path("/proc/run.html")):
        assert main([*fake, "--report", str(path)]) == 1
        errors = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
        assert len(errors) == 1
        assert "cannot write" in errors[0]
        assert "give a path in a writable folder" in errors[0]


@pytest.mark.slow
def test_a_browser_shows_it_in_silence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("unicon_core.drawing.interactive", lambda: None)
    page = tmp_path / "run.html"
    assert main(["run", "go2_walk", "--no-ros", "--duration", "3", "--report", str(page)]) == 0
    text = page.read_text("utf-8")
    axes = ("[µs]", "late", "busy", "[N·m]", "effort limit", "next deadline")
    assert [words for words in axes if words not in read_page(text).text] == []
    told, console = looked_at(text, tmp_path)
    assert console == []
    assert [label for label, *_ in told["pictures"]] == [h for _, h, _ in PICTURES.values()]
    assert all(300 < shown < 1200 and strokes > 20 for _, shown, strokes in told["pictures"])
    assert told["wide"] <= 1200
    assert told["height"] > 2000


@pytest.mark.slow
def test_a_hundred_thousand_ticks_make_no_larger_page(tmp_path: Path) -> None:
    def wild(joint_pos: Amends, joint_effort: Amends) -> Tick:
        def move() -> None:
            joint_pos[:] = rng.normal(size=12)
            joint_effort[:] = rng.normal(size=12)

        return move

    rng = np.random.default_rng(0)
    page, report, _ = ran(tmp_path / "run.html", block(wild), 100_000, " ".join(PICTURES))
    assert report.ticks == 100_000
    title = "the last 32,768 of 100,000 ticks"
    if page.panels:
        (curves,) = (each["curves"] for each in page.panels if each["title"] == title)
        assert [each["label"] for each in curves] == ["busy", "next deadline"]
    else:  # without uplot-python
        assert title in page.text
        assert "late" not in page.text.split("Timing")[1].split("Every joint")[0].split("\n")[3:]


def test_a_picture_that_cannot_be_drawn_says_why_and_leaves_the_others(tmp_path: Path) -> None:
    def fails(figure: Any) -> bool:
        raise ValueError("no <luck>")

    def draws(figure: Any) -> bool:
        figure.add_subplot().plot([0.0, 1.0])
        return True

    def empty(figure: Any) -> bool:
        return False

    pictures = {"a": (fails, "A", ""), "b": (draws, "B", ""), "c": (empty, "C", "")}
    found = dict(drawings(pictures, folder=tmp_path))
    assert list(found) == ["a", "b"]
    assert "could not be drawn: ValueError: no &lt;luck&gt;" in found["a"]
    assert "<svg" in found["b"]
    assert [path.name for path in tmp_path.iterdir()] == ["b.png"]
