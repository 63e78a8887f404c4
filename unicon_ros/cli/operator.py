"""The operator's go at the terminal, for `unicon run`."""

from __future__ import annotations

import os
import select
import sys
import threading
from contextlib import suppress
from typing import TYPE_CHECKING

from unicon_core.errors import UniconError

if TYPE_CHECKING:
    from unicon_core.runtime import Runner

LOOK = 0.2
"""How long Enter is waited for before the phase is looked at, in [s]."""


def listen(runner: Runner, with_ros: bool) -> None:
    """Take the Enter key for the operator's go.

    Raises:
        UniconError: nobody could say it.
    """
    if not sys.stdin or not sys.stdin.isatty():
        if with_ros:
            return
        raise UniconError(
            f"platform {runner.program.platform.facts.name!r} is a robot, which waits for the "
            "operator's go, and standard input is not a terminal: add --yes to let it move once "
            "its gates hold, or --ros and call ~/start"
        )

    from unicon_core.runtime.phases import Phase

    moving = (Phase.APPROACH, Phase.RUN, Phase.SOFT, Phase.DAMP)

    def wait() -> None:
        with suppress(OSError):
            while runner.phase not in moving:  # then keys are the workflow's
                if not select.select([0], [], [], LOOK)[0]:
                    continue
                if not os.read(0, 1024):
                    return
                if not runner.go() and runner.waits_for:
                    runner.options.warn(f"not yet: it waits for {runner.waits_for}")

    threading.Thread(target=wait, name="operator", daemon=True).start()
