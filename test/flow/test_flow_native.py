"""Native ticks against the Python tick: results, states, memory and faults of random graphs.

Numbers have the same bits; a NaN is a NaN, whatever its payload.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from random_graphs import World, block_kinds, trees

from unicon_base.errors import Fault
from unicon_core.blocks.approach import FadeIn
from unicon_core.blocks.forward_command import CommandStates, ForwardCommand
from unicon_core.blocks.maps import projected_gravity
from unicon_core.blocks.postures import Commands, Damp, Hold, JointCommand, Pose
from unicon_core.blocks.safety import limits, stops
from unicon_core.blocks.safety.servo_stops import TrackingStop
from unicon_core.blocks.safety.stops import Commanded, Elapsed, Settled, tilted
from unicon_core.blocks.safety.stuck import EncoderStop
from unicon_core.blocks.velocity_command import Drive, VelocityCommand
from unicon_core.flow import Block, CompiledGraph, Node, as_block, compile_graph
from unicon_core.flow.block import LinearMap
from unicon_core.flow.fuse import fuse
from unicon_core.memory import Memory
from unicon_core.native.build import COMPILERS
from unicon_core.native.tick import NativeTick
from unicon_core.robots import load_robot
from unicon_core.states import States, StateSpec, standard_states
from unicon_core.states.standard import COMMAND_STATES, forwarded_states
from unicon_core.workflow.autowire import BuildContext
from unicon_core.workflow.uses import expression

pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, COMPILERS)), reason="no C++ compiler (apt install g++)"
)

TICKS = 14
ONCE = (Phase.explicit, Phase.generate)
"""Each example is compiled: to shrink one would take minutes."""
PERIOD = 0.02
ROBOT = load_robot("go2")
SPECIAL = np.array([0.0, -0.0, np.nan, np.inf, -np.inf, 1e-45, -1e-40, 3e38], np.float32)
PYTHONS = "inline code of Python"
STIRRED = ("joint_pos", "joint_vel", "velocity_command", "base_quat", "projected_gravity")


def _servo(s: States) -> limits.Servo:
    return limits.Servo(**{name: s[name] for name in limits.Servo.__annotations__})


def _joints(s: States) -> JointCommand:
    return JointCommand(**{name: s[name] for name in JointCommand.__annotations__})


def _commands(s: States) -> Commands:
    return Commands(**{name: s[name] for name in COMMAND_STATES})


def _forward(s: States, **options: Any) -> ForwardCommand:
    wanted = CommandStates(**{name: s[name] for name in CommandStates.__annotations__})
    context = BuildContext(s, ROBOT, PERIOD, {}, Path())
    return ForwardCommand(_joints(s), wanted, context=context, **options)


MAKERS: dict[str, Callable[[States], Any]] = {
    "copy": lambda s: LinearMap(s["joint_pos"], s["joint_pos_target"]),
    "gather": lambda s: LinearMap(s["joint_vel"], s["few"], [3, 0, 11], 0.3, [1.0, -0.0, 2e-3]),
    "reversed": lambda s: LinearMap(s["joint_pos"], s["joint_vel_target"], range(11, -1, -1)),
    "narrow": lambda s: LinearMap(s["wide"], s["few"], None, None, 1e-3),
    "widen": lambda s: LinearMap(s["few"], s["wide"], None, 1.1, None),
    "column": lambda s: LinearMap(s["square"][:, 1], s["few"]),
    "command": lambda s: VelocityCommand(
        s["velocity_command"], period=PERIOD, schedule=[(0.0, 1.0, 0.0, 0.1), (0.06, 0.2, 0.1, 0)]
    ),
    "ramp": lambda s: VelocityCommand(
        s["velocity_command"], period=PERIOD, constant=(1.0, -0.5, 0.2), ramp=2.0, duration=0.1
    ),
    "pose": lambda s: Pose(_joints(s), robot=ROBOT, period=PERIOD, duration=0.1, fade_in=0.06),
    "hold": lambda s: Hold(_joints(s), robot=ROBOT, period=PERIOD, duration=0.06),
    "keep": lambda s: Hold(_joints(s), robot=ROBOT, period=PERIOD, keep_gains=True),
    "damp": lambda s: Damp(_joints(s), robot=ROBOT, period=PERIOD, duration=0.04),
    "drive": lambda s: Drive(s["sticks"], s["buttons"], s["alive"], s["velocity_command"]),
    "held drive": lambda s: Drive(s["sticks"], s["buttons"], s["alive"], s["velocity_command"],
                                  hold="select"),
    "forward": lambda s: _forward(s, integral=3.0, moves=["*_calf_joint", "FL_*"]),
    "forward home": lambda s: _forward(s, silent="home", duration=0.1),
    "bound": lambda s: expression("0.1 < joint_pos[3] <= 0.6 or not alive", s),
    "turn": lambda s: expression("tick % 3 == 1 and wide[-1] > -0.3 and square[1][2] != 1e-45", s),
    PYTHONS: lambda s: expression("joint_pos[3] * 2.0 > 0.6", s),
    "elapsed": lambda s: Elapsed(period=PERIOD, seconds=0.06),
    "tilted": lambda s: tilted(s["projected_gravity"]),
    "commanded": lambda s: Commanded(s["velocity_command"], period=PERIOD, hold=0.06),
    "settled": lambda s: Settled(s["joint_vel"], period=PERIOD, velocity=0.7, duration=0.04),
    "gravity": lambda s: projected_gravity(s["base_quat"], s["projected_gravity"]),
    "limits": lambda s: limits.joint_limits(s["joint_pos_target"], robot=ROBOT),
    "limit stop": lambda s: limits.joint_limits(s["joint_pos_target"], robot=ROBOT, beyond="trip"),
    "rate": lambda s: limits.rate_limit(s["joint_pos"], s["joint_pos_target"], robot=ROBOT,
                                        period=PERIOD),
    "rate stop": lambda s: limits.rate_limit(s["joint_pos"], s["joint_pos_target"], robot=ROBOT,
                                             period=PERIOD, beyond="trip"),
    "effort": lambda s: limits.effort_limits(_servo(s), robot=ROBOT),
    "effort stop": lambda s: limits.effort_limits(_servo(s), robot=ROBOT, beyond="trip"),
    "fade": lambda s: FadeIn(s["joint_stiffness"], s["joint_vel_target"], s["joint_effort_ff"],
                             period=PERIOD, duration=0.1),
    "finite": lambda s: stops.Finite(_commands(s), robot=ROBOT),
    "tilt": lambda s: stops.TiltStop(s["projected_gravity"]),
    "velocity": lambda s: stops.VelocityStop(s["joint_vel"], states=s, robot=ROBOT),
    "height": lambda s: stops.height_stop(s["base_pos_w"], states=s, robot=ROBOT, lowest=-1.0),
    "stale": lambda s: stops.StaleStop(s["stamp_ns"], period=PERIOD, timeout=0.06),
    "button": lambda s: stops.ButtonStop(s["buttons"], s["alive"], period=PERIOD, lost=0.06),
    "remote": lambda s: stops.RemoteStop(s["buttons"], robot=ROBOT, on=["select"]),
    "tracking": lambda s: TrackingStop(s["joint_pos"], s["joint_pos_target"], s["joint_stiffness"],
                                       robot=ROBOT, period=PERIOD, timeout=0.06),
    "encoder": lambda s: EncoderStop(s["joint_pos"], s["joint_pos_target"], s["joint_stiffness"],
                                     robot=ROBOT, period=PERIOD),
}  # fmt: skip


class NativeWorld(World):
    """A building whose blocks have twins, but for those called "python"."""

    root: Node

    def __init__(self, tree: Any, kinds: Any, names: tuple[str, ...], fused: bool) -> None:
        self.names = iter(names)
        super().__init__(tree, kinds)
        self.root = fuse(self.root, self.states) if fused else self.root
        self.memory = Memory({f"{i}": block.tick for i, block in enumerate(self.blocks)})

    @property
    def states(self) -> States:
        return self._states

    @states.setter
    def states(self, small: States) -> None:
        specs = standard_states(ROBOT.joint_names) | {
            name: small.spec(name) for name in small
        } | {
            **forwarded_states(ROBOT.joint_names), "sticks": StateSpec((4,)),
            "few": StateSpec((3,)), "wide": StateSpec((3,), "float64"),
            "square": StateSpec((3, 3)), "buttons": StateSpec((16,), "bool"),
            "alive": StateSpec((), "bool"),
        }  # fmt: skip
        self._states = States(specs)

    def block(self, i: int, *kind: Any) -> Block:
        name = next(self.names)
        return super().block(i, *kind) if name == "python" else as_block(MAKERS[name](self.states))


def stir(states: States, rng: np.random.Generator, wild: float) -> None:
    """Change what is measured; some of it is what no robot measures."""
    for name in (*STIRRED, *COMMAND_STATES):
        view = states[name].reshape(-1)
        if name in STIRRED or rng.random() < 0.3:
            view += rng.normal(scale=0.3, size=view.size).astype(np.float32)
        odd = rng.random(view.size) < wild
        view[odd] = rng.choice(SPECIAL, odd.sum())
    for name in forwarded_states(ROBOT.joint_names):
        states[name][...] = rng.normal(size=12)
        states[name][rng.random(12) < rng.choice([0.0, 0.5, 1.0])] = np.nan
    states["sticks"][...] = rng.normal(scale=0.6, size=4)
    states["wide"][...] = rng.normal(size=3)
    states["square"][...] = rng.choice(SPECIAL, (3, 3))
    states["tick"][...] += 1
    states["stamp_ns"][...] += rng.integers(2)
    states["buttons"][0] = rng.random() < 0.2
    states["alive"][...] = rng.random() < 0.6


def plain(value: Any) -> Any:
    """Return values with one NaN for all, so that equal means equal bits of all numbers."""
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        return np.where(np.isnan(value), np.nan, value).tobytes()
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(each) for each in value]
    return (type(value), repr(value))


def ticks(
    world: NativeWorld, graph: CompiledGraph, seed: int, wild: float, first: int = 0
) -> Iterator[Any]:
    """Yield all that can be seen of each tick."""
    for number in range(first, TICKS):
        stir(world.states, np.random.default_rng(1000 * seed + number), wild)
        try:
            seen: list[Any] = [graph.step(), graph.deferred()]
        except Fault as fault:
            seen = [str(fault)]
            graph.reset()
        states = [plain(world.states[name]) for name in world.states]
        yield [seen, states, plain(world.memory.take()), graph.save(), [*world.log]]


def refused(line: str) -> None:
    raise AssertionError(line)


examples = st.tuples(
    trees,
    block_kinds,
    st.tuples(*[st.sampled_from(["python", *MAKERS])] * 5),
    st.booleans(),
    st.booleans(),
    st.integers(0, 1000),
    st.sampled_from([0.0, 0.02, 0.3]),
)


def check(
    tree: Any, kinds: Any, names: Any, fused: bool, traced: bool, seed: int, wild: float
) -> None:
    fast, slow, third = (NativeWorld(tree, kinds, names, fused) for _ in range(3))
    graph = NativeTick(fast.states, refused).compile(fast.root, trace=traced)
    python = compile_graph(slow.root, trace=traced)
    makes = compile_graph if seed % 3 else NativeTick(third.states, refused).compile
    after = makes(third.root, trace=traced)
    if not seed % 2:  # the snapshot is of Python then
        fast, slow, graph, python = slow, fast, python, graph
    cut = seed % TICKS
    whole = not any(word in f"{tree} {names}" for word in ("python", "predicate", "switch"))
    with np.errstate(all="ignore"):
        seen = []
        for number, (one, other) in enumerate(
            zip(ticks(fast, graph, seed, wild), ticks(slow, python, seed, wild))
        ):
            assert one == other
            seen.append(one[:4])
            if number == cut and whole:  # another one goes on from a snapshot
                third.states.buffer[:] = fast.states.buffer
                third.memory.put_back(fast.memory.take())
                after.load(graph.save())
                rest = ticks(third, after, seed, wild, cut + 1)
        if whole:
            assert [each[:4] for each in rest] == seen[cut + 1 :]


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@settings(max_examples=8, phases=ONCE)
@given(examples)
def test_native_graphs_equal_python(example: Any) -> None:
    check(*example)


@pytest.mark.slow
@settings(max_examples=1500, phases=ONCE)
@given(examples)
def test_many_native_graphs_equal_python(example: Any) -> None:
    check(*example)


@pytest.mark.parametrize("first", range(0, len(MAKERS), 5))
def test_every_twin_equals_its_block(first: int) -> None:
    native = [name for name in MAKERS if name != PYTHONS]
    names = [*native, *native][first : first + 5]
    blocks = ("zip", tuple(("block", i) for i in range(5)))
    kinds = [((False,), False, False, False)] * 5
    for wild in (0.0, 0.05):
        check(blocks, kinds, tuple(names), False, False, first, wild)
    world = NativeWorld(blocks, kinds, tuple(names), False)
    text = NativeTick(world.states, refused).source(world.root)
    assert "Python runs" not in text
