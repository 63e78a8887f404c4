"""What `unicon emulate` prints reaches it: the command of `ready` is run as it stands."""

from __future__ import annotations

import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from emulated_runs import UNICON
from peer import Peer
from test_one_word import NEEDS
from vendor_robots import DRIVES, completed, serve

pytestmark = pytest.mark.timeout(120)

QUICK = ("go1", "rohand")


@pytest.mark.parametrize(
    "name",
    [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in DRIVES],
)
def test_the_printed_command_reaches_it(
    processes: Callable[..., Peer], tmp_path: Path, name: str
) -> None:
    needs = "cyclonedds" if "dfx" in name else NEEDS.get(DRIVES[name])
    if needs is not None:
        pytest.importorskip(needs, reason=f"needs {needs}")
    generation = "legged_sdk_3.8.4" if name == "aliengo" else ""
    file = completed(name, tmp_path)
    robot = serve(processes, name, file, "--model=fake", "--posture=default", generation=generation)
    command = robot.of("ready")[0]["command"]
    words = [word for word in shlex.split(command) if not word.startswith("ROS_DOMAIN_ID=")]
    assert words[:3] == ["unicon", "run", "h1_stand"]
    # On top of what is printed: patience with a busy machine.
    patient = ["--set=pacing.hang=20", f"--set=safety={robot.safety}"]
    if DRIVES[name] != "ros":
        patient += [
            f"--set=platforms.{DRIVES[name]}.{limit}" for limit in ("silence=5", "connect=20")
        ]
    run = subprocess.run(
        [*UNICON, *words[1:], *patient, "--duration=1", "--quiet"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=90,
    )
    assert run.returncode == 0, (command, run.stdout, run.stderr)
    assert robot.wait_for("first")["distance"] < 0.05
