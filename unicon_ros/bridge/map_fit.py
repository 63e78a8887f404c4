"""Whether a message map fits a workflow's states, told without ROS: for `unicon check`.

The codecs are built as the bridge and platform `ros` build them; neither node nor context is made.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unicon_core.errors import PlatformError, UniconError
from unicon_core.flow import Block, Stage
from unicon_core.platforms.platform import Binding, Facts
from unicon_core.resources import find_config
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_msgs_map import (
    Decoder,
    Encoder,
    MapDependencyError,
    MapStateError,
    load_map,
)
from unicon_ros import compat
from unicon_ros.bridge.bindings import arrays_of, given_by_blocks, names_of, variables_of

if TYPE_CHECKING:
    from unicon_core.check import CheckResult
    from unicon_core.check.subject import Subject
    from unicon_core.workflow import Program

__all__ = ["check_mirror", "examine_platform", "mirror_hook", "refuse_untold", "wanted_of"]

NO_CODECS = "the message map was not looked at: {}"
NO_ROS = "rclpy is not installed: whether ROS knows the map's types was not looked at"


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
    arrays = {name: states[name] for name in states}
    names = {name: spec.names for name, spec in states.layout.specs.items() if spec.names}
    variables: dict[str, object] = {"joint_names": list(robot.joint_names)}
    try:
        heard, said, decoders = _codecs(path, arrays, names, variables)
    except MapDependencyError as error:
        return Binding(Facts("ros", writes=tuple(states), notes=(NO_CODECS.format(error),)))
    except UniconError as error:
        raise PlatformError(f"platform 'ros': {error}") from error
    if not heard:
        raise PlatformError(f"map {path} subscribes to nothing; a robot tells its joint_pos")
    written = dict.fromkeys(state for spec in heard for state in spec.states)
    turned = "base_quat" in written and "projected_gravity" not in written
    if turned:
        written["projected_gravity"] = None
    writes = tuple(dict.fromkeys([*written, "stamp_ns"]))
    read = dict.fromkeys(state for spec in said for state in spec.states)
    reads = tuple(s for s in read if s in states and (s not in writes or s in COMMAND_STATES))
    note = _unknown_types([*heard, *said])

    def require(needed: Mapping[str, str]) -> None:
        refuse_untold(path, wanted_of(needed, writes, turned), decoders, states)

    facts = Facts("ros", reads=reads, writes=writes, notes=(note,) if note else ())
    return Binding(facts, require)


def wanted_of(needed: Mapping[str, str], writes: Iterable[str], turned: bool) -> dict[str, str]:
    """Return those of the needed states that messages tell, with who reads them.

    Args:
        needed: each state that a block on the critical path reads, and that block's name.
        writes: states that the platform writes.
        turned: whether gravity is computed of the orientation.
    """
    wanted = {name: reader for name, reader in needed.items() if name in writes}
    if turned and "projected_gravity" in wanted:
        wanted.setdefault("base_quat", wanted["projected_gravity"])
    return wanted


def refuse_untold(
    path: Path, wanted: Mapping[str, str], decoders: Sequence[Decoder], states: States
) -> None:
    """Refuse a map that writes some elements only of a state that is needed.

    Raises:
        PlatformError: it does.
    """
    for name, reader in wanted.items():
        told = [d.elements(name) for d in decoders if name in d.spec.states]
        written, size = set().union(*told), states[name].size
        if told and len(written) < size:
            raise PlatformError(
                f"platform 'ros': the map {path} writes {len(written)} of {size} "
                f"elements of {name}, which block {reader!r} reads; map the others too"
            )


def mirror_hook(program: Program, name: str | None = None) -> dict[Stage, list[Block]]:
    """Return what stands in the graph for the topics that `--ros` hears, as the bridge has it.

    A map that does not fit gives nothing here: `check_mirror` tells it.

    Args:
        program: on its way to be built; this is a hook of it.
        name: of the map; None for the workflow's own, else the default.
    """
    path = find_config("maps", name or program.document.get("map", str) or "default")
    try:
        heard, _, _ = _codecs(path, arrays_of(program), names_of(program), variables_of(program))
    except UniconError:
        return {}
    states = {state for spec in heard for state in spec.states}
    if not states or not states.isdisjoint(program.platform.facts.writes):
        return {}
    written = given_by_blocks(program)
    writes, amends = tuple(sorted(states - written)), tuple(sorted(states & written))
    inputs = Block("ros inputs", bool, writes=writes, amends=amends, endless=True)
    return {Stage.INPUT: [inputs]}


def check_mirror(subject: Subject, result: CheckResult, name: str | None = None) -> None:
    """Add a finding where the map that `--ros` would use does not fit the workflow.

    Args:
        subject: the built workflow.
        result: is added to.
        name: of the map; None for the workflow's own, else the default.
    """
    program: Program = subject.program
    path = find_config("maps", name or subject.document.get("map", str) or "default")
    try:
        heard, _, _ = _codecs(path, arrays_of(program), names_of(program), variables_of(program))
    except MapDependencyError as error:
        result.note("map.fit", f"map {path}", NO_CODECS.format(error))
        return
    except UniconError as error:
        result.find_error("map.fit", f"map {path}", error)
        return
    for spec in heard:
        for state in spec.states:
            if state in program.platform.facts.writes:
                result.find(
                    "map.fit",
                    spec.where or spec.topic,
                    f"topic {spec.topic!r} would write state {state!r}, which platform "
                    f"{subject.platform.name!r} writes",
                    "take the topic out of the map, or use platform 'ros'",
                )


def _codecs(
    path: Path,
    arrays: Mapping[str, Any],
    names: Mapping[str, Sequence[str]],
    variables: Mapping[str, object],
) -> tuple[list[Any], list[Any], list[Decoder]]:
    """Build every codec of a map; return the entries that are received and sent, and decoders.

    An optional entry whose states are not there is left out, as in a run.

    Raises:
        MapDependencyError: rosbags is not installed.
        MapError: the map is wrong, or does not fit.
    """

    def built(spec: Any, build: Callable[..., Any]) -> Any:
        try:
            return build(spec, arrays, names, variables)
        except MapStateError:
            if not spec.optional:
                raise
            return None

    mapping = load_map(path)
    decoders = [built(spec, Decoder.build) for spec in mapping.subscribe]
    encoders = [built(spec, Encoder.build) for spec in mapping.publish]
    heard = [spec for spec, made in zip(mapping.subscribe, decoders) if made is not None]
    said = [spec for spec, made in zip(mapping.publish, encoders) if made is not None]
    return heard, said, [made for made in decoders if made is not None]


def _unknown_types(specs: Iterable[Any]) -> str:
    """Return a note where ROS is not there to be asked.

    Raises:
        PlatformError: ROS does not know a type that the map needs.
    """
    if find_spec("rclpy") is None:
        return NO_ROS
    for spec in specs:
        if not spec.optional and compat.message_class(spec.type) is None:
            raise PlatformError(
                f"platform 'ros': {spec.where or spec.topic}: the type {spec.type} is not "
                f"installed; install the ROS package {spec.type.split('/')[0]}"
            )
    return ""
