"""Process of control on local state, ROS only a mirror: the whole core, on memory."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from unicon_core.flow import Block
from unicon_core.runtime import Runner
from unicon_core.workflow import Workflow, load_workflow
from unicon_ros.bench.pipelines.log import Log, arguments
from unicon_ros.bench.pipelines.workflows import write_local
from unicon_ros.bridge import RosSession


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    log = Log(options.out, "stamp", "end")

    def note(workflow: Workflow) -> list[Block]:
        # The first block after `send`: the command of this tick has just been handed over.
        stamp, tick, now = workflow.states["stamp_ns"], workflow.states["tick"], time.monotonic_ns
        every = max(1, round(options.state_rate / options.rate))

        def note_command() -> None:
            at = now()
            if int(tick) % every == 0:
                log.add(int(stamp), at)

        return [Block("note", note_command, reads=("stamp_ns", "tick"))]

    with tempfile.TemporaryDirectory() as folder:
        workflow_file, map_file = write_local(
            Path(folder), options.joints, options.rate, options.state_rate, options.best_effort
        )
        session = RosSession(map=map_file, node_name="controller")
        workflow = load_workflow(
            workflow_file, inputs=[session.inputs], observers=[note, session.observers]
        )
        runner = Runner(workflow)
        session.attach(runner)
        runner.run()
        log.save()
        session.close()


if __name__ == "__main__":
    main()
