"""Page: a run in the browser, for everybody who looks; made of viser, in a process of its own."""

from __future__ import annotations

import logging
import math
import threading
import time
import warnings
from collections import deque
from html import escape
from typing import Any

import numpy as np

from unicon_base import AnyDict, AnyMapping, UniconError, imported
from unicon_lab.view import PORT
from unicon_lab.view.page.plots import PLOTTED, TIMING, History, table
from unicon_lab.view.shown import Shown
from unicon_lab.view.source import Remote, Snapshot, Source, Wheel
from unicon_ros.web_front import check_reach, listening, netloc, refusal

_RATE = 2.0  # [s] over which ticks are counted
MOST = 16
"""Viewers at once."""


class Page:
    """Sink `page`.

    Args:
        shown: the run.
        source: its ticks; one with `span` and `seek(t)` is a recording.
        remote: what goes back.
        options: `host`, `port`, `token`, `fps`.

    Attributes:
        address: where it is seen.

    Raises:
        MissingDependencyError: viser is not installed.
        UniconError: it may not or cannot be served there.
    """

    def __init__(self, shown: Shown, source: Source, remote: Remote, options: AnyMapping) -> None:
        rich, viser = (imported(name, "--view", "view") for name in ("rich", "viser"))
        from unicon_lab.view.page import viewer
        from unicon_lab.view.page.scene import Stage

        host, token = str(options.get("host", "127.0.0.1")), str(options.get("token", ""))
        check_reach(host, token)
        self._shown, self._source, self._remote, self._token = shown, source, remote, token
        self._fps, self._link = float(options.get("fps", 30.0)), viewer
        self._history = History(shown.layout, shown.period)
        self._wheel = Wheel(remote, shown.command_bounds, bool(shown.bodies))
        self._note, self._pages = "", 0
        self._stage: Stage | None = None
        try:
            if shown.model is None:
                self._note = "the robot names no model: it is not drawn"
            else:
                self._stage = Stage(shown)
        except UniconError as error:
            self._note = f"the robot is not drawn: {error}"
        self._viewers: dict[int, Any] = {}
        self._came: deque[Any] = deque()
        self._lock = threading.Lock()
        self._gone: deque[int] = deque()
        self._handle = self._drawn = -1
        self._seen, self._ticks = time.monotonic(), deque[tuple[float, int]]()
        self._plays, self._speed, self._time, self._sought = True, 1.0, 0.0, -1.0
        self._played = time.monotonic()
        warnings.filterwarnings("ignore", "Queued a")  # viser's, of a page that has just gone
        rich.reconfigure(quiet=True)  # viser would print where it is served
        logging.getLogger("websockets").setLevel(logging.CRITICAL)
        with listening(host, int(options.get("port", PORT))) as free:
            port = free.getsockname()[1]  # viser waits for ever where there is none
        self._server = viser.ViserServer(host, port, verbose=False)
        viewer.close_doors(self._server)
        viewer.guard(self._server, self._refused)
        self._server.on_client_connect(self._came.append)
        self._server.on_client_disconnect(lambda client: self._gone.append(client.client_id))
        place = netloc(host, self._server.get_port())
        self.address = f"http://{place}"
        if token:
            self.address += f"/?websocket=ws://{place}/{token}"

    # -- the thread that polls ------------------------------------------------------------------

    def poll(self) -> None:
        """Show what is new; called about 60 times a second, always in the same thread."""
        now = time.monotonic()
        self._greet()
        if len(self._viewers) != self._pages:
            self._pages = len(self._viewers)
            self._remote.pages(self._pages)
        if self._source.span is not None:
            self._play(now)
        self._wheel.look(now)
        tick = self._source.latest()
        if tick is not None and tick.handle != self._handle:
            self._take(tick.handle, now)
            if self._ticks and tick.tick < self._ticks[-1][1]:  # it went back
                self._ticks.clear()
            self._ticks.append((now, tick.tick))
            self._seen = now
        while self._ticks and now - self._ticks[0][0] > _RATE:
            self._ticks.popleft()
        self._answer()
        if not self._viewers:
            return
        new = tick is not None and tick.handle != self._drawn
        pose = None
        if tick is not None and self._stage is not None:
            pose = self._stage.put(tick.tick, tick.states)
        for number, viewer in list(self._viewers.items()):
            viewer.ended = bool(self._source.texts.get("ended"))
            try:
                viewer.show(pose, tick, self._status, new or viewer.pictures == 0, now)
            except Exception as error:  # whatever one widget was told, the others look on
                self._drop(number, error)
        self._drawn = self._handle

    def close(self) -> None:
        """Close the server; safe to call twice."""
        self._server.stop()

    def _greet(self) -> None:
        """Let browsers in that have come, and forget those that went."""
        from unicon_lab.view.page.viewer import Viewer

        while self._came:
            client = self._came.popleft()
            if self._refused(client):  # or has gone already
                continue
            try:
                self._viewers[client.client_id] = Viewer(
                    client,
                    self._shown,
                    self._history,
                    self._stage,
                    self._remote,
                    self._wheel,
                    self._recorded if self._source.span is not None else None,
                    self._source.span,
                    self._fps,
                )
            except Exception as error:  # whatever a browser says of itself, the others look on
                self._drop(client.client_id, error)
        while self._gone:
            viewer = self._viewers.pop(self._gone.popleft(), None)
            if viewer is not None:
                viewer.gone()

    def _drop(self, number: int, error: Exception) -> None:
        """Let a browser go that cannot be served."""
        self._note = f"a browser was let go: {error!r}"
        self._link.drop(self._server, number)
        self._gone.append(number)

    def _refused(self, client: Any) -> str:
        """Return why a browser may not look."""
        headers, path = self._link.opened(self._server, client)
        if len(self._viewers) >= MOST:
            return f"{MOST} viewers look already"
        return refusal(headers, path, self._token)

    def _take(self, handle: int, now: float) -> None:
        """Take the ticks that have come into the history."""
        if handle < self._handle:
            self._history.clear()
            self._handle = max(handle - round(PLOTTED / self._shown.period), 0)
        for tick in self._source.since(self._handle):
            self._history.take(tick)
        self._handle = handle

    def _answer(self) -> None:
        """Give each answer to the page that asked."""
        answers = self._source.answers
        while answers:
            answered = answers.pop(0)
            for viewer in self._viewers.values():
                if answered.number in viewer.acts:
                    viewer.acts.discard(answered.number)
                    viewer.tell(answered.text, answered.done)

    def _status(self, tick: Snapshot | None, driver: str) -> tuple[str, str, bool]:
        """Return how the run is, with who drives in words; see `status_html`."""
        if tick is None:
            return table({"phase": "no tick yet"}), "no tick yet", False
        rate = 0.0
        if self._ticks:  # of late
            (first, one), (last, other) = self._ticks[0], self._ticks[-1]
            rate = (other - one) / (last - first) if last > first else 0.0
        stale = 0.0 if self._source.span else time.monotonic() - self._seen
        texts = dict(self._source.texts)
        if self._note:
            texts["notes"] = [*texts.get("notes", ()), self._note]
        return status_html(self._shown, tick, self._history, rate, texts, driver, stale)

    # -- recordings -----------------------------------------------------------------------------

    def _play(self, now: float) -> None:
        """Move on in a recording, which has one time for all who look."""
        assert self._source.span is not None
        (first, last), elapsed = self._source.span, now - self._played
        self._played = now
        with self._lock:
            if self._plays and self._viewers:  # it does not begin before somebody looks
                self._time = min(self._time + self._speed * elapsed, last)
                self._plays = self._time < last
            wanted = self._time = max(self._time, first)
            plays = self._plays
        if wanted != self._sought:
            self._sought = wanted
            self._source.seek(wanted)  # type: ignore[attr-defined]
        for viewer in self._viewers.values():
            viewer.panel.show_time(wanted, plays)

    def _recorded(self, what: str, *given: Any) -> None:
        """Take what a viewer does to a recording; in the server's thread."""
        assert self._source.span is not None
        with self._lock:
            if what == "seek" and math.isfinite(given[0]):
                self._time = float(given[0])
            elif what == "speed":
                self._speed = float(given[0])
            elif what == "play":
                self._plays = not self._plays
                if self._time >= self._source.span[1]:
                    self._time = self._source.span[0]


def status_html(
    shown: Shown,
    tick: Snapshot,
    history: History,
    rate: float,
    texts: AnyDict,
    driver: str,
    stale: float,
) -> tuple[str, str, bool]:
    """Return how the run is: phase, timing against the deadline, faults, gates, who drives.

    As HTML, in a few words for the place beside the e-stop, and whether something is wrong.

    Args:
        shown: the run.
        tick: its newest one.
        history: of late.
        rate: ticks a second as they come.
        texts: of the source; `timed` False where nobody has timed its ticks.
        driver: who drives, in words.
        stale: time since the newest tick came, in [s].
    """
    _, rows = history.last(2.0)
    late, busy = (rows[:, history.columns[name].start] for name in TIMING)
    phase = shown.phases[tick.phase] if tick.phase < len(shown.phases) else str(tick.phase)
    brief = phase + (", paused" if tick.paused else "")
    found = {"phase": f"<b>{escape(phase)}</b>{brief.removeprefix(phase)}"}
    faults, silent = list(map(str, texts.get("faults", ()))), stale > 1.0 and not tick.paused
    if ended := str(texts.get("ended", "")):
        silent, brief = False, f"ended: {ended}"
        found["phase"] = f"<b>{escape(brief)}</b>"
    if silent:
        silence = f"no tick for {stale:.0f} s"
        found["phase"] += f" {_red(silence)}"
        brief += f": {silence}"
    brief += f"\n{tick.tick * shown.period:.1f} s"
    if texts.get("waits_for"):
        brief += f"\nwaits for {texts['waits_for']}"
        found["waits for"] = f'<b style="color:#e8590c">{escape(texts["waits_for"])}</b>'
    if "skill" in tick.states and shown.skills:
        number = int(tick.states["skill"].reshape(-1)[0])
        name = shown.skills[number] if 0 <= number < len(shown.skills) else "none"
        found["skill"] = f"<b>{escape(name)}</b>"
    found["tick"] = f"{tick.tick} · {tick.tick * shown.period:.1f} s"
    if texts.get("timed", True):
        brief += f" · {rate:.0f} Hz"
        found["rate"] = f"{rate:.1f} Hz, wanted {1.0 / shown.period:.1f} Hz"
        if len(rows):
            deadline = shown.period * 1e3
            p50, p99 = np.percentile(busy, (50, 99))
            share = f"{100.0 * p99 / deadline:.0f} % of the deadline of {deadline:g} ms"
            found["busy"] = f"p50 {p50:.2f} ms, p99 {p99:.2f} ms: {share}"
            found["late"] = f"p99 {np.percentile(late, 99):.2f} ms, max {late.max():.2f} ms"
        overruns = f"{tick.overruns}"
        found["overruns"] = _red(overruns) if tick.overruns else overruns
    if driver:
        found["driver"] = escape(driver)
    if faults:
        brief = f"ended: {faults[0]}" if ended else faults[0]
        found["fault"] = "<br>".join(map(_red, faults))
    if notes := texts.get("notes"):
        found["notes"] = "<br>".join(escape(str(note)) for note in notes[-3:])
    return table(found), brief, bool(faults) or silent


def _red(text: str) -> str:
    return f'<span style="color:#e03131;font-weight:600">{escape(text)}</span>'
