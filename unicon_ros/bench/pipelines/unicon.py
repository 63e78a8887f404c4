"""Process of our controllers: `--variant` deadline, state or local.

`deadline` and `state` tick freely or with the states of a robot behind topics. `local` is control
on local state, ROS only a mirror: the whole core, on memory.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner
from unicon_core.workflow import Program, load_workflow
from unicon_ros.bench.pipelines.log import Log, arguments
from unicon_ros.bench.pipelines.workflows import write_bridged, write_local
from unicon_ros.bridge import RosSession


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    run = _local if options.variant == "local" else _bridged
    with tempfile.TemporaryDirectory() as folder:
        run(options, Path(folder))


def _bridged(options: argparse.Namespace, folder: Path) -> None:
    log = Log(options.out, "stamp", "seen", "begin", "end")

    def note(program: Program) -> dict[Stage, list[Block]]:
        stamp, seen_ns = program.states["stamp_ns"], 0

        def note_seen() -> None:
            nonlocal seen_ns
            seen_ns = time.time_ns()

        def note_sent() -> None:
            now = time.time_ns()
            if stamp[()]:
                # What lies between is the identity copy: Send begins where Recv has ended.
                log.add(int(stamp), seen_ns, seen_ns, now)

        return {
            Stage.INPUT: [Block("seen", note_seen)],
            Stage.OBSERVE: [Block("sent", note_sent, reads=("stamp_ns",))],
        }

    path, _ = write_bridged(
        folder, options.joints, options.rate, options.best_effort, options.variant
    )
    Runner(load_workflow(path, hooks=[note])).run()
    log.save()


def _local(options: argparse.Namespace, folder: Path) -> None:
    log = Log(options.out, "stamp", "end")

    def note(program: Program) -> dict[Stage, list[Block]]:
        # The first block after `send`: the command of this tick has just been handed over.
        stamp, tick, now = program.states["stamp_ns"], program.states["tick"], time.monotonic_ns
        every = max(1, round(options.state_rate / options.rate))

        def note_command() -> None:
            at = now()
            if int(tick) % every == 0:
                log.add(int(stamp), at)

        return {Stage.OBSERVE: [Block("note", note_command, reads=("stamp_ns", "tick"))]}

    path, map_file = write_local(
        folder, options.joints, options.rate, options.state_rate, options.best_effort
    )
    session = RosSession(map=map_file, node_name="controller")
    runner = Runner(load_workflow(path, hooks=[note, session.hook]))
    session.attach(runner)
    runner.run()
    log.save()
    session.close()


if __name__ == "__main__":
    main()
