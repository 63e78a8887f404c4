"""Whether a message map fits a workflow's states, told without ROS: for `unicon check`.

The codecs are built as the bridge and platform `ros` build them; neither node nor context is made.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from unicon_base import AnyMapping, PlatformError, UniconError
from unicon_base.arrays import Float32
from unicon_base.resources import find_config
from unicon_core.flow import Block, Stage
from unicon_core.platforms.platform import Binding, Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_msgs_map import (
    Decoder,
    Encoder,
    MapDependencyError,
    MapFileError,
    MapStateError,
    MessageMap,
    load_map,
)
from unicon_msgs_map.spec import TopicSpec
from unicon_ros import compat
from unicon_ros.bridge.bindings import arrays_of, names_of, robot_variables, told_states

if TYPE_CHECKING:
    from unicon_core.check import CheckResult
    from unicon_core.check.subject import Subject
    from unicon_core.workflow import HookBlocks, Program
    from unicon_core.workflow.program_data import ProgramData

ORIENTATION = "base_quat"

EFFORT = "joint_effort_target"
"""What a map of platform `ros` may publish besides states: the torques of the servo in [N·m], for a
robot that takes nothing else."""
MEASURED = ("joint_pos", "joint_vel")
"""What the servo looks at."""

NO_CODECS = "the message map was not looked at: {}"
NO_ROS = "rclpy is not installed: whether ROS knows the map's types was not looked at"


class Exchange:
    """What platform `ros` hears and says by a map, and what that is to a workflow.

    Args:
        path: of the map.
        states: of the workflow.
        decoders: of what is heard.
        said: entries of the map that are published.

    Attributes:
        writes: states that the platform writes.
        reads: states that it reads.
        turned: whether gravity is computed of the orientation.

    Raises:
        PlatformError: nothing is heard.
    """

    def __init__(
        self, path: Path, states: States, decoders: Sequence[Decoder], said: Iterable[TopicSpec]
    ) -> None:
        if not decoders:
            raise PlatformError(f"map {path} subscribes to nothing; a robot tells its joint_pos")
        self._path, self._states, self._decoders = path, states, decoders
        told = [state for decoder in decoders for state in decoder.spec.states]
        self.turned = ORIENTATION in told and "projected_gravity" not in told
        also = ["projected_gravity", "stamp_ns"] if self.turned else ["stamp_ns"]
        self.writes = tuple(dict.fromkeys([*told, *also]))
        read = dict.fromkeys(state for spec in said for state in spec.states)
        if EFFORT in read:
            for state in MEASURED:
                if state not in told:
                    raise PlatformError(
                        f"map {path} publishes {EFFORT}, which is computed of {state}; subscribe "
                        f"a topic that tells {state}"
                    )
            read = dict.fromkeys([*(s for s in read if s != EFFORT), *COMMAND_STATES])
        self.reads = tuple(s for s in read if s not in self.writes or s in COMMAND_STATES)

    def wanted(self, needed: Mapping[str, str]) -> dict[str, str]:
        """Return those of the needed states that messages tell, with who reads them.

        Args:
            needed: each state that a block on the critical path reads, and that block's name.

        Raises:
            PlatformError: the map writes some elements only of a state that is needed.
        """
        wanted = {name: reader for name, reader in needed.items() if name in self.writes}
        if self.turned and "projected_gravity" in wanted:
            wanted.setdefault(ORIENTATION, wanted["projected_gravity"])
        for name, reader in wanted.items():
            told = [d.elements(name) for d in self._decoders if name in d.spec.states]
            written, size = set().union(*told), self._states[name].size
            if told and len(written) < size:
                raise PlatformError(
                    f"platform 'ros': the map {self._path} writes {len(written)} of {size} "
                    f"elements of {name}, which block {reader!r} reads; map the others too"
                )
        return wanted


def examine_platform(
    states: States,
    robot: Robot,
    period: float,
    *,
    map: str = "ros_robot",
    relative_to: Path | None = None,
    **others: Any,
) -> Binding:
    """Return what platform `ros` would read and write; takes what its factory takes.

    Raises:
        PlatformError: the map does not fit the states or the robot.
    """
    path = find_config("maps", map, error=PlatformError, relative_to=relative_to)
    ros_is_there = find_spec("rclpy") is not None
    try:
        decoders, encoders = robot_codecs(load_map(path), states, robot)
        said = [encoder.spec for encoder in encoders]
        for spec in (*(decoder.spec for decoder in decoders), *said) if ros_is_there else ():
            message_class(spec)
    except MapDependencyError as error:
        return Binding(Facts("ros", writes=tuple(states), notes=(NO_CODECS.format(error),)))
    except UniconError as error:
        raise PlatformError(f"platform 'ros': {error}") from error
    exchange = Exchange(path, states, decoders, said)
    notes = () if ros_is_there else (NO_ROS,)
    facts = Facts("ros", reads=exchange.reads, writes=exchange.writes, notes=notes)

    def require(needed: Mapping[str, str]) -> None:
        exchange.wanted(needed)

    return Binding(facts, require)


def robot_codecs(
    mapping: MessageMap, states: States, robot: Robot, effort: Float32 | None = None
) -> tuple[list[Decoder], list[Encoder]]:
    """Build the codecs of a map for platform `ros`, as `codecs` does.

    Args:
        mapping: the map.
        states: of the workflow.
        robot: whose joints they are.
        effort: of the servo in [N·m], shape (n,), which a map may publish as `EFFORT`.
    """
    if mapping.trajectory is not None:
        raise MapFileError(
            "platform 'ros' takes a robot's states, not trajectories; put them into the workflow's "
            "own map",
            mapping.trajectory.where,
        )
    arrays = {name: states[name] for name in states}
    arrays[EFFORT] = np.zeros(robot.num_joints, np.float32) if effort is None else effort
    names = {name: spec.names for name, spec in states.layout.specs.items() if spec.names}
    return codecs(mapping, arrays, names, {"joint_names": list(robot.joint_names)})


def message_class(spec: TopicSpec) -> Any:
    """Return the Python class of a topic's type; None where it is absent and optional.

    Raises:
        PlatformError: ROS does not know the type, and the map needs it.
    """
    message = compat.bytes_class(spec.type, spec.messages)
    if message is None and not spec.optional:
        raise PlatformError(
            f"{spec.where or spec.topic}: topic {spec.topic!r}: the type {spec.type} is not "
            f"installed; {installing(spec)}, or say optional: true"
        )
    return message


def installing(spec: TopicSpec) -> str:
    """Return how to get a topic's type."""
    return f"install the ROS package {spec.type.split('/')[0]}"


def mirror_hook(program: Program, name: str | None = None) -> HookBlocks:
    """Return what stands in the graph for the topics that `--ros` hears, as the bridge has it.

    A map that does not fit gives nothing here: `check_mirror` tells it.

    Args:
        program: on its way to be built; this is a hook of it.
        name: of the map; None for the workflow's own, else the default.
    """
    path = find_config("maps", name or program.document.get("map") or "default")
    try:
        mapping = load_map(path)
        states = {state for spec in _heard(program, mapping) for state in spec.states}
        played = _played(program, mapping)
    except UniconError:
        return {}
    if not states.isdisjoint(program.platform.facts.writes):
        return {}
    written = told_states(program)
    writes, amends = tuple(sorted(states - written)), tuple(sorted(states & written))
    inputs = Block("ros inputs", bool, writes=writes, amends=amends, endless=True)
    trajectory = Block("ros trajectory", bool, writes=played, endless=True)
    return {Stage.INPUT: [*[inputs] * bool(states), *[trajectory] * bool(played)]}


def check_mirror(subject: Subject, result: CheckResult, name: str | None = None) -> None:
    """Add a finding where the map that `--ros` would use does not fit the workflow.

    Args:
        subject: the built workflow.
        result: is added to.
        name: of the map; None for the workflow's own, else the default.
    """
    program = subject.program
    path = find_config("maps", name or subject.document.get("map") or "default")
    try:
        mapping = load_map(path)
        heard = _heard(program, mapping)
        _played(program, mapping)
    except MapDependencyError as error:
        result.note("map.fit", f"map {path}", NO_CODECS.format(error))
        return
    except UniconError as error:
        result.find_error("map.fit", f"map {path}", error)
        return
    for spec in heard:
        for what, remedy in contested_states(spec, program.platform.facts):
            result.find("map.fit", spec.where or spec.topic, what, remedy)


def contested_states(spec: TopicSpec, facts: Facts) -> Iterator[tuple[str, str]]:
    """Yield what is wrong and a remedy for each state of a topic that the platform writes too."""
    for state in spec.states:
        if state in facts.writes:
            yield (
                f"topic {spec.topic!r} would write state {state!r}, which platform {facts.name!r} "
                "writes",
                "take the topic out of the map, or use platform 'ros'",
            )


def _played(program: ProgramData, mapping: MessageMap) -> tuple[str, ...]:
    """Return the states that a map's trajectories write; raises where nobody would follow them."""
    if mapping.trajectory is None:
        return ()
    from unicon_ros.bridge.trajectories import PLAYED, followers  # few need them

    followers(mapping.trajectory, program)
    return PLAYED


def _heard(program: ProgramData, mapping: MessageMap) -> list[TopicSpec]:
    """Return what the bridge hears by a map; raises as `codecs`."""
    bindings = arrays_of(program), names_of(program), robot_variables(program.robot)
    decoders, _ = codecs(mapping, *bindings)
    return [decoder.spec for decoder in decoders]


def codecs(
    mapping: MessageMap,
    arrays: AnyMapping,
    names: Mapping[str, Sequence[str]],
    variables: Mapping[str, object],
) -> tuple[list[Decoder], list[Encoder]]:
    """Build every codec of a map.

    An optional entry whose states are not there is left out, as in a run.

    Raises:
        MapDependencyError: rosbags is not installed.
        MapError: the map is wrong, or does not fit.
    """

    def built(spec: TopicSpec, build: Callable[..., Any]) -> list[Any]:
        try:
            return [build(spec, arrays, names, variables)]
        except MapStateError:
            if not spec.optional:
                raise
            return []

    decoders = [made for spec in mapping.subscribe for made in built(spec, Decoder.build)]
    encoders = [made for spec in mapping.publish for made in built(spec, Encoder.build)]
    return decoders, encoders
