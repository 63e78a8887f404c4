"""The executable `look`: runs this package's workflow with ROS 2 on.

ros2 run pan_tilt look --duration 10 --report look.json
"""

from __future__ import annotations

import sys

from unicon_ros.cli.main import main as unicon

__all__ = ["main"]


def main() -> int:
    """Run `pan_tilt_look`; takes the options of `unicon run`."""
    return unicon(["run", "pan_tilt_look", "--ros", *sys.argv[1:]])
