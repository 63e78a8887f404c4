"""ROS's own launch and ros2cli, installed from their sources for a test: they have no wheels.

`UNICON_ROS2_SOURCE` names the folders that hold them, separated by colons: checkouts of
ros2/launch, ros2/launch_ros, ros2/ros2cli, ros2/rosidl_runtime_py and osrf/osrf_pycommon, or one
folder with all five, of the branch of the distribution that is installed (jazzy). Nothing is
written there.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

__all__ = ["Lacking", "Ros2"]

ROOT = Path(__file__).resolve().parent.parent.parent
NEEDED = (
    *("launch", "launch_xml", "launch_yaml", "launch_ros", "ros2launch", "osrf_pycommon"),
    "rosidl_runtime_py",
    *("ros2cli", "ros2pkg", "ros2lifecycle", "ros2node", "ros2param", "ros2service", "ros2topic"),
)
NODE = """\
#!/bin/sh
exec {python} -c 'import sys; from unicon_ros.node_main import main; sys.exit(main())' "$@"
"""
# launch_ros names these two types where it is imported, for containers that no test starts.
COMPOSITION = "class LoadNode:\n    class Request: ...\n    class Response: ...\n"


class Lacking(Exception):
    """There is no source; the message says what to set."""


class Ros2:
    """The command `ros2`, and a prefix in which it finds unicon_ros.

    Args:
        folder: where all of it is put.

    Raises:
        Lacking: a package is not below the folders of UNICON_ROS2_SOURCE.
    """

    def __init__(self, folder: Path) -> None:
        given = [Path(each) for each in os.environ.get("UNICON_ROS2_SOURCE", "").split(":") if each]
        if not given:
            raise Lacking("set UNICON_ROS2_SOURCE to checkouts of launch, launch_ros and ros2cli")
        self.site, self.prefix = folder / "site", folder / "prefix"
        wheels = folder / "wheels"
        for name in NEEDED:
            found = [
                setup.parent
                for root in given
                for setup in sorted(root.rglob("setup.py"))
                if (setup.parent / name / "__init__.py").is_file()
            ]
            if not found:
                raise Lacking(f"no package {name} below UNICON_ROS2_SOURCE")
            if name == "osrf_pycommon":  # its setup.py asks for an older setuptools
                shutil.copytree(found[0] / name, self.site / name)
                continue
            copy = shutil.copytree(found[0], folder / "source" / name)
            _run("setup.py", "-q", "bdist_wheel", "-d", str(wheels), at=copy)
        pip = ("-m", "pip", "install", "-q", "--no-deps", "--no-index", "--upgrade")
        _run(*pip, "--target", str(self.site), *map(str, wheels.glob("*.whl")), at=folder)
        composition = self.site / "composition_interfaces" / "srv"
        composition.mkdir(parents=True)
        (composition.parent / "__init__.py").touch()
        (composition / "__init__.py").write_text(COMPOSITION)
        self._install()

    def _install(self) -> None:
        share = self.prefix / "share"
        index = share / "ament_index" / "resource_index" / "packages"
        for each in (index, share / "unicon_ros" / "launch", self.prefix / "lib" / "unicon_ros"):
            each.mkdir(parents=True)
        (index / "unicon_ros").touch()
        launch = share / "unicon_ros" / "launch" / "unicon.launch.py"
        launch.symlink_to(ROOT / "launch" / launch.name)
        node = self.prefix / "lib" / "unicon_ros" / "unicon_node"
        node.write_text(NODE.format(python=sys.executable))
        node.chmod(0o755)

    def environment(self, *paths: Path) -> dict[str, str]:
        """Return the variables of a shell in which it is sourced; `paths` go before PYTHONPATH."""
        return os.environ | {
            "PYTHONPATH": os.pathsep.join(map(str, (*paths, ROOT, self.site))),
            "AMENT_PREFIX_PATH": os.pathsep.join((str(self.prefix), sys.prefix)),
            "PYTHONUNBUFFERED": "1",
        }

    def start(self, *words: str, paths: tuple[Path, ...] = ()) -> subprocess.Popen[str]:
        """Start `ros2 WORDS…` in a process group of its own."""
        return subprocess.Popen(
            [sys.executable, str(self.site / "bin" / "ros2"), *words],
            env=self.environment(*paths),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    def say(self, *words: str) -> tuple[int, str]:
        """Run `ros2 WORDS…`; return its exit status and what it said."""
        started = self.start(*words)
        try:
            said, _ = started.communicate(timeout=60)
        finally:
            started.kill()
        return started.returncode, said


def _run(*words: str, at: Path) -> None:
    done = subprocess.run(
        [sys.executable, *words], cwd=at, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(words)} in {at}:\n{done.stdout}{done.stderr}")
