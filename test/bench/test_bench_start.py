"""`unicon bench start`: processes up to their first tick, beside what they must import."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")

from benchmarks import programs as start
from unicon_ros.cli.bench import BENCHES


@pytest.mark.parametrize("case", [start.BASE, start.RUN])
def test_a_process_is_so_old_and_bytecode_goes_where_it_is_told(case: str, tmp_path: Path) -> None:
    environment = start._environment(tmp_path)
    assert 0.0 < start._seconds(case, tmp_path, environment) < start.PATIENCE
    assert any((tmp_path / "bytecode").rglob("*.pyc"))


def test_a_process_that_fails_is_told(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"'unicon run nowhere' ended with 1: .*'nowhere'"):
        start._seconds("unicon run nowhere", tmp_path, start._environment(tmp_path))


def test_without_ros_the_rest_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(what: str) -> None:
        raise start.MissingDependencyError(what, "rclpy", "somehow")

    monkeypatch.setattr(start.compat, "import_rclpy", missing)
    monkeypatch.setattr(start, "_seconds", lambda case, *_: 0.2 if case == start.BASE else 0.3)
    result = start.run_start(rounds=2)
    assert list(result.ratios) == ["start"]
    assert result.ratios["start"]["value"] == pytest.approx(1.5)
    assert {case["samples"] for case in result.cases.values()} == {2}


def test_a_start_that_takes_too_long_misses_its_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(start.compat, "import_rclpy", lambda what: None)
    monkeypatch.setattr(start, "_seconds", lambda case, *_: {start.ROS: 0.7}.get(case, 0.2))
    result = start.run_start(rounds=1)
    assert result.ratios["start"]["holds"]
    assert not result.ratios["start_ros"]["holds"]


def test_the_command_knows_it() -> None:
    assert BENCHES["start"] == start.__name__
