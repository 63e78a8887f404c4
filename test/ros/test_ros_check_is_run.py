"""`unicon check` says of every shipped workflow on every platform what `unicon run` does.

The verdict of a run is that of its first tick: on the simulators a tick or two are run, without
what winds the run down. On platform `ros` nobody publishes here, so that no tick comes; a run that
is built, would wait for the first message, passes what is asked before a start and has its runner
made is one that begins. Both go through the command line, in this process, with the real rclpy.
"""

from __future__ import annotations

import contextlib
import gc
import io
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

from unicon_base.packages import all_registered
from unicon_core.runtime import Report, Runner
from unicon_ros.bridge.ros_platform import RosPlatform
from unicon_ros.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "pan_tilt"
SIMULATORS = ("mujoco", "pybullet", "fake")
MAPS = sorted(path.stem for path in (ROOT / "config/maps").glob("*.yaml"))
SHIPPED = sorted((ROOT / "config/workflows").glob("*.yaml"))
EXAMPLES = [
    ROOT / "examples" / path
    for path in ("weak_calf.yaml", "rover/drive.yaml", "native/go2_native.yaml")
]
OWN = ROOT / "examples" / PACKAGE / "config"
BUSY = ("go2_nav", PACKAGE + "_look")
FEW = ("agibot_x2", "default", "joint_state_in", "ros_robot", "unitree_go", "unitree_hg")


class Case(NamedTuple):
    """A workflow on a platform, with the map of platform `ros` or of `--ros` beside another."""

    workflow: str
    platform: str
    map: str = ""

    @property
    def arguments(self) -> list[str]:
        """What check and run have in common."""
        path = next((p for p in [*SHIPPED, *EXAMPLES] if p.stem == self.workflow), self.workflow)
        given = [str(path), "--set", f"platform={self.platform}"]
        if self.workflow == "go2_native":  # tests run side by side
            given += ["--set", f"store={{shm: test{os.getpid()}}}"]
        if self.platform == "ros":
            return [*given, "--set", f"platforms.ros.map={self.map}"]
        return [*given, "--ros", "--map", self.map] if self.map else given

    def __str__(self) -> str:
        return "-".join(filter(None, self))


def cases() -> list[Case]:
    """Return every shipped workflow on every platform, and on `ros` with every map."""
    found = []
    own = [path.stem for path in (OWN / "workflows").glob("*.yaml")]
    for workflow in [*(path.stem for path in [*SHIPPED, *EXAMPLES]), *own]:
        more = [path.stem for path in (OWN / "maps").glob("*.yaml")] if workflow in own else []
        found += [Case(workflow, platform) for platform in SIMULATORS]
        found += [Case(workflow, "ros", each) for each in [*MAPS, *more]]
    return found


CASES = cases()
MIRRORED = [Case(case.workflow, "fake", case.map) for case in CASES if case.map]
QUICK = [
    case
    for case in [*CASES, *MIRRORED]
    if (case.workflow in BUSY and (not case.map or case.map in (*FEW, PACKAGE)))
    or case == ("hand_webxr", "fake", "joint_trajectory_in")  # two writers of a command
]


class BeganError(BaseException):
    """A run on platform `ros` has come to its first tick, for which nobody sends data."""


@pytest.fixture(scope="module", autouse=True)
def example(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The package of the examples, as after `pip install -e`."""
    built = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")
    root = tmp_path_factory.mktemp("example") / PACKAGE
    source = shutil.copytree(OWN.parent, root, ignore=built)
    command = [sys.executable, "setup.py", "-q", "egg_info"]
    subprocess.run(command, cwd=source, check=True, capture_output=True, timeout=60)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(source))
        all_registered.cache_clear()
        yield
    all_registered.cache_clear()
    for name in [each for each in sys.modules if each.split(".")[0] == PACKAGE]:
        del sys.modules[name]


@pytest.fixture(autouse=True)
def nobody_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a run on platform `ros` go on where it would wait, up to its first tick."""
    real = Runner.run

    def run(self: Runner) -> Report:
        if self.program.platform.facts.simulated:
            return real(self)
        self.program.close()
        raise BeganError

    monkeypatch.setattr(RosPlatform, "connect", lambda _: None)
    monkeypatch.setattr(Runner, "_wind_down", lambda _: None)
    monkeypatch.setattr(Runner, "run", run)


def call(arguments: Sequence[str]) -> tuple[int, str]:
    """Return exit status and what was said to standard error."""
    said = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        try:
            status = main(arguments)
        except BeganError:
            status = 0
    return status, said.getvalue()


def compare(case: Case, folder: Path) -> None:
    """Check and run one case, and hold both verdicts equal."""
    if case.platform in ("mujoco", "pybullet"):
        pytest.importorskip(case.platform)
    found, told = folder / "findings.json", folder / "report.json"
    checked, _ = call(["check", *case.arguments, "--json", str(found)])
    findings = json.loads(found.read_text("utf-8"))["findings"]
    speed = "real" if case.platform == "ros" else "max"
    options = ["--duration", "0.03", "--speed", speed, "--yes", "--quiet", "--report", str(told)]
    ran, said = call(["run", *case.arguments, *options])
    assert (ran, checked) in ((0, 0), (1, 1)), (findings, said)
    if ran == 1 and "would write state" not in said:  # of which a bridge tells the first alone
        assert any(finding["evidence"] in said for finding in findings), (findings, said)
    if ran == 0 and case.platform != "ros":
        assert json.loads(told.read_text("utf-8"))["ticks"] > 0


@pytest.mark.parametrize("case", QUICK, ids=str)
def test_check_says_what_run_does(case: Case, tmp_path: Path) -> None:
    compare(case, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("case", [c for c in CASES + MIRRORED if c not in QUICK], ids=str)
def test_check_says_what_run_does_everywhere(case: Case, tmp_path: Path) -> None:
    compare(case, tmp_path)


def test_every_shipped_workflow_and_map_is_among_the_cases() -> None:
    workflows = {case.workflow for case in CASES}
    on_disk = [*ROOT.glob("config/workflows/*.yaml"), *ROOT.glob("examples/**/workflows/*.yaml")]
    assert workflows >= {path.stem for path in on_disk}
    maps = {path.stem for path in ROOT.glob("config/maps/*.yaml")}
    for workflow in workflows:
        assert maps <= {c.map for c in CASES if (c.workflow, c.platform) == (workflow, "ros")}
        assert {c.platform for c in CASES if c.workflow == workflow} == {*SIMULATORS, "ros"}
    for path in ROOT.glob("examples/**/*.yaml"):  # a workflow has a flow
        is_workflow = "\nflow:" in path.read_text("utf-8")
        assert not is_workflow or path.stem in workflows


@pytest.mark.slow
def test_runs_of_one_process_leave_no_file_open(capfd: pytest.CaptureFixture[str]) -> None:
    arguments = ["run", "go2_stand", "--set", "platform=fake", "--no-ros", "--quiet"]
    arguments += ["--duration", "0.03", "--speed", "max"]

    def opened() -> int:
        assert main(arguments) == 0
        gc.collect()  # as the next run does where conftest.py lets it
        return len(list(Path("/proc/self/fd").iterdir()))

    first = opened()
    assert [opened() for _ in range(3)] == [first] * 3
