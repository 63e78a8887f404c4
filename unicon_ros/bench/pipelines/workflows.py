"""Workflows and a robot of any number of joints, written for the benchmark's own controllers."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import JOINT_STATES
from unicon_ros.bench.pipelines.log import COMMAND, IMU, MIRROR, STATE


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


PLATFORM = "unicon_ros.bridge.ros_platform:make"

HELD = 60
"""Longest time that a pipeline is held between its turns in [s], so that it is not a fault."""

_JOINT = (
    "{{name: joint_{i}, lower: -3.0, upper: 3.0, velocity: 20.0, effort: 50.0, default: 0.0, "
    "rest: 0.0, stiffness: 50.0, damping: 1.0}}"
)

_ROBOT = """\
schema: unicon.robot/1
name: bench_robot
description: A robot of the benchmark
manufacturer: none
kind: humanoid
models: {{}}
base_frame: base_link
joints:
{joints}
imu: {{frame: imu_link, position: [0, 0, 0], quat: [1, 0, 0, 0]}}
feet: []
transport: {{protocol: none}}
sources: {{joints: made up, gains: made up, default: made up, rest: made up, imu: made up,
          transport: made up}}
unknown: [feet]
"""


def write_local(
    folder: Path, joints: int, rate: float, state_rate: float, best_effort: bool
) -> tuple[Path, Path]:
    """Write workflow and map of control on local state with ROS as a mirror.

    States are read and mirrored at `state_rate`, commands made at `rate`, as by the other
    pipelines.

    Returns:
        The workflow file and the map file.
    """
    _write_robot(folder, joints)
    platform = "unicon_ros.bench.pipelines.workflows:LocalPlatform"
    every = max(1, round(state_rate / rate))
    workflow = _workflow(platform, "", rate * every, "deadline", every)
    return _written(folder, workflow, f"publish:\n{joint_states_entry(MIRROR, best_effort)}")


def write_bridged(
    folder: Path, joints: int, rate: float, best_effort: bool, trigger: str
) -> tuple[Path, Path]:
    """Write workflow and map of control over topics: the robot is platform `ros`.

    States are heard with best effort, as by shipped maps and by those that say no `qos`.

    Args:
        best_effort: QoS of commands.
        trigger: `deadline` ticks freely, `state` ticks when a state arrives.

    Returns:
        The workflow file and the platform's map file.
    """
    _write_robot(folder, joints)
    workflow = _workflow(PLATFORM, f"'{PLATFORM}': {{map: ./robot.yaml}}", rate, trigger)
    topics = f"""\
subscribe:
{joint_states_entry(STATE, best_effort=True)}
    timeout: {HELD}
  - topic: {IMU}
    type: sensor_msgs/msg/Imu
    qos: {_qos(best_effort=True)}
    timeout: {HELD}
    fields: {{orientation: base_quat, angular_velocity: base_ang_vel,
             linear_acceleration: base_lin_acc}}
publish:
  - topic: {COMMAND}
    type: sensor_msgs/msg/JointState
    qos: {_qos(best_effort)}
    fields: {{header.stamp: stamp_ns, name: $joint_names, position: joint_pos_target}}
"""
    return _written(folder, workflow, topics)


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


def _workflow(platform: str, options: str, rate: float, trigger: str, every: int = 1) -> str:
    identity = "{copy: {source: joint_pos, target: joint_pos_target}}"
    lines = [
        "robot: ./bench_robot.yaml",
        f"platform: {platform}",
        f"platforms: {{{options}}}",
        f"rate: {rate}",
        f"pacing: {{trigger: {trigger}, hang: {HELD}}}",
        f"flow: {identity if every == 1 else f'{{every: {{n: {every}, do: {identity}}}}}'}",
        "safety: none",
        "start: none",
    ]
    return "\n".join(lines) + "\n"


def _write_robot(folder: Path, joints: int) -> None:
    rows = "\n".join(f"  - {_JOINT.format(i=i)}" for i in range(joints))
    (folder / "bench_robot.yaml").write_text(_ROBOT.format(joints=rows), encoding="utf-8")


def _written(folder: Path, workflow: str, topics: str) -> tuple[Path, Path]:
    paths = folder / "workflow.yaml", folder / "robot.yaml"
    for path, text in zip(paths, (workflow, topics)):
        path.write_text(text, encoding="utf-8")
    return paths
