"""The parts of the live page that need no browser: who drives, who may look, what is plotted."""

from __future__ import annotations

import re
import shlex
import socket
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import unicon_lab.view.page.sink as wheel_module
from unicon_base.errors import UniconError
from unicon_core.states import Layout, States, StateSpec
from unicon_core.states.standard import standard_states
from unicon_lab.run_options import view_options
from unicon_lab.view.page.plots import (
    ALL,
    POINTS,
    SECONDS,
    TIMES,
    VELOCITY,
    History,
    Plot,
    choices,
    curves_of,
    element_choices,
    groups,
)
from unicon_lab.view.page.sink import MOST, status_html
from unicon_lab.view.shown import DEAD_MAN, GraphLine
from unicon_lab.view.source import Wheel
from unicon_ros.cli.main import _parser, main
from unicon_ros.web_front import check_reach, listening, refusal

LEGS = tuple(f"{leg}_{part}_joint" for leg in ("FL", "FR") for part in ("hip", "thigh", "calf"))
BOUNDS = ((-0.5, 1.0), (-0.4, 0.4), (-1.0, 1.0))


class Told:
    """A remote that notes what it is told."""

    def __init__(self) -> None:
        self.said: list[Any] = []

    def touch(self) -> None:
        self.said.append("touch")

    def let_go(self) -> None:
        self.said.append("let_go")

    def drive(self, velocity: Any) -> None:
        self.said.append([round(float(x), 3) for x in velocity])

    def pull(self, body: int, *ends: Any) -> None:
        self.said.append(("pull", body, *ends))


@pytest.fixture
def told() -> Told:
    return Told()


@pytest.fixture
def wheel(told: Told) -> Wheel:
    return Wheel(told, BOUNDS)


# -- who drives ---------------------------------------------------------------------------------


def test_one_drives_and_the_others_are_told_who(wheel: Wheel, told: Told) -> None:
    assert wheel.take(1, 0.0) == ""
    assert "viewer 1 drives" in wheel.take(2, 0.1)
    assert not wheel.steer(2, (0.3, 0.0, 0.0), 0.1)
    assert not wheel.heard(2, 0.1)
    wheel.let_go(2)
    assert wheel.driver == 1
    assert told.said == ["touch"]


def test_a_velocity_is_bounded_and_sent_with_each_sign_of_life(wheel: Wheel, told: Told) -> None:
    wheel.take(1, 0.0)
    assert wheel.steer(1, (9.0, -9.0, 0.5), 0.1)
    assert wheel.heard(1, 0.2)
    assert told.said == ["touch", [1.0, -0.4, 0.5], [1.0, -0.4, 0.5]]


@pytest.mark.parametrize("velocity", [(np.nan, 0, 0), (np.inf, 0, 0), (0.1,), (), (0, 0, 0, 0)])
def test_a_velocity_that_is_none_is_not_taken(wheel: Wheel, told: Told, velocity: Any) -> None:
    wheel.take(1, 0.0)
    assert not wheel.steer(1, velocity, 0.1)
    assert told.said == ["touch"]


def test_a_silent_driver_is_lost_and_has_to_take_the_wheel_anew(wheel: Wheel, told: Told) -> None:
    wheel.take(1, 0.0)
    wheel.steer(1, (0.5, 0.0, 0.0), 0.1)
    stall = 0.1 + DEAD_MAN + 0.01
    # What its page had sent before the stall comes now, all at once.
    assert not wheel.steer(1, (0.5, 0.0, 0.0), stall)
    assert not wheel.heard(1, stall)
    assert wheel.driver is None
    assert "was silent" in wheel.lost
    assert told.said[-1] == [0.0, 0.0, 0.0]
    assert wheel.take(1, stall) == ""
    assert wheel.velocity.tolist() == [0.0, 0.0, 0.0]
    assert wheel.lost == ""


def test_silence_is_noticed_without_a_message(wheel: Wheel) -> None:
    wheel.take(1, 0.0)
    wheel.look(DEAD_MAN)
    assert wheel.driver == 1
    wheel.look(DEAD_MAN + 0.01)
    assert wheel.driver is None
    assert wheel.take(2, 1.0) == ""


def test_a_closed_page_stands_still_and_gives_nothing_back(wheel: Wheel, told: Told) -> None:
    wheel.take(1, 0.0)
    wheel.steer(1, (0.5, 0.0, 0.0), 0.1)
    wheel.lose(1, "was closed")
    assert told.said[-1] == [0.0, 0.0, 0.0]
    assert "let_go" not in told.said
    assert wheel.driver is None


def test_who_lets_go_gives_the_command_back(wheel: Wheel, told: Told) -> None:
    wheel.take(1, 0.0)
    wheel.let_go(1)
    assert told.said == ["touch", "let_go"]
    assert wheel.driver is None


def test_without_a_velocity_command_there_is_nothing_to_drive(told: Told) -> None:
    assert "nothing to drive" in Wheel(told, ()).take(1, 0.0)
    assert told.said == []
    drags = Wheel(told, (), drags=True)
    assert drags.take(1, 0.0) == ""
    assert drags.steer(1, (0.5, 0.0, 0.0), 0.1)
    assert told.said[-1] == [0.0, 0.0, 0.0]


def test_only_who_drives_drags_and_silence_releases(wheel: Wheel, told: Told) -> None:
    ends = (0.0, 0.1, 0.2), (1.0, 0.0, 0.5)
    assert not wheel.pull(1, 0.0, 3, *ends)
    wheel.take(1, 0.0)
    assert not wheel.pull(2, 0.1, 3, *ends)
    assert wheel.pull(1, 0.1, 3, *ends)
    assert told.said == ["touch", ("pull", 3, *ends)]
    assert not wheel.pull(1, DEAD_MAN + 0.01, 3, *ends)
    assert told.said[2:] == [("pull", 0), [0.0, 0.0, 0.0]]


# -- who may look -------------------------------------------------------------------------------

HOST = "127.0.0.1:8700"


@pytest.mark.parametrize(
    ("host", "origin", "path", "token", "why"),
    [
        (HOST, f"http://{HOST}", "/", "", ""),
        ("localhost:8700", "http://localhost:8700", "/", "", ""),
        ("[::1]:8700", "http://[::1]:8700", "/", "", ""),
        (HOST, None, "/", "", ""),  # a program of this machine
        (HOST, "http://evil.example", "/", "", "page of http://evil.example"),
        (HOST, "http://127.0.0.1:80", "/", "", "page of http://127.0.0.1:80"),
        (HOST, "null", "/", "", "page of null"),
        ("evil.example:8700", "http://evil.example:8700", "/", "", "host 'evil.example'"),
        ("", None, "/", "", "host ''"),
        ("[", "http://[", "/", "", "cannot be read"),
        ("robot:8700", "http://robot:8700", "/s3cretword", "s3cretword", ""),
        ("robot:8700", "http://robot:8700", "/", "s3cretword", "token"),
        ("robot:8700", "http://robot:8700", "/s3cretwore", "s3cretword", "token"),
        ("robot:8700", "http://robot:8700", "/ümlaut", "s3cretword", "token"),
        ("robot:8700", "http://evil.example", "/s3cretword", "s3cretword", "page of"),
    ],
)
def test_only_pages_of_this_server_may_look(
    host: str, origin: str | None, path: str, token: str, why: str
) -> None:
    headers = {"Host": host} | ({"Origin": origin} if origin else {})
    found = refusal(headers, path, token)
    assert (found == "") == (why == "")
    assert why in found


def test_beyond_this_machine_a_token_is_needed() -> None:
    check_reach("127.0.0.1", "")
    check_reach("0.0.0.0", "s3cretword")
    with pytest.raises(UniconError, match=r"--view-host 0\.0\.0\.0 lets everybody.*--view-token"):
        check_reach("0.0.0.0", "")
    for token in ("short", "with/slash1", "blank blank", "ümläut123"):
        with pytest.raises(UniconError, match="is not a token; give 8 or more"):
            check_reach("0.0.0.0", token)


def test_a_taken_port_gives_the_next_one_and_the_last_one_an_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with listening("127.0.0.1", port) as server:
            assert port < server.getsockname()[1] < port + 100
    refused = pytest.raises(UniconError, match="--view-port 65535: Address already in use; give")
    with suppress(OSError), socket.create_server(("127.0.0.1", 65535)), refused:
        listening("127.0.0.1", 65535)
    with pytest.raises(UniconError, match=r"--view-host 192\.0\.2\.1 .*; give others"):
        listening("192.0.2.1", 8700)


@pytest.mark.parametrize("port", ["65536", "-1", "web"])
def test_what_is_no_port_is_refused(port: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["run", "go2_walk", "--view", "--view-port", port])
    assert "argument --view-port: " in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--view-token=c0rrecthorse", "--view-host=0.0.0.0"])
def test_what_is_said_of_a_viewer_that_nobody_opens_is_refused(
    option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "go2_walk", "--no-ros", option]) == 1
    assert "--view-host and --view-token go with --view; add it" in capsys.readouterr().err


# -- what is plotted ----------------------------------------------------------------------------


@pytest.fixture
def layout() -> Layout:
    specs = standard_states(LEGS) | {"picture": StateSpec((64, 64)), "flag": StateSpec((), "bool")}
    return Layout(specs)


def tick(layout: Layout, number: int, **values: Any) -> Any:
    states = States(layout)
    for name, value in values.items():
        states[name][...] = value
    return SimpleNamespace(tick=number, late_ns=number * 1000, busy_ns=500_000, states=states)


def test_any_state_of_numbers_can_be_chosen_and_pictures_are_left_out(layout: Layout) -> None:
    known = choices(layout, History(layout, 0.02))
    assert known[:2] == (VELOCITY, TIMES)
    assert {"joint_pos", "base_quat", "stamp_ns", "flag"} <= set(known)
    assert "picture" not in known


def test_elements_are_grouped_by_leg() -> None:
    assert groups(LEGS) == {"FL": LEGS[:3], "FR": LEGS[3:]}
    arm = [f"left_{name}" for name in ("hip_pitch", "hip_roll", *map(str, range(8)))]
    assert groups(arm) == {"left_hip": ("left_hip_pitch", "left_hip_roll")}


def test_a_target_is_dashed_beside_what_is_measured(layout: Layout) -> None:
    history = History(layout, 0.02)
    curves = curves_of(layout, history, "joint_pos", LEGS[1])
    assert [(c.label, c.dashed) for c in curves] == [
        ("FL_thigh_joint", False),
        ("FL_thigh_joint target", True),
    ]
    assert curves[0].colour == curves[1].colour
    history.take(tick(layout, 1, joint_pos=np.arange(6), joint_pos_target=10 + np.arange(6)))
    plot = Plot(layout, history, "joint_pos", LEGS[1], 0.02)
    _, measured, target, _ = plot.data(1.0)
    lines = re.findall(r"<line ([^>]*)/></svg>&nbsp;([^<]*)", plot.legend())
    assert [(name, "dasharray" in look) for look, name in lines] == [
        ("FL_thigh_joint", False),
        ("FL_thigh_joint target", True),
    ]
    assert (measured.tolist(), target.tolist()) == ([1.0], [11.0])


def test_velocity_has_what_is_commanded_beside_it_and_titles_have_units(layout: Layout) -> None:
    history = History(layout, 0.02)
    history.take(
        tick(
            layout,
            5,
            velocity_command=(1, 2, 3),
            base_lin_vel=(4, 5, 0),
            base_ang_vel=(0, 0, 6),
        )
    )
    plot = Plot(layout, history, VELOCITY, ALL, 0.02)
    assert [float(x[0]) for x in plot.data(1.0)[:-1]] == pytest.approx([0.1, 4, 1, 5, 2, 6, 3])
    assert plot.title == "velocity, commanded dashed [m/s, rad/s]"
    assert Plot(layout, history, "base_lin_acc", ALL, 0.02).title == "base_lin_acc [m/s²] in base"
    assert "FL_hip_joint" in element_choices(layout, "joint_pos")
    assert element_choices(layout, "tick") == (ALL,)


@pytest.mark.parametrize("period", [0.02, 0.002, 0.1])
def test_history_keeps_the_last_seconds_and_the_worst_of_the_ticks_between(
    layout: Layout, period: float
) -> None:
    history = History(layout, period)
    count = round(3 * SECONDS / period)
    each = tick(layout, 0)
    for number in range(count):
        each.tick, each.late_ns = number, 7_000_000 if number == count - 12 else 0
        history.take(each)
    time, rows = history.last(SECONDS)
    assert time[-1] - time[0] == pytest.approx(SECONDS, abs=2 * max(period, 0.011))
    assert (np.diff(time) > 0).all()
    assert rows[-12:, history.columns["late"].start].max() == pytest.approx(7.0)
    data = Plot(layout, history, TIMES, ALL, period).data(SECONDS)
    assert len(data[0]) <= POINTS
    assert data[0][-1] == time[-1]
    assert data[3][0] == pytest.approx(period * 1e3)  # the deadline


@pytest.mark.parametrize(("noise", "spans"), [(0.001, 0.02), (0.3, 0.6)])
def test_an_axis_does_not_magnify_noise(layout: Layout, noise: float, spans: float) -> None:
    history = History(layout, 0.02)
    for number in range(9):
        where = 0.5 + noise * (-1) ** number
        history.take(tick(layout, number, joint_pos=where, joint_pos_target=0.5))
    plot = Plot(layout, history, "base_quat", ALL, 0.02)
    assert len(plot.series()) == len(plot.data(9.0))
    plot = Plot(layout, history, "joint_pos", LEGS[0], 0.02)
    seen = np.concatenate([plot.data(9.0)[1], plot.data(9.0)[-1]])
    assert np.nanmax(seen) - np.nanmin(seen) == pytest.approx(spans, rel=1e-3)
    assert plot.series()[-1]["stroke"] == "transparent"


def test_the_state_beside_the_estop_is_short_and_says_what_is_wrong(layout: Layout) -> None:
    def brief(stale: float = 0.0, paused: bool = False, **texts: Any) -> tuple[str, bool]:
        seen = tick(layout, 100)
        seen.phase, seen.paused, seen.overruns = 0, paused, 0
        shown: Any = SimpleNamespace(phases=("run",), period=0.02, skills=())
        return status_html(shown, seen, History(layout, 0.02), 50.0, texts, "", stale)[1:]

    assert brief() == ("run\n2.0 s · 50 Hz", False)
    assert brief(paused=True, stale=9.0) == ("run, paused\n2.0 s · 50 Hz", False)
    assert brief(stale=3.0) == ("run: no tick for 3 s\n2.0 s · 50 Hz", True)
    assert brief(waits_for="the go") == ("run\n2.0 s\nwaits for the go · 50 Hz", False)
    assert brief(faults=["tilted <45°"]) == ("tilted <45°", True)


def test_a_reset_begins_the_plots_anew(layout: Layout) -> None:
    history = History(layout, 0.02)
    for number in (10, 11, 12, 3):
        history.take(tick(layout, number))
    assert history.last(9.0)[0].tolist() == [pytest.approx(0.06)]


def test_a_plot_before_the_first_tick_is_empty_but_there(layout: Layout) -> None:
    data = Plot(layout, History(layout, 0.02), "joint_pos", ALL, 0.02).data(5.0)
    assert len(data) == 2 + 2 * len(LEGS)
    assert np.isnan(data[1]).all()


def test_the_running_part_of_the_graph_stands_out() -> None:
    pytest.importorskip("viser", reason="no live page: pip install 'unicon_ros[view]'")
    from unicon_lab.view.page.panel import graph_html

    lines = [
        GraphLine(0, "chain", (), 0),
        GraphLine(1, "<b>", ((0, 1),)),
        GraphLine(1, "c", ((0, 0),)),
    ]
    html = graph_html(lines, [1])
    assert "▸ &lt;b&gt;" in html
    assert "· c" in html


# -- docs/howto/view.md --------------------------------------------------------------------------

DOCUMENT = (Path(__file__).parents[2] / "docs/howto/view.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("line", re.findall(r"^unicon .*?(?=\s+#|$)", DOCUMENT, re.MULTILINE))
def test_each_command_of_the_document_is_one(line: str) -> None:
    arguments = _parser().parse_args(shlex.split(line)[1:])
    if arguments.command == "run":
        options = view_options(vars(arguments))
        assert options["sink"] == "page"
        check_reach(options["host"], options["token"])


def test_the_document_has_the_figures_and_the_keys_of_the_code() -> None:
    script = (Path(wheel_module.__file__).parent / "script.js").read_text(encoding="utf-8")
    keys = re.findall(r"\b([a-z]): \[(\d), (-?1)\]", script)
    assert {key for key, axis, _ in keys if axis == "0"} == {"i", "k"}
    assert "I and K forwards and back, U and O sideways, J and L turn" in DOCUMENT
    assert [key for key, *_ in keys] == ["i", "k", "u", "o", "j", "l"]
    assert f"After {DEAD_MAN} s of silence" in DOCUMENT
    pytest.importorskip("viser", reason="no live page: pip install 'unicon_ros[view]'")
    from unicon_core.models.posed import TOUCHING

    assert f"within {1e3 * TOUCHING:.0f} mm of the floor" in DOCUMENT
    assert f"up to {MOST}" in DOCUMENT
