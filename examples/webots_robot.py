"""Prints a robot as plain nodes for a Webots world, with the names that platform `webots` expects.

    python webots_robot.py go2 > go2.wbo

Needs `pip install urdf2webots` (tried: 2025.0.0). docs/reference/platforms.md says what the world
needs besides.
"""

import sys
import tempfile
from pathlib import Path

from unicon_core.models.find import pick_model
from unicon_core.models.kinematic_tree import physical_urdf
from unicon_core.models.load import load_model
from unicon_core.robots import load_robot


def main(name: str) -> None:
    from urdf2webots.importer import convertUrdfFile  # imported here: nothing else needs it

    robot = load_robot(name)
    urdf = physical_urdf(load_model(pick_model(robot, None, None), robot), robot)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.urdf"
        path.write_text(urdf, encoding="utf-8")
        print(convertUrdfFile(input=str(path), robotName=name))


if __name__ == "__main__":
    main(sys.argv[1])
