"""Runs a workflow with its bridge and prints each tick: what the joints are sent, where they are.

A process of its own, since it needs the type support of control_msgs from its first import on.
Usage: trajectory_host.py WORKFLOW SECONDS [PATH=VALUE …]   `map` of the workflow counts.
"""

from __future__ import annotations

import json
import sys
import time

from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import HookBlocks, Program
from unicon_core.workflow.document import load_document
from unicon_ros.bridge import RosSession


def told(program: Program) -> HookBlocks:
    states = program.states

    def say() -> None:
        line = {
            "kind": "tick",
            "tick": int(states.tick),
            "stamp": int(states.stamp_ns),
            "at": time.monotonic_ns(),
            "measured": states.joint_pos.tolist(),
            "target": states.joint_pos_target.tolist(),
            "commanded": [None if x != x else x for x in states.joint_pos_command.tolist()],
            "velocity": states.joint_vel_target.tolist(),
        }
        print(json.dumps(line), flush=True)

    return {Stage.OBSERVE: [Block("told", say)]}


def warn(text: str) -> None:
    print(json.dumps({"kind": "warning", "text": text}), flush=True)


def main() -> None:
    document = load_document(sys.argv[1], sys.argv[3:])
    session = RosSession(map=document.get("map"), warn=warn)
    runner = Runner(
        Program(document, hooks=[session.hook, told]),
        RunOptions(duration=float(sys.argv[2]), warn=warn),
    )
    session.attach(runner)
    report = runner.run()
    session.close()
    print(json.dumps({"kind": "end", "faults": report.faults, **session.counts()}), flush=True)


main()
