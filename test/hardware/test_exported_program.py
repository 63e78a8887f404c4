"""An exported controller as a C++ program walks an emulated Go2; ROS commands and mirrors it.

The process with robot and ROS shares its states; the program publishes the motor commands. What is
killed cannot damp: then the other process does, and where both are gone the robot's own timeout.
"""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from emulated_runs import ROOM, EmulatedUnitree
from peer import Peer

from unicon_core.platforms.kit.command import BLEND
from unicon_core.states.backends.shm import remove_dead
from unicon_ros.cli.main import main

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-unitree]'")
pytest.importorskip("mujoco")
onnxruntime = pytest.importorskip("onnxruntime")
rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 (rclpy)")
pytestmark = [pytest.mark.slow, pytest.mark.ros, pytest.mark.timeout(300)]

WORKFLOW = str(Path(__file__).resolve().parents[2] / "examples" / "native" / "go2_native.yaml")
DEAD_MAN = 0.2
# Of the process with the robot, patient with a busy machine, [s].
TIMEOUT = 0.5
WALK = 14.0
LEAST = 3.0


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The compiled program in the exported folder."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("neither g++ nor clang++ (apt install g++)")
    out = tmp_path_factory.mktemp("program") / "out"
    sets = ["--set", "commands=[]", "--set", "flow={policy: walk}"]
    assert main(["export", "go2_walk", *sets, "--cpp", str(out)]) == 0
    header = ["states", "--header", str(out / "states.h"), WORKFLOW, "--set", "platform=unitree"]
    assert main(header) == 0
    words = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-O2", "-ffp-contract=off"]
    words += ["-DSILENCE_NS=5000000000", "main.cpp", "controller.cpp", "-o", "drive", "-ldl"]
    subprocess.run([compiler, *words], cwd=out, check=True, timeout=120)
    return out / "drive"


class Operator:
    """A plain node of ROS: publishes `cmd_vel` and notes `joint_states`."""

    def __init__(self) -> None:
        from geometry_msgs.msg import Twist
        from sensor_msgs.msg import JointState

        rclpy.init()
        self.states: list[Any] = []
        self._node = rclpy.create_node("operator")
        self._velocity = Twist()
        self._velocity.linear.x = 0.5
        publisher = self._node.create_publisher(Twist, "cmd_vel", 10)
        self._node.create_timer(0.05, lambda: publisher.publish(self._velocity))
        self._node.create_subscription(JointState, "joint_states", self.states.append, 10)
        self._thread = threading.Thread(target=rclpy.spin, args=(self._node,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        rclpy.shutdown()
        self._thread.join(10)
        self._node.destroy_node()


@pytest.fixture
def operator() -> Iterator[Operator]:
    found = Operator()
    yield found
    found.close()


@pytest.mark.parametrize("victims", ["program", "program and process"])
def test_it_walks_and_damps_after_a_kill(
    victims: str,
    program: Path,
    processes: Callable[..., Peer],
    operator: Operator,
    tmp_path: Path,
) -> None:
    library = next((Path(onnxruntime.__file__).parent / "capi").glob("libonnxruntime.so*"))
    robot = EmulatedUnitree(processes, "go2", dead_man=DEAD_MAN)
    name = f"exported-{os.getpid()}"
    external = f"{{segment: {name}-commands, timeout: {TIMEOUT}}}"
    sets = f"--set=store={{shm: {name}}}", f"--set=flow.chain.1.external={external}"
    run = robot.run(WORKFLOW, tmp_path, "--ros", *sets)
    words = [program, library, program.parent, name, f"{name}-commands"]
    driven = subprocess.Popen([*map(str, words)], env={})
    try:
        first = robot.wait_for("first", timeout=30.0)
        time.sleep(WALK)
        assert driven.poll() is None
        assert run.poll() is None, (tmp_path / "run.txt").read_text()
        damped, killed = len(robot.of("damping")), time.monotonic()
        driven.kill()
        if victims != "program":
            run.kill()
        damping = robot.wait_for("damping", damped + 1)
        took = damping["after"] - killed
        print(
            f"{victims}: first command {first['distance']:.3f} rad off, damping by {damping['by']} "
            f"after {took:.3f} s, {len(operator.states)} joint_states"
        )
        if victims == "program":  # the process damps and ends; then no command comes
            assert damping["by"] == "command"
            assert took < TIMEOUT + BLEND + ROOM
            assert run.wait(30) == 3
            said = (tmp_path / "run.txt").read_text()
            assert f"-commands' has been silent for {TIMEOUT:g} s" in said
            damping = robot.wait_for("damping", damped + 2)
        else:
            assert took < DEAD_MAN + ROOM
        assert damping["by"] == "dead man"
    finally:
        driven.kill()
        driven.wait(10)
        run.kill()
        run.wait(10)
        for each in (name, f"{name}-commands"):
            assert remove_dead(each)  # the states stayed
    moved = robot.moved()
    print(f"{victims}: moved {moved:.2f} m")
    assert moved >= LEAST
    states = operator.states
    assert len(states) > 10 * WALK
    assert len(states[-1].name) == 12
    assert math.dist(states[0].position, states[-1].position) > 0.1
