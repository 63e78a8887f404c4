"""`unicon bench latency`: real processes over real DDS; only how figures are made is judged."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import pytest

from unicon_ros.bench.report import Bench
from unicon_ros.cli import bench as command
from unicon_ros.cli.main import main

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.alone]


@pytest.mark.slow
def test_plain_and_our_own_pipelines_close_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    from unicon_ros.bench import latency

    chosen = (
        "plain, two processes",
        "unicon, on state",
        "plain, wait set and take, typed",
        "plain, wait set and take, raw",
        "unicon, on joint states alone",
        "unicon, local, ROS a mirror",
        "plain, a mirror alone",
        "unicon, local, observed by us",
    )
    variants = tuple(variant for variant in latency.VARIANTS if variant.name in chosen)
    monkeypatch.setattr(latency, "VARIANTS", variants)
    monkeypatch.setenv("UNICON_UNITREE_SDK", "")
    result = latency.run(1, seconds=0.6)
    for name in chosen[:5]:
        for row in ("recv", "send", "state_to_command", "end_to_end"):
            case = result.cases[f"{name}: {row}"]
            assert case["samples"] >= 20
            assert 0.0 < case["p50"] < 1e6
        # A command cannot be at the robot before the controller has sent it.
        sent, arrived = (result.cases[f"{name}: {r}"]["p50"] for r in ("recv", "end_to_end"))
        assert sent < arrived
    for name in chosen[5:]:  # 300 on a machine that is not busy
        assert result.cases[f"{name}: mirror"]["samples"] >= 20
    assert "mirror, of that of a plain node that publishes nothing else" in result.facts
    strongest = {"strongest_typed", "strongest_raw", "strongest_cpu"}
    assert set(result.ratios) == {"end_to_end", "local", "mirror", "cpu", *strongest}
    assert all(ratio["value"] > 0.0 for ratio in result.ratios.values())
    assert result.facts["joints"] == 20
    assert result.facts["left out: SDK (sync), SDK (async)"]
    assert not [case for case in result.cases if "SDK" in case]


@pytest.mark.slow
def test_the_strongest_rows_alone_have_ratios_of_their_tails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "bench.json"
    given = ["--strongest", "--rounds", "2", "--seconds", "0.6", "--json", str(file)]
    assert main(["bench", "latency", *given]) == 0
    result = json.loads(file.read_text())
    names = {f"strongest_{name}" for name in ("raw", "cpu", "typed")}
    assert set(result["ratios"]) == names | {f"strongest_typed_p{n}" for n in (50, 95, 99)}
    for name in result["ratios"]:
        low, high = map(float, result["facts"][f"{name}, 95 % interval"].split(" to "))
        assert 0.0 < low <= high
    lost = [case["mean"] for name, case in result["cases"].items() if ": lost" in name]
    assert len(lost) == 5
    assert max(lost) < 5.0


def test_the_raw_plain_controller_answers_what_the_typed_one_does() -> None:
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import JointState

    from unicon_ros.bench.pipelines.waiting import raw_answer, typed_answer

    class Publisher:
        def __init__(self) -> None:
            self.publish = self.publish_raw = self.add
            self.sent: list[object] = []

        def add(self, message: object) -> None:
            self.sent.append(message)

    numbers = [0.1 * i for i in range(20)]
    names = [f"joint_{i}" for i in range(20)]
    state = JointState(name=names, position=numbers, velocity=numbers[::-1], effort=numbers)
    state.header.stamp.sec, state.header.stamp.nanosec = 12, 345
    publisher = Publisher()
    assert typed_answer(publisher, 20)(state) == 12_000_000_345
    assert raw_answer(publisher, 20)(bytes(serialize_message(state))) == 12_000_000_345
    typed, raw = publisher.sent
    assert deserialize_message(raw, JointState) == typed
    assert list(typed.position) == numbers  # type: ignore[attr-defined]


def test_each_pipeline_is_shipped_beside_the_bench() -> None:
    from unicon_ros.bench.latency import PIPELINES, STRONGEST, VARIANTS

    every = (*VARIANTS, *STRONGEST)
    sides = {side for each in every for side in (each.measuring, each.controller) if side}
    assert "fast_robot/observer" in sides
    assert not [side for side in sides if not find_spec(f"{PIPELINES}.{side.partition('/')[0]}")]


def test_turns_that_would_let_peers_take_each_other_for_dead_are_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["bench", "latency", "--seconds", "3"]) != 0
    told = capsys.readouterr().err
    assert "--seconds 3: with 16 variants in turn give more than 0 and at most" in told
    assert "raise --rounds" in told


@pytest.mark.parametrize("options", [[], ["--strongest"], ["--budget"]])
@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "1e9"])
def test_no_time_and_too_much_are_refused(
    options: list[str], seconds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "latency", *options, "--seconds", seconds]) == 1
    said = capsys.readouterr().err
    assert f"--seconds {float(seconds):g}: with " in said
    assert "give more than 0 and at most" in said


def test_ctrl_c_ends_it_with_a_result_and_no_process_left(tmp_path: Path) -> None:
    file = tmp_path / "bench.json"
    arguments = [sys.executable, "-m", "unicon_ros", "bench", "latency", "--json", str(file)]
    process = subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=dict(os.environ)
    )
    try:
        end = time.monotonic() + 40.0
        while len(children := _children(process.pid)) < 2 and time.monotonic() < end:
            time.sleep(0.1)
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 0, told
    assert "stopped; 0 whole rounds are kept" in told
    assert json.loads(file.read_text())["rounds"] == 0
    assert children
    assert not [pid for pid in children if Path(f"/proc/{pid}").exists()]


def _children(parent: int) -> list[int]:
    listing = Path(f"/proc/{parent}/task/{parent}/children")
    return [int(pid) for pid in listing.read_text().split()]


def test_assert_exits_1_where_a_ratio_misses_its_bar(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bench = Bench("made", seed=0, rounds=1)
    bench.case("a", [1.0, 2.0, 3.0])
    bench.ratio("kept", 0.1, 0.2)
    bench.ratio("missed", 0.3, 0.2)
    module = type(sys)("made_bench")
    module.run = lambda rounds=None, **options: bench  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "made_bench", module)
    monkeypatch.setitem(command.BENCHES, "tick", "made_bench")
    file = tmp_path / "b.json"
    assert main(["bench", "tick", "--json", str(file)]) == 0
    assert main(["bench", "tick", "--assert"]) == 1
    values = json.loads(file.read_text())
    assert set(values) >= {"bench", "machine", "versions", "seed", "rounds", "cases", "ratios"}
    assert values["ratios"]["missed"] == {
        "value": 0.3, "bar": 0.2, "holds": False, "claim": "at most"
    }  # fmt: skip
    assert "MISSED" in capsys.readouterr().out


def test_a_bench_that_is_not_shipped_says_where_it_runs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "CHECKOUT", tmp_path)
    monkeypatch.setitem(command.BENCHES, "tick", "nowhere.tick")
    assert main(["bench", "tick"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "bench tick: only `latency` is part of the installed package" in line
    assert "clone the repository" in line
