"""`--view=meshcat`: its page gets the robot's shapes and where they are."""

from __future__ import annotations

import socket
import time
from pathlib import Path
from urllib.request import Request, urlopen

import pytest

pytest.importorskip("meshcat", reason="pip install 'unicon_ros[meshcat]'")
pytest.importorskip("viser", reason="pip install 'unicon_ros[view]'")
pytest.importorskip("mujoco")

import umsgpack
from websockets.sync.client import connect

from unicon_core.errors import UniconError
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import Program, load_document
from unicon_ros.view.view import View

pytestmark = pytest.mark.slow


def test_a_token_is_refused_as_its_page_could_not_give_it() -> None:
    options = {"sink": "meshcat", "host": "127.0.0.1", "port": 8730, "token": "c0rrecthorse"}
    view = View({**options, "fps": 30.0})
    program = Program(load_document("go2_stand"), hooks=[view.hook])
    try:
        with pytest.raises(UniconError, match=r"takes no --view-token; .* or take --view=page"):
            view.attach(Runner(program, RunOptions(duration=1.0)))
    finally:
        view.close()
        program.close()


def test_a_page_gets_the_robot_and_nobody_else_can_reach_it(tmp_path: Path) -> None:
    options = {"sink": "meshcat", "host": "127.0.0.1", "port": 8730, "token": "", "fps": 30.0}
    view = View(options)
    program = Program(load_document("go2_stand"), hooks=[view.hook])
    runner = Runner(program, RunOptions(duration=3.0))
    view.attach(runner)
    try:
        page = urlopen(Request(view.address)).read()
        assert b"meshcat" in page.lower()
        address = view.address.replace("http", "ws").removesuffix("/static/")
        port = int(address.rsplit(":", 1)[1])
        for outside in socket.gethostbyname_ex(socket.gethostname())[2]:
            if not outside.startswith("127."):
                with pytest.raises(OSError):
                    socket.create_connection((outside, port), 1.0)
        with connect(address, max_size=None) as client:
            assert runner.run().faults == []
            kinds: dict[str, set[str]] = {}
            end = time.monotonic() + 3.0
            while time.monotonic() < end:
                try:
                    told = umsgpack.unpackb(client.recv(timeout=0.2))
                except TimeoutError:
                    break
                kinds.setdefault(told["type"], set()).add(told["path"])
    finally:
        view.close()
        program.close()
    assert len(kinds["set_object"]) >= 13
    assert len({path for path in kinds["set_transform"] if "robot" in path}) >= 13
