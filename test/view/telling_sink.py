"""A sink for tests: tells what it sees in a file, and does what another file says."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from unicon_lab.view.shown import Shown
from unicon_lab.view.source import Remote, Source


class Telling:
    """Reads lines `[method, *arguments]` of the file `say`, writes the newest tick into `seen`."""

    def __init__(self, shown: Shown, source: Source, remote: Remote, options: dict[str, Any]):
        self._shown, self._source, self._remote = shown, source, remote
        self._folder = Path(options["folder"])
        self._read, self._each, self._handle, self._lost = 0, False, 0, 0
        self._velocity: list[float] | None = None
        self.address = f"file://{self._folder}"

    def poll(self) -> None:
        """Do what is said, and tell what is seen."""
        say = self._folder / "say"
        lines = say.read_text().splitlines() if say.exists() else []
        for line in lines[self._read :]:
            what, *given = json.loads(line)
            if what == "hold":
                self._velocity = given[0]
            elif what == "raise":
                raise RuntimeError("a sink that fails")
            elif what == "sleep":
                time.sleep(given[0])
            elif what == "act":
                self._remote.act(given[0], **given[1])
            else:
                getattr(self._remote, what)(*given)
        self._read = len(lines)
        if self._velocity is not None:
            self._remote.drive(self._velocity)  # type: ignore[arg-type]
        for seen in self._source.since(self._handle):
            self._lost += seen.handle - self._handle - 1
            self._handle = seen.handle
        tick = self._source.latest()
        if tick is None:
            return
        told = {
            "tick": tick.tick,
            "phase": self._shown.phases[tick.phase],
            "driving": tick.driving,
            "paused": tick.paused,
            "lost": self._lost,
            "max_vx": self._shown.parameters["max_vx"].value,
            "busy_ns": tick.busy_ns,
            "running": [each.text for each in self._shown.graph if each.runs(list(tick.counters))],
            "velocity_command": tick.states["velocity_command"].tolist(),
            "answers": [(a.number, a.done, a.text) for a in self._source.answers],
            **self._source.texts,
        }
        new = self._folder / "seen.new"
        new.write_text(json.dumps(told))
        new.rename(self._folder / "seen")

    def close(self) -> None:
        """Nothing is open."""
