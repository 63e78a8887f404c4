"""`unicon run --metrics PORT`: figures that Prometheus reads, for any client and any request."""

from __future__ import annotations

import ast
import os
import re
import signal
import socket
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_core import __version__
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.workflow import Program, load_document
from unicon_lab.view.metered import Metered
from unicon_lab.view.metrics import _TABLE, BOUNDS, _escaped, _number
from unicon_ros.cli.main import main

RATE = 200.0


class Metering:
    """A run of the fake platform in a thread, with its figures served."""

    def __init__(self, folder: Path) -> None:
        file = folder / "metered.yaml"
        file.write_text(
            'schema: unicon.workflow/1\nname: "walk \\"a\\\\b"\nrobot: go2\nplatform: fake\n'
            f"rate: {RATE}\ncommands: [{{velocity_command: {{constant: [0.3, 0.1, -0.2]}}}}]\n"
            "flow: hold\n"
        )
        self.lines = list[str]()
        self.metered = Metered(0, warn=self.lines.append)
        self.program = Program(load_document(file), hooks=[self.metered.hook])
        self.runner = Runner(self.program, RunOptions(duration=60.0, warn=self.lines.append))
        self.metered.attach(self.runner)
        self.port = int(self.metered.address.rsplit(":", 1)[1].split("/")[0])
        self.report: Report | None = None
        self.thread = threading.Thread(target=self._run)
        self.thread.start()

    def _run(self) -> None:
        self.report = self.runner.run()
        self.metered.close()

    def text(self) -> str:
        with urllib.request.urlopen(self.metered.address, timeout=20.0) as answer:
            assert answer.headers["Content-Type"] == "text/plain; version=0.0.4; charset=utf-8"
            return str(answer.read().decode())

    def figures(self) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
        parser = pytest.importorskip(
            "prometheus_client.parser", reason="pip install prometheus_client"
        )
        found = {}
        for family in parser.text_string_to_metric_families(self.text()):
            assert family.documentation
            for sample in family.samples:
                found[sample.name, tuple(sample.labels.items())] = sample.value
        return found

    def value(self, name: str, **labels: str) -> float:
        return self.figures()[f"unicon_{name}", tuple(labels.items())]

    @property
    def process(self) -> int:
        assert self.metered._peripheral is not None
        return self.metered._peripheral.process.pid

    def end(self) -> Report:
        self.runner.stop()
        self.thread.join(10.0)
        assert self.report is not None
        return self.report


@pytest.fixture(scope="module")
def metering(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Metering]:
    made = Metering(tmp_path_factory.mktemp("metering"))
    yield made
    report = made.end()
    assert report.faults == []
    with pytest.raises(OSError):
        made.text()  # nobody answers any more


def test_prometheus_reads_what_the_run_does(metering: Metering) -> None:
    end = time.monotonic() + 30.0
    while metering.value("ticks_total") < 21 and time.monotonic() < end:
        time.sleep(0.1)
    found = metering.figures()
    names = {name for name, _ in found}
    about = {"workflow": 'walk "a\\b', "robot": "go2", "platform": "fake"}
    about |= {"version": __version__}
    assert found["unicon_run_info", tuple(about.items())] == 1
    ticks = found["unicon_ticks_total", ()]
    assert ticks > 20
    assert found["unicon_tick_period_seconds", ()] == 1 / RATE
    assert found["unicon_phase", (("phase", "run"),)] == 1
    assert sum(found["unicon_phase", (("phase", p),)] for p in ("wait", "run", "damp", "off")) == 1
    assert found["unicon_faults", ()] == 0
    unseen = found["unicon_ticks_unseen_total", ()]  # none, but on a machine that stood still
    for name in ("tick_busy_seconds", "tick_lateness_seconds"):
        buckets = [
            found[f"unicon_{name}_bucket", (("le", _number(b)),)] for b in (*BOUNDS, float("inf"))
        ]
        assert buckets == sorted(buckets)
        assert buckets[-1] == found[f"unicon_{name}_count", ()]
        assert 0 <= ticks - unseen - buckets[-1] <= 1  # a tick is counted by the one behind it
    assert 0.0 < found["unicon_tick_busy_seconds_sum", ()] < 10.0
    command = [found["unicon_velocity_command_meters_per_second", (("axis", a),)] for a in "xy"]
    assert command == pytest.approx([0.3, 0.1])
    assert found["unicon_turn_command_radians_per_second", (("axis", "z"),)] == pytest.approx(-0.2)
    joints = metering.program.robot.joint_names
    for k, joint in enumerate(joints):
        at = found["unicon_joint_position_radians", (("joint", joint),)]
        assert at == pytest.approx(float(metering.program.states["joint_pos"][k]), abs=1e-4)
    assert abs(found["unicon_last_tick_timestamp_seconds", ()] - time.time()) < 10.0
    assert not any("temperature" in name or "battery" in name for name in names)  # nobody tells
    time.sleep(0.2)
    assert metering.value("ticks_total") > ticks


def test_other_paths_and_methods_are_refused(metering: Metering) -> None:
    def asked(text: bytes) -> bytes:
        with socket.create_connection(("127.0.0.1", metering.port), timeout=5.0) as client:
            client.sendall(text)
            parts = []
            while part := client.recv(1 << 16):
                parts.append(part)
            return b"".join(parts)

    assert b"404" in asked(b"GET / HTTP/1.1\r\n\r\n").splitlines()[0]
    assert b"there is /metrics" in asked(b"GET /../etc/passwd HTTP/1.1\r\n\r\n")
    assert b"501" in asked(b"POST /metrics HTTP/1.1\r\nContent-Length: 0\r\n\r\n").splitlines()[0]
    assert b"400" in asked(b"\x00\xff garbage\r\n\r\n")
    assert (
        b"431" in asked(b"GET /metrics HTTP/1.1\r\n" + b"x" * 70_000 + b"\r\n\r\n").splitlines()[0]
    )
    head = asked(b"HEAD /metrics?x=1 HTTP/1.1\r\n\r\n")
    assert b"200 OK" in head
    assert head.endswith(b"\r\n\r\n")
    assert asked(b"GET /metrics HTTP/1.0\r\n\r\n").count(b"# TYPE") > 10


@pytest.mark.slow
def test_slow_and_silent_clients_cost_nobody_an_answer(metering: Metering) -> None:
    stalled = [socket.create_connection(("127.0.0.1", metering.port)) for _ in range(60)]
    try:
        for number, client in enumerate(stalled):
            if number % 2:
                client.sendall(b"GET /metr")
        begin = time.monotonic()
        assert metering.value("ticks_total") > 0
        assert time.monotonic() - begin < 1.0
        time.sleep(2.5)  # they are let go meanwhile
        closed = 0
        for client in stalled:
            client.settimeout(1.0)
            try:
                closed += client.recv(10) == b""
            except ConnectionResetError:
                closed += 1
        assert closed == len(stalled)
    finally:
        for client in stalled:
            client.close()


def test_a_taken_port_is_an_error_before_the_run(
    metering: Metering, capsys: pytest.CaptureFixture[str]
) -> None:
    run = ["run", "go2_stand", "--set", "platform=fake", "--no-ros", "--duration", "0.1"]
    assert main([*run, "--metrics", str(metering.port)]) == 1
    assert capsys.readouterr().err.strip() == (
        f"unicon: error: --metrics: port {metering.port} is taken by another process; give another "
        "one, or 0 for any that is free"
    )
    with pytest.raises(SystemExit):
        main([*run, "--metrics", "70000"])
    assert "70000 is not a port" in capsys.readouterr().err


@pytest.mark.slow
def test_a_killed_process_comes_back_at_the_same_port(metering: Metering) -> None:
    ticks = metering.value("ticks_total")
    os.kill(metering.process, signal.SIGKILL)
    end = time.monotonic() + 10.0
    while True:
        try:
            again = metering.value("ticks_total")
            break
        except (urllib.error.URLError, OSError):
            assert time.monotonic() < end
            time.sleep(0.1)
    assert again > ticks  # counted by the run, not by who tells it
    assert any("metrics: its process" in line and "SIGKILL" in line for line in metering.lines)


def test_labels_and_numbers_are_written_as_the_format_wants() -> None:
    assert _escaped('a"b\\c\nd') == 'a\\"b\\\\c\\nd'
    values: list[Any] = [1, 0.5, np.float32(0.25), np.nan, np.inf, -np.inf, np.int64(3)]
    assert [_number(v) for v in values] == ["1", "0.5", "0.25", "NaN", "+Inf", "-Inf", "3.0"]


def test_the_table_of_the_documentation_names_what_there_is() -> None:
    root = Path(__file__).resolve().parents[2]
    section = (root / "docs" / "howto" / "reports.md").read_text("utf-8").split("## Metrics")[1]
    rows = [line for line in section.splitlines() if line.startswith("| `")]
    named = {name for row in rows for name in re.findall(r"`([a-z_]+)", row.split("|")[1])}
    code = (root / "unicon_lab" / "view" / "metrics.py").read_text("utf-8")
    made = set(_TABLE["states"])
    for call in (node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Call)):
        name = getattr(call.func, "id", getattr(call.func, "attr", ""))
        if name == "_singles":
            made |= {str(keyword.arg) for keyword in call.keywords}
        elif name in ("_metric", "lines"):
            made |= {each.value for each in call.args if isinstance(each, ast.Constant)}
    made |= {f"ros_messages_{way}_total" for way in ("published", "received")}
    assert named == made == set(_TABLE["help"])
