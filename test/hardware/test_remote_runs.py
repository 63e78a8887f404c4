"""`go2_buttons` and `g1_buttons` by the remote of an emulated robot: every mode, every refusal."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from emulated_runs import FIRST, PATIENT, EmulatedUnitree
from peer import Peer, wait_for

from unicon_core.blocks.controls.gamepad import ABS, EVENT, KEY, pad_of

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-unitree]'")
pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")

pytestmark = [pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(300)]

CODES = {name: code for code, name in pad_of(None).keys.items()}
# ABS_Y, its end that is up.
FORWARD = 0x01, -32768
# Of the workflows, patient with a robot that a busy machine holds up.
SAFETY = PATIENT.replace("tilt_stop", "{button_stop: {on: [select]}}")
# How long a button is pressed, [s].
HELD = 0.2


class Hands:
    """Hold the pipe that the emulated robot's remote is read from, and read what the run says."""

    def __init__(self, folder: Path) -> None:
        self.pipe, self.told = folder / "remote", folder / "run.txt"
        os.mkfifo(self.pipe)
        self._file = os.open(self.pipe, os.O_RDWR | os.O_NONBLOCK)
        self._seen = 0

    def hold(self, name: str, value: int = 1) -> None:
        os.write(self._file, EVENT.pack(0, 0, KEY, CODES[name], value))

    def push(self, forward: bool) -> None:
        axis, end = FORWARD
        os.write(self._file, EVENT.pack(0, 0, ABS, axis, end if forward else 0))

    def press(self, name: str, answer: str) -> None:
        """Press and let go; wait until the run says so as its next word about buttons."""
        for value in (1, 0):
            self.hold(name, value)
            time.sleep(HELD)
        wait_for(lambda: len(self.words()) > self._seen, f"{name}: {answer}", 20.0)
        said = self.words()[self._seen]
        assert answer in said, self.told.read_text()
        self._seen += 1

    def knock(self, name: str, answer: str) -> None:
        """Press again and again until the flow has begun, which hears it."""
        end = time.monotonic() + 30.0
        while not self.words():
            assert time.monotonic() < end, self.told.read_text()
            for value in (1, 0):
                self.hold(name, value)
                time.sleep(HELD)
        time.sleep(HELD)
        assert answer in self.words()[0]
        self._seen = len(self.words())

    def words(self) -> list[str]:
        lines = self.told.read_text().splitlines()
        return [line for line in lines if "mode: " in line or " is refused: " in line]

    def close(self) -> None:
        os.close(self._file)


@pytest.fixture
def hands(tmp_path: Path) -> Iterator[Hands]:
    made = Hands(tmp_path)
    yield made
    made.close()


@pytest.fixture
def begun(
    processes: Callable[..., Peer], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, hands: Hands
) -> Iterator[Callable[..., tuple[EmulatedUnitree, subprocess.Popen[str]]]]:
    """Begins a robot with that remote, and a run on it."""
    monkeypatch.setenv("PYTHONPATH", "")  # is put back at the end
    runs: list[subprocess.Popen[str]] = []

    def begin(workflow: str, *robot: str) -> tuple[EmulatedUnitree, subprocess.Popen[str]]:
        emulated = EmulatedUnitree(processes, *robot, remote=hands.pipe)
        runs.append(emulated.run(workflow, tmp_path, "--no-ros", f"--set=safety={SAFETY}"))
        assert emulated.wait_for("first")["distance"] <= FIRST
        return emulated, runs[-1]

    yield begin
    for run in runs:
        run.kill()
        run.wait(10)


def test_a_go2_goes_through_all_its_modes_by_its_own_remote(
    begun: Callable[..., tuple[EmulatedUnitree, subprocess.Popen[str]]], hands: Hands
) -> None:
    robot, run = begun("go2_buttons", "go2")
    hands.knock("start", "start is refused: walk is entered from stand, and this is passive")
    hands.press("X", "X is refused: lie is entered from stand, and this is passive")
    hands.press("A", "mode: stand")
    hands.press("start", "start is refused: stand is not at its end, press it again in ")
    time.sleep(3.0)
    hands.press("X", "mode: lie")
    hands.press("start", "start is refused: walk is entered from stand, and this is lie")
    time.sleep(2.5)
    hands.press("A", "mode: stand")
    time.sleep(3.0)
    hands.push(True)
    hands.press("start", "start is refused: a stick is pushed; let go of it first")
    hands.push(False)
    hands.press("start", "mode: walk")
    hands.press("X", "X is refused: lie is entered from stand, and this is walk")
    hands.push(True)
    hands.hold("R1")
    time.sleep(4.0)
    hands.hold("R1", 0)
    hands.push(False)
    time.sleep(1.0)
    hands.press("A", "mode: stand")
    hands.press("B", "mode: passive")
    hands.hold("select")
    assert run.wait(30) == 3
    assert "the operator pressed select" in hands.told.read_text()
    assert robot.of("damping")
    assert robot.moved() > 1.0


def test_a_g1_goes_through_all_its_modes_by_its_own_remote(
    begun: Callable[..., tuple[EmulatedUnitree, subprocess.Popen[str]]], hands: Hands, assets: Path
) -> None:
    robot, run = begun("g1_buttons", "g1_29dof", "--posture=default", "--let-go=1000")
    hands.knock("start", "start is refused: walk is entered from stand, and this is passive")
    hands.press("X", "X is refused: lie is entered from walk, and this is passive")
    hands.press("A", "mode: stand")
    hands.press("start", "start is refused: stand is not at its end, press it again in ")
    hands.press("X", "X is refused: lie is entered from walk, and this is stand")
    time.sleep(1.5)
    hands.push(True)
    hands.press("start", "start is refused: a stick is pushed; let go of it first")
    hands.push(False)
    hands.press("start", "mode: walk")
    hands.press("X", "X is refused: walk is not at its end, press it again in ")
    time.sleep(1.5)
    hands.push(True)
    hands.press("X", "X is refused: a stick is pushed; let go of it first")
    hands.push(False)
    hands.press("A", "mode: stand")
    time.sleep(1.5)
    hands.press("start", "mode: walk")
    time.sleep(1.5)
    hands.press("X", "mode: lie")
    hands.press("start", "start is refused: walk is entered from stand, and this is lie")
    hands.press("A", "mode: stand")
    hands.press("B", "mode: passive")
    hands.hold("select")
    assert run.wait(30) == 3
    assert "the operator pressed select" in hands.told.read_text()
    assert robot.of("damping")
