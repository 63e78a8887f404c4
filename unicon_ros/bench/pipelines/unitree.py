"""Process of our controller on platform `unitree`: the robot is behind Unitree's DDS.

`--variant` is the robot and how it ticks: `h1:state`, `h1:deadline`.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from unicon_core.blocks.joint_command import JointCommand
from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner
from unicon_core.workflow import Program, load_workflow
from unicon_ros.bench.pipelines.log import Log, arguments
from unicon_ros.bench.pipelines.workflows import HELD

WORKFLOW = """\
robot: {robot}
platform: "unicon_hardware.unitree.platform:make"
platforms:
  "unicon_hardware.unitree.platform:make":
    {{address: 127.0.0.1, domain: {domain}, connect: 20, silence: 10}}
rate: {rate}
pacing: {{trigger: {trigger}, hang: {held}}}
states: {{wireless_remote: {{shape: [40], dtype: uint8}}}}
flow: "unicon_ros.bench.pipelines.unitree:identity"
safety: none
start: none
"""


def identity(command: JointCommand) -> Callable[[], None]:
    """Command what is measured, limp."""

    def tick() -> None:
        command.joint_pos_target[...] = command.joint_pos
        command.joint_vel_target[...] = 0.0
        command.joint_effort_ff[...] = 0.0
        command.joint_stiffness[...] = 0.0
        command.joint_damping[...] = 0.0

    return tick


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    robot, _, trigger = options.variant.partition(":")
    log = Log(options.out, "stamp", "seen", "begin", "end", "cost")

    def note(program: Program) -> dict[Stage, list[Block]]:
        stamp = program.states["wireless_remote"].view(np.int64)
        platform, now = program.platform, time.time_ns
        recv, send = platform.recv, platform.send
        seen = cost = begin = end = last = 0

        def timed_recv() -> bool | None:
            nonlocal seen, cost
            before = now()
            done = recv()
            seen = now()
            cost = seen - before
            return done

        def timed_send() -> bool | None:
            nonlocal begin, end
            begin = now()
            done = send()
            end = now()
            return done

        def note_sent() -> None:
            nonlocal last
            made = int(stamp[0])
            # What is received twice costs nothing, and would not tell what a state costs.
            log.add(made, seen, begin, end, cost + end - begin if made != last else -1)
            last = made

        # Before the graph is built of them.
        platform.recv, platform.send = timed_recv, timed_send  # type: ignore[method-assign]
        return {Stage.OBSERVE: [Block("sent", note_sent, reads=("wireless_remote",))]}

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "workflow.yaml"
        domain = os.environ["ROS_DOMAIN_ID"]
        text = WORKFLOW.format(
            robot=robot, domain=domain, rate=options.rate, trigger=trigger, held=HELD
        )
        path.write_text(text, encoding="utf-8")
        Runner(load_workflow(path, hooks=[note])).run()
    log.save()


if __name__ == "__main__":
    main()
