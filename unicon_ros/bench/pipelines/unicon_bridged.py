"""Process of our controller on a robot behind ROS topics: `--variant deadline` or `state`."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner
from unicon_core.workflow import Program, load_workflow
from unicon_ros.bench.pipelines.log import Log, arguments
from unicon_ros.bench.pipelines.workflows import write_bridged


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    log = Log(options.out, "stamp", "seen", "begin", "end")
    seen_ns = 0

    def seen(program: Program) -> dict[Stage, list[Block]]:
        def note() -> None:
            nonlocal seen_ns
            seen_ns = time.time_ns()

        return {Stage.INPUT: [Block("seen", note)]}

    def sent(program: Program) -> dict[Stage, list[Block]]:
        stamp = program.states["stamp_ns"]

        def note() -> None:
            now = time.time_ns()
            if stamp[()]:
                # What lies between is the identity copy: Send begins where Recv has ended.
                log.add(int(stamp), seen_ns, seen_ns, now)

        return {Stage.OBSERVE: [Block("sent", note, reads=("stamp_ns",))]}

    with tempfile.TemporaryDirectory() as folder:
        path, _ = write_bridged(
            Path(folder), options.joints, options.rate, options.best_effort, options.variant
        )
        runner = Runner(load_workflow(path, hooks=[seen, sent]))
        runner.run()
        log.save()


if __name__ == "__main__":
    main()
