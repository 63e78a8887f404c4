"""`unicon bench stores`: each way carries whole values, ratios have bars, nothing is left."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from benchmarks import stores
from benchmarks.stores import group
from unicon_core.states.backends.shm import segments
from unicon_ros.bench.report import Bench
from unicon_ros.cli.bench import BENCHES

pytestmark = [pytest.mark.timeout(110), pytest.mark.alone]
OURS = ("shm, sleeping", "zmq ipc")


def names_left() -> list[str]:
    return [found.name for found in segments() if found.name.startswith("unicon-")]


CPU = "reader's CPU [% of a core]"  # one sample of each round in which values came


def measured(rounds: int, *names: str, others: bool = False) -> Bench:
    """Measure ways; again where a busy machine let no value through in half a second."""
    ways = {name: way for name, way in stores.WAYS.items() if others or name in names}
    for _ in range(5):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(stores, "WAYS", ways)
            bench = stores.run(rounds)
        if all(bench.cases.get(f"{name}: {CPU}", {}).get("samples") == rounds for name in names):
            return bench
    pytest.fail(f"no values in some of {rounds} rounds, five times: {bench.table()}")


@pytest.mark.slow
def test_ways_without_ros_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stores, "SAMPLES", 5)
    chosen = [name for name in OURS if name == OURS[0] or find_spec("zmq")]
    before = names_left()
    bench = measured(2, *chosen)
    assert bench.rounds == 2
    for name in chosen:
        for row in ("one way", "send"):
            case = bench.cases[f"{name}: {row}"]
            assert case["samples"] > 0  # 250 of a round, on a machine that is not busy
            assert case["min"] > 0.0
        assert ", 0 torn, " in bench.facts[name]
    assert bench.cases["publish 1 kB: shm"]["samples"] == 10
    bars = {name: ratio["bar"] for name, ratio in bench.ratios.items()}
    assert bars == {"publish": 4.0} | ({"shm_wake": 0.5} if "zmq ipc" in chosen else {})
    assert json.loads(bench.to_json())["bench"] == "stores"
    assert names_left() == before


@pytest.mark.ros
@pytest.mark.slow
def test_rclpy_carries_the_same_values(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy")
    monkeypatch.setattr(stores, "SAMPLES", 2)
    bench = measured(1, "rclpy", "shm, sleeping")
    assert bench.cases["rclpy: one way"]["samples"] > 0
    assert ", 0 torn, " in bench.facts["rclpy"]
    assert "shm_one_way" in bench.ratios


def test_what_is_not_installed_is_skipped_with_a_note(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stores, "SAMPLES", 2)
    monkeypatch.setattr(stores, "find_spec", lambda module: None)
    bench = measured(1, "shm, sleeping", others=True)
    assert bench.facts["rclpy"].startswith("skipped: pip install 'unicon_ros[ros]', or source")
    assert bench.facts["zmq ipc"] == "skipped: pip install 'unicon_ros[zmq]'"
    assert set(bench.ratios) == {"publish"}
    assert "shm, sleeping: one way" in bench.cases


def test_it_is_a_bench_of_the_command_line() -> None:
    assert BENCHES["stores"] == "benchmarks.stores"
    assert group().layout.nbytes == 512


def test_a_torn_value_would_be_told(tmp_path: Path) -> None:
    """The reader's process finds a value whose parts are of two numbers."""

    states, log = group(), tmp_path / "0.npz"

    class Torn:
        closed = False

        def receive(self, timeout: float) -> bool:
            states.data[:] = 7.0
            states.data[100:] = 8.0
            states.number = 8
            return True

        def close(self) -> None:
            self.closed = True

    class Once:
        left = 3

        def __bool__(self) -> bool:
            self.left -= 1
            return self.left < 0

    receiver = Torn()
    stores._read(receiver, states, log, Once())  # type: ignore[arg-type]
    assert receiver.closed
    assert np.load(log)["torn"].tolist() == [1, 1, 1]
