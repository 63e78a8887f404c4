"""Meshcat: the robot in meshcat's page, for `--view=meshcat`; to look at, and nothing else."""

from __future__ import annotations

import asyncio
import tempfile
import threading
import time
from collections.abc import Mapping
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from unicon_core.errors import MissingDependencyError, UniconError
from unicon_core.platforms.kit.base import rotation
from unicon_ros.view.front import Front, hidden_address
from unicon_ros.view.shown import Shown
from unicon_ros.view.source import Remote, Source

START = 10.0
"""How long its server may take to begin, in [s]."""


class Meshcat:
    """The sink.

    Args:
        shown: the run.
        source: of its ticks.
        remote: not used: nobody drives from here.
        options: `host`, `port`, `token`, `fps`.

    Attributes:
        address: where it is seen.

    Raises:
        MissingDependencyError: meshcat is not installed.
        UniconError: the robot has no model, or no port is free.
    """

    def __init__(
        self, shown: Shown, source: Source, remote: Remote, options: Mapping[str, Any]
    ) -> None:
        try:
            import meshcat.geometry
            from meshcat.servers.zmqserver import ZMQWebSocketBridge
            from meshcat.visualizer import Visualizer

            from unicon_ros.view.page.scene import Stage
        except ModuleNotFoundError as error:
            raise MissingDependencyError(
                "--view=meshcat", str(error.name), "pip install 'unicon_ros[meshcat]'"
            ) from error
        host, token = str(options["host"]), str(options["token"])
        if token:  # its page asks for its parts without one
            raise UniconError(
                "--view=meshcat takes no --view-token; leave --view-host and --view-token out and "
                "come through ssh -L, or take --view=page"
            )
        if shown.model is None:
            raise UniconError(f"--view=meshcat: robot {shown.robot.name} names no model to draw")
        self._source, self._interval, self._due = source, 1.0 / float(options["fps"]), 0.0
        self._stage = Stage(shown)
        self._folder = tempfile.TemporaryDirectory(prefix="unicon-meshcat-")
        self._hidden, self._url = hidden_address(), f"ipc://{Path(self._folder.name, 'zmq')}"
        self._loop: Any = None
        ready = threading.Event()
        self._thread = threading.Thread(
            target=self._serve, args=(ZMQWebSocketBridge, ready), name="meshcat", daemon=True
        )
        self._thread.start()
        if not ready.wait(START):
            raise UniconError(f"--view=meshcat: its server did not begin within {START:g} s")
        self._front = Front(host, int(options["port"]), (self._hidden, self._port))
        self.address = f"http://{self._front.at}/static/"
        with redirect_stdout(StringIO()):  # it prints an address at which nothing is
            self._page = Visualizer(zmq_url=self._url)
        self._bodies = sorted({shape.body for shape in self._stage.shapes})
        for number, shape in enumerate(self._stage.shapes):
            red, green, blue = (round(255 * part) for part in shape.rgba[:3])
            self._page[f"robot/{shape.body}/{number}"].set_object(
                meshcat.geometry.TriangularMeshGeometry(shape.vertices, shape.faces),
                meshcat.geometry.MeshLambertMaterial(
                    color=red << 16 | green << 8 | blue, opacity=shape.rgba[3]
                ),
            )

    def _serve(self, bridge: Any, ready: threading.Event) -> None:
        """Run meshcat's server; by itself it would listen to the whole network."""
        hidden, asked = self._hidden, self

        class Hidden(bridge):
            def make_app(self) -> Any:
                app = super().make_app()
                listen = app.listen

                def only_here(port: int, **options: Any) -> None:
                    server = listen(0, address=hidden, **options)
                    sockets = list(server._sockets.values())
                    asked._port = sockets[0].getsockname()[1]

                app.listen = only_here
                return app

        self._loop = asyncio.new_event_loop()
        asyncio.set_event_loop(self._loop)
        Hidden(zmq_url=self._url, port=1)
        self._loop.call_soon(ready.set)
        self._loop.run_forever()

    _port = 0

    def poll(self) -> None:
        """Put the robot where the newest tick has it."""
        if time.monotonic() < self._due:
            return
        self._due = time.monotonic() + self._interval
        tick = self._source.latest()
        if tick is None:
            return
        pose = self._stage.put(tick.tick, tick.states)
        turned = rotation(pose.quat)
        for body in self._bodies:
            placed = np.eye(4)
            placed[:3, :3] = turned[body]
            placed[:3, 3] = pose.position[body]
            self._page[f"robot/{body}"].set_transform(placed)

    def close(self) -> None:
        """End the server."""
        self._front.close()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(2.0)
        self._folder.cleanup()
