"""A page that shows the past: what it says, who drives, what a branch does, what comes at the end.

The client speaks viser's protocol; no browser is needed.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("viser", reason="no live page: pip install 'unicon_ros[view]'")

import test_page_stays
from browser import Run
from test_page_parts import LEGS, tick
from test_page_stays import printed, served
from test_push_page import CAMERA, STANDS, until

from unicon_core.states import Layout
from unicon_core.states.standard import standard_states
from unicon_lab.view.page.plots import ALL, SECONDS, History, Plot


class Page(test_page_stays.Page):
    """A page that also knows the properties of its widgets, and how the camera was put."""

    def __init__(self, port: int) -> None:
        self.properties, self.aims = dict[str, dict[str, Any]](), list[Any]()
        super().__init__(port)

    def _take(self, said: dict[str, Any]) -> None:
        if said["type"] == "GuiSliderMessage":
            self.widgets.setdefault(said["props"]["label"], said["uuid"])
        if said["type"].startswith("Gui") and "props" in said:
            self.properties[said["uuid"]] = {"value": said.get("value"), **said["props"]}
        elif said["type"] == "GuiUpdateMessage":
            self.properties.setdefault(said["uuid"], {}).update(said["updates"])
        if said["type"] == "SetCameraPositionMessage":
            self.aims.append(said["position"])
        super()._take(said)

    def get(self, label: str, name: str = "value") -> Any:
        return self.properties[self.widgets[label]].get(name)

    @property
    def ago(self) -> list[str]:
        return re.findall(r"PAST: ([\d.]+) s ago", self.briefs[-1] if self.briefs else "")[-1:]


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Run]:
    path = tmp_path / "stands.yaml"
    path.write_text(STANDS.format(platform="mujoco"))
    made = Run(path, fps=10.0)
    yield made
    made.end()


@pytest.fixture
def page(run: Run) -> Iterator[Page]:
    made = Page(run.port)
    until(lambda: "time [s]" in made.widgets and made.get("time [s]", "max") > 2.0)
    yield made
    made.close()


def test_the_past_is_shown_while_the_run_goes_on_and_says_so(run: Run, page: Page) -> None:
    height = page.places["/world/body/1"]
    assert not page.get("Branch here", "visible")
    page.set("time [s]", 0.02)
    until(lambda: page.ago and float(page.ago[0]) > 1.5)
    assert page.get("Branch here", "visible")
    until(lambda: page.places["/world/body/1"] != height)  # it has not stood up yet
    lying, ticks = page.places["/world/body/1"], int(run.program.states["tick"])
    time.sleep(1.0)
    assert page.places["/world/body/1"] == lying
    assert int(run.program.states["tick"]) > ticks + 20
    assert f"{ticks // 50}." not in page.briefs[-1].split("PAST")[0]  # the status stays live
    page.set("Back to live", True)
    until(lambda: not page.ago)
    until(lambda: page.places["/world/body/1"] != lying)
    assert not page.get("Branch here", "visible")
    assert run.report is None


def test_the_estop_works_in_the_past(run: Run, page: Page) -> None:
    page.set("time [s]", 0.5)
    until(lambda: page.ago)
    page.set("E-STOP", True)
    assert run.wait().faults == ["emergency stop by a viewer"]


def test_who_looks_back_does_not_drive(run: Run, page: Page) -> None:
    page.set("Take the wheel", True)
    until(lambda: page.bindings)
    page.set("time [s]", 0.5)
    until(lambda: not page.bindings)
    until(lambda: page.ago)
    page.set("Take the wheel", True)  # which needs the present
    until(lambda: page.bindings)
    until(lambda: not page.ago)


def test_a_time_that_is_none_shows_one_that_is(run: Run, page: Page) -> None:
    for garbage in (float("nan"), float("inf"), -5.0, 1e300):
        page.set("time [s]", garbage)
        time.sleep(0.5)
        page.set("Branch here", True)
        time.sleep(0.5)
        page.set("Back to live", True)
        until(lambda: not page.ago)
        assert run.report is None
        assert page._thread.is_alive()


def test_a_page_branches_twice_and_in_a_pause(run: Run, page: Page) -> None:
    states = run.program.states
    until(lambda: states["tick"] > 150)
    for _ in range(2):
        page.set("time [s]", 1.0)
        until(lambda: page.ago)
        before = len(page.answers)
        page.set("Branch here", True)
        until(lambda before=before: len(page.answers) > before)
        assert "the run goes on from " in page.answers[-1]
        until(lambda: not page.ago)
        assert states["tick"] < 130
        until(lambda: page.get("time [s]", "max") < 2.6)  # what was left is forgotten
        until(lambda: page.get("time [s]", "max") > 2.7)
    run.view.controls.pause()
    driver = run.view._driver
    assert driver is not None
    driver._take = bool  # heard every quarter of a second
    page.set("time [s]", 1.0)
    until(lambda: page.ago)
    page.set("Branch here", True)
    until(lambda: states["tick"] < 60)
    time.sleep(0.3)
    assert states["tick"] < 60  # it stands still there


def test_plots_leave_a_view_alone_that_was_turned(run: Run, page: Page) -> None:
    def see(width: int, position: Any) -> None:
        page._send({**CAMERA, "image_width": width, "position": position})
        time.sleep(0.3)

    see(600, page.aims[-1])
    page.set("Plots", True)
    until(lambda: len(page.aims) == 2)  # the robot fills the narrower view
    see(600, page.aims[-1])
    page.set("Plots", True)
    until(lambda: len(page.aims) == 3)
    see(600, [3, 3, 3])
    page.set("Plots", True)
    time.sleep(0.7)
    assert len(page.aims) == 3


def test_the_recording_opens_at_the_same_address(tmp_path: Path) -> None:
    path, record = tmp_path / "stands.yaml", tmp_path / "stands.mcap"
    path.write_text(STANDS.format(platform="mujoco"))
    command = [sys.executable, "-m", "unicon_ros", "run", str(path), "--duration", "3"]
    process = subprocess.Popen(
        [*command, "--view", "--view-port", "0", "--record", str(record)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        port = served(process)
        page = Page(port)
        try:
            until(lambda: "Open recording" in page.widgets)
            assert not page.get("Open recording", "visible")
            printed(process)
            until(lambda: page.get("Open recording", "visible"))
            page.set("Branch here", True)
            page.set("time [s]", 1.0)  # also behind the end
            until(lambda: page.ago)
            page.set("Branch here", True)
            until(lambda: any("the run has ended" in each for each in page.answers))
            page.set("Open recording", True)
            assert process.stdout is not None
            lines = iter(process.stdout.readline, "")
            assert next(each for each in lines if "view: " in each).split()[1].endswith(f":{port}")
        finally:
            page.close()
        again = Page(port)
        try:
            until(lambda: "time [s]" in again.widgets and again.get("time [s]", "max") > 2.5)
            assert "E-STOP" not in again.widgets
        finally:
            again.close()
    finally:
        process.kill()
        process.communicate()


def test_what_was_before_a_branch_stays_and_a_pause_takes_no_room() -> None:
    layout = Layout(standard_states(LEGS))
    history = History(layout, 0.02)
    for number in (*range(100), *[60] * 9000, 61):
        history.take(tick(layout, number, joint_pos=number))
    time, _ = history.last(SECONDS)
    assert time.tolist() == pytest.approx([0.02 * n for n in range(62)])
    assert list(history.span) == pytest.approx([0.0, 1.22])
    for moment, row in ((0.5, 25), (-1.0, 0), (9e9, 61), (0.505, 25)):
        found, states = history.at(moment)
        assert found == pytest.approx(0.02 * row)
        assert states["joint_pos"].tolist() == [row] * len(LEGS)
    plot = Plot(layout, history, "joint_pos", ALL, 0.02)
    assert plot.data(1.0, 0.5)[0][[0, -1]].tolist() == pytest.approx([0.0, 0.5])
