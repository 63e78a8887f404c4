"""The base of all peripherals: what is lost is neutral at once, and no tick waits."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from unicon_base.errors import UniconError
from unicon_core.flow import Block
from unicon_core.handles import FOLDER
from unicon_core.robots import load_robot
from unicon_core.states import States, StateSpec
from unicon_core.states.backends.shm import segments
from unicon_core.workflow.autowire import BuildContext
from unicon_ros.bridge.images import FrameMessage
from unicon_ros.peripheral import Peripheral, peripheral_block, peripheral_states, short

SPECS = peripheral_states(
    "counting",
    {"count": StateSpec((), "int64", initial=-7), "wished": StateSpec((), "int64")},
    ["picture"],
)


class Rig:
    """A peripheral with its states, and what it tells."""

    def __init__(self, plug: Path, dry: bool = False, **options: Any) -> None:
        self.states, self.lines = States(SPECS), list[str]()
        context = BuildContext(
            self.states, load_robot("go2"), 0.005, tell=self.lines.append, dry=dry
        )
        self.block: Block = peripheral_block(
            context,
            "counting",
            "counting_device",
            {"plug": str(plug), **options},
            values=["count", "wished"],
            frames={"picture": FrameMessage("", bytes(16), 0, (16,), "|u1")},
        )

    @property
    def tick(self) -> Peripheral:
        assert isinstance(self.block.tick, Peripheral)
        return self.block.tick

    def until(self, holds: Callable[[], bool], patience: float = 5.0) -> float:
        """Tick until something holds; return for how long, in [s]."""
        begin = time.monotonic()
        while not holds():
            assert time.monotonic() - begin < patience, (self.lines, dict(self.values()))
            self.block.tick()
            time.sleep(0.002)
        return time.monotonic() - begin

    def values(self) -> Iterator[tuple[str, int]]:
        for name in SPECS:
            yield name, int(self.states[name])

    def alive(self) -> bool:
        return bool(self.states["counting_alive"])

    def neutral(self) -> bool:
        return dict(self.values()) == {name: {"count": -7}.get(name, 0) for name in SPECS}


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    (tmp_path / "plug").touch()
    made = Rig(tmp_path / "plug")
    yield made
    assert made.block.close is not None
    made.block.close()
    made.block.close()
    assert not [each for each in segments() if each.name.startswith("counting-")]
    assert not [ring for ring in made.tick.rings.values() if ring.path.exists()]


def test_what_it_tells_comes_with_its_frame(rig: Rig) -> None:
    rig.until(lambda: int(rig.states["count"]) > 3)
    assert rig.tick.first["pid"] == rig.tick.process.pid
    handle = int(rig.states["counting_picture_handle"])
    frame = rig.tick.rings["picture"].frame(handle)
    assert frame is not None
    assert frame[0] == handle == int(rig.states["count"])
    age = time.monotonic_ns() - int(rig.states["counting_stamp_ns"])
    assert 0 <= age < 1e9


def test_unplugged_it_is_neutral_at_once_and_comes_back(rig: Rig, tmp_path: Path) -> None:
    rig.until(rig.alive)
    (tmp_path / "plug").unlink()
    rig.until(lambda: not rig.alive(), 1.0)
    assert rig.neutral()
    (tmp_path / "plug").touch()
    rig.until(rig.alive)
    rig.until(lambda: len(rig.lines) == 2)
    assert rig.lines == [
        "counting: unplugged; its values are neutral until it is back",
        "counting: it is there",
    ]


def test_it_begins_without_the_device(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "plug")
    rig.until(lambda: bool(rig.lines))
    assert rig.neutral()
    (tmp_path / "plug").touch()
    rig.until(rig.alive)
    assert rig.block.close is not None
    rig.block.close()


def test_a_stopped_process_is_stale_and_no_tick_waits(rig: Rig) -> None:
    rig.until(rig.alive)
    os.kill(rig.tick.process.pid, signal.SIGSTOP)
    for _ in range(30_000):  # far more than a pipe holds
        rig.tick.wish("nothing", 1.0)
    rig.until(lambda: not rig.alive(), 2.0)
    assert rig.neutral()
    os.kill(rig.tick.process.pid, signal.SIGCONT)
    rig.until(lambda: rig.alive() and int(rig.states["wished"]) > 10)


def test_a_killed_process_is_neutral_and_started_again(rig: Rig) -> None:
    rig.until(rig.alive)
    before = rig.tick.process.pid
    os.kill(before, signal.SIGKILL)
    rig.until(lambda: not rig.alive(), 2.0)
    assert rig.neutral()
    rig.until(rig.alive, 10.0)
    assert rig.tick.process.pid != before
    assert "was killed by SIGKILL; its values are neutral" in rig.lines[0]
    rig.until(lambda: len(rig.lines) == 2)
    assert rig.lines[1] == "counting: its process runs again"


@pytest.mark.slow
def test_what_dies_again_and_again_is_started_ever_more_rarely(rig: Rig, tmp_path: Path) -> None:
    rig.until(rig.alive)
    (tmp_path / "plug").write_text("broken")
    rig.until(lambda: rig.tick.started >= 4, 30.0)
    waits = [line.rsplit(" in ", 1)[1] for line in rig.lines if "started again in" in line]
    assert waits[:3] == ["1 s", "2 s", "4 s"]
    assert "counting raised RuntimeError: broken" in rig.lines
    (tmp_path / "plug").write_text("")
    rig.until(rig.alive, 20.0)


@pytest.mark.slow
def test_garbage_in_the_pipe_does_not_end_the_tries(rig: Rig, tmp_path: Path) -> None:
    rig.until(rig.alive)
    (tmp_path / "plug").write_text("garbage")
    os.kill(rig.tick.process.pid, signal.SIGKILL)
    rig.until(lambda: rig.tick.started == 3, 20.0)
    (tmp_path / "plug").write_text("")
    rig.until(rig.alive, 20.0)


def test_closed_while_it_is_started_again_no_process_is_left(tmp_path: Path) -> None:
    (tmp_path / "plug").touch()
    rig = Rig(tmp_path / "plug")
    rig.until(rig.alive)
    os.kill(rig.tick.process.pid, signal.SIGKILL)
    rig.until(lambda: rig.tick.started == 2)
    rig.tick.close()
    thread = rig.tick._thread
    assert thread is not None
    thread.join(10.0)
    assert not thread.is_alive()
    assert rig.tick.process.poll() is not None
    assert not [each for each in segments() if each.name.startswith("counting-")]


def test_what_is_too_long_for_the_pipe_is_left_out_whole(rig: Rig) -> None:
    rig.until(rig.alive)
    os.kill(rig.tick.process.pid, signal.SIGSTOP)
    for _ in range(200):  # until there is room for a part alone
        rig.tick.wish("longer", "x" * 5000)
        rig.tick.wish("long", "x" * 4000)
    os.kill(rig.tick.process.pid, signal.SIGCONT)
    rig.until(lambda: 0 < int(rig.states["wished"]) < 20)
    there = int(rig.states["wished"])
    rig.tick.wish("short")  # understood as what it is
    rig.until(lambda: int(rig.states["wished"]) == there + 1)
    assert short("\N{SNOWMAN}" * 1000, 100) == "\N{SNOWMAN}" * 16


def test_it_ends_with_its_parent(tmp_path: Path) -> None:
    (tmp_path / "plug").touch()
    told, tell = os.pipe()
    parent = os.fork()
    if not parent:  # a parent that is killed
        rig = Rig(tmp_path / "plug")
        os.write(tell, str(rig.tick.process.pid).encode())
        os.kill(os.getpid(), signal.SIGKILL)
    child = int(os.read(told, 20))
    os.waitpid(parent, 0)
    end = time.monotonic() + 5.0
    while Path(f"/proc/{child}/stat").exists() and time.monotonic() < end:
        if Path(f"/proc/{child}/stat").read_text().split()[2] == "Z":
            break
        time.sleep(0.05)
    assert time.monotonic() < end
    for ring in FOLDER.glob("unicon_frames_*"):
        if ring.stat().st_size == 8 * 8 + 16 * 4 + 16 * 4:  # of the parent that was killed
            ring.unlink()


def test_what_it_cannot_do_is_the_parents_error(tmp_path: Path) -> None:
    with pytest.raises(UniconError, match="wrong is given; leave it out"):
        Rig(tmp_path / "plug", wrong=True)


def test_a_dry_run_opens_nothing(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "plug", dry=True, wrong=True)
    rig.block.tick()
    assert rig.neutral()
    assert rig.block.writes == tuple(SPECS)
