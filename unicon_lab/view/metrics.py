"""Metrics: a run as figures for Prometheus, at http://127.0.0.1:PORT/metrics.

The format is Prometheus' text exposition format 0.0.4. Runs in the viewer's process. What each
metric is, and which states are metrics, stands in `metrics.yaml`.
"""

from __future__ import annotations

import errno
import threading
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import AnyMapping, UniconError
from unicon_base.arrays import Array, Float64
from unicon_base.located_yaml import read_yaml
from unicon_core import __version__
from unicon_lab.view.shown import Shown
from unicon_lab.view.source import Remote, Snapshot, Source

PATH = "/metrics"
KIND = "text/plain; version=0.0.4; charset=utf-8"

PATIENCE = 2.0
"""So long a client may be silent, in [s]."""

MOST = 256
"""Clients at once."""

BOUNDS = (
    *(25e-6, 50e-6, 100e-6, 250e-6, 500e-6, 1e-3, 2.5e-3, 5e-3, 10e-3, 20e-3, 50e-3, 100e-3),
    *(250e-3, 1.0),
)
"""Of the histograms, in [s]."""

# Labels and a value.
_Labelled = tuple[Mapping[str, str], Any]

_TABLE: AnyMapping = read_yaml(Path(__file__).with_name("metrics.yaml")).value


class Metrics:
    """The sink of `--metrics`: counts every tick, and answers every request.

    Args:
        shown: the run.
        source: of its ticks.
        remote: not used: nobody drives from here.
        options: `port`; `written`: the states that somebody tells.

    Raises:
        UniconError: the port cannot be had.
    """

    def __init__(self, shown: Shown, source: Source, remote: Remote, options: AnyMapping) -> None:
        self._shown, self._source, self._written = shown, source, set(options["written"])
        self._server = _Server(int(options["port"]), self._page)
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}{PATH}"
        self._busy, self._late = _Histogram(), _Histogram()
        self._handle = self._unseen = 0
        self._largest: Float64 | None = None
        self._text: tuple[object, bytes] = (None, b"")

    def poll(self) -> None:
        """Count the new ticks."""
        with self._server.lock:
            for tick in self._source.since(self._handle):
                self._unseen += tick.handle - self._handle - 1
                self._handle = tick.handle
                self._count(tick)

    def _count(self, tick: Snapshot) -> None:
        if tick.busy_ns:  # they are of the tick before; the first has none
            self._busy.add(tick.busy_ns * 1e-9)
            self._late.add(max(tick.late_ns, 0) * 1e-9)
        if "joint_effort" in self._written:
            effort = np.abs(tick.states["joint_effort"], dtype=np.float64)
            self._largest = effort if self._largest is None else np.fmax(self._largest, effort)

    def close(self) -> None:
        """Let the port go."""
        self._server.shutdown()
        self._server.server_close()

    # -- what is told ---------------------------------------------------------------------------

    def _page(self) -> bytes:
        """Return the figures; of a flood of requests all get the same."""
        texts = self._source.texts
        key = (self._handle, len(texts["faults"]), texts.get("counts"))
        if self._text[0] != key or not self._handle:
            self._text = key, "".join(self._lines()).encode()
        return self._text[1]

    def _lines(self) -> Iterator[str]:
        shown, texts, tick = self._shown, self._source.texts, self._source.latest()
        about = {
            "workflow": shown.workflow,
            "robot": shown.robot.name,
            "platform": shown.platform,
            "version": __version__,
        }
        yield from _metric("run_info", [(about, 1)])
        yield from _singles(tick_period_seconds=shown.period, faults=len(texts["faults"]))
        for key in ("published", "received"):
            if counts := texts.get("counts", {}).get(key):
                yield from _metric(f"ros_messages_{key}_total", _each("topic", *zip(*counts)))
        if tick is None:
            return
        at = [int(number == tick.phase) for number in range(len(shown.phases))]
        yield from _metric("phase", _each("phase", shown.phases, at))
        yield from _singles(
            last_tick_timestamp_seconds=tick.wall_ns * 1e-9,
            ticks_total=self._handle,
            overruns_total=tick.overruns,
            ticks_unseen_total=self._unseen,
        )
        yield from self._busy.lines("tick_busy_seconds")
        yield from self._late.lines("tick_lateness_seconds")
        yield from self._of_states(tick.states)

    def _of_states(self, states: Mapping[str, Array]) -> Iterator[str]:
        robot = self._shown.robot
        joints = robot.joint_names
        for name, (state, *axes) in _TABLE["states"].items():
            if state not in states or state not in self._written:
                continue
            values = states[state].reshape(-1)
            if axes:
                told = _each("axis", "xyz"[slice(*axes)], values[slice(*axes)])
            elif values.size == len(joints) and values.size > 1:
                told = _each("joint", joints, values)
            else:
                told = [({}, x) for x in values[:1]]
            yield from _metric(name, told)
        if "projected_gravity" in self._written:
            upright = float(np.clip(-states["projected_gravity"].reshape(-1)[2], -1.0, 1.0))
            yield from _singles(base_tilt_radians=np.arccos(upright))
        if self._largest is not None:
            largest, limits = (
                _each("joint", joints, each) for each in (self._largest, robot.effort_limit)
            )
            yield from _metric("joint_torque_largest_newton_meters", largest)
            limits = [(joint, x) for joint, x in limits if np.isfinite(x)]
            yield from _metric("joint_torque_limit_newton_meters", limits)


class _Server(ThreadingHTTPServer):
    """Python's own, on loopback, with a thread for each client; it serves from the beginning."""

    daemon_threads = True

    def __init__(self, port: int, page: Callable[[], bytes]) -> None:
        self.page, self.lock = page, threading.Lock()
        self._room = threading.BoundedSemaphore(MOST)
        try:
            super().__init__(("127.0.0.1", port), _Answer)
        except (OSError, OverflowError) as error:
            taken = getattr(error, "errno", 0) == errno.EADDRINUSE
            why = "is taken by another process" if taken else f"cannot be used: {error}"
            raise UniconError(
                f"--metrics: port {port} {why}; give another one, or 0 for any that is free"
            ) from error
        threading.Thread(target=self.serve_forever, name="metrics", daemon=True).start()

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        if self._room.acquire(blocking=False):
            with suppress(OSError):
                super().process_request_thread(request, client_address)
            self._room.release()
        else:
            self.shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Nobody is told of a client that has gone."""


class _Answer(BaseHTTPRequestHandler):
    """One client of `_Server`."""

    timeout = PATIENCE
    server: _Server

    def do_GET(self) -> None:
        self._tell(whole=True)

    def do_HEAD(self) -> None:
        self._tell(whole=False)

    def _tell(self, *, whole: bool) -> None:
        if self.path.split("?", 1)[0] != PATH:
            self.send_error(404, explain=f"there is {PATH}")
            return
        with self.server.lock:
            page = self.server.page()
        self.send_response(200)
        self.send_header("Content-Type", KIND)
        self.send_header("Content-Length", str(len(page)))
        self.end_headers()
        if whole:
            self.wfile.write(page)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing is logged."""


class _Histogram:
    def __init__(self) -> None:
        self._counts, self._sum = [0] * (len(BOUNDS) + 1), 0.0

    def add(self, value: float) -> None:
        self._counts[bisect_left(BOUNDS, value)] += 1
        self._sum += value

    def lines(self, name: str) -> Iterator[str]:
        yield _head(name, "histogram")
        below = 0
        for bound, count in zip((*BOUNDS, float("inf")), self._counts):
            below += count
            yield f'unicon_{name}_bucket{{le="{_number(bound)}"}} {below}\n'
        yield f"unicon_{name}_sum {_number(self._sum)}\n"
        yield f"unicon_{name}_count {below}\n"


def _head(name: str, kind: str) -> str:
    return f"# HELP unicon_{name} {_TABLE['help'][name]}\n# TYPE unicon_{name} {kind}\n"


def _each(label: str, names: Iterable[str], values: Iterable[Any]) -> list[_Labelled]:
    """Return values, each with a label."""
    return [({label: name}, value) for name, value in zip(names, values)]


def _metric(name: str, told: Iterable[_Labelled]) -> Iterator[str]:
    """Yield the lines of a metric: one whose name ends in `_total` is a counter, others gauges."""
    yield _head(name, "counter" if name.endswith("_total") else "gauge")
    for labels, value in told:
        inside = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
        yield f"unicon_{name}{f'{{{inside}}}' if inside else ''} {_number(value)}\n"


def _singles(**values: Any) -> Iterator[str]:
    """Yield the lines of metrics of one number each, by their names."""
    for name, value in values.items():
        yield from _metric(name, [({}, value)])


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")


def _number(value: Any) -> str:
    if isinstance(value, int):
        return str(value)
    text = repr(float(value))
    return {"nan": "NaN", "inf": "+Inf", "-inf": "-Inf"}.get(text, text)
