"""`ros2` as users have it: installed, from source on the wheels, or calls that equal its own.

From source: each variable names a checkout of the repository beside it, of the installed
distribution (`git clone -b jazzy …`). Nothing is built: ROS's own Python runs from where it is.

    UNICON_ROS2CLI            ros2/ros2cli
    UNICON_ROSIDL_RUNTIME_PY  ros2/rosidl_runtime_py
    UNICON_LAUNCH             ros2/launch
    UNICON_LAUNCH_ROS         ros2/launch_ros
    UNICON_OSRF_PYCOMMON      osrf/osrf_pycommon

launch_ros imports composition_interfaces, which the wheels lack, for composed nodes, which nothing
here starts: where it is missing an empty module of its name is there to be imported.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

__all__ = ["HERE", "ROOT", "Clients", "make_prefix", "sources"]

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
VARIABLES = {
    "UNICON_ROS2CLI": (
        *("ros2cli", "ros2topic", "ros2node", "ros2service", "ros2param", "ros2lifecycle"),
        *("ros2pkg", "ros2run", "ros2interface"),
    ),
    "UNICON_ROSIDL_RUNTIME_PY": (".",),
    "UNICON_LAUNCH": ("launch", "launch_xml", "launch_yaml"),
    "UNICON_LAUNCH_ROS": ("launch_ros", "ros2launch"),
    "UNICON_OSRF_PYCOMMON": (".",),
}
RUN = "import sys; from ros2cli.cli import main; sys.exit(main())"
UNUSED = """\
class LoadNode:
    class Request: pass
    class Response: pass
"""


@dataclass
class Clients:
    """How `ros2 WORDS…` is run here.

    Attributes:
        whose: `installed`, `source` or `equal`.
        command: what stands before the words.
        environment: the variables.
    """

    whose: str
    command: list[str]
    environment: dict[str, str] = field(default_factory=dict)

    def line(self, *words: str) -> list[str]:
        """Return the command line of `ros2 WORDS…`."""
        if words[0] in ("node", "topic", "param", "lifecycle") and self.whose != "equal":
            words = (*words[:2], "--no-daemon", "--spin-time", "2", *words[2:])
        return [*self.command, *words]

    def run(self, *words: str, timeout: float = 60.0) -> subprocess.CompletedProcess[str]:
        """Run `ros2 WORDS…`."""
        return subprocess.run(
            self.line(*words),
            env={**os.environ, **self.environment},
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )

    def start(self, *words: str, output: Path) -> subprocess.Popen[bytes]:
        """Start `ros2 WORDS…` in a group of its own, as a shell does; both outputs go to a file."""
        with output.open("wb") as file:
            return subprocess.Popen(
                self.line(*words),
                env={**os.environ, **self.environment},
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )


def sources() -> dict[str, Path]:
    """Return the checkouts that are named and there, by variable."""
    named = {name: os.environ.get(name, "") for name in VARIABLES}
    return {name: Path(path) for name, path in named.items() if path and os.path.isdir(path)}


def find_clients(folder: Path, prefix: Path, *needed: str) -> Clients:
    """Return how `ros2` is run.

    Args:
        folder: to write to: names of commands, as setup.py tells them.
        prefix: first of the ament path.
        needed: variables without which it is not theirs.
    """
    path = [str(prefix), *filter(None, [os.environ.get("AMENT_PREFIX_PATH")]), sys.prefix]
    environment = {"AMENT_PREFIX_PATH": os.pathsep.join(path)}
    installed = shutil.which("ros2")
    if installed is not None:
        return Clients("installed", [installed], environment)
    here = sources()
    if any(name not in here for name in needed):
        equal = [sys.executable, str(HERE / "equal_calls.py")]
        return Clients("equal", equal, environment | {"PYTHONPATH": python_path()})
    trees = [root / each for name, root in here.items() for each in VARIABLES[name]]
    folder.mkdir(parents=True, exist_ok=True)
    for tree in trees:  # entry points: ros2cli finds its commands by them
        done = subprocess.run(
            [sys.executable, "setup.py", "-q", "egg_info", "--egg-base", str(folder)],
            cwd=tree,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f"{tree}: {done.stderr}"
    if importlib.util.find_spec("composition_interfaces") is None:
        unused = folder / "composition_interfaces" / "srv"
        unused.mkdir(parents=True, exist_ok=True)
        (unused.parent / "__init__.py").touch()
        (unused / "__init__.py").write_text(UNUSED)
    environment["PYTHONPATH"] = python_path(folder, *trees)
    return Clients("source", [sys.executable, "-c", RUN], environment)


def python_path(*first: Path) -> str:
    """Return a PYTHONPATH with these folders, this source tree and that of the recording robot."""
    mine = [*map(str, first), str(ROOT), str(ROOT / "test" / "attack")]
    return os.pathsep.join([*mine, *filter(None, [os.environ.get("PYTHONPATH")])])


def make_prefix(folder: Path) -> Path:
    """Make an ament prefix with this source tree as package unicon_ros; return it."""
    index = folder / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "unicon_ros").touch()
    share, programs = folder / "share" / "unicon_ros", folder / "lib" / "unicon_ros"
    share.mkdir()
    programs.mkdir(parents=True)
    for name in ("launch", "config"):  # `ros2 launch` follows no links to folders
        shutil.copytree(ROOT / name, share / name)
    shutil.copy(ROOT / "package.xml", share)
    for name, module in (
        ("unicon_node", "unicon_ros.node_main"),
        ("unicon", "unicon_ros.cli.main"),
    ):
        program = programs / name
        program.write_text(
            f"#!{sys.executable}\nimport sys\nfrom {module} import main\nsys.exit(main())\n"
        )
        program.chmod(0o755)
    return folder
