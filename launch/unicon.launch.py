"""Starts unicon_node with a workflow, for `ros2 launch unicon_ros unicon.launch.py`.

Everything is decided before anything starts, so that a wrong argument or a missing program never
leaves a controller behind; and the node damps and ends when this launch ends, however it does.

There is an argument for each parameter of the node, and what is not given is left to `params_file`
and to the node. `rviz:=true` opens RViz beside it. `remap` takes ROS's own notation, several
separated by spaces: `remap:="cmd_vel:=teleop/cmd_vel joint_states:=robot/joint_states"`. Several
robots, each in a `namespace`, share /tf: give each its `frame_prefix`, as `namespace:=robot1
frame_prefix:=robot1/`.
"""

import difflib
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from unicon_ros.parameter_table import AT_CONFIGURE, AT_ONCE, LAUNCH

WORKFLOW = "go2_stand"
"""What runs where neither `workflow` nor `params_file` says it."""
DECLARED = (*AT_CONFIGURE, *AT_ONCE)
PARAMETERS = {name: default for name, default, _ in DECLARED} | {"use_sim_time": False}
ARGUMENTS = {name: ("", what) for name, _, what in DECLARED} | LAUNCH
"""Name to default and description; an empty text is not given."""
LAUNCH_OWN = ("launch-prefix", "launch-prefix-filter")
RVIZ_CONFIG = Path(__file__).resolve().parent.parent / "config" / "rviz" / "unicon.rviz"


def truth(text: str, argument: str) -> bool:
    """Return the truth value that an argument says, or raise a ValueError that names it."""
    values = {"true": True, "1": True, "false": False, "0": False}
    if text.lower() not in values:
        raise ValueError(f"argument {argument}:={text}: write true or false")
    return values[text.lower()]


def typed(text: str, argument: str, default: Any) -> Any:
    """Return what an argument says, of the type of a parameter's default, or raise a ValueError."""
    if isinstance(default, bool):
        return truth(text, argument)
    if isinstance(default, int | float):
        try:
            return type(default)(text)
        except ValueError:
            what = "a number" if isinstance(default, float) else "a whole number"
            raise ValueError(f"argument {argument}:={text}: write {what}") from None
    if isinstance(default, list):
        try:
            value = yaml.safe_load(text)
        except yaml.YAMLError:
            value = None
        if not isinstance(value, list) or not all(isinstance(each, str) for each in value):
            raise ValueError(f"argument {argument}:={text}: write a list, as \"['a', 'b']\"")
        return value or [""]
    return ParameterValue(text, value_type=str)


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


def strangers(context: LaunchContext) -> list[str]:
    """Return the arguments that nobody takes, with the nearest of ours, a line for each.

    A launch file that includes this one passes on all that it has itself, so that there only names
    that are nearly ours count.
    """
    here = Path(__file__).resolve()
    direct = any(
        Path(word).resolve() == here or (package, word) == ("unicon_ros", here.name)
        for package, word in zip(["", *sys.argv], sys.argv)
    )
    names = {rule.partition(":=")[0] for rule in context.argv} if direct else set()
    names = names or set(context.launch_configurations)
    found = []
    for name in sorted(names - {*ARGUMENTS, *LAUNCH_OWN}):
        near = difflib.get_close_matches(name, ARGUMENTS, 1, 0.6 if direct else 0.8)
        if direct or near:
            said = f"did you mean {near[0]}? " if near else ""
            found.append(f"no argument {name!r}; {said}known: {', '.join(sorted(ARGUMENTS))}")
    if direct and found:
        raise ValueError("; ".join(found))
    return found


def sections(values: Any, path: str = "") -> Iterator[str]:
    """Return the names of nodes that a parameter file has parameters for; `**` are wildcards."""
    for key, value in values.items() if isinstance(values, dict) else ():
        if key == "ros__parameters":
            yield path or "/"
        else:
            yield from sections(value, f"{path}/{str(key).strip('/')}")


def refuse_parameters(path: str, node: str) -> None:
    """Raise a ValueError where a parameter file says nothing for a node; rcl would not tell."""
    try:
        found = list(sections(yaml.safe_load(Path(path).read_text("utf-8"))))
    except (OSError, ValueError) as error:
        raise ValueError(f"argument params_file:={path}: {error}") from error
    except yaml.YAMLError as error:
        raise ValueError(
            f"argument params_file:={path}: not YAML ({' '.join(str(error).split())})"
        ) from error
    for name in found:
        pattern = re.escape(name).replace(r"/\*\*", "(/.*)?").replace(r"\*", "[^/]+")
        if re.fullmatch(pattern, node):
            return
    raise ValueError(
        f"argument params_file:={path}: it has no parameters for node {node}, but for "
        f"{', '.join(found) or 'none'}; write them under /**: or {node}:, as ros__parameters:"
    )


def nodes(context: LaunchContext) -> list[Any]:
    """Return what to start, once the arguments have their values and all is there."""
    value = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    told = [LogInfo(msg=f"unicon.launch.py: {line}") for line in strangers(context)]
    rviz = truth(value["rviz"], "rviz")
    if rviz:
        distro = os.environ.get("ROS_DISTRO", "<distro>")
        install = f"sudo apt install ros-{distro}-rviz2"
        refuse_missing("rviz2", "rviz2", f"install it ({install}), or leave rviz:=true out")
    if not value["name"]:
        raise ValueError("argument name: the node needs a name, as unicon")
    file = os.path.expanduser(value["params_file"])
    if file:
        full = "/".join(filter(None, (value["namespace"].strip("/"), value["name"])))
        refuse_parameters(file, f"/{full}")
    elif not value["workflow"]:
        value["workflow"] = WORKFLOW
    parameters = {
        name: typed(value[name], name, default)
        for name, default in PARAMETERS.items()
        if value[name]
    }
    # Launch leaves its processes running when it is killed, or gets SIGTERM (systemd does).
    whom = str(os.getpid()) if truth(value["end_with_launch"], "end_with_launch") else "nobody"
    started = [
        Node(
            package="unicon_ros",
            executable="unicon_node",
            name=value["name"],
            namespace=value["namespace"],
            parameters=[*([file] if file else []), parameters],
            arguments=["--end-with", whom],
            remappings=remaps(value["remap"]),
            output="screen",
            # The node damps the motors on SIGINT: give it time before the harder signals.
            sigterm_timeout="10",
            sigkill_timeout="10",
        )
    ]
    if rviz:
        use_sim_time = {"use_sim_time": parameters.get("use_sim_time", False)}
        started.append(
            Node(
                package="rviz2",
                executable="rviz2",
                namespace=value["namespace"],
                arguments=["--display-config", str(rviz_config(value["frame_prefix"]))],
                parameters=[use_sim_time],
            )
        )
    return [*told, *started]


def generate_launch_description() -> LaunchDescription:
    """Return what `ros2 launch` runs."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])
