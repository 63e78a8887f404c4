"""What `import unicon_core` and `unicon --help` must not load."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("rclpy", "mujoco", "onnxruntime", "rosbags", "torch")


def loaded(code: str, modules: tuple[str, ...]) -> list[str]:
    """Return which of some modules a program loads."""
    look = f"{code}\nimport sys\nprint('LOADED', *sorted(set({modules!r}) & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", look], capture_output=True, text=True, timeout=60, check=True
    )
    return done.stdout.splitlines()[-1].split()[1:]


@pytest.mark.smoke
@pytest.mark.parametrize(
    "code",
    [
        "import unicon_core",
        "import unicon_core.workflow, unicon_core.runtime, unicon_core.policies",
        "from unicon_ros.cli.main import main\nmain(['robots'])",
    ],
)
def test_optional_packages_are_not_loaded_before_they_are_needed(code: str) -> None:
    assert loaded(code, HEAVY) == []


def test_help_loads_not_even_numpy() -> None:
    code = "from unicon_ros.cli.main import main\ntry: main(['--help'])\nexcept SystemExit: pass"
    assert loaded(code, (*HEAVY, "numpy", "yaml")) == []


def test_the_list_of_workflows_loads_not_even_numpy() -> None:
    code = "from unicon_ros.cli.main import main\nmain(['workflows'])"
    assert loaded(code, (*HEAVY, "numpy", "unicon_core.runtime", "unicon_core.policies")) == []


def test_a_named_command_loads_no_other_packages_commands() -> None:
    code = (
        "from unicon_ros.cli.main import main\ntry:\n    main([{}])\nexcept SystemExit:\n    pass"
    )
    theirs = ("unicon_lab.commands.sweep",)
    assert loaded(code.format("'check', '--help'"), theirs) == []
    assert loaded(code.format("'--help'"), theirs) == list(theirs)
