"""`ros2` as users have it: installed, from source on the wheels, or calls that equal its own.

From source: `UNICON_ROS2_SOURCE` names the folders that hold it, separated by colons: checkouts of
ros2/launch, ros2/launch_ros, ros2/ros2cli, ros2/rosidl_runtime_py and osrf/osrf_pycommon, or one
folder with all five, of the branch of the distribution that is installed (jazzy). Nothing is built
or written there: ROS's own Python runs from where it is.

launch_ros names two types of composition_interfaces where it is imported, for containers, which
no test starts; the wheels lack that package, so a module of its name is there to be imported.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

__all__ = ["CLI", "HERE", "LAUNCH", "ROOT", "Clients", "find_clients", "make_prefix"]

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
CLI = (
    *("ros2cli", "ros2topic", "ros2node", "ros2service", "ros2param", "ros2lifecycle", "ros2pkg"),
    *("ros2run", "ros2interface", "rosidl_runtime_py"),
)
LAUNCH = ("launch", "launch_xml", "launch_yaml", "launch_ros", "ros2launch", "osrf_pycommon")
RUN = "#!{python}\nimport sys\nfrom {module} import main\nsys.exit(main())\n"
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
    """Return the folders of the packages whose source is at hand, by name."""
    found: dict[str, Path] = {}
    for root in filter(None, os.environ.get("UNICON_ROS2_SOURCE", "").split(os.pathsep)):
        for setup in sorted(Path(root).rglob("setup.py")):
            for name in (*CLI, *LAUNCH):
                if (setup.parent / name / "__init__.py").is_file():
                    found.setdefault(name, setup.parent.resolve())
    return found


def find_clients(folder: Path, prefix: Path, needed: Sequence[str]) -> Clients:
    """Return how `ros2` is run.

    Args:
        folder: to write to: names of commands, as setup.py tells them.
        prefix: first of the ament path.
        needed: packages without whose source it is not theirs.
    """
    path = [str(prefix), *filter(None, [os.environ.get("AMENT_PREFIX_PATH")]), sys.prefix]
    environment = {"AMENT_PREFIX_PATH": os.pathsep.join(path), "PYTHONUNBUFFERED": "1"}
    installed = shutil.which("ros2")
    if installed is not None:
        return Clients("installed", [installed], environment)
    here = sources()
    if any(name not in here for name in needed):
        equal = [sys.executable, str(HERE / "equal_calls.py")]
        return Clients("equal", equal, environment | {"PYTHONPATH": python_path()})
    folder.mkdir(parents=True, exist_ok=True)
    trees = list(dict.fromkeys(here[name] for name in needed))
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
    command = write_program(folder / "bin" / "ros2", "ros2cli.cli")
    return Clients("source", [str(command)], environment)


def write_program(path: Path, module: str) -> Path:
    """Write an executable that calls `main` of a module, as installations have it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(RUN.format(python=sys.executable, module=module))
    path.chmod(0o755)
    return path


def python_path(*first: Path) -> str:
    """Return a PYTHONPATH with these folders, this source tree and that of the recording robot."""
    mine = [*map(str, first), str(ROOT), str(ROOT / "test" / "attack")]
    return os.pathsep.join([*mine, *filter(None, [os.environ.get("PYTHONPATH")])])


def make_prefix(folder: Path) -> Path:
    """Make an ament prefix with this source tree as package unicon_ros; return it."""
    index = folder / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "unicon_ros").touch()
    share = folder / "share" / "unicon_ros"
    for name in ("launch", "config"):  # `ros2 launch` follows no links to folders
        shutil.copytree(ROOT / name, share / name)
    shutil.copy(ROOT / "package.xml", share)
    for name, module in (
        ("unicon_node", "unicon_ros.node_main"),
        ("unicon", "unicon_ros.cli.main"),
    ):
        write_program(folder / "lib" / "unicon_ros" / name, module)
    return folder
