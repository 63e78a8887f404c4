"""Third parties: blocks, platforms and policies of an installed distribution, found by name."""

from __future__ import annotations

import importlib
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from unicon_base.errors import PolicyError, WorkflowError
from unicon_base.packages import all_registered
from unicon_core.policies import load_policy, policy_names
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow
from unicon_core.workflow.registry import known

ROOT = Path(__file__).resolve().parents[2]

CODE = '''
"""A package of somebody else."""

from pathlib import Path

from unicon_core.flow import Amends
from dataclasses import replace

from unicon_core.platforms.fake import FakePlatform

HERE = Path(__file__).parent
WALK = HERE / "walk"
NUMBER = 7
NOWHERE = "/no/such/folder"


def wobble(joint_pos_target: Amends, *, by: float = 0.25):
    """Move the targets of all joints."""

    def tick() -> bool:
        joint_pos_target[...] += by
        return False

    return tick


class BenchRobot(FakePlatform):
    facts = replace(FakePlatform.facts, name="bench_robot")


def bench_robot(states, robot, period, *, scene, time_constant: float = 0.0) -> BenchRobot:
    """A robot on our bench."""
    return BenchRobot(states, robot, period, scene, time_constant)


def walk_of_today() -> Path:
    return HERE / "walk"


def raising() -> Path:
    raise RuntimeError("no licence")
'''

ENTRY_POINTS = """
[unicon.blocks]
wobble = their_robots:wobble
hold = their_robots:wobble
gone_block = their_robots:gone

[unicon.platforms]
bench_robot = their_robots:bench_robot
other_robot = their_robots_of_last_year:make

[unicon.policies]
their_walk = their_robots:WALK
their_walk_by_function = their_robots:walk_of_today
their_number = their_robots:NUMBER
their_nowhere = their_robots:NOWHERE
their_licence = their_robots:raising
their_gone = their_robots:gone
"""

WORKFLOW = """\
robot: go2
platform: bench_robot
platforms: {bench_robot: {time_constant: 0.1}}
policies: {walk: their_walk}
flow:
  zip:
    - policy: walk
    - wobble: {by: 0.5}
safety: [finite]
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder of `sys.path` with a package and its metadata, as pip leaves them."""
    site = tmp_path_factory.mktemp("site")
    package, info = site / "their_robots", site / "their_robots-1.2.dist-info"
    package.mkdir()
    info.mkdir()
    (package / "__init__.py").write_text(CODE, encoding="utf-8")
    shutil.copytree(ROOT / "config" / "policies" / "go2_velocity", package / "walk")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: their-robots\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS, encoding="utf-8")
    sys.path.insert(0, str(site))
    importlib.invalidate_caches()
    known.cache_clear()
    all_registered.cache_clear()
    yield site
    sys.path.remove(str(site))
    sys.modules.pop("their_robots", None)
    known.cache_clear()
    all_registered.cache_clear()


@pytest.fixture
def path(installed: Path, tmp_path: Path) -> Path:
    file = tmp_path / "theirs.yaml"
    file.write_text(WORKFLOW, encoding="utf-8")
    return file


def test_a_workflow_of_their_block_platform_and_policy_runs(path: Path) -> None:
    workflow = load_workflow(path)
    assert workflow.platform.facts.name == "bench_robot"
    assert [block.name for block in workflow.blocks[:2]] == ["policy", "wobble"]
    report = Runner(workflow, RunOptions(duration=0.2, speed="max")).run()
    assert report.ticks == 10
    assert report.faults == []
    assert report.platform == "bench_robot"


def test_their_block_does_what_it_says(path: Path) -> None:
    moved = Runner(load_workflow(path), RunOptions(speed="max"))
    still = Runner(load_workflow(path, ["flow.zip.1.wobble.by=0.0"]), RunOptions(speed="max"))
    for runner in (moved, still):
        runner.tick(0)
        runner.close()
    difference = moved.program.states.joint_pos_target - still.program.states.joint_pos_target
    assert difference.tolist() == pytest.approx([0.5] * 12, abs=1e-6)


def test_a_name_of_ours_is_not_taken_over(installed: Path) -> None:
    assert known("blocks")["hold"] == "unicon_core.blocks.postures:Hold"
    assert known("blocks")["wobble"] == "their_robots:wobble"


@pytest.mark.parametrize("name", ["their_walk", "their_walk_by_function"])
def test_their_policy_is_a_path_or_a_function_that_returns_one(installed: Path, name: str) -> None:
    assert name in policy_names()
    contract = load_policy(name)
    assert contract.path == installed / "their_robots" / "walk" / "policy.yaml"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "their_number",
            "policy 'their_number' (entry point their_robots:NUMBER): its value is of type int; it "
            "must be the path of a folder or file, or a function that returns one",
        ),
        (
            "their_nowhere",
            "policy 'their_nowhere' (entry point their_robots:NOWHERE): no such path "
            "/no/such/folder; install its package again",
        ),
        (
            "their_licence",
            "policy 'their_licence' (entry point their_robots:raising): RuntimeError: no licence; "
            "install its package again",
        ),
        (
            "their_gone",
            "policy 'their_gone' (entry point their_robots:gone): AttributeError: module "
            "'their_robots' has no attribute 'gone'; install its package again",
        ),
    ],
)
def test_a_broken_registration_of_a_policy_is_told(
    installed: Path, name: str, message: str
) -> None:
    with pytest.raises(PolicyError) as caught:
        load_policy(name)
    assert str(caught.value) == message


def test_broken_registrations_of_blocks_and_platforms_are_told(path: Path) -> None:
    with pytest.raises(WorkflowError) as block:
        load_workflow(path, ["flow=gone_block"])
    assert "block 'gone_block': module 'their_robots' has no 'gone'" in str(block.value)
    with pytest.raises(WorkflowError) as platform:
        load_workflow(path, ["platform=other_robot"])
    assert "platform 'other_robot': no module 'their_robots_of_last_year'" in str(platform.value)


def test_an_unknown_name_lists_theirs_too(path: Path) -> None:
    with pytest.raises(WorkflowError, match="unknown block 'wobbel'; did you mean 'wobble'"):
        load_workflow(path, ["flow=wobbel"])
    with pytest.raises(PolicyError, match="unknown policy 'their_wall'; did you mean 'their_walk'"):
        load_workflow(path, ["policies.walk=their_wall"])
