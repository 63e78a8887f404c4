"""Stand-in for isaaclab.app."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from vendor_world import Refused


class App:
    def close(self) -> None:
        pass


class AppLauncher:
    """isaaclab/app/app_launcher.py: before all other modules, once in a process."""

    launched = False

    def __init__(
        self, launcher_args: argparse.Namespace | dict[str, Any] | None = None, **kwargs: Any
    ) -> None:
        if AppLauncher.launched or "isaaclab.sim" in sys.modules:
            raise Refused("the app is launched after its modules, or twice")
        if launcher_args is not None or set(kwargs) - {"headless", "device", "enable_cameras"}:
            raise Refused(f"no arguments {launcher_args} {sorted(kwargs)}")
        AppLauncher.launched = True
        self.app = App()
