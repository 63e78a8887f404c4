"""Block `grid_map`: a layer of maps on a ROS topic becomes heights around the robot, or a fault."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Fault, UniconError
from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States, standard_states
from unicon_core.terrain.height_map import ElevationGrid, MapHeights
from unicon_core.workflow import Program, load_document
from unicon_core.workflow.autowire import BuildContext
from unicon_msgs_map.layout.messages import shared_messages
from unicon_msgs_map.spec import Qos, SubscribeSpec
from unicon_ros import compat
from unicon_ros import elevation_map as module
from unicon_ros.bench.report import free_domain
from unicon_ros.bridge.own_node import OwnNode
from unicon_ros.bridge.qos import LATCHED, qos_profile
from unicon_ros.elevation_map import GRID_MAP, GridMap, GridMapDecoder

SPEC = SubscribeSpec("heights", GRID_MAP, (), shared_messages())
NOW = 1_000_000_000_000


def ground(x: Any, y: Any) -> Any:
    """Steps along x, other ones along y: no turn and no mirror looks alike."""
    return np.floor(4.0 * np.asarray(x)) * 0.01 + np.floor(4.0 * np.asarray(y)) * 0.1


def grid_map(
    heights: Callable[[Any, Any], Any] = ground,
    *,
    lengths: tuple[float, float] = (3.0, 2.0),
    step: float = 0.05,
    middle: tuple[float, float] = (0.0, 0.0),
    start: tuple[int, int] = (0, 0),
    row_major: bool = False,
    frame: str = "odom",
    stamp: int = NOW,
    turn: float = 0.0,
    layers: tuple[str, ...] = ("variance", "elevation"),
    big: bool = False,
    change: Callable[[Any], Any] = lambda _: None,
) -> bytes:
    """Return a GridMap as bytes, written cell by cell as ANYbotics/grid_map defines them."""
    shared_messages().struct(GRID_MAP)
    store = shared_messages().store
    made: Any = {name.split("/")[-1]: kind for name, kind in store.types.items()}
    rows, columns = (round(length / step) for length in lengths)
    matrix = np.zeros((rows, columns), np.float32)
    for i, j in np.ndindex(rows, columns):
        x = middle[0] + lengths[0] / 2 - (i + 0.5) * step
        y = middle[1] + lengths[1] / 2 - (j + 0.5) * step
        matrix[(i + start[0]) % rows, (j + start[1]) % columns] = heights(x, y)
    sizes = {"column_index": columns, "row_index": rows}
    names = [*sizes][::-1] if row_major else [*sizes]
    layout = made["MultiArrayLayout"](
        [made["MultiArrayDimension"](name, sizes[name], 0) for name in names], 0
    )
    flat = matrix.reshape(-1, order="C" if row_major else "F")
    others = np.full_like(flat, 9.0)
    said = made["GridMap"](
        made["Header"](made["Time"](stamp // 10**9, stamp % 10**9), frame),
        made["GridMapInfo"](
            step,
            *lengths,
            made["Pose"](
                made["Point"](*middle, 0.0),
                made["Quaternion"](0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2)),
            ),
        ),
        list(layers),
        ["elevation"],
        [
            made["Float32MultiArray"](layout, flat if name == "elevation" else others)
            for name in layers
        ],
        *start,
    )
    change(said)
    return bytes(store.serialize_cdr(said, GRID_MAP, little_endian=not big))


class Topic:
    """A topic on which a test sends."""

    polled, topic, why = True, "/heights", ""

    def __init__(self, _: Any, decoder: GridMapDecoder, *__: Any) -> None:
        self.decoder, self.queue = decoder, list[bytes]()

    def poll(self) -> None:
        if self.queue and not self.decoder.decode(self.queue.pop()):
            self.why = self.decoder.last_error
        self.queue.clear()

    def close(self) -> None: ...


class Bench:
    """A block with a base that is put where a test wants it."""

    def __init__(self, **options: Any) -> None:
        self.states = States(standard_states(["j"]) | GridMap.declares(**options))
        self.block = GridMap(BuildContext(self.states, None, 0.02), **options)  # type: ignore[arg-type]
        self.topic: Any = self.block._topic
        self.now = 0.0

    def tick(self, *raws: bytes, at: tuple[float, float] = (0.0, 0.0)) -> None:
        self.states["base_pos_w"][:2] = at
        self.topic.queue += raws
        self.block()

    def matches(self) -> bool:
        """Return whether all that is known is the ground."""
        heights, valid = self.states["height_map"], self.states["height_map_valid"] == 1
        step = float(self.states["height_map_resolution"])
        at = (np.arange(len(heights)) - (len(heights) - 1) / 2) * step
        x, y = self.states["height_map_centre"][:, None].astype(np.float64) + at
        return bool(np.abs(heights - ground(x, y[:, None]))[valid].max() < 1e-5)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Stand in for ROS; return the time in [s], in a list."""
    now = [0.0]

    class Clock:
        monotonic = staticmethod(lambda: now[0])
        time_ns = staticmethod(lambda: NOW + round(now[0] * 1e9))

    class Node:
        node = None

        def close(self) -> None: ...

    monkeypatch.setattr(module, "time", Clock)
    monkeypatch.setattr(module, "TopicIn", Topic)
    monkeypatch.setattr(module, "OwnNode", lambda *_: Node())
    monkeypatch.setattr(module, "message_class", lambda _: None)
    monkeypatch.setattr(compat, "polled_group", lambda: None)
    return now


@pytest.mark.parametrize("start", [(0, 0), (17, 0), (0, 39), (59, 1)])
@pytest.mark.parametrize("row_major", [False, True])
@pytest.mark.parametrize("big", [False, True])
def test_a_map_is_laid_into_the_world_wherever_its_ring_begins(
    start: tuple[int, int], row_major: bool, big: bool, clock: Any
) -> None:
    bench = Bench()
    middle = (0.35, -0.2)
    bench.tick(grid_map(start=start, row_major=row_major, middle=middle, big=big), at=(0.4, -0.1))
    assert bench.matches()
    assert bench.states["height_map_valid"].sum() == 60 * 40  # of 80 x 80
    assert bench.states["height_map_centre"].tolist() == pytest.approx([0.4, -0.1], abs=0.026)
    assert np.isfinite(bench.states["height_map"]).all()


@pytest.mark.parametrize(("step", "size"), [(0.05, 1.0), (0.025, 2.0), (0.1, 4.0)])
def test_another_resolution_or_size_takes_the_nearest_cells(
    step: float, size: float, clock: Any
) -> None:
    bench = Bench(size=size)
    bench.tick(grid_map(lambda x, y: x + 0.1 * y, step=step))
    points = np.stack(np.meshgrid([-0.4, -0.1, 0.0, 0.3], [-0.2, 0.1, 0.42])).reshape(2, -1)
    found = MapHeights(bench.states)(points)
    np.testing.assert_allclose(found, points[0] + 0.1 * points[1], atol=1.1 * max(step, 0.05))


def test_cells_that_are_not_known_are_filled_and_marked(clock: Any) -> None:
    def holed(x: float, y: float) -> float:
        hole = abs(x - 0.3) < 0.1 and abs(y) < 0.1
        return (np.nan if x > 0.3 else np.inf) if hole else 0.25

    bench = Bench(size=2.0)
    bench.tick(grid_map(holed))
    valid = bench.states["height_map_valid"] == 1
    assert (~valid).sum() == 16
    assert bench.states["height_map"] == pytest.approx(0.25)
    bench.tick(grid_map(lambda *_: np.nan))
    assert not bench.states["height_map_valid"].any()
    assert np.isnan(bench.states["height_map"]).all()


def test_the_map_follows_the_robot_and_the_newest_message(clock: Any) -> None:
    bench = Bench(size=1.0)
    bench.tick(grid_map(lengths=(4.0, 4.0)))
    before = bench.states["height_map_centre"].copy()
    bench.tick(at=(0.2, 0.0))
    assert (bench.states["height_map_centre"] == before).all()
    bench.tick(at=(1.0, -0.8))
    assert bench.states["height_map_centre"] == pytest.approx([1.0, -0.8], abs=0.026)
    assert bench.matches()
    # The map jumps by meters, and says the same of the world; then it is of another place.
    bench.tick(grid_map(middle=(3.0, -1.0)), at=(1.6, -0.8))
    assert bench.matches()
    assert 0 < bench.states["height_map_valid"].sum() < 400
    bench.tick(grid_map(middle=(30.0, 0.0)), at=(1.6, -0.8))
    assert not bench.states["height_map_valid"].any()
    for lost in (np.nan, np.inf):
        bench.tick(at=(lost, 0.0))
    assert bench.states["height_map_centre"] == pytest.approx([1.6, -0.8], abs=0.026)


def cut(array: Any) -> None:
    array.data = array.data[:-1]


REFUSED: dict[str, dict[str, Any]] = {
    "it has no layer 'elevation'; known: traversability, variance": {
        "layers": ("variance", "traversability")
    },
    "it has no layer 'elevation'; did you mean 'elevations'?": {"layers": ("elevations",)},
    "it is in frame 'map'; give frame, if base_pos_w is in that": {"frame": "map"},
    "its stamp is 5 s from now; see to clocks": {"stamp": NOW - 5 * 10**9},
    "its stamp is 7 s from now; see to clocks": {"stamp": NOW + 7 * 10**9},
    "x and y, and no turn": {"turn": 0.1},
    "send finite resolution above 0": {"change": lambda m: setattr(m.info, "resolution", 0.0)},
    "nan, 0.0, 0.0, 0.0]; send finite": {
        "change": lambda m: setattr(m.info.pose.position, "y", float("nan"))
    },
    "{'row_index': 120.0, 'column_index': 80.0}": {
        "change": lambda m: setattr(m.info, "resolution", 0.025)
    },
    "has 2399 numbers for {'column_index': 40, 'row_index': 60}": {
        "change": lambda m: cut(m.data[1])
    },
    "from (60, 0) on": {"change": lambda m: setattr(m, "outer_start_index", 60)},
    "from (0, 65535) on": {"change": lambda m: setattr(m, "inner_start_index", 65535)},
    "numbers for {} from": {"change": lambda m: m.data[1].layout.dim.clear()},
    "numbers for {'column_index': 40} from": {"change": lambda m: m.data[1].layout.dim.pop()},
    "it is no GridMap: zip() argument 2 is shorter": {"change": lambda m: m.data.pop()},
    "lengths make {'row_index': -0.0": {"change": lambda m: setattr(m.info, "length_x", -1e-9)},
    "lengths make {'row_index': inf": {
        "change": lambda m: [
            setattr(m.info, k, v) for k, v in (("length_x", 1e308), ("resolution", 1e-9))
        ]
    },
}


@pytest.mark.parametrize("text", REFUSED)
def test_what_does_not_fit_is_refused_with_its_reason(text: str, clock: Any) -> None:
    bench = Bench()
    bench.tick(grid_map())
    before = bench.states["height_map"].copy()
    bench.tick(grid_map(**REFUSED[text]))
    assert bench.block._maps.rejected == 1
    assert text in bench.topic.why
    assert bench.topic.why.startswith("elevation_map (grid_map_msgs/msg/GridMap): ")
    assert np.array_equal(bench.states["height_map"], before)


def test_truncated_and_changed_bytes_never_raise(clock: Any) -> None:
    maps = GridMapDecoder(SPEC, "elevation", "odom", None, 2.0)
    whole, grid = grid_map(lengths=(0.3, 0.2)), ElevationGrid(80, 0.05, 0.0)
    for size in range(len(whole)):
        assert not maps.decode(whole[:size]), size
    random = np.random.default_rng(0)
    for _ in range(3000):
        raw = bytearray(whole)
        for place in random.integers(0, len(raw), random.integers(1, 4)):
            raw[place] = random.choice([0, 1, 127, 255, random.integers(256)])
        if maps.decode(bytes(raw)):
            grid.move(np.zeros(2))
            grid.add(maps.points(np.zeros(2), 2.0), 0.0)
    assert maps.received > 300  # of heights, and of what nothing depends on
    assert maps.decode(whole)


def test_silence_and_repetition_are_a_fault_or_the_last_map(clock: Any) -> None:
    waits = Bench()
    waits.tick()
    clock[0] = 1.9
    waits.tick()
    clock[0] = 2.1
    with pytest.raises(Fault, match=r"^grid_map: no map on topic '/heights' for 2 s; see to what"):
        waits.tick()
    # A map of 1.5 s ago is news for half a second; the same again is none.
    old = grid_map(stamp=NOW + 600_000_000)
    told, holds = Bench(), Bench(on_stale="last")
    for each in (told, holds):
        each.tick(old)
    clock[0] = 2.7
    holds.tick(old)
    assert holds.block._maps.received == 2
    with pytest.raises(Fault, match=r"for 2 s \(the last: elevation_map .* 2\.1 s from now"):
        told.tick(old)
    clock[0] = 500.0
    holds.tick()
    assert holds.matches()
    without = Bench()
    without.tick(grid_map(stamp=0))  # nobody knows its age
    assert without.matches()


def test_a_flood_costs_one_map_a_tick(clock: Any) -> None:
    bench = Bench()
    bench.tick(*[grid_map(lambda *_: 0.5, lengths=(0.5, 0.5))] * 300, grid_map())
    assert bench.block._maps.received == 1
    assert bench.matches()


def test_simulated_maps_have_the_time_of_the_simulation() -> None:
    maps = GridMapDecoder(SPEC, "elevation", "odom", np.array(5 * 10**9), 2.0)
    assert maps.decode(grid_map(stamp=4 * 10**9))
    assert maps.age == pytest.approx(1.0)
    assert not maps.decode(grid_map(stamp=NOW))


WORKFLOW = """\
robot: go2
platform: fake
policies: {walk: go2_stairs}
deferred: [{grid_map: {topic: /heights, stale: 10.0}}]
flow: {chain: [{loop: {do: hold, until: "height_map_centre[0] < 1e6"}}, {policy: walk}]}
safety: [finite]
"""


def test_without_ros_a_workflow_with_it_is_built_and_wrong_options_are_errors(
    tmp_path: Path,
) -> None:
    path = tmp_path / "w.yaml"
    path.write_text(WORKFLOW)
    program = Program(load_document(path), dry=True)
    policy = next(block for block in program.blocks if block.name == "policy")
    assert {"height_map", "height_map_centre"} <= {*policy.reads}
    program.close()
    for text, said in (("/heights", "3maps"), ("10.0", "11.0")):
        path.write_text(WORKFLOW.replace(text, said))
        with pytest.raises(UniconError, match=f"is '?{said}"):
            Program(load_document(path), dry=True)


@pytest.mark.ros
@pytest.mark.timeout(120)
@pytest.mark.parametrize("latched", [False, True])
def test_a_policy_sees_the_maps_of_a_topic(
    latched: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rclpy")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))
    own = OwnNode("mapper", None, ())
    kind = compat.bytes_class(GRID_MAP, shared_messages())
    profile = qos_profile(LATCHED if latched else Qos())
    publisher = own.node.create_publisher(kind, "/heights", profile)
    publish, release = compat.raw_publish(publisher)
    path = tmp_path / "w.yaml"
    path.write_text(WORKFLOW.replace("stale", "latched: true, stale") if latched else WORKFLOW)
    raw, count = grid_map(stamp=0), 0
    if latched:
        publish(raw)  # before anybody listens

    def send() -> None:
        nonlocal count
        count += 1
        if not latched and count % 5 == 0:  # every second one is cut off
            publish(raw if count % 2 else raw[: count % len(raw)])

    hook = {Stage.OBSERVE: [Block("mapper", send, endless=True)]}
    warnings: list[str] = []
    program = Program(load_document(path), hooks=[lambda _: hook])
    try:
        report = Runner(program, RunOptions(duration=6.0, warn=warnings.append)).run()
        assert report.faults == [], warnings
        assert any("it is no GridMap" in line for line in warnings) != latched
        scan = -program.states["height_scan"].reshape(11, 17)
        x, y = np.meshgrid(np.linspace(-0.8, 0.8, 17), np.linspace(-0.5, 0.5, 11))
        close = np.abs(scan - ground(x + 1e-3, y + 1e-3)) < 1e-4
        assert close.mean() > 0.75  # the others lie on a border of cells
    finally:
        release()
        own.close()
