"""`unicon` with a middleware that fails: `… LOG HOW AFTER run WORKFLOW …`, for the fault bench.

HOW is `take` (of `cmd_vel`), `publish` (of `joint_commands`), or `all`: with either of these two,
every topic of the process is refused. It begins with message AFTER.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from faults.command_log import FAULT, CommandLog
from unicon_ros import compat
from unicon_ros.cli.main import main as unicon

COUNTED = {
    "take": ("cmd_vel",),
    "publish": ("joint_commands",),
    "all": ("cmd_vel", "joint_commands"),
}
_take, _publish = compat.raw_take, compat.raw_publish


def main() -> int:
    """Run the command line with what fails in its place."""
    log, what, left = CommandLog(Path(sys.argv[1])), sys.argv[2], int(sys.argv[3])

    def refuse(topic: str) -> None:
        nonlocal left
        if topic.endswith(COUNTED[what]):
            left -= 1
            if left == 0:
                log.add(FAULT)
        elif what != "all":
            return
        if left <= 0:
            raise RuntimeError("refused by the bench's middleware")

    def raw_take(subscription: Any) -> tuple[Callable[[], bytes | None] | None, Any]:
        take, release = _take(subscription)
        if take is None:
            return take, release
        inner, topic = take, subscription.topic_name

        def failing() -> bytes | None:
            raw = inner()
            if raw is not None or left <= 0:
                refuse(topic)
            return raw

        return failing, release

    def raw_publish(publisher: Any) -> tuple[Callable[[bytes], object], Callable[[], None]]:
        publish, release = _publish(publisher)
        topic = publisher.topic_name

        def failing(raw: bytes) -> object:
            refuse(topic)
            return publish(raw)

        return failing, release

    if what != "publish":
        compat.raw_take = raw_take
    if what != "take":
        compat.raw_publish = raw_publish
    return unicon(sys.argv[4:])


if __name__ == "__main__":
    sys.exit(main())
