"""Six questions are answered at the head of every page; its curves are read, hovered and zoomed."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import answered, first_screen, read_page

from unicon_core.drawing import ROOM, Curve, Lines, Panel, drawings, envelope
from unicon_core.page import answers, interactive, link, page
from unicon_lab.commands.diagnose import _page
from unicon_lab.diagnose import Cause, Diagnosis, Shown
from unicon_lab.recording import open_record
from unicon_lab.report import words
from unicon_lab.sweep.report import write_report
from unicon_lab.sweep.results import Results
from unicon_ros.cli.main import main


@pytest.fixture
def library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package in place of uplot-python."""
    static = tmp_path / "packages" / "uplot" / "static"
    static.mkdir(parents=True)
    (static.parent / "__init__.py").write_text("raise ImportError('it is never imported')")
    (static / "uPlot.iife.js").write_text("/* MIT Licensed */ var uPlot;")
    (static / "uPlot.min.css").write_text(".uplot {}")
    monkeypatch.syspath_prepend(str(tmp_path / "packages"))
    return static


def shown(*panels: Panel, **look: Any) -> str:
    """Return a page with panels."""
    pictures = {"x": (Lines(lambda: panels, **look), "Heading", "")}
    return page("title", "", [each for _, each in drawings(pictures)])


def curve(values: Any, label: str = "measured") -> Curve:
    return Curve(label, "#123456", 0.02 * np.arange(len(values)), np.asarray(values, np.float64))


def test_curves_are_in_the_page_with_the_library_and_its_licence(library: Path) -> None:
    text = shown(Panel("joint", "rad", [curve([0.0, 1.0, 0.5])]))
    (panel,) = read_page(text).panels
    assert (panel["unit"], panel["clock"], panel["time"]) == ("rad", "time [s]", [0.0, 0.02, 0.04])
    assert panel["curves"][0]["y"] == [0.0, 1.0, 0.5]
    assert "MIT Licensed" in text
    assert "<svg" not in text
    assert "pip install" not in text
    assert text.index("MIT Licensed") > text.index("Heading")


def test_without_the_library_curves_stand_still_and_one_sentence_says_how(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for module in ("drawing", "page"):
        monkeypatch.setattr(f"unicon_core.{module}.interactive", lambda: None)
    text = shown(Panel("joint", "rad", [curve([0.0, 1.0])]))
    seen = read_page(text)
    assert seen.panels == []
    assert seen.pictures["Heading"] > 10
    assert seen.texts[-1] == "Curves to hover and zoom: pip install 'unicon_ros[pages]'"
    assert "[rad]" in seen.text
    assert "pip install" not in page("title", "", ["<p>no curves</p>"])


def test_a_broken_library_is_none(library: Path) -> None:
    assert interactive() == library
    (library / "uPlot.iife.js").unlink()
    assert interactive() is None


def test_names_of_others_end_no_script(library: Path) -> None:
    name = "</script><b>\"'&é\u2028関節"
    text = shown(Panel(name, "</script>", [curve([1.0, 2.0], name)]))
    (panel,) = read_page(text).panels
    assert panel["title"] == panel["curves"][0]["label"] == name
    assert text.count("</script>") == 3


def test_gaps_and_what_is_infinite_are_null_and_no_peak_is_lost(library: Path) -> None:
    values = np.sin(np.arange(1_000_000) * 0.01)
    values[777_777], values[123_456] = 5.0, -7.0
    values[400_000:500_000] = math.nan
    values[3], values[4] = math.inf, -math.inf
    text = shown(Panel("long", "rad", [curve(values)]))
    (panel,) = read_page(text).panels
    kept = [each for each in panel["curves"][0]["y"] if each is not None]
    assert (min(kept), max(kept)) == (-7.0, 5.0)
    gap = [t for t, y in zip(panel["time"], panel["curves"][0]["y"]) if y is None and t > 100]
    assert 7_900 < min(gap) < 8_100
    assert 9_900 < max(gap) < 10_100
    assert len(text) < 600_000
    assert "NaN" not in text
    assert "Infinity" not in panel["curves"][0]["y"]


@pytest.mark.parametrize("values", [[], [math.nan], [math.nan, math.inf]])
def test_a_curve_without_a_number_is_no_picture(library: Path, values: list[float]) -> None:
    assert list(drawings({"x": (Lines(lambda: [Panel("", "", [curve(values)])]), "", "")})) == []


def test_one_sample_and_sixty_joints_have_room(library: Path) -> None:
    (panel,) = read_page(shown(Panel("one", "rad", [curve([2.5])]))).panels
    assert panel["curves"][0]["y"] == [2.5]
    many = [Panel(f"joint {k}", "rad", [curve(np.sin(np.arange(99_999.0)))] * 2) for k in range(60)]
    text = shown(*many, columns=4)
    assert sum(len(c["y"]) for p in read_page(text).panels for c in p["curves"]) <= ROOM
    assert len(text) < 300_000


def test_curves_of_other_times_keep_their_values() -> None:
    late = Curve("late", "#123456", np.array([0.01, 0.03]), np.array([4.0, 8.0]))
    (picture,) = [Lines(lambda: [Panel("", "m", [curve([1.0, 3.0]), late])]).html()]
    assert '"x":[[0.0,0.01,0.02,0.03]]' in picture
    assert '"y":[1.0,2.0,3.0,null]' in picture
    assert '"y":[null,4.0,6.0,8.0]' in picture


def test_an_envelope_holds_lowest_and_highest_of_each_stretch() -> None:
    rng = np.random.default_rng(0)
    for count in (1, 7, 100, 1001):
        made = curve(rng.normal(size=count))
        few = envelope(made, 10)
        assert len(few.values) <= max(20, min(count, 20))
        assert (few.values.min(), few.values.max()) == (made.values.min(), made.values.max())
        assert (np.diff(few.time) >= 0.0).all()
        assert few.time[0] == made.time[0]
        assert few.time[-1] == made.time[-1]


def test_the_words_of_answers_leave_out_what_is_no_number() -> None:
    states = {
        "base_lin_vel": np.array([[3.0, 4.0, 0.0], [math.nan, 0.0, 0.0]]),
        "joint_vel": np.full((2, 3), math.inf),
        "projected_gravity": np.tile([0.0, 0.0, -1.0], (20, 1)),
        "velocity_command": np.array([[0.5, 0.0, 0.0], [0.0, 0.0, 0.0]]),
    }
    fast, fell, asked = words(states, 0.02)
    assert fast == "base 5.00 m/s on average, 5.00 m/s at most"
    assert fell == "no: leaned by 0° at most"
    assert asked.startswith(
        "forward +0.50 m/s, left +0.00 m/s, turning +0.00 rad/s on average in 50"
    )
    states["projected_gravity"][10:] = [0.0, 1.0, 0.0]
    assert words(states, 0.02)[1] == "yes, at 0.20 s"
    states["projected_gravity"][2:7] = math.nan  # what is lacking moves no time
    assert words(states, 0.02)[1] == "yes, at 0.20 s"
    states["projected_gravity"][10:] = math.inf
    assert words(states, 0.02)[1] == (
        "not known: no attitude in 75% of the time; else leaned by 0° at most"
    )
    assert words({}, 0.02)[0] == "not known: no speed is recorded"
    assert "not known" in words({}, 0.02)[1]


def test_every_question_needs_its_answer_and_links_are_relative(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="zip"):
        answers("one", "two")
    where = link(tmp_path / "a b" / "<walk>.mcap", tmp_path / "pages")
    assert 'href="./../a%20b/%3Cwalk%3E.mcap"' in where
    text = page("x", "", [answers(*["<b>not escaped</b>"] * 5, where)])
    assert "<b>" not in text
    assert answered(text)["Where is it recorded"].endswith("<walk>.mcap")


CAUSE = Cause(
    *("strength", "RL_calf_joint", "plant", 0.97, -0.3, -0.35, -0.25),
    evidence="RL_calf_joint at 1.2 s",
    shown=Shown("RL_calf_joint", "rad", [1.2, 1.22], [0.0, 0.1], [0.3, 0.2], [0.0, 0.1]),
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the page of a run, its recording, and the page of its diagnosis."""
    folder = tmp_path_factory.mktemp("made")
    run = ["run", "go2_walk", "--no-ros", "--speed", "max", "--quiet", "--duration", "1"]
    files = ["--report", str(folder / "run.html"), "--record", str(folder / "walk.mcap")]
    assert main([*run, *files]) == 0
    path = folder / "walk.mcap"
    for name, causes in (("diagnose", (CAUSE,)), ("nothing", ())):
        out = folder / f"{name}.html"
        out.write_text(_page(open_record(path), path, out, Diagnosis(causes, windows=5)))
    return folder


def test_a_run_and_a_diagnosis_answer_with_a_link_to_the_recording(made: Path) -> None:
    for name, joint, when in (
        ("run", "RR_calf_joint: ", "of 1.00 s"),
        ("diagnose", "RL_calf_joint: strength of RL_calf_joint, 97%, -30.0% (95 %: ", "1.20 to 1."),
        ("nothing", "none: no cause explains", "of 5 windows"),
    ):
        text = (made / f"{name}.html").read_text("utf-8")
        found = answered(text)
        assert found["Which joint"].startswith(joint)
        assert when in found["When"]
        assert "m/s on average" in found["How fast"]
        assert found["Did it fall"].startswith("no: leaned by ")
        assert found["What was commanded"].startswith(("to stand", "forward"))
        assert '<a href="./walk.mcap">' in text
        assert "unicon view " in found["Where is it recorded"]


def hovered_and_zoomed(tab: Any) -> None:
    """Check that a plot says its value below the mouse, and that zooming one zooms all."""
    widths = "[...document.querySelectorAll('.u-over')].map(each => each.clientWidth)"
    assert min(tab.evaluate(widths)) > 100
    group = tab.locator(".plots:has(> div:nth-child(3))").first  # two panels at least
    group.locator(".u-over").first.scroll_into_view_if_needed()
    box = group.locator(".u-over").first.bounding_box()
    y = box["y"] + box["height"] / 2

    def read(share: float, k: int) -> list[str]:
        tab.mouse.move(box["x"] + share * box["width"], y)
        tab.wait_for_timeout(100)
        return [
            str(text)
            for text in group.locator(".u-legend").nth(k).locator(".u-value").all_inner_texts()
        ]

    first, second = read(0.5, 0), read(0.5, 1)
    assert first[0] == second[0]  # the time
    assert any(unit in first[1] for unit in ("m/s", "rad")), first
    assert float(first[1].split()[0]) == float(first[1].split()[0])
    whole = float(read(0.99, 1)[0]) - float(read(0.01, 1)[0])
    tab.mouse.move(box["x"] + 0.4 * box["width"], y)
    tab.mouse.down()
    tab.mouse.move(box["x"] + 0.6 * box["width"], y, steps=5)
    tab.mouse.up()
    for k in (0, 1):
        assert 0.1 * whole < float(read(0.99, k)[0]) - float(read(0.01, k)[0]) < 0.3 * whole
    tab.mouse.dblclick(box["x"] + 0.5 * box["width"], y)
    assert float(read(0.99, 1)[0]) - float(read(0.01, 1)[0]) > 0.9 * whole


@pytest.mark.slow
@pytest.mark.parametrize("name", ["run", "diagnose", "analyze", "transfer", "sweep"])
def test_the_first_screen_answers_and_curves_are_hovered_and_zoomed(
    name: str, made: Path, tmp_path: Path
) -> None:
    makers: dict[str, Callable[[], Path]] = {"analyze": analyzed, "transfer": moved, "sweep": swept}
    at = makers[name](made, tmp_path) if name in makers else made / f"{name}.html"
    pytest.importorskip("playwright")
    plotted = interactive() is not None and name in ("run", "analyze", "transfer")
    first_screen(at, hovered_and_zoomed if plotted else None)


def analyzed(made: Path, folder: Path) -> Path:
    record = str(made / "walk.mcap")
    assert main(["analyze", record, record, "--out", str(folder / "out")]) == 0
    return folder / "out" / "report.html"


def moved(made: Path, folder: Path) -> Path:
    command = ["transfer", "go2_walk", "--platforms", "mujoco,fake", "--duration", "1"]
    assert main([*command, "--out", str(folder / "out")]) == 0
    return folder / "out" / "report.html"


def swept(made: Path, folder: Path) -> Path:
    (folder / "s.yaml").write_text(
        "workflow: go2_walk\nduration: 0.1\nvary: {scene.delay: [0, 1]}\n"
    )
    assert main(["sweep", str(folder / "s.yaml"), "--out", str(folder / "out")]) == 0
    return write_report(Results(folder / "out"))
