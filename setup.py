"""Package metadata of unicon_ros, for pip and for colcon alike.

Everything stands here and not in a `[project]` table of pyproject.toml, because colcon reads this
file only. No dependency pins to a file, an address or a machine.
"""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = "unicon_ros"
ROOT = Path(__file__).resolve().parent
ROOMS = (
    *("unicon_base", "unicon_core", "unicon_msgs_map", "unicon_ros", "unicon_sims"),
    *("unicon_hardware", "unicon_manipulation", "unicon_lab"),
)

# The wheels of ROS 2 Jazzy exist for CPython 3.10 to 3.14 on x86-64 Linux only. Everywhere else the
# markers leave them out, and rclpy comes from a sourced ROS installation.
ROS_WHEELS = (
    "sys_platform == 'linux' and platform_machine == 'x86_64' "
    "and implementation_name == 'cpython' and python_version < '3.15'"
)

# Elsewhere pip would compile PyBullet for a quarter of an hour.
PYBULLET_WHEELS = (
    "sys_platform == 'linux' and platform_machine == 'x86_64' "
    "and implementation_name == 'cpython' and python_version < '3.12'"
)

# MuJoCo reads the models for all simulators. 4.0.0 has a regression in its sparse Cholesky
# factorization, noted upstream.
SIM = ["mujoco>=3.10,!=4.0.0", "onnxruntime"]

EXTRAS = {
    "sim": SIM,
    "sim-pybullet": [*SIM, f"pybullet==3.2.7; {PYBULLET_WHEELS}"],
    "bags": ["rosbags>=0.11"],
    "ros": [
        f"ros-rclpy[fastrtps]==7.1.6; {ROS_WHEELS}",
        f"ros-jazzy-common-interfaces==5.3.6; {ROS_WHEELS}",
    ],
    # The quadratic programs of block `reach`.
    "ik": ["daqp>=0.7"],
    "zmq": ["pyzmq"],
    # Exports to Parquet: 130 MB installed.
    "parquet": ["pyarrow"],
    # LeRobot data sets: 300 MB. Its own package (6 GB) is not needed.
    "lerobot": ["pyarrow", "av", "pillow"],
    # `unicon sweep`: 220 MB.
    "sweep": ["pyarrow", "scipy>=1.15"],
    "plots": ["matplotlib"],
    # Curves of pages that are hovered and zoomed: uPlot (MIT) as a file of this package.
    "pages": ["matplotlib", "uplot-python==1.1.1"],
    # The live page; its client is part of the package, so that it works off-line.
    "view": ["viser==1.1.1"],
    # `unicon video`.
    "video": [*SIM, "viser==1.1.1", "av", "pillow", "matplotlib"],
    # A headset's page; the second makes its certificate, the third its pictures.
    "webxr": ["websockets>=14", "cryptography>=42", "pillow"],
    # setuptools 80 turns `colcon build --symlink-install` into a silent copy.
    "test": [
        "pytest",
        "pytest-timeout",
        "pytest-xdist>=3.7",
        "pytest-rerunfailures>=16.7",
        "hypothesis",
        "jsonschema",
        "mcap-ros2-support",
        "onnx",
        "prometheus_client",
        "psutil",
        # Peers of hands over Modbus; 3.16 serves `SimDevice`.
        "pymodbus>=3.16,<4",
        "pyserial",
        "colcon-common-extensions",
        "setuptools>=70.1,<80",
    ],
    "completion": ["argcomplete>=3"],
    # Minor versions are held: a new one may format or type differently and break `make check`.
    "dev": ["ruff==0.17.*", "mypy==2.4.*", "import-linter>=2.1", "types-PyYAML", "pdoc>=15"],
}
EXTRAS["all"] = sorted({requirement for extra in EXTRAS.values() for requirement in extra})
# Not in `all`: 765 MB, 703 MB and 4 GB. All are held at what was tried; MJX must be of MuJoCo's own
# version.
EXTRAS["sim-mjx"] = ["mujoco==3.17.0", "mujoco-mjx==3.17.0", "jax[cpu]==0.10.2", "onnxruntime"]
EXTRAS["sim-newton"] = ["newton[sim]==1.8.0", *SIM]
EXTRAS["sim-genesis"] = ["genesis-world==1.4.5", "torch>=2.13", *SIM]
# Nor this: 54 MB, for `--view=foxglove` alone.
EXTRAS["foxglove"] = ["foxglove-sdk==0.30.3", "rosbags>=0.11"]
# Nor this: a camera's driver, which needs Debian's libusb-1.0-0 besides.
EXTRAS["realsense"] = ["pyrealsense2>=2.56"]
# Nor this: 754 MB installed (2.13, CPU), for TorchScript policies alone.
EXTRAS["torch"] = ["torch"]
# Nor this: 6 GB, for policies that LeRobot trained. Held at what was tried.
EXTRAS["lerobot-policies"] = ["lerobot>=0.4.4,<0.5"]
# Nor this: 243 MB, for `unicon sweep --engine ray` alone. Held at what was tried.
EXTRAS["ray"] = ["ray==2.60.0", *EXTRAS["sweep"]]
# Nor what a vendor's protocol needs: a computer on a robot wants that of its robot alone.
EXTRAS["hw-arx"] = ["python-can>=4.3"]
for _robot in ("unitree", "pnd", "dobot", "inspire", "booster"):  # they speak DDS
    EXTRAS[f"hw-{_robot}"] = ["cyclonedds==11.0.1", "rosbags>=0.11"]


def version() -> str:
    """Return the version, which has one home: `unicon_core.__version__`."""
    text = (ROOT / "unicon_core" / "__init__.py").read_text(encoding="utf-8")
    found = re.search(r'^__version__ = "([^"]+)"$', text, re.MULTILINE)
    if found is None:
        raise SystemExit("setup.py: unicon_core/__init__.py has no __version__ line")
    return found.group(1)


def files_below(folder: str) -> list[str]:
    """Return the files below a folder of the source tree, as sorted relative POSIX paths."""
    return sorted(
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and not path.name.startswith(".")
    )


def data_files() -> list[tuple[str, list[str]]]:
    """Return what goes to `share/`: the ament marker, the manifest, and every resource file."""
    share = {f"share/{NAME}": ["package.xml"]}
    for resource in [*files_below("config"), *files_below("launch")]:
        folder = Path(resource).parent.as_posix()
        share.setdefault(f"share/{NAME}/{folder}", []).append(resource)
    marker = ("share/ament_index/resource_index/packages", [f"resource/{NAME}"])
    return [marker, *sorted(share.items())]


BESIDE = (
    *(".cpp", ".h", ".html", ".js", ".json", ".mplstyle", ".msg", ".txt", ".xml", ".yaml"),
    "py.typed",
)
"""Endings of files beside the code."""


def package_data() -> dict[str, list[str]]:
    """Return the files beside the code: type markers, tables, messages, the runtime in C.

    Spelled out file by file, since setuptools before 62.3 (Ubuntu 22.04 has 59.6) knows no `**`.
    """
    return {
        package: [
            Path(path).relative_to(package).as_posix()
            for path in files_below(package)
            if path.endswith(BESIDE)
        ]
        for package in ROOMS
    }


setup(
    name=NAME,
    version=version(),
    description="Learned robot controllers on real and simulated robots inside ROS 2, "
    "free of its overhead",
    long_description=(ROOT / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    license_files=["LICENSE"],
    maintainer="The unicon_ros maintainers",
    maintainer_email="maintainers@unicon-ros.example",
    python_requires=">=3.10",
    packages=find_packages(str(ROOT), include=[f"{room}*" for room in ROOMS]),
    package_data=package_data(),
    data_files=data_files(),
    install_requires=["numpy", "pyyaml"],
    extras_require=EXTRAS,
    entry_points={
        "console_scripts": [
            "unicon = unicon_ros.cli.main:main",
            "unicon_node = unicon_ros.node_main:main",
            "latency_bench = unicon_ros.bench.latency:main",
        ],
        "unicon.blocks": [
            "camera = unicon_ros.bridge.camera:camera",
            "elevation_map = unicon_ros.elevation_map:ElevationMap",
            "grid_map = unicon_ros.elevation_map:GridMap",
            "headset_controls = unicon_manipulation.teleop.operator:HeadsetControls",
            "livox = unicon_hardware.peripherals.livox.livox:livox",
            "reach = unicon_manipulation.reach:Reach",
            "realsense = unicon_hardware.peripherals.realsense:realsense",
            "recorded = unicon_lab.replay.series:recorded",
            "retarget = unicon_manipulation.retargeting_block:Retarget",
            "teleop = unicon_manipulation.teleop.teleop:Teleop",
            "webcam = unicon_hardware.peripherals.webcam:webcam",
            "webxr = unicon_hardware.peripherals.webxr.webxr:webxr",
        ],
        "unicon.platforms": [
            "arx = unicon_hardware.arx.platform:make",
            "azureloong = unicon_hardware.azureloong.platform:make",
            "booster = unicon_hardware.booster.platform:make",
            "dobot = unicon_hardware.dobot.platform:make",
            "fourier = unicon_hardware.fourier.platform:make",
            "gazebo = unicon_ros.bridge.gazebo:make",
            "genesis = unicon_sims.genesis.platform:make",
            "inspire = unicon_hardware.inspire.platform:make",
            "isaacgym = unicon_sims.isaacgym.platform:make",
            "isaaclab = unicon_sims.isaaclab.platform:make",
            "isaacsim = unicon_sims.isaaclab.platform:make",
            "mjx = unicon_sims.mjx.platform:make",
            "newton = unicon_sims.newton.platform:make",
            "pnd = unicon_hardware.pnd.platform:make",
            "pybullet = unicon_sims.pybullet.platform:make",
            "replay = unicon_lab.replay.platform:make",
            "rohand = unicon_hardware.rohand.platform:make",
            "ros = unicon_ros.bridge.ros_platform:make",
            "unitree = unicon_hardware.unitree.platform:make",
            "unitree_dex3 = unicon_hardware.unitree_dex3.platform:make",
            "unitree_legged = unicon_hardware.unitree_legged.platform:make",
            "webots = unicon_sims.webots.platform:make",
            "xhand = unicon_hardware.xhand.platform:make",
        ],
        "unicon.commands": [
            "emulate = unicon_hardware.emulate.command",
            "analyze = unicon_lab.commands.analyze",
            "bag = unicon_lab.commands.bag",
            "diagnose = unicon_lab.commands.diagnose",
            "replay = unicon_lab.commands.replay",
            "report_run = unicon_lab.commands.report_run",
            "serve = unicon_ros.cli.serve",
            "sweep = unicon_lab.commands.sweep",
            "transfer = unicon_lab.commands.transfer",
            "view = unicon_lab.commands.view",
        ],
        "unicon.documents": ["sweep = unicon_lab.sweep.sweep_file:SweepDocument"],
        "unicon.run": ["lab = unicon_lab.run_options"],
        "unicon.faces": [
            "arx = unicon_hardware.arx.platform:face",
            "azureloong = unicon_hardware.azureloong.codec:face",
            "booster = unicon_hardware.booster.takeover:face",
            "dobot_atom = unicon_hardware.dobot.codec:face",
            "fourier_fsa = unicon_hardware.fourier.face:face",
            "inspire = unicon_hardware.inspire.platform:face",
            "inspire_dfx = unicon_hardware.inspire.dds.wire:face",
            "inspire_ftp = unicon_hardware.inspire.dds.wire:face",
            "pnd_adam = unicon_hardware.pnd.platform:face",
            "rohand = unicon_hardware.rohand.platform:face",
            "ros = unicon_hardware.emulate.ros_face:face",
            "unitree_dex3 = unicon_hardware.unitree_dex3.platform:face",
            "unitree_go = unicon_hardware.unitree.face:face",
            "unitree_hg = unicon_hardware.unitree.face:face",
            "unitree_legged = unicon_hardware.unitree_legged.platform:face",
        ],
    },
    zip_safe=False,
)
