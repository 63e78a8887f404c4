"""`ros2 run unicon_ros latency_bench`: the same as `unicon bench latency`."""

from __future__ import annotations

import sys

from unicon_ros.cli.main import main as unicon


def main() -> int:
    """Run the benchmark with the process's arguments and return the exit status."""
    return unicon(["bench", "latency", *sys.argv[1:]])


if __name__ == "__main__":
    raise SystemExit(main())
