"""A diagnosis beside a run: it reads the last ticks, tells once, holds nothing up, ends with it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")

from unicon_base.errors import MissingDependencyError, PlatformError, UniconError
from unicon_core.handles import FrameRing, clean_frames
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import load_robot
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.states import States, StateSpec
from unicon_core.states.standard import standard_states
from unicon_core.workflow import Program, load_document
from unicon_lab.diagnose import Cause, fit
from unicon_lab.diagnose.fit import Diagnosed, Live
from unicon_lab.view.shown import HEAD
from unicon_lab.view.source import LiveSource, Remote
from unicon_ros.attachments import Asked
from unicon_ros.cli.main import main

GO2 = load_robot("go2")
PERIOD = 0.02
CALF = Cause("strength", "RL_calf_joint", "plant", 0.99, -0.3, -0.33, -0.27)
SAID = "-30.0% (95 %: -33.0% to -27.0%)"


class Ticks:
    """A ring of a run's ticks, as a tick fills it, in which one joint swings."""

    def __init__(self, slots: int, **more: StateSpec) -> None:
        self.states = States(standard_states(GO2.joint_names) | more)
        self.ring = FrameRing.create(HEAD.size + self.states.buffer.nbytes, slots)
        self.tick = 0

    def fill(self, count: int) -> None:
        for _ in range(count):
            self.states["tick"][...] = self.tick
            self.states["joint_pos"][0] = 0.5 * np.sin(0.3 * self.tick)
            frame = self.ring.fill()
            frame[: HEAD.size] = np.frombuffer(HEAD.pack(self.tick, *[0] * 9), np.uint8)
            frame[HEAD.size :] = self.states.buffer.view(np.uint8)
            self.ring.commit(0)
            self.tick += 1


class Told(list[str]):
    """What a feed tells: lines, and the causes of the last verdict."""

    causes: Any = None

    def tell(self, line: str) -> None:
        self.append(line)

    def words(self, causes: dict[str, str]) -> None:
        self.causes = causes


@pytest.fixture
def ticks() -> Iterator[Ticks]:
    made = Ticks(300)
    yield made
    made.ring.close()


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is waited for."""
    monkeypatch.setattr(fit, "SPAN", 0.0)


def device(ticks: Ticks, told: Told, scene: Scene | None = None) -> Live:
    shown: Any = SimpleNamespace(layout=ticks.states.layout, robot=GO2, period=PERIOD)
    source: Any = LiveSource(shown.layout, ticks.ring)
    return Live(shown, source, Remote(None), {"scene": scene or Scene(), "feed": told})


def looked(ticks: Ticks, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the motion that is diagnosed."""
    found: list[Any] = []

    def causes(motion: Any, *_: Any, **__: Any) -> Any:
        found.append(motion)
        return SimpleNamespace(causes=())

    monkeypatch.setattr(fit, "plant_causes", causes)
    device(ticks, Told())._verdict.result()
    return found[0]


def test_it_looks_at_the_last_ticks_of_a_ring_that_went_round(
    ticks: Ticks, monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks.fill(1000)
    motion = looked(ticks, monkeypatch)
    swung = 0.5 * np.sin(0.3 * np.arange(1000 - len(motion.measured["joint_pos"]), 1000))
    assert len(swung) == 298
    np.testing.assert_allclose(motion.measured["joint_pos"][:, 0], swung, atol=1e-6)
    assert (np.diff(motion.starts) % motion.length == 0).all()
    assert len(motion.starts) == fit.WINDOWS


def test_ticks_that_were_overwritten_while_it_read_are_in_no_window(
    ticks: Ticks, monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks.fill(300)
    whole, read = FrameRing.frame, list[int]()

    def frame(ring: FrameRing, handle: int) -> Any:
        read.append(handle)
        if len(read) == 100:  # the run goes on by half a ring
            ticks.fill(150)
        return whole(ring, handle)

    monkeypatch.setattr(FrameRing, "frame", frame)
    motion = looked(ticks, monkeypatch)
    swing = motion.measured["joint_pos"][:, 0]
    assert len(swing) < 270
    for start in motion.starts:
        window = swing[start - 1 : start + motion.length + 1]
        after = window[1:-1] * 2.0 * np.cos(0.3) - window[:-2]  # of a sine, by two before
        np.testing.assert_allclose(window[2:], after, atol=1e-5)


def test_an_estimated_velocity_counts_as_none(monkeypatch: pytest.MonkeyPatch) -> None:
    names = {}
    for estimated in ({}, {"base_lin_vel_variance": StateSpec((3,))}):
        made = Ticks(20, **estimated)
        one = device(made, Told())
        names[len(estimated)] = "base_lin_vel" in one._names
        one._pool.shutdown(wait=False, cancel_futures=True)
        made.ring.close()
    assert names == {0: True, 1: False}


def test_a_cause_is_told_once_and_again_when_it_is_another_size(ticks: Ticks) -> None:
    told = Told()
    one = device(ticks, told)
    line = f"diagnose: strength of RL_calf_joint: {SAID} from the simulation"
    one._tell([CALF])
    one._tell([replace(CALF, size=-0.35, low=-0.38, high=-0.32)])  # intervals that overlap
    assert told == [line]
    assert told.causes == {"cause strength of RL_calf_joint": "-35.0% (95 %: -38.0% to -32.0%)"}
    one._tell([])
    assert told.causes == {}
    one._tell([CALF, replace(CALF, kind="friction", probability=0.8)])  # too unsure a second one
    assert told == [line]
    assert told.causes == {"cause strength of RL_calf_joint": SAID}
    one._tell([replace(CALF, size=-0.5, low=-0.55, high=-0.45)])
    assert told[1:] == [
        "diagnose: strength of RL_calf_joint: -50.0% (95 %: -55.0% to -45.0%) from the simulation"
    ]
    load = Cause("payload", "", "plant", 1.0, 4.0, 3.9, 4.1, "kg", alike=("attitude y",))
    one._tell([load])
    assert told[2:] == [
        "diagnose: payload or attitude y: +4 kg (95 %: +3.9 kg to +4.1 kg) from the simulation"
    ]
    one._pool.shutdown(wait=False, cancel_futures=True)


@pytest.mark.parametrize("short", [True, False])
def test_no_verdict_for_long_is_told_once_with_its_reason(
    short: bool, ticks: Ticks, monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks.fill(20 if short else 300)

    def slow(*_: Any, **__: Any) -> Any:
        time.sleep(0.3)
        return SimpleNamespace(causes=())

    patience = 2.0 if short else 0.2  # a look has to end before
    monkeypatch.setattr(fit, "PATIENCE", patience)
    monkeypatch.setattr(fit, "plant_causes", slow)
    told = Told()
    one = device(ticks, told)
    end = time.monotonic() + patience + 0.6
    while time.monotonic() < end:
        one.poll()
        time.sleep(0.01)
    why = "a diagnosis needs at least 8 windows" if short else fit._BUSY
    (line,) = told
    assert line.startswith(f"diagnose: no verdict within {patience:g} s: {why}")
    one._pool.shutdown(wait=False, cancel_futures=True)


def test_what_cannot_be_is_refused_before_the_run(
    ticks: Ticks, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["run", "go2_stand", "--diagnose", "--speed", "max"]) == 1
    assert capsys.readouterr().err == (
        "unicon: error: --diagnose cannot follow --speed max; leave one out\n"
    )
    with pytest.raises((PlatformError, UniconError), match=r"nowhere\.xml"):
        device(ticks, Told(), Scene(model="nowhere.xml"))
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingDependencyError, match=r"needs mujoco: pip install"):
        device(ticks, Told())


@pytest.mark.slow
def test_it_ends_with_a_parent_that_is_killed() -> None:
    words = ("run", "go2_stand", "--set", "platform=fake", "--duration", "60", "--diagnose")
    run = subprocess.Popen(
        [sys.executable, "-m", "unicon_ros", *words], stdout=subprocess.DEVNULL, stderr=-1
    )
    children = Path(f"/proc/{run.pid}/task/{run.pid}/children")

    def until(holds: Any) -> Any:
        end = time.monotonic() + 30.0
        while not (found := holds()):
            assert time.monotonic() < end
            time.sleep(0.05)
        return found

    def diagnosing() -> str:
        found = children.read_text().split()
        return next((c for c in found if b"view.process" in _file(c, "cmdline")), "")

    child = until(diagnosing)
    until(lambda: len(os.listdir(f"/proc/{child}/task")) > 1)  # its thread waits
    run.send_signal(signal.SIGKILL)
    run.communicate()
    until(lambda: _file(child, "stat").rpartition(b")")[2].split()[:1] in ([], [b"Z"]))
    assert clean_frames()  # what nobody could remove


def _file(process: str, name: str) -> bytes:
    try:
        return Path(f"/proc/{process}/{name}").read_bytes()
    except OSError:
        return b""


def walked(diagnosed: bool, **overrides: Any) -> tuple[Report, list[str], Any]:
    """Let a Go2 walk for 60 s; return the report, the lines and the run's statistics."""
    given = {
        "commands": [{"velocity_command": {"constant": [0.6, 0.0, 0.2]}}],
        "flow.chain.2.loop.until.elapsed": 60.0,
        "duration": 90.0,
        **overrides,
    }
    document, lines = load_document("go2_walk", given), list[str]()
    each = Diagnosed(Asked({}, document, None, None, lines.append))
    program = Program(document, hooks=[each.hook] if diagnosed else [])
    runner = Runner(program, RunOptions(duration=60.0, warn=lines.append))
    if diagnosed:
        each.attach(runner)
    report = runner.run()
    begin = time.monotonic()
    each.close()
    assert time.monotonic() - begin < 1.0
    return report, lines, runner.statistics


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_weak_calf_is_named_while_it_walks_and_a_healthy_robot_has_none(assets: Path) -> None:
    report, lines, statistics = walked(
        True, **{"scene.joints": {"RL_calf_joint": {"strength": 0.7}}}
    )
    assert report.faults == []
    assert [line.split(":")[1] for line in lines] == [" strength of RL_calf_joint"], lines
    size = float(lines[0].split(": ")[2].split("%")[0])
    assert -34.0 < size < -26.0
    assert statistics.overruns < 0.02 * statistics.count
    report, lines, statistics = walked(True)
    assert report.faults == []
    assert lines == []
    assert statistics.overruns < 0.02 * statistics.count
