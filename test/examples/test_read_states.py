"""The reader in plain Python gets whole values of a live writer, without unicon and NumPy."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from unicon_core.states import Layout, States, StateSpec
from unicon_core.states.backends.shm import Segment, ShmWriter
from unicon_core.states.groups import groups_of

SCRIPT = Path(__file__).resolve().parents[2] / "examples" / "read_states.py"
NAME = f"test-plain-{os.getpid()}"
KINDS = ("bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")
SPECS = {f"a_{kind}": StateSpec((2,), kind) for kind in (*KINDS, "float16", "float32", "float64")}
SPECS |= {"grid": StateSpec((2, 150)), "joint_pos_target": StateSpec((3,)), "tick": StateSpec()}


def read(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the script with nothing of ours in reach."""
    code = (
        "import sys; sys.argv = sys.argv[1:]\n"
        "for name in ('unicon_core', 'unicon_ros', 'numpy'): sys.modules[name] = None\n"
        "exec(compile(open(sys.argv[0]).read(), sys.argv[0], 'exec'))"
    )
    return subprocess.run(
        [sys.executable, "-S", "-I", "-c", code, str(SCRIPT), *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        cwd="/",
        env={},
        check=False,
    )


@pytest.mark.parametrize("num_robots", [None, 2])
def test_each_state_is_read(num_robots):
    states = States(Layout(SPECS, num_robots))
    segment = Segment.create(NAME, groups_of(states.layout))
    try:
        for writer in (ShmWriter(segment, group, states) for group in segment.groups):
            for k, name in enumerate(states):
                states[name] = k + 1 if name != "a_bool" else True
            writer.publish()
        for name in ("a_bool", "a_int8", "a_uint64", "a_float16", "joint_pos_target", "tick"):
            done = read(NAME, name, "1")
            assert done.returncode == 0, done.stderr
            number, _, unit, old, *values = done.stdout.split()
            assert (number, unit, old) == ("1", "ms", "old:")
            expected = np.array([float(v) if v != "True" else 1.0 for v in values])
            np.testing.assert_array_equal(expected, states[name].astype(float).ravel())
        done = read(NAME, "absent")
        assert (done.returncode, done.stderr) == (1, "no state 'absent' in this segment\n")
        segment.memory[8] = 9
        assert "of another version" in read(NAME, "tick").stderr
    finally:
        segment.close()


def test_values_of_a_writer_that_never_rests_are_whole():
    states = States(SPECS)
    segment = Segment.create(NAME, groups_of(states.layout))
    stopped = threading.Event()

    def write() -> None:
        writer = ShmWriter(segment, "measured", states)
        while not stopped.is_set():
            states.grid += 1
            writer.publish()

    thread = threading.Thread(target=write)
    thread.start()
    try:
        done = read(NAME, "grid", "15")
    finally:
        stopped.set()
        thread.join()
        segment.close()
    lines = [line.split() for line in done.stdout.splitlines()]
    assert len(lines) == 15, done.stderr
    numbers = [int(line[0]) for line in lines]
    assert numbers == sorted(set(numbers))
    for line in lines:
        assert len(line) == 4 + 300
        assert set(line[4:]) == {line[0] + ".0"}


def test_it_is_short():
    assert len(SCRIPT.read_text(encoding="utf-8").splitlines()) <= 60
