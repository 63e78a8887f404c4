"""`check`, `robots`, `run` and `preflight` agree: each robot, policy and platform that are shipped.

A run goes as far as the network or the bus, which is replaced: a robot that is looked for was not
refused. Platforms over ROS have a table of their own, test/ros/test_ros_check_is_run.py.
"""

from __future__ import annotations

import socket
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
import yaml

from unicon_base.errors import MissingDependencyError, PlatformError, UniconError
from unicon_core import latches
from unicon_core.check import check_workflow, refuse_errors
from unicon_core.platforms.platform import Facts
from unicon_core.robots import load_robot, robot_names
from unicon_core.robots.table import robots_table
from unicon_core.workflow import Program
from unicon_core.workflow.document import load_document, workflow_names
from unicon_core.workflow.hardware import declared_facts
from unicon_core.workflow.registry import find_factory, known

OPTIONS: dict[str | tuple[str, str], dict[str, Any]] = {
    ("aliengo", "unitree_legged"): {"generation": "legged_sdk_3.8.4"},
    ("inspire_rh56_left", "inspire"): {"device": "/dev/null"},
    ("inspire_rh56_right", "inspire"): {"device": "/dev/null"},
    "arx": {"unverified": True},
    "azureloong": {"address": "127.0.0.1"},
    "dobot": {"fsm_id": 1},
    "rohand": {"device": "/dev/null"},
}
"""What a platform asks of the one who has the robot."""
OVER_ROS = ("gazebo", "ros")
NONE: Mapping[str, Any] = MappingProxyType({})
LOUD = ("arx", "azureloong", "unitree_legged")
"""What cannot be opened to receive only (docs/reference/hardware.md): preflight is refused."""


class Reached(BaseException):
    """The robot is looked for."""


def _reached(*_: Any, **__: Any) -> Any:
    raise Reached


@pytest.fixture
def unreachable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace what opens a robot."""
    from unicon_hardware.arx import platform as arx
    from unicon_hardware.dds.participant import Participant
    from unicon_hardware.modbus import link as reached
    from unicon_hardware.xhand.platform import XhandWire

    monkeypatch.setattr(latches, "ipv4_of", str)  # it asks the kernel through a socket
    monkeypatch.setattr(socket, "socket", _reached)
    monkeypatch.setattr(Participant, "__init__", _reached)
    monkeypatch.setattr(reached, "open_serial", _reached)
    monkeypatch.setattr(reached, "open_tcp", _reached)
    monkeypatch.setattr(arx, "open_bus", _reached)
    monkeypatch.setattr(XhandWire, "__init__", _reached)


def _refusal(path: str | Path, overrides: Mapping[str, Any] = NONE, *, silent: bool) -> str:
    """Return why a run, or a silent one as preflight's, does not begin; "" where it does."""
    try:
        program = Program(load_document(path, overrides), silent=silent)
    except Reached:
        return ""
    except UniconError as error:
        return str(error)
    try:
        refuse_errors(program)
    except UniconError as error:
        return str(error)
    finally:
        program.close()
    return ""


@cache
def _listed() -> str:
    """Return the list of `unicon robots`, with what each lacks below."""
    return robots_table()


def _agree(path: Path, robot: str, platform: str, simulated: bool) -> bool:
    """Compare the four about one pair; return whether it runs."""
    options = OPTIONS.get((robot, platform), OPTIONS.get(platform, {}))
    values = {
        "robot": robot,
        "platform": platform,
        "platforms": {platform: options},
        "rate": 50,
        "flow": {"hold": {}},
        "safety": ["finite", "joint_limits"],
    }
    path.write_text(yaml.safe_dump(values), "utf-8")
    findings = [str(found) for found in check_workflow(path).findings]
    refused = _refusal(path, silent=False)
    assert bool(findings) == bool(refused), (robot, findings, refused)
    if not simulated:
        if not findings:
            assert f"to drive {robot}, set" not in _listed(), (robot, platform)
        else:
            spoken = declared_facts(find_factory("platforms", platform, PlatformError), platform)
            known_protocol = load_robot(robot).transport["protocol"] in spoken.protocols
            assert not known_protocol or load_robot(robot).missing_facts(), (robot, findings)
        if platform not in LOUD:
            assert bool(findings) == bool(_refusal(path, silent=True)), (robot, findings)
    return not findings


def _platform(name: str, request: pytest.FixtureRequest) -> Facts:
    """Return what a platform declares; a robot is out of reach from now on."""
    try:
        facts = declared_facts(find_factory("platforms", name, PlatformError), name)
    except MissingDependencyError as error:
        pytest.skip(str(error))
    if not facts.simulated:
        request.getfixturevalue("unreachable")
    return facts


PLATFORMS = [name for name in known("platforms") if name not in OVER_ROS]


@pytest.mark.parametrize("platform", PLATFORMS)
def test_no_robot_contradicts_on_its_platform(
    platform: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    facts = _platform(platform, request)
    if facts.simulated and platform != "fake":
        pytest.skip("a simulator, as fake")
    for robot in robot_names():
        if facts.simulated or load_robot(robot).transport["protocol"] in facts.protocols:
            _agree(tmp_path / "held.yaml", robot, platform, facts.simulated)


@pytest.mark.slow
@pytest.mark.parametrize("platform", PLATFORMS)
def test_no_pair_of_robot_and_platform_contradicts(
    platform: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    simulated = _platform(platform, request).simulated
    if simulated and platform != "mujoco":
        pytest.skip("a simulator, as mujoco")
    path = tmp_path / "held.yaml"
    runs = [robot for robot in robot_names() if _agree(path, robot, platform, simulated)]
    assert runs or platform in ("dobot", "fourier", "replay"), "no robot can be driven"


@pytest.mark.slow
@pytest.mark.parametrize("platform", PLATFORMS)
def test_no_shipped_policy_contradicts_on_a_platform(
    platform: str, assets: Path, request: pytest.FixtureRequest
) -> None:
    """Every shipped workflow, with its policies, gates and safety blocks.

    A divided one cannot be looked at silently, whatever its platform.
    """
    facts = _platform(platform, request)
    if facts.simulated and platform not in ("mujoco", "fake", "pybullet"):
        pytest.skip("a simulator, as mujoco")
    for workflow in workflow_names():
        document = load_document(workflow)
        robot = str(document.get("robot"))  # of several: no options are known
        options = OPTIONS.get((robot, platform), OPTIONS.get(platform, {}))
        changed = {"platform": platform, "platforms": {platform: options}}
        findings = [str(found) for found in check_workflow(workflow, changed).findings]
        silently = not (facts.simulated or platform in LOUD or "parts" in document.values)
        for silent in (False, True) if silently else (False,):
            refused = _refusal(workflow, changed, silent=silent)
            assert bool(findings) == bool(refused), (workflow, silent, findings, refused)
