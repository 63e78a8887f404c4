"""colcon builds, tests and starts the package in a fresh workspace, copied and symlinked.

Inside this, `colcon test` runs the tests marked `smoke` only (UNICON_TESTS=smoke), so that the
tests do not run themselves. A user's own `colcon test` runs everything but this file and the
installation by pip.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import pytest
from source_tree import copy_source

MODES = {"copied": [], "symlinked": ["--symlink-install"]}


@dataclass(frozen=True)
class Workspace:
    """A colcon workspace that holds a built copy of this source tree."""

    root: Path
    colcon: str
    mode: str

    @property
    def prefix(self) -> Path:
        return self.root / "install" / "unicon_ros"

    def sourced(self, *command: str) -> list[str]:
        """Return the command line that runs a command with the workspace sourced."""
        return ["bash", "-c", '. install/setup.bash && exec "$@"', "sourced", *command]

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            self.sourced(*command), cwd=self.root, capture_output=True, text=True, check=False
        )


@pytest.fixture(
    scope="module", params=["copied", pytest.param("symlinked", marks=pytest.mark.slow)]
)
def workspace(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, under_colcon: bool
) -> Workspace:
    """Build a copy of the source tree with colcon, in each of the two ways to install."""
    if under_colcon:
        pytest.skip("colcon runs these tests already")
    beside = Path(sys.executable).with_name("colcon")
    colcon = str(beside) if beside.exists() else shutil.which("colcon")
    if colcon is None:
        pytest.skip("colcon is not installed: pip install -e '.[test]'")
    root = tmp_path_factory.mktemp(f"workspace_{request.param}")
    copy_source(root / "src" / "unicon_ros")
    done = subprocess.run(
        [colcon, "build", *MODES[request.param], "--event-handlers", "console_direct+"],
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return Workspace(root, colcon, request.param)


@pytest.mark.parametrize("name", ["unicon", "unicon_node"])
def test_an_executable_lies_where_ros2_run_and_launch_look(workspace: Workspace, name: str) -> None:
    assert os.access(workspace.prefix / "lib" / "unicon_ros" / name, os.X_OK)


def test_a_sourced_workspace_runs_its_own_code(workspace: Workspace) -> None:
    done = workspace.run(sys.executable, "-c", "import unicon_core; print(unicon_core.__file__)")
    assert workspace.root in Path(done.stdout.strip()).parents, done.stderr


def test_configuration_and_launch_files_lie_in_the_share(workspace: Workspace) -> None:
    share = workspace.prefix / "share" / "unicon_ros"
    for name in ("config/robots/go2.yaml", "launch/unicon.launch.py", "config/rviz/unicon.rviz"):
        assert (share / name).is_file()
        assert (share / name).is_symlink() is (workspace.mode == "symlinked")


def test_the_node_runs_the_workflow_of_its_parameter_and_ends_on_sigint(
    workspace: Workspace,
) -> None:
    node = workspace.prefix / "lib" / "unicon_ros" / "unicon_node"
    process = subprocess.Popen(
        workspace.sourced(str(node), "--ros-args", "-p", "workflow:=go2_stand"),
        cwd=workspace.root,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    output = ""
    try:
        assert process.stdout is not None
        for line in process.stdout:
            output += line
            if "running go2_stand" in line:
                break
        early = process.poll()
        process.send_signal(signal.SIGINT)
        output += process.communicate(timeout=30)[0]
    finally:
        process.kill()
    assert early is None, f"the node ended by itself:\n{output}"
    assert process.returncode == 0, output
    assert "Traceback" not in output


@pytest.mark.slow
def test_colcon_test_passes_and_did_run_tests(workspace: Workspace) -> None:
    done = subprocess.run(
        [workspace.colcon, "test", "--return-code-on-test-failure"],
        cwd=workspace.root,
        env={**os.environ, "UNICON_TESTS": "smoke"},
        capture_output=True,
        text=True,
        check=False,
    )
    report = workspace.root / "build" / "unicon_ros" / "pytest.xml"
    cases = [case.get("name") for case in ElementTree.parse(report).iter("testcase")]
    log = workspace.root / "log" / "latest_test" / "unicon_ros" / "stdout_stderr.log"
    assert done.returncode == 0, done.stdout + done.stderr + log.read_text(encoding="utf-8")
    assert "test_python_dash_m_prints_the_commands" in cases
