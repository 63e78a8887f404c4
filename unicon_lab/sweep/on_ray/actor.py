"""Actor: a worker of a sweep on a node of a Ray cluster; the same rows by the same code as `local`.

Nothing of ours is imported with this module: what a node lacks is told by `hello`, in one line.
"""

from __future__ import annotations

import os
import socket
from pathlib import Path
from typing import Any


class RowActor:
    """Runs rows, one after the other, in the folder that Ray has unpacked.

    Args:
        manifest: as of `shipment.manifest`.
    """

    def __init__(self, manifest: dict[str, Any]) -> None:
        self._manifest = manifest
        self._root = Path.cwd()
        self._runner: Any = None
        self._error = ""

    def hello(self) -> dict[str, Any]:
        """Return who this is: `node`, `pid`, `folder`, `code` and `versions` as of `identity`."""
        from unicon_lab.sweep.plan import code_sha256, versions

        return {
            "node": socket.gethostname(),
            "pid": os.getpid(),
            "code": code_sha256(),
            "versions": versions(),
        }

    def row(self, settings: list[str]) -> dict[str, Any]:
        """Return what is told of a row, as of `RowRunner.told`."""
        from unicon_base.errors import UniconError
        from unicon_lab.sweep.on_ray.shipment import arrive
        from unicon_lab.sweep.worker import RowRunner

        if self._runner is None:
            task, original = arrive(self._root, self._manifest)
            try:
                self._runner = RowRunner(task, original)
            except UniconError as error:
                return {"error": original(error)}
        told: dict[str, Any] = self._runner.told(settings)
        return told
