"""A package of a workspace that brings its own robot, block, map, message, policy and workflow."""

from pathlib import Path

from setuptools import setup

NAME = "pan_tilt"
INDEX = "share/ament_index/resource_index"


def installed(folder: str) -> list[tuple[str, list[str]]]:
    """Return where the files below a folder go: to the same place in the package's share."""
    files: dict[str, list[str]] = {}
    for path in sorted(Path(folder).rglob("*")):
        if path.is_file():
            files.setdefault(f"share/{NAME}/{path.parent.as_posix()}", []).append(path.as_posix())
    return list(files.items())


setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        (f"{INDEX}/packages", [f"resource/{NAME}"]),
        (f"{INDEX}/unicon.config", [f"resource/unicon.config/{NAME}"]),  # see share/…/config
        (f"share/{NAME}", ["package.xml"]),
        *installed("config"),
        *installed("msg"),
    ],
    install_requires=["unicon_ros"],
    entry_points={
        "console_scripts": ["look = pan_tilt.look:main"],  # ros2 run pan_tilt look
        "unicon.blocks": ["look_around = pan_tilt.blocks:look_around"],
        "unicon.config": ["pan_tilt = pan_tilt:config"],  # finds config/ after pip install -e, too
    },
    zip_safe=False,
)
