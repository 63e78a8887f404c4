"""Starts unicon_node with a workflow, for `ros2 launch unicon_ros unicon.launch.py`.

Everything is decided before anything starts, so that a wrong argument or a missing program never
leaves a controller behind; and the node damps and ends when this launch ends, however it does.

`rviz:=true` opens RViz beside it. `remap` takes ROS's own notation, several separated by spaces:
`remap:="cmd_vel:=teleop/cmd_vel joint_states:=robot/joint_states"`. Several robots, each in a
`namespace`, share /tf: give each its `frame_prefix`, as `namespace:=robot1 frame_prefix:=robot1/`.
"""

import os
import tempfile
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "workflow": ("go2_stand", "name or path of the workflow to run"),
    "map": ("", "name or path of the message map; empty: the workflow's own"),
    "namespace": ("", "namespace of the node and of its topics"),
    "frame_prefix": ("", "stands before the names of all frames, such as robot1/"),
    "use_sim_time": ("false", "follow /clock; a simulator in the workflow publishes it itself"),
    "autostart": ("true", "configure and activate at start; else by lifecycle transitions"),
    "record": ("", "file (.mcap) or folder/ to record to; empty: no recording"),
    "record_split": ("", "size or length of a file of a recording, such as 1GB or 60s"),
    "rviz": ("false", "open RViz with the robot, its frames and its odometry"),
    "remap": ("", "remaps as from:=to, separated by spaces"),
}
RVIZ_CONFIG = Path(__file__).resolve().parent.parent / "config" / "rviz" / "unicon.rviz"


def truth(text: str, argument: str) -> bool:
    """Return the truth value that an argument says, or raise a ValueError that names it."""
    values = {"true": True, "1": True, "false": False, "0": False}
    if text.lower() not in values:
        raise ValueError(f"argument {argument}:={text}: write true or false")
    return values[text.lower()]


def remaps(text: str) -> list[tuple[str, str]]:
    """Return the (from, to) pairs of a text like `a:=b c:=d`, or raise a ValueError."""
    pairs = []
    for rule in text.split():
        old, separator, new = rule.partition(":=")
        if not (old and separator and new):
            raise ValueError(f"argument remap: {rule!r} is not of the form from:=to")
        pairs.append((old, new))
    return pairs


def rviz_config(prefix: str) -> Path:
    """Return our view of RViz, or a copy of it that looks for frames with a prefix."""
    if not prefix:
        return RVIZ_CONFIG
    # RViz puts the slash between its prefix and the name of a link by itself.
    before, after = 'TF Prefix: ""', f"TF Prefix: {prefix.removesuffix('/')}"
    text = RVIZ_CONFIG.read_text().replace(before, after)
    for frame in ("odom", "base_link"):
        text = text.replace(f"Frame: {frame}", f"Frame: {prefix}{frame}")
    path = Path(tempfile.mkdtemp(prefix="unicon_rviz_"), RVIZ_CONFIG.name)
    path.write_text(text)
    return path


def refuse_missing(package: str, executable: str, remedy: str) -> None:
    """Raise a RuntimeError where launch would not find an executable of a package.

    Launch itself notices only when it comes to start it, with other processes running already, and
    may then lose those.
    """
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    paths = [Path(prefix, "lib", package, executable) for prefix in prefixes if prefix]
    if not any(os.access(path, os.X_OK) for path in paths):
        raise RuntimeError(
            f"no executable {executable!r} of package {package!r} in AMENT_PREFIX_PATH; {remedy}"
        )


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes to start, once the arguments have their values and all is there."""
    value = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    rviz = truth(value["rviz"], "rviz")
    if rviz:
        distro = os.environ.get("ROS_DISTRO", "<distro>")
        install = f"sudo apt install ros-{distro}-rviz2"
        refuse_missing("rviz2", "rviz2", f"install it ({install}), or leave rviz:=true out")
    use_sim_time = truth(value["use_sim_time"], "use_sim_time")
    parameters = {
        "workflow": ParameterValue(value["workflow"], value_type=str),
        "use_sim_time": use_sim_time,
        "autostart": truth(value["autostart"], "autostart"),
    }
    for name in ("map", "record", "record_split", "frame_prefix"):
        if value[name]:
            parameters[name] = ParameterValue(value[name], value_type=str)
    started = [
        Node(
            package="unicon_ros",
            executable="unicon_node",
            name="unicon",
            namespace=value["namespace"],
            parameters=[parameters],
            # Launch leaves its processes running when it is killed, or gets SIGTERM (systemd does).
            arguments=["--end-with", str(os.getpid())],
            remappings=remaps(value["remap"]),
            output="screen",
            # The node damps the motors on SIGINT: give it time before the harder signals.
            sigterm_timeout="10",
            sigkill_timeout="10",
        )
    ]
    if rviz:
        started.append(
            Node(
                package="rviz2",
                executable="rviz2",
                namespace=value["namespace"],
                arguments=["--display-config", str(rviz_config(value["frame_prefix"]))],
                parameters=[{"use_sim_time": use_sim_time}],
            )
        )
    return started


def generate_launch_description() -> LaunchDescription:
    """Return what `ros2 launch` runs."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])
