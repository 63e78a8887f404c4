"""Process of our controllers: `--variant` deadline, state, joints, nth, local or ROBOT:TRIGGER.

`deadline` and `state` tick freely or with the states of a robot behind topics. `joints` and `nth`
hear no IMU, like the strongest plain controllers; `nth` ticks with each n-th state, at the rate of
commands. `local` is control on local state, ROS only a mirror: the whole core, on memory.
`h1:state` and `h1:deadline` control a robot behind Unitree's DDS.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml

from unicon_base.located_yaml import read_yaml
from unicon_core.blocks.postures import JointCommand
from unicon_core.flow import Block, Stage
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.runtime import Runner
from unicon_core.states import States
from unicon_core.states.standard import JOINT_STATES
from unicon_core.workflow import HookBlocks, Program, load_workflow
from unicon_ros.bench.pipelines.log import COMMAND, IMU, MIRROR, STATE, Log, arguments, joint_names
from unicon_ros.bridge import RosSession


class LocalPlatform:
    """Copies a driver's arrays into the states and the targets back."""

    facts = Facts("local", writes=(*JOINT_STATES, "stamp_ns"), reads=("joint_pos_target",))

    def __init__(self, states: States, robot: Robot, period: float) -> None:
        self._stamp = states["stamp_ns"]
        # One copy in and one out: the joint states stand back to back in the buffer.
        n = robot.num_joints
        first = states.offset("joint_pos")
        self._measured = states.buffer_of(np.float32)[first : first + 3 * n]
        self._driver_in = np.zeros(3 * n, np.float32)
        self._target = states["joint_pos_target"]
        self._driver_out = np.zeros(n, np.float32)
        self._scratch_in, self._scratch_out = np.zeros_like(self._driver_in), np.zeros(n, "f4")

    def recv(self) -> None:
        self._stamp[...] = time.monotonic_ns()
        self._measured[...] = self._driver_in

    def send(self) -> None:
        self._driver_out[...] = self._target

    def warm_up(self) -> None:
        time.monotonic_ns()
        self._scratch_in[...] = self._driver_in
        self._scratch_out[...] = self._target

    def close(self) -> None:
        self._driver_out[...] = 0.0


OURS = "unicon_ros.bench.pipelines.unicon"
IDENTITY = "{copy: {source: joint_pos, target: joint_pos_target}}"

HELD = 60
"""Longest time that a pipeline is held between its turns in [s], so that it is not a fault."""


def write_local(
    folder: Path, joints: int, rate: float, state_rate: float, best_effort: bool
) -> tuple[Path, Path]:
    """Write workflow and map of control on local state with ROS as a mirror.

    States are read and mirrored at `state_rate`, commands made at `rate`, as by the other
    pipelines.

    Returns:
        The workflow file and the map file.
    """
    every = max(1, round(state_rate / rate))
    flow = f"{{every: {{n: {every}, do: {IDENTITY}}}}}" if every > 1 else IDENTITY
    workflow = _workflow("./bench_robot.yaml", f"{OURS}:LocalPlatform", "", rate * every, flow=flow)
    topics = f"publish:\n{joint_states_entry(MIRROR, best_effort)}"
    return _written(folder, joints, workflow, topics)


def write_bridged(
    folder: Path,
    joints: int,
    rate: float,
    best_effort: bool,
    trigger: str,
    every: int = 0,
    imu: bool = True,
) -> tuple[Path, Path]:
    """Write workflow and map of control over topics: the robot is platform `ros`.

    States are heard with best effort, as by shipped maps and by those that say no `qos`.

    Args:
        best_effort: QoS of commands.
        trigger: `deadline` ticks freely, `state` ticks when a state arrives.
        every: with `state`, n of each n-th state; 0: the one nearest to a deadline.
        imu: hear the IMU besides the joint states.

    Returns:
        The workflow file and the platform's map file.
    """
    trigger += f", every: {every}" if every else ""
    workflow = _workflow("./bench_robot.yaml", "ros", "map: ./robot.yaml", rate, trigger)
    inertial = f"""
  - topic: {IMU}
    type: sensor_msgs/msg/Imu
    qos: {_qos(best_effort=True)}
    timeout: {HELD}
    fields: {{orientation: base_quat, angular_velocity: base_ang_vel,
             linear_acceleration: base_lin_acc}}"""
    topics = f"""\
subscribe:
{joint_states_entry(STATE, best_effort=True)}
    timeout: {HELD}{inertial if imu else ""}
publish:
  - topic: {COMMAND}
    type: sensor_msgs/msg/JointState
    qos: {_qos(best_effort)}
    fields: {{header.stamp: stamp_ns, name: $joint_names, position: joint_pos_target}}
"""
    return _written(folder, joints, workflow, topics)


def joint_states_entry(topic: str, best_effort: bool) -> str:
    """Return the map's entry of a topic that carries the measured joint states and their stamp."""
    return f"""\
  - topic: {topic}
    type: sensor_msgs/msg/JointState
    qos: {_qos(best_effort)}
    fields: {{header.stamp: stamp_ns, name: $joint_names, position: joint_pos,
             velocity: joint_vel, effort: joint_effort}}"""


def _qos(best_effort: bool) -> str:
    return f"{{reliability: {'best_effort' if best_effort else 'reliable'}, depth: 1}}"


def _workflow(
    robot: str,
    platform: str,
    options: str,
    rate: float,
    trigger: str = "deadline",
    flow: str = IDENTITY,
    more: str = "",
) -> str:
    return f"""\
robot: {robot}
platform: {platform}
platforms: {{'{platform}': {{{options}}}}}
rate: {rate}
pacing: {{trigger: {trigger}, hang: {HELD}}}
flow: {flow}
safety: none
start: none
{more}"""


def _written(folder: Path, joints: int, workflow: str, topics: str) -> tuple[Path, Path]:
    robot = read_yaml(Path(__file__).with_name("bench_robot.yaml")).value
    (joint,) = robot["joints"]
    robot["joints"] = [joint | {"name": name} for name in joint_names(joints)]
    (folder / "bench_robot.yaml").write_text(yaml.safe_dump(robot), "utf-8")
    paths = folder / "workflow.yaml", folder / "robot.yaml"
    for path, text in zip(paths, (workflow, topics)):
        path.write_text(text, "utf-8")
    return paths


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    behind_dds = _unitree if ":" in options.variant else _bridged
    run = _local if options.variant == "local" else behind_dds
    with tempfile.TemporaryDirectory() as folder:
        run(options, Path(folder))


def _bridged(options: argparse.Namespace, folder: Path) -> None:
    log = Log(options.out, "stamp", "seen", "begin", "end")

    def note(program: Program) -> HookBlocks:
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

    variant, effort = options.variant, options.best_effort
    every = round(options.state_rate / options.rate) if variant == "nth" else 0
    alone = variant in ("joints", "nth")
    trigger = "state" if alone else variant
    path, _ = write_bridged(
        folder, options.joints, options.rate, effort, trigger, every, imu=not alone
    )
    Runner(load_workflow(path, hooks=[note])).run()
    log.save()


def _local(options: argparse.Namespace, folder: Path) -> None:
    log = Log(options.out, "stamp", "end")

    def note(program: Program) -> HookBlocks:
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


def identity(command: JointCommand) -> Callable[[], None]:
    """Command what is measured, limp."""

    def tick() -> None:
        command.joint_pos_target[...] = command.joint_pos
        command.joint_vel_target[...] = 0.0
        command.joint_effort_ff[...] = 0.0
        command.joint_stiffness[...] = 0.0
        command.joint_damping[...] = 0.0

    return tick


def _unitree(options: argparse.Namespace, folder: Path) -> None:
    robot, _, trigger = options.variant.partition(":")
    log = Log(options.out, "stamp", "seen", "begin", "end", "cost")

    def note(program: Program) -> HookBlocks:
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

    domain = os.environ["ROS_DOMAIN_ID"]
    reached = f"address: 127.0.0.1, domain: {domain}, connect: 20, silence: 10"
    remote = "states: {wireless_remote: {shape: [40], dtype: uint8}}"
    platform = "unicon_hardware.unitree.platform:make"
    path = folder / "workflow.yaml"
    path.write_text(
        _workflow(robot, platform, reached, options.rate, trigger, f"{OURS}:identity", remote)
    )
    Runner(load_workflow(path, hooks=[note])).run()
    log.save()


if __name__ == "__main__":
    main()
