"""ROS tests: a domain of its own for each test, plain peers as processes, workflows to run."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from command_watch import CommandWatch
from peer import Peer
from ros_helpers import REACT, SWAY, Run

from unicon_core.robots import load_robot
from unicon_ros.bench.report import free_domain

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent


@pytest.fixture(autouse=True)
def domain(monkeypatch: pytest.MonkeyPatch) -> int:
    """A ROS domain of this test alone."""
    number = free_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    return number


def generated(package: str, kind: str) -> dict[str, str]:
    """Return what to change in the environment of a process, so that it can import a package.

    Skips the test where its type `kind` is not installed, and cannot be generated.
    """
    from unicon_ros import compat

    if compat.message_class(kind) is not None:
        return {}
    sys.path.insert(0, str(ROOT / "tools" / "lib"))
    from make_type_support import Unavailable, environment, type_support

    try:
        prefix = type_support({package: HERE / "interfaces" / package})
    except Unavailable as error:
        pytest.skip(f"not tried with generated code: {package} is absent, and {error}")
    values = environment(prefix)
    values["PYTHONPATH"] += f"{os.pathsep}{ROOT}"
    return values


@pytest.fixture(scope="module")
def tf2_environment() -> dict[str, str]:
    """What lets a process import tf2_msgs."""
    return generated("tf2_msgs", "tf2_msgs/msg/TFMessage")


@pytest.fixture(scope="module")
def control_environment() -> dict[str, str]:
    """What lets a process import control_msgs."""
    return generated("control_msgs", "control_msgs/action/FollowJointTrajectory")


@pytest.fixture
def peers(processes: Callable[..., Peer]) -> Callable[..., Peer]:
    """Starts plain rclpy scripts of `peers/`."""

    def start(script: str, *arguments: str, python: str = sys.executable) -> Peer:
        return processes(python, str(HERE / "peers" / f"{script}.py"), *arguments)

    return start


@pytest.fixture
def nodes(processes: Callable[..., Peer]) -> Callable[..., Peer]:
    """Starts unicon_node with ROS arguments."""
    code = "import sys; from unicon_ros.node_main import main; sys.exit(main())"

    def start(*arguments: str) -> Peer:
        os.environ.setdefault("PYTHONPATH", str(ROOT))
        return processes(sys.executable, "-c", code, *arguments)

    return start


@pytest.fixture
def sway(tmp_path: Path) -> Path:
    """A simulated Go2 that stands and leans forward as the velocity command says."""
    path = tmp_path / "sway.yaml"
    path.write_text(SWAY)
    return path


@pytest.fixture
def react(tmp_path: Path) -> Path:
    """A fake Go2 whose hip targets follow the velocity command at once."""
    path = tmp_path / "react.yaml"
    path.write_text(REACT)
    return path


@pytest.fixture
def runs() -> Iterator[Callable[..., Run]]:
    """Starts workflows with a bridge, and ends them."""
    started: list[Run] = []

    def start(*arguments: Any, **options: Any) -> Run:
        run = Run(*arguments, **options)
        started.append(run)
        return run.start()

    yield start
    for run in started:
        if run.alive:
            run.end()
        run.session.close()


@pytest.fixture
def watches() -> Iterator[Callable[[str], CommandWatch]]:
    """Listens to what a robot is commanded."""
    made: list[CommandWatch] = []

    def start(robot: str) -> CommandWatch:
        made.append(CommandWatch(load_robot(robot).joint_names))
        return made[-1]

    yield start
    for watch in made:
        watch.close()
