"""What `import unicon_core` and `unicon --help` must not load."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("rclpy", "mujoco", "onnxruntime", "rosbags", "torch")


@pytest.mark.smoke
@pytest.mark.parametrize(
    "code",
    [
        "import unicon_core",
        "import unicon_core.workflow, unicon_core.runtime, unicon_core.policies",
        "from unicon_ros.cli.main import main\ntry: main(['--help'])\nexcept SystemExit: pass",
        "from unicon_ros.cli.main import main\nmain(['robots'])",
    ],
)
def test_optional_packages_are_not_loaded_before_they_are_needed(code: str) -> None:
    look = f"{code}\nimport sys\nprint('LOADED', *sorted(set({HEAVY!r}) & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", look], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.splitlines()[-1] == "LOADED"
