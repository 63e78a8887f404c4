"""Viewer: one browser: its view, its widgets, and how many pictures it can take."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.resources import files
from typing import Any

import numpy as np
from viser import _messages

from unicon_base import AnyDict
from unicon_lab.view.page.panel import PANEL, Panel, graph_html
from unicon_lab.view.page.plots import History
from unicon_lab.view.page.scene import Pose, Scene, Stage, aim
from unicon_lab.view.shown import Shown
from unicon_lab.view.source import Remote, Snapshot, Wheel

KEY = "unicon"
"""Of the storage; nothing is kept there."""

_TEXT = 1000  # characters of a heartbeat: a gamepad's name is the longest part
_LONGEST = 0.15  # [s] that one picture counts: the first is the whole scene


def _connection(server: Any, number: int) -> Any:
    """Return the websocket of a client by its number, None where it has gone."""
    return server._websock_server._live_connections.get(number)


def opened(server: Any, client: Any) -> tuple[Mapping[str, str], str]:
    """Return headers and path of the request that opened a client's websocket."""
    request = getattr(_connection(server, client.client_id), "request", None)
    return ({}, "") if request is None else (request.headers, request.path)


def drop(server: Any, number: int) -> None:
    """Close the websocket of a client, by its number."""
    if connection := _connection(server, number):
        asyncio.run_coroutine_threadsafe(connection.close(1008, "refused"), server.get_event_loop())


def guard(server: Any, refused: Callable[[Any], str]) -> None:
    """Let a server close each websocket at its opening that is refused.

    Args:
        server: viser's.
        refused: is given a connection with `client_id`; returns why not, "" to let it in.
    """

    async def look(connection: Any) -> None:
        if refused(connection):
            await _connection(server, connection.client_id).close(1008, "refused")

    server._websock_server.on_client_connect(look)


def close_doors(server: Any) -> None:
    """Take from a server what would ask a foreign host: its share button's tunnel."""
    for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(message)


Status = Callable[[Snapshot | None, str], tuple[str, str, bool]]


class PageConnection:
    """The line to one page.

    viser has no heartbeat, no gamepad, no origin check and no token. What is used of its internals
    stands in this module, and setup.py holds its version. A page answers the question for one key
    of the browser's storage as soon as it has handled all that was sent before it: that
    acknowledges a picture. Our script in the page (`script.js`) reports 10 times a second that it
    lives, and at once what gamepad and keys do: as the text of a hidden widget.

    Args:
        client: viser's handle.
        heard: is given what the page tells of itself, in another thread.
        stop, live: viser's buttons behind the large one, and behind that which leads from the past
            to the present; None in a recording.

    Attributes:
        asked, answered: pictures sent, and those that the page has handled.
        takes: how long it takes of late to have one handled, in [s].
    """

    def __init__(self, client: Any, heard: Callable[[AnyDict], None], stop: Any, live: Any) -> None:
        self._connection = client._websock_connection
        self.asked = self.answered = 0
        self.takes = self._sent = 0.0
        self._connection.register_handler(
            _messages.LocalStorageGetItemResponseMessage, self._answer
        )
        beat = client.gui.add_text("heartbeat", "", visible=False)

        @beat.on_update
        async def _(_: Any) -> None:
            state = state_of(beat.value)
            if state is not None:
                heard(state)

        uuids = {"stop": stop, "live": live, "beat": beat}
        uuids = {name: each and each._impl.uuid for name, each in uuids.items()}
        script = files(__package__).joinpath("script.js").read_text("utf-8")
        self._execute(f"const given = {json.dumps(uuids)};\n{script}")

    def brief(self, said: list[Any]) -> None:
        """Show the run beside the e-stop: in words, whether badly, whether ended, how long ago."""
        self._execute(f"uniconPage.brief(...{json.dumps(said)})")

    def _execute(self, source: str) -> None:
        self._connection.queue_message(_messages.RunJavascriptMessage(source=source))

    @property
    def pending(self) -> int:
        """Pictures that the page has not handled yet."""
        return self.asked - self.answered

    def ask(self) -> None:
        """Ask the page to answer when it has handled all that was sent so far."""
        self.asked += 1
        self._sent = time.monotonic()
        self._connection.queue_message(
            _messages.LocalStorageGetItemRequestMessage(key=KEY, request_uuid=str(self.asked))
        )

    def _answer(self, _: int, message: Any) -> None:
        with suppress(ValueError):
            number = int(message.request_uuid)
            if self.answered < number <= self.asked:
                self.answered = number
                took = min(time.monotonic() - self._sent, _LONGEST)
                self.takes += 0.4 * (took - self.takes)


def state_of(text: str) -> AnyDict | None:
    """Return what a heartbeat tells, None for garbage.

    Args:
        text: a number, a blank, and a JSON object: `hidden`, `stops` (presses of the e-stop),
            `dark` (of the system), `pad` (name) and `device`, three numbers from -1 to 1 for vx, vy
            and wz.
    """
    if len(text) > _TEXT:
        return None
    try:
        state = json.loads(text.partition(" ")[2])
    except ValueError:
        return None
    return state if isinstance(state, dict) else None


# Between two of them, in [s]; of the charts one at a time.
_TEXTS, _CHARTS, _PATH, _BRIEF = 0.25, 0.1, 0.2, 0.5

_STILL = (0.0, 0.0, 0.0)

# A page that needs longer for a picture, in [s], has as long to itself before the next one: its
# buttons and its heartbeat come first. One picture is on its way at most, so that none is late.
_QUICK = 0.06


class Viewer:
    """One browser.

    Args:
        client: viser's handle.
        shown, history, stage: the run; `stage` None where there is no model.
        remote, wheel: how it acts.
        recorded: takes `seek`, `play` and `speed` of a recording; None of a live run.
        span: first and last moment of a recording in [s].
        fps: pictures a second at most.

    Attributes:
        number: by which the others know it, from 1 on.
        acts: numbers of its acts that have no answer yet.
        pictures: sent so far.
        ended: the run has ended.
        past: time that is shown in place of the present in [s]; None for the present.
    """

    def __init__(
        self,
        client: Any,
        shown: Shown,
        history: History,
        stage: Stage | None,
        remote: Remote,
        wheel: Wheel,
        recorded: Any,
        span: tuple[float, float] | None,
        fps: float,
    ) -> None:
        self.number, self._client, self._shown = client.client_id + 1, client, shown
        self._remote, self._wheel, self._recorded = remote, wheel, recorded
        self._interval = 1.0 / fps
        self.acts, self.pictures, self._stops = set[int](), 0, 0
        self._device = list(_STILL)
        self._said, self._dark, self._grips, self._stage = "", False, False, stage
        self._held, self._brief, self.ended = list[Any](), list[Any](), False
        self._drawn, self._history = np.inf, history
        self.past: float | None = None
        self._due, self._chart = dict[str, float](), 0
        self._aimed = client.camera.position
        with client.atomic():
            self._aim(PANEL)
            self._scene = Scene(client.scene, stage)
            self.panel = Panel(client, shown, history, self._scene, self._do, span)
            self.link = PageConnection(client, self._heard, self.panel.stop, self.panel.live)
            self.link.ask()

    def show(
        self, pose: Pose | None, tick: Snapshot | None, status: Status, new: bool, now: float
    ) -> None:
        """Send a picture where one is due and the page has room for it.

        Args:
            pose: of the tick; None without a model.
            tick: the newest; None before the first.
            status: of a tick and who drives, in words: see `status_html`.
            new: the tick has not been shown before.
            now: time in [s].
        """
        if self.link.pending:
            return
        states, moment = tick.states if tick is not None else {}, np.inf
        if tick is not None and (past := self.past) is not None:  # of the server's thread
            moment, states = self._history.at(past)
            pose = None if self._stage is None else self._stage.past(states)
        new = new or moment != self._drawn or self._is_due("still", _TEXTS, now)
        slow = 2.0 * self.link.takes if self.link.takes > _QUICK else 0.0
        if not new or not self._is_due("picture", max(self._interval, slow), now):
            return
        self._drawn = moment
        with self._client.atomic():
            if pose is not None:
                self._scene.draw(pose, states, self._is_due("path", _PATH, now))
                self.pictures += 1
            if self._is_due("texts", _TEXTS, now):
                self._texts(tick, status)
            seen = tick is not None and self.panel.plots.visible
            if seen and self._is_due("chart", _CHARTS, now):
                charts, self._chart = self.panel.charts, self._chart + 1  # one after the other
                charts[self._chart % len(charts)].refresh(self.panel.window.value, moment)
            self.link.ask()
        self._client.flush()

    def tell(self, text: str, done: bool = True) -> None:
        """Show a line for a few seconds."""
        self._client.add_notification(
            "unicon", text, auto_close_seconds=6.0, color="green" if done else "red"
        )

    def gone(self) -> None:
        """Note that the browser is not there any more."""
        self._wheel.lose(self.number, "was closed")

    def _texts(self, tick: Snapshot | None, status: Status) -> None:
        panel = self.panel
        text, *brief = (*status(tick, self._driver()), self.ended)
        panel.status.content = text
        panel.again(self.ended)
        brief.append(panel.past(self._history.span, self.past))
        if brief != self._brief and self._is_due("brief", _BRIEF, time.monotonic()):
            self._brief = brief
            self.link.brief(brief)
        panel.wheel(self._wheel.driver, self.number)
        if (drives := self._wheel.driver == self.number) != self._grips:
            self._grips = drives
            self._scene.grip(self._drag if drives else None)
        if tick is not None:
            panel.graph.content = graph_html(self._shown.graph, tick.counters.tolist())
        if self._wheel.driver != self.number:
            panel.show_velocity(_STILL)
        if self._said:
            text, self._said = self._said, ""
            self.tell(text, False)

    def _driver(self) -> str:
        if self._recorded is not None:
            return ""
        driver = self._wheel.driver
        if driver == self.number:
            return "you drive"
        who = self._wheel.lost or "nobody drives from a page"
        if driver is not None:
            who = f"viewer {driver} drives"
        return f"{who}; you are viewer {self.number}"

    def _is_due(self, what: str, interval: float, now: float) -> bool:
        if is_due := now >= (due := self._due.get(what, 0.0)):
            self._due[what] = max(due + interval, now + 0.5 * interval)
        return is_due

    # -- in the server's thread -----------------------------------------------------------------

    def _heard(self, state: AnyDict) -> None:
        """Take what the page tells with an answer: it lives, and gamepad and keys."""
        stops = state.get("stops", 0)
        if isinstance(stops, int) and stops > self._stops:
            self._stops = stops
            self._do("estop")
        if self._held:
            self._pull()
        now, dark = time.monotonic(), state.get("dark") is True
        if dark != self._dark:
            self._dark = dark
            self.panel.dark(dark)
        if state.get("hidden"):
            self._wheel.lose(self.number, "was hidden")
            return
        device = _vector(state.get("device"))
        if device is not None and device != self._device:
            self._device = device
            bounds = self._shown.command_bounds
            velocity = [abs(x) * (high if x > 0 else low) for x, (low, high) in zip(device, bounds)]
            if self._wheel.steer(self.number, velocity, now):
                self.panel.show_velocity(self._wheel.velocity)
            return
        self._wheel.heard(self.number, now)

    def _drag(self, body: int, event: Any) -> None:
        """Take a drag: the point of the body that was gripped is pulled to the cursor."""
        if event.phase == "end" or self._stage is None:
            self._held = []
            self._wheel.pull(self.number, time.monotonic(), 0)
        elif event.phase == "start":
            place = self._stage.held(body, self._scene.placed(event.start_position))
            self._held = [self._stage.dragged[body], place, event.end_position]
        elif self._held:
            self._held[2] = event.end_position
            self._pull()

    def _pull(self) -> None:
        """Pull to where the cursor is now: the world passes below a robot that is followed."""
        *held, goal = self._held
        if not self._wheel.pull(self.number, time.monotonic(), *held, self._scene.placed(goal)):
            self._held = []

    def _do(self, what: str, *given: Any) -> None:
        now, wheel = time.monotonic(), self._wheel
        if what == "estop":
            self._remote.estop()
        elif what == "plots":
            self._aim(*given)
        elif what in ("past", "live") and self._recorded is None:
            self._look_at(*given)
        elif what == "branch" and self.past is not None:
            self._act("branch", {"tick": self.past / self._shown.period + 1.5, "then": given[0]})
            self._look_at()
        elif what == "wheel":
            self._look_at()
            if wheel.driver == self.number:
                wheel.let_go(self.number)
            else:
                self._said = wheel.take(self.number, now) or self._said
                self.panel.show_velocity(_STILL)
            self._due["texts"] = 0.0
        elif what == "zero":
            wheel.steer(self.number, _STILL, now)
            self.panel.show_velocity(_STILL)
        elif what == "steer":
            wheel.steer(self.number, given[0], now)
        elif what == "act":
            self._act(*given)
        elif self._recorded is not None:
            self._recorded(what, *given)

    def _look_at(self, past: float | None = None) -> None:
        """Show a time of the past in [s], or the present; who drives has to see the present."""
        if past is not None:
            self._wheel.lose(self.number, "shows the past")
        self.past = past
        self._due["texts"] = self._due["brief"] = 0.0

    def _aim(self, taken: float) -> None:
        """Let the robot fill the view where nobody has turned it; `taken` as of `aim`."""
        camera = self._client.camera
        if self._stage is not None and np.allclose(camera.position, self._aimed, atol=1e-3):
            self._aimed = aim(camera, self._stage, taken)

    def _act(self, name: str, arguments: AnyDict) -> None:
        """Ask the run for something; while somebody drives, only he may, but for a stop."""
        driver = self._wheel.driver
        if driver is not None and driver != self.number and name != "stop":
            self._said = f"viewer {driver} drives: only he may {name}"
            return
        self.acts.add(self._remote.act(name, **arguments))


def _vector(given: Any) -> list[float] | None:
    if not isinstance(given, list) or len(given) != 3:
        return None
    return given if all(isinstance(x, int | float) for x in given) else None
