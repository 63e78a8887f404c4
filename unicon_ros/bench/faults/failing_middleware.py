"""`unicon` with a middleware that refuses: `… LOG take|publish run WORKFLOW …`, for the bench.

`take` fails on `cmd_vel` after 30 messages, `publish` on `joint_commands` after 40.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from unicon_ros import compat
from unicon_ros.bench.faults.command_log import FAULT, CommandLog
from unicon_ros.cli.main import main as unicon

GOOD = {"take": 30, "publish": 40}
_take, _publish = compat.raw_take, compat.raw_publish


def main() -> int:
    """Run the command line with one of the two replaced."""
    log, what = CommandLog(Path(sys.argv[1])), sys.argv[2]
    left = GOOD[what]

    def count() -> None:
        nonlocal left
        left -= 1
        if left == 0:
            log.add(FAULT)
        if left <= 0:
            raise RuntimeError("refused by the bench's middleware")

    def raw_take(subscription: Any) -> tuple[Callable[[], bytes | None] | None, Any]:
        take, release = _take(subscription)
        if take is None or not subscription.topic_name.endswith("cmd_vel"):
            return take, release
        inner = take

        def failing() -> bytes | None:
            raw = inner()
            if raw is not None or left <= 0:
                count()
            return raw

        return failing, release

    def raw_publish(publisher: Any) -> tuple[Callable[[bytes], object], Callable[[], None]]:
        publish, release = _publish(publisher)
        if not publisher.topic_name.endswith("joint_commands"):
            return publish, release

        def failing(raw: bytes) -> object:
            count()
            return publish(raw)

        return failing, release

    compat.raw_take, compat.raw_publish = {
        "take": (raw_take, _publish),
        "publish": (_take, raw_publish),
    }[what]
    return unicon(sys.argv[3:])


if __name__ == "__main__":
    sys.exit(main())
