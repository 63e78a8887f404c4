"""A command's way there and back: published here, answered by `examples/c/identity.c`, taken here.

`python test/states/c_round_trip.py [STEPS]` prints how long it takes on this machine.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import c_peers
import numpy as np

from unicon_base.errors import StateError
from unicon_core.states import Layout, States, standard_states
from unicon_core.states.backends.shm import Segment, ShmReader, ShmWriter
from unicon_core.states.groups import groups_of

LAYOUT = Layout(standard_states([f"joint_{i}" for i in range(29)]))
PATIENCE = 20.0
"""How long a loaded machine may take for one answer, or for the peer's start, in [s]."""


class Peer:
    """A running `identity`, with our ends of both segments."""

    def __init__(self, program: Path, name: str, states: States) -> None:
        self.states, self.answer = states, f"{name}-answer"
        self.segment = Segment.create(name, groups_of(states.layout))
        self.writer = ShmWriter(self.segment, "measured", states)
        self.process = subprocess.Popen(
            [program, name, self.answer], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.reader = self._attach()

    def _attach(self) -> ShmReader:
        end = time.monotonic() + PATIENCE
        while True:
            try:
                return ShmReader(self.answer, "command", self.states)
            except StateError:
                if self.process.poll() is not None or time.monotonic() > end:
                    self.close()
                    raise
                time.sleep(0.005)

    def step(self) -> int:
        """Publish, and take the answer into the states; return how long that took, [ns]."""
        begin = time.perf_counter_ns()
        self.writer.publish()
        if not (self.reader.wait(PATIENCE) and self.reader.take()):
            raise AssertionError("no answer")
        return time.perf_counter_ns() - begin

    def close(self) -> str:
        """End the peer, and return what it says in the end."""
        self.process.send_signal(signal.SIGTERM)
        try:
            said, complained = self.process.communicate(timeout=PATIENCE)
        finally:
            self.process.kill()
            self.segment.close()
        return said + complained


@contextmanager
def identity(program: Path, name: str, states: States) -> Iterator[Peer]:
    """Run the peer while the block runs."""
    peer = Peer(program, name, states)
    try:
        yield peer
        peer.reader.close()
    finally:
        peer.close()


def main(steps: int) -> None:
    """Measure and print: one step after the other, and as a controller of 500 Hz makes them."""
    states = States(LAYOUT)
    with tempfile.TemporaryDirectory() as folder:
        program = c_peers.build(c_peers.IDENTITY, groups_of(LAYOUT), Path(folder))
        with identity(program, f"round-trip-{os.getpid()}", states) as peer:
            for pause, said in (
                (0.0, "one after the other"),
                (0.002, "with 2 ms of sleep between"),
            ):
                took = np.zeros(steps)
                for i in range(steps):
                    states.joint_pos = i
                    took[i] = peer.step() / 1e3
                    time.sleep(pause)
                p50, p99 = np.percentile(took, [50, 99])
                print(f"Python -> C -> Python, {said}: p50 {p50:.1f}, p99 {p99:.1f} µs")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
