"""What a viewer's process is given first, and how a tick lies in the ring."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from unicon_base import UniconError
from unicon_base.located_yaml import read_yaml
from unicon_core.flow import Chain, Node, Switch
from unicon_core.flow.compiled import CompiledGraph
from unicon_core.models.find import model_of, terrain_of
from unicon_core.platforms.platform import Pushable, TakesForces
from unicon_core.robots import Robot
from unicon_core.runtime.phases import Phase
from unicon_core.show.text import branches, title
from unicon_core.states import Layout, StateSpec
from unicon_core.states.standard import EXTERNAL_FORCE, EXTERNAL_PUSH
from unicon_core.terrain.words import Terrain
from unicon_core.workflow import Program
from unicon_core.workflow.flow_yaml import skills_of
from unicon_core.workflow.policies import shadowed_in
from unicon_lab.recording.ticks import Names, term_names
from unicon_ros.parameter_table import AT_ONCE, RANGES
from unicon_ros.peripheral import peripheral_states

NAME = "view"
"""Of the peripheral that a viewer's process is."""

HEAD = struct.Struct("<10q")
"""What a tick begins with: number, when its copy was made [ns, CLOCK_MONOTONIC], phase, paused;
of the tick before, lateness and time that it took [ns]; overruns, who drives (1: the viewer),
robots, counters. Then the counters of the graph, int64, and the states."""

DRIVING, GIVEN_BACK = 1, 2
"""Values of `view_mode`; 0: nobody drives."""

DEAD_MAN = 0.5
"""So long a driver counts that is not heard, in [s]."""

_STATES = read_yaml(Path(__file__).with_name("states.yaml")).value
PAGE = peripheral_states(NAME, {name: StateSpec(**spec) for name, spec in _STATES.items()})
"""What a viewer's process tells, beside the states of the workflow. Its stamp is when the driver
was heard last."""


@dataclass(frozen=True)
class GraphLine:
    """A line of the picture of the graph.

    Attributes:
        depth: below the root.
        text: of the node.
        when: it runs where each of these counters has this value.
        number: of the counter that tells which of its children runs, -1 for none.
    """

    depth: int
    text: str
    when: tuple[tuple[int, int], ...]
    number: int = -1

    def runs(self, counters: Sequence[int]) -> bool:
        """Tell whether the node is in its turn."""
        return all(counters[number] == value for number, value in self.when)


@dataclass(frozen=True)
class Parameter:
    """A number that may be changed while ticks run.

    Attributes:
        value: at present.
        low, high: its range.
        description: what it does, with its unit.
    """

    value: float
    low: float
    high: float
    description: str


@dataclass(frozen=True)
class Shown:
    """A run, as a viewer is told of it.

    Attributes:
        workflow: its name.
        platform: name of the platform.
        simulated: it is a simulator, which can be paused, stepped and reset.
        robot: the robot.
        model: the file that describes its links; None where there is none.
        layout: of the states in the ring.
        period: of a tick in [s].
        phases: names of the phases, by number.
        graph: lines of the picture of the graph.
        skills: names; the state `skill` is the number of the present one.
        command_bounds: lowest and highest vx, vy [m/s] and wz [rad/s].
        drives: a velocity command is read by somebody.
        parameters: those that may be changed, with their present values.
        map: name of the message map.
        frame_prefix: of ROS frames.
        terrain: the ground under a simulated robot, None for flat.
        swaps: a policy ticks beside another one and may replace it.
        bodies: names of the simulated bodies by their numbers, where a viewer may drag them.
        pushes: the base of a simulated robot may be pushed.
        names: of elements of states, as of `term_names`.
        records: the run leaves a recording.
    """

    workflow: str
    platform: str
    simulated: bool
    robot: Robot
    model: Path | None
    layout: Layout
    period: float
    phases: tuple[str, ...]
    graph: tuple[GraphLine, ...]
    skills: tuple[str, ...] = ()
    command_bounds: tuple[tuple[float, float], ...] = ()
    drives: bool = False
    parameters: dict[str, Parameter] = field(default_factory=dict)
    map: str = "default"
    frame_prefix: str = ""
    terrain: Terrain | None = None
    swaps: bool = False
    bodies: tuple[str, ...] = ()
    pushes: bool = False
    names: Names = field(default_factory=dict)
    records: bool = False

    def tell(self, values: Mapping[str, float]) -> None:
        """Note the present values of parameters; in a viewer's process."""
        for name, value in values.items():
            if name in self.parameters:
                self.parameters[name] = replace(self.parameters[name], value=float(value))


def shown_of(
    program: Program, graph: CompiledGraph, map: str = "default", frame_prefix: str = ""
) -> tuple[Shown, tuple[str, ...]]:
    """Return what is told of a program, and the graph's variables that are its counters.

    Args:
        program: it.
        graph: the compiled tick of its run.
        map: name of the message map.
        frame_prefix: of ROS frames.
    """
    try:
        model = model_of(program.platform, program.robot)
    except UniconError:
        model = None
    variables = tuple(graph.places.values())
    numbers = {owner: number for number, owner in enumerate(graph.places)}
    bounds = tuple((bound.low, bound.high) for bound in program.command_bounds)
    skills, platform = skills_of(program), program.platform
    bodies: tuple[str, ...] = ()
    if isinstance(platform, TakesForces) and EXTERNAL_FORCE in program.states:
        bodies = platform.bodies
    shown = Shown(
        program.name,
        program.platform.facts.name,
        program.platform.facts.simulated,
        program.robot,
        model,
        program.states.layout,
        program.period,
        tuple(phase.value for phase in Phase),
        tuple(_lines(program.root, numbers, "", 0, ())),
        () if skills is None else skills.names,
        bounds,
        bool(bounds),
        {
            name: Parameter(value, *RANGES[name], what)
            for name, value, what in AT_ONCE
            if name in RANGES
        },
        map,
        frame_prefix,
        terrain_of(program.platform),
        shadowed_in(program.blocks) is not None,
        bodies,
        pushable(program),
        term_names(program),
    )
    return shown, variables


def pushable(program: Program) -> bool:
    """Tell whether the base of a simulated robot may be pushed, and a record shows it."""
    platform = program.platform
    moves = "base_lin_vel" in platform.facts.writes and isinstance(platform, Pushable)
    return moves and platform.facts.simulated and EXTERNAL_PUSH in program.states


def _lines(
    node: Node,
    numbers: Mapping[int, int],
    label: str,
    depth: int,
    when: tuple[tuple[int, int], ...],
) -> list[GraphLine]:
    number = numbers.get(id(node), -1) if isinstance(node, Chain | Switch) else -1
    text = f"{label}: {title(node)}" if label else title(node)
    lines = [GraphLine(depth, text, when, number)]
    for place, (name, child) in enumerate(branches(node)):
        inside = when if number < 0 else (*when, (number, place))
        lines += _lines(child, numbers, name, depth + 1, inside)
    return lines
