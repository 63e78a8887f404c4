"""Process of control on local state, ROS only a mirror: the whole core, on memory."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner
from unicon_core.workflow import Program, load_workflow
from unicon_ros.bench.pipelines.log import Log, arguments
from unicon_ros.bench.pipelines.workflows import write_local
from unicon_ros.bridge import RosSession


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
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

    with tempfile.TemporaryDirectory() as folder:
        workflow_file, map_file = write_local(
            Path(folder), options.joints, options.rate, options.state_rate, options.best_effort
        )
        session = RosSession(map=map_file, node_name="controller")
        program = load_workflow(workflow_file, hooks=[note, session.hook])
        runner = Runner(program)
        session.attach(runner)
        runner.run()
        log.save()
        session.close()


if __name__ == "__main__":
    main()
