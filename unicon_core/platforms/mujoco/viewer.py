"""A window on a simulated robot, for `unicon run --view=window`; a deferred block."""

from __future__ import annotations

import os
import sys
import time
from typing import Any

from unicon_base.errors import PlatformError, one_line


class Viewer:
    """Block: shows a model, done when its window is closed.

    Args:
        model: the `MjModel`.
        data: the `MjData`, read between physics steps only (the block runs in the tick's thread).
        rate: largest number of pictures per second.

    Raises:
        PlatformError: there is no display.
    """

    name = "viewer"

    def __init__(self, model: Any, data: Any, rate: float = 60.0) -> None:
        on_linux = sys.platform.startswith("linux")
        if on_linux and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise PlatformError(
                "the viewer needs a display and neither DISPLAY nor WAYLAND_DISPLAY is set; "
                "give --view for a page in the browser, or run it under a desktop, `ssh -X` or "
                "`xvfb-run`"
            )
        import mujoco.viewer

        try:
            self._handle = mujoco.viewer.launch_passive(model, data)
        except Exception as error:  # glfw raises classes of its own
            raise PlatformError(
                f"the viewer cannot open a window: {one_line(error)}; "
                "give --view for a page in the browser"
            ) from error
        self._interval = 1.0 / rate
        self._due = 0.0

    def __call__(self) -> bool:
        now = time.monotonic()
        if now >= self._due:
            self._due = now + self._interval
            self._handle.sync()
        return not self._handle.is_running()

    def close(self) -> None:
        """Close the window; safe to call twice."""
        self._handle.close()
