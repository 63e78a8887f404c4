"""A page that drags a body, as a browser without a screen sends it: who may, how hard, how it ends.

The client speaks viser's protocol; no browser is needed.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import browser
import numpy as np
import pytest
from browser import Run

pytest.importorskip("viser", reason="no live page: pip install 'unicon_ros[view]'")

import msgspec
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

STANDS = """\
schema: unicon.workflow/1
name: stands
robot: go2
platform: {platform}
rate: 50
flow: {{chain: [{{pose: {{to: stand, duration: 0.5}}}}, hold]}}
"""
CAMERA = {**browser.CAMERA, "image_width": 800}


class Tab:
    """A page: answers pictures, beats while `alive`, and knows widgets and what can be dragged."""

    def __init__(self, port: int) -> None:
        self.alive, self.widgets, self.bindings, self.owner = True, dict[str, str](), set[str](), ""
        self.places: dict[str, list[float]] = {}
        self._open, self._count = True, 0
        protocols: Any = ["viser-v1.1.1"]
        self._socket = connect(f"ws://127.0.0.1:{port}", subprotocols=protocols, max_size=None)
        self._send(CAMERA)
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _send(self, message: dict[str, Any]) -> None:
        self._socket.send(msgspec.msgpack.encode(message))

    def _listen(self) -> None:
        unpack, beaten = zstandard.ZstdDecompressor(), 0.0
        while self._open:
            if self.alive and "heartbeat" in self.widgets and time.monotonic() - beaten > 0.1:
                beaten, self._count = time.monotonic(), self._count + 1
                self.set("heartbeat", f'{self._count} {{"hidden": false, "stops": 0}}')
            try:
                data: Any = self._socket.recv(timeout=0.05)
            except TimeoutError:
                continue
            except ConnectionClosed:
                return
            packed = data[16 : 16 + int.from_bytes(data[8:16], "little")]
            for said in msgspec.msgpack.decode(unpack.decompress(packed))["messages"]:
                self._take(said)

    def _take(self, said: dict[str, Any]) -> None:
        kind, name = said["type"], str(said.get("name"))
        if kind == "LocalStorageGetItemRequestMessage":
            until(lambda: self.alive or not self._open)
            answer = {"value": None, "error": None, "request_uuid": said["request_uuid"]}
            self._send({"type": "LocalStorageGetItemResponseMessage"} | answer)
        elif kind == "SetSceneNodeDragBindingsMessage":
            (self.bindings.add if said["bindings"] else self.bindings.discard)(name)
            self.owner = said["owner"]
        elif kind == "SetPositionMessage":
            self.places[name] = said["position"]
        elif kind in ("GuiButtonMessage", "GuiTextMessage", "GuiButtonGroupMessage"):
            self.widgets.setdefault(said["props"]["label"], said["uuid"])

    def set(self, label: str, value: Any) -> None:
        """Do something to a widget."""
        update = {"type": "GuiUpdateMessage", "uuid": self.widgets[label]}
        self._send({**update, "updates": {"value": value}})

    def drag(self, phase: str, node: str, start: Any, end: Any) -> None:
        """Drag a node from a point of the scene to another one, both in [m]."""
        where = {"start_position": list(map(float, start)), "end_position": list(map(float, end))}
        screen = {"start_screen_pos": [0.5, 0.5], "end_screen_pos": [0.5, 0.5]}
        message = {"type": "SceneNodeDragMessage", "phase": phase, "name": node, **where, **screen}
        self._send(
            message
            | {"instance_index": None, "button": "left", "modifier": None, "owner": self.owner}
        )

    def close(self) -> None:
        """Close the page."""
        self._open = False
        self._thread.join(5.0)
        self._socket.close()


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Callable[[str], tuple[Run, Callable[[], Tab]]]]:
    """Start a run on a platform; return it and what opens a page of it."""
    ends: list[Callable[[], object]] = []

    def begin(platform: str) -> tuple[Run, Callable[[], Tab]]:
        path = tmp_path / "stands.yaml"
        path.write_text(STANDS.format(platform=platform))
        run = Run(path, fps=10.0)
        ends.append(run.end)

        def tab() -> Tab:
            made = Tab(run.port)
            ends.insert(0, made.close)
            until(lambda: "heartbeat" in made.widgets)
            return made

        return run, tab

    yield begin
    for end in ends:
        end()


def until(holds: Callable[[], object], patience: float = 20.0) -> None:
    begin = time.monotonic()
    while not holds():
        assert time.monotonic() - begin < patience
        time.sleep(0.02)


def test_a_page_drags_while_it_drives_and_is_heard(
    opened: Callable[[str], tuple[Run, Callable[[], Tab]]],
) -> None:
    run, open_tab = opened("mujoco")
    states, platform = run.program.states, run.program.platform
    one, other = open_tab(), open_tab()
    time.sleep(0.5)
    assert one.bindings == other.bindings == set()  # a drag turns the view
    one.set("Take the wheel", True)
    until(lambda: one.bindings)
    assert other.bindings == set()
    number = platform.bodies.index("base_link")  # type: ignore[attr-defined]
    node = next(each for each in one.bindings if each.startswith("/world/body/1/"))
    trunk = np.add(one.places["/world/body/1"], one.places.get("/world", (0, 0, 0)))
    aside, far = (np.add(trunk, (0.0, y, 0.0)) for y in (0.2, 9.0))
    other.drag("start", node, trunk, far)
    time.sleep(0.3)
    assert not states["external_force"].any()
    one.drag("start", node, trunk, trunk)
    one.drag("update", node, trunk, aside)
    until(lambda: states["external_force"][1] > 20.0)
    assert int(states["external_force_body"]) == number
    assert states["external_force_point"] == pytest.approx(states["base_pos_w"], abs=0.05)
    time.sleep(1.0)  # beats alone keep it
    assert states["external_force"][1] > 10.0
    one.drag("end", node, trunk, trunk)
    until(lambda: not states["external_force"].any(), 1.0)
    one.drag("start", node, trunk, aside)
    until(lambda: states["external_force"].any())
    one.alive, silent = False, time.monotonic()
    until(lambda: not states["external_force"].any(), 2.0)
    assert 0.2 < time.monotonic() - silent < 1.5
    one.alive = True
    one.drag("update", node, trunk, far)
    time.sleep(0.3)
    assert not states["external_force"].any()  # the wheel has to be taken again
    until(lambda: not one.bindings)


def test_what_cannot_feel_a_force_is_not_dragged(
    opened: Callable[[str], tuple[Run, Callable[[], Tab]]],
) -> None:
    run, open_tab = opened("fake")
    tab = open_tab()
    assert "Take the wheel" not in tab.widgets  # nothing to drive, and nothing to drag
    assert not any(label.startswith("push") for label in tab.widgets)
    tab.drag("start", "/world/body/1/shape_0", (0, 0, 0.3), (0, 9, 0.3))
    time.sleep(0.5)
    assert run.report is None
    assert "external_force" in run.program.states
    assert not run.program.states["external_force"].any()
