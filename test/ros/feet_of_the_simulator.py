"""Runs a workflow with its bridge and prints where the simulator has the feet, tick by tick.

A process of its own, since the test listens in another one.
Usage: feet_of_the_simulator.py WORKFLOW SECONDS
"""

from __future__ import annotations

import json
import sys

from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import HookBlocks, Program, load_workflow
from unicon_ros.bridge import RosSession


def feet(workflow: Program) -> HookBlocks:
    data = workflow.platform.data  # type: ignore[attr-defined]

    def say() -> None:
        at = {name: data.body(name).xpos.tolist() for name in workflow.robot.feet}
        stamp = int(workflow.states.stamp_ns)
        print(json.dumps({"kind": "feet", "stamp": stamp, "at": at}), flush=True)

    return {Stage.INPUT: [Block("feet", say)]}


def main() -> None:
    session = RosSession()
    # Among the inputs, since `send` steps the simulator on to the next tick's place.
    workflow = load_workflow(sys.argv[1], hooks=[session.hook, feet])
    runner = Runner(workflow, RunOptions(duration=float(sys.argv[2])))
    session.attach(runner)
    runner.run()
    session.close()


main()
