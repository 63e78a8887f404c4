"""A run with a live page and a browser that looks at it, for tests and for the picture in docs."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.workflow import Program, load_document
from unicon_lab.view.view import View

CHROMIUM = Path("/usr/bin/chromium")
MISSING = "no browser: sudo apt install chromium && pip install playwright"

FLAGS = (
    *("--headless", "--no-sandbox", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
)

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1, 0, 0, 0],
    "position": [1, 1, 1],
    "look_at": [0, 0, 0],
    "up_direction": [0, 0, 1],
    **dict.fromkeys(("image_height", "image_width"), 500),
    **dict.fromkeys(("fov", "near", "far"), 1.0),
}
"""What a page of viser's says first."""


class Run:
    """A run in a thread with a live page.

    Attributes:
        closed: time of the day at which the platform was closed, which damps first; 0 before.
        changes: time of the day and value of each new velocity command.
    """

    def __init__(
        self, workflow: str | Path, port: int = 0, *overrides: str, **options: Any
    ) -> None:
        self.lines: list[str] = []
        document = load_document(workflow, [])
        given = {"sink": "page", "host": "127.0.0.1", "port": port, "token": "", "fps": 30.0}
        self.view = View(given | options, warn=self.lines.append)
        self.view.declare(document)
        self.program = Program(document, hooks=[self.view.hook])
        self.closed = 0.0
        close = self.program.platform.close

        def closing() -> None:
            self.closed = self.closed or time.time()
            close()

        self.program.platform.close = closing  # type: ignore[method-assign]
        self.runner = Runner(self.program, RunOptions(duration=120.0, warn=self.lines.append))
        self.view.attach(self.runner)
        self.address = self.view.address
        self.report: Report | None = None
        self.changes: list[tuple[float, list[float]]] = []
        self._threads = [threading.Thread(target=each) for each in (self._run, self._watch)]
        for thread in self._threads:
            thread.start()

    @property
    def port(self) -> int:
        return int(self.address.split("//")[1].split("/")[0].split(":")[1])

    @property
    def command(self) -> list[float]:
        return [round(float(x), 3) for x in self.program.states["velocity_command"]]

    def _run(self) -> None:
        try:
            self.report = self.runner.run()
        finally:
            self.view.close()

    def _watch(self) -> None:
        while self._threads[0].is_alive():
            if not self.changes or self.changes[-1][1] != self.command:
                self.changes.append((time.time(), self.command))
            time.sleep(0.002)

    def wait(self, patience: float = 10.0) -> Report:
        for thread in self._threads:
            thread.join(patience)
        assert self.report is not None, self.lines
        return self.report

    def end(self) -> Report:
        self.runner.stop()
        return self.wait()


class Page:
    """One tab; keeps what went wrong and whom it asked."""

    def __init__(self, browser: Any, address: str, width: int = 820, height: int = 600) -> None:
        self.tab = browser.new_page(viewport={"width": width, "height": height})
        self.errors: list[str] = []
        self.hosts: set[str] = set()
        self.tab.on(
            "console", lambda said: self.errors.append(said.text) if said.type == "error" else 0
        )
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.on("request", lambda asked: self._asked(asked.url))
        self.tab.on("websocket", lambda opened: self._asked(opened.url))
        self.tab.goto(address)
        self.until("document.getElementById('unicon-estop')?.textContent === 'E-STOP'")

    def _asked(self, url: str) -> None:
        if not url.startswith(("data:", "blob:")):
            self.hosts.add(url.split("/")[2])

    def until(self, script: str, patience: float = 30.0) -> float:
        """Wait until JavaScript is true; return how long it took, [s]."""
        begin = time.monotonic()
        self.tab.wait_for_function(f"() => {script}", timeout=1e3 * patience, polling=20)
        return time.monotonic() - begin

    def ask(self, script: str) -> Any:
        return self.tab.evaluate(f"() => {script}")

    def says(self, text: str) -> bool:
        return bool(self.ask(f"document.body.innerText.includes({text!r})"))

    def press(self, label: str) -> float:
        """Click a button; return the time of the day of the click."""
        found = "[...document.querySelectorAll('button')].find(each => each.innerText.trim() === "
        when = self.ask(
            f"{{const button = {found}{label!r}); button.click(); "
            "return performance.timeOrigin + performance.now()}"
        )
        return float(when) / 1e3


@contextmanager
def chromium() -> Iterator[Any]:
    """Open a browser without a screen."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=list(FLAGS))
        try:
            yield browser
        finally:
            browser.close()


def look(port: int, seconds: float, answers: bool) -> list[float]:
    """Look as a browser does, without drawing; return the time of each picture.

    Args:
        port: of the page.
        seconds: how long.
        answers: it acknowledges pictures; else it is stalled.
    """
    import msgspec
    import zstandard
    from websockets.sync.client import connect

    seen, unpack = [], zstandard.ZstdDecompressor()
    protocols: Any = ["viser-v1.1.1"]
    with connect(f"ws://127.0.0.1:{port}", subprotocols=protocols, max_size=None) as socket:
        socket.send(msgspec.msgpack.encode(CAMERA))
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if not answers:
                time.sleep(0.05)
                continue
            try:
                data = bytes(socket.recv(timeout=0.5))  # type: ignore[arg-type]
            except TimeoutError:
                continue
            packed = data[16 : 16 + int.from_bytes(data[8:16], "little")]
            for said in msgspec.msgpack.decode(unpack.decompress(packed))["messages"]:
                if said["type"] == "LocalStorageGetItemRequestMessage":
                    seen.append(time.monotonic())
                    answer = {"value": None, "error": None, "request_uuid": said["request_uuid"]}
                    answer["type"] = "LocalStorageGetItemResponseMessage"
                    socket.send(msgspec.msgpack.encode(answer))
    return seen
