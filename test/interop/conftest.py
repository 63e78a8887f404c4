"""Interoperability tests: a ROS domain for each module, generated types, a second distribution."""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from talkers import clean_environment

from unicon_ros.bench.report import free_domain

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools" / "lib"))
KILTED = ["ros-rclpy[fastrtps]==9.1.2", "ros-kilted-common-interfaces"]


@pytest.fixture(autouse=True, scope="module")
def domain() -> Iterator[None]:
    """A ROS domain of this module alone."""
    before = os.environ.get("ROS_DOMAIN_ID")
    os.environ["ROS_DOMAIN_ID"] = str(free_domain())
    yield
    if before is not None:
        os.environ["ROS_DOMAIN_ID"] = before


@pytest.fixture(scope="session")
def type_support() -> dict[str, str]:
    """Environment in which aimdk_msgs, tf2_msgs, unitree_go and unitree_hg import; generated."""
    from make_type_support import Unavailable, environment
    from make_type_support import type_support as made

    from unicon_ros import compat

    messages = ROOT / "unicon_msgs_map" / "msg"
    packages = {
        "tf2_msgs": ROOT / "test" / "ros" / "interfaces" / "tf2_msgs",
        "unitree_go": messages / "unitree_go",
        "unitree_hg": messages / "unitree_hg",
        "aimdk_msgs": messages / "aimdk_msgs",
    }
    examples = ("tf2_msgs/msg/TFMessage", "unitree_go/msg/LowCmd", "unitree_hg/msg/LowCmd")
    examples += ("aimdk_msgs/msg/JointStateArray",)
    absent = {
        name: packages[name]
        for name, example in zip(packages, examples)
        if compat.message_class(example) is None
    }
    if not absent:
        return {}
    if "ROS_DISTRO" in os.environ:
        pytest.skip(f"no type support of {', '.join(absent)}: build these packages with colcon")
    try:
        values = environment(made(absent))
    except Unavailable as error:
        pytest.skip(f"no type support of {', '.join(absent)}: {error}")
    values["PYTHONPATH"] += f"{os.pathsep}{ROOT}"
    return values


@pytest.fixture(scope="session")
def kilted() -> Callable[[], str]:
    """Returns the Python of a venv with Kilted's wheels, made where it is not there yet."""

    def made() -> str:
        home = ROOT / "build" / "kilted" / f"venv-{sys.version_info[0]}.{sys.version_info[1]}"
        python = home / "bin" / "python"
        if not (home / "whole").exists():
            venv.create(home, with_pip=True, clear=True)
            install = [str(python), "-m", "pip", "install", "--quiet", *KILTED]
            install += ["numpy", "pyyaml", "rosbags"]
            done = subprocess.run(
                install, env=clean_environment(), capture_output=True, text=True, check=False
            )
            if done.returncode:
                pytest.skip(f"Kilted's wheels cannot be installed ({done.stderr[-300:]})")
            (home / "whole").touch()
        install = [str(python), "-m", "pip", "install", "--quiet", "--no-deps"]
        subprocess.run(
            [*install, "--force-reinstall", str(ROOT)], env=clean_environment(), check=True
        )
        return str(python)

    return made
