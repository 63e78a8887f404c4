"""Pictures in a contract: how they are made of frames, what fills them, what is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import numpy_helper
from policy_helpers import robot, toy_values, write_graph, write_toy

from unicon_base.errors import Fault, PolicyError, UniconError
from unicon_core.flow import Block, Stage
from unicon_core.handles import FrameRing
from unicon_core.policies import Policy, load_policy, perception, policy_states, policy_table
from unicon_core.policies.perception import ImageSpec, ImageTerm, taps
from unicon_core.policies.policy_yaml import write_policy_yaml
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States, StateSpec, standard_states
from unicon_core.workflow import Program, load_document
from unicon_core.workflow.autowire import BuildContext
from unicon_lab.recording import open_record
from unicon_ros.bridge.images import FrameMessage, cloud_message, frame_message, jpeg_message
from unicon_ros.cli.main import main
from unicon_ros.peripheral import FrameSource

H, W = 12, 20
COLORS, DEPTHS = frame_message("color", W, H, "eye"), frame_message("depth", W, H, "eye")
STATES = {"eye_handle": StateSpec((), "int64")}


def plain(pixels: np.ndarray, spec: ImageSpec) -> np.ndarray:
    """Return what a policy sees, pixel by pixel: shape (height, width, colours)."""
    top, bottom, left, right = spec.crop
    seen = pixels.astype(np.float64).reshape(*pixels.shape[:2], -1)
    seen = seen[top : len(seen) - bottom, left : seen.shape[1] - right]
    if spec.range is not None:
        near, far = spec.range
        seen = np.where(np.isnan(seen), far, np.minimum(np.maximum(seen, near), far))
    else:
        seen = seen / 255.0
    (rows, columns, colors), (height, width) = seen.shape, spec.size
    out = np.zeros((height, width, colors))
    for i in range(height):
        for j in range(width):
            y, x = (i + 0.5) * rows / height, (j + 0.5) * columns / width
            if spec.resize == "nearest":
                out[i, j] = seen[math.floor(y), math.floor(x)]
            elif spec.resize == "bilinear":
                y, x = min(max(y - 0.5, 0), rows - 1), min(max(x - 0.5, 0), columns - 1)
                for a in {math.floor(y), math.ceil(y)}:
                    for b in {math.floor(x), math.ceil(x)}:
                        out[i, j] += (1 - abs(y - a)) * (1 - abs(x - b)) * seen[a, b]
            else:
                y0, y1 = i * rows / height, (i + 1) * rows / height
                x0, x1 = j * columns / width, (j + 1) * columns / width
                for a in range(rows):
                    for b in range(columns):
                        tall = max(min(y1, a + 1) - max(y0, a), 0)
                        wide = max(min(x1, b + 1) - max(x0, b), 0)
                        out[i, j] += tall * wide * seen[a, b]
                out[i, j] /= (y1 - y0) * (x1 - x0)
    return np.array(spec.offset) + np.array(spec.scale) * out


class Camera:
    """A camera whose frames a test makes, as a block of a peripheral has them."""

    outside = True

    def __init__(self, message: FrameMessage) -> None:
        self.ring, self.message = FrameRing.create(len(message.template)), message
        self.sources = {"eye": FrameSource(self.ring, message)}

    def __call__(self) -> None: ...


class Bench:
    """A picture's state with the camera behind it; frames have the time `now`, in [s]."""

    now = 100.0
    dated = True
    """Stamps count from 1970, as a webcam's, else from the machine's start, as a Livox's."""

    def __init__(self, spec: ImageSpec, message: FrameMessage, **context: Any) -> None:
        states = standard_states(["j"]) | STATES | spec.states("rgb_image")
        self.states, self.camera = States(states, context.pop("num_robots", None)), Camera(message)
        eye = Block("eye", self.camera, writes=tuple(STATES), stage=Stage.RECV)
        blocks = context.pop("blocks", [eye])
        built = BuildContext(self.states, None, 0.02, blocks=blocks, **context)  # type: ignore[arg-type]
        self.term = ImageTerm(built, "rgb_image", spec)

    def shoot(self, pixels: Any) -> None:
        """Let a frame come now."""
        self.camera.message.data(self.camera.ring.fill())[...] = pixels
        stamp = perception.time.time_ns() if self.dated else perception.time.monotonic_ns()
        self.states["eye_handle"][...] = self.camera.ring.commit(stamp)

    def tick(self, seconds: float = 0.02) -> tuple[float, float]:
        """Go on; return the first value and the age."""
        Bench.now += seconds
        self.term()
        return float(self.states["rgb_image"].flat[0]), float(self.states["rgb_image_age"])


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    class Clock:
        monotonic_ns = staticmethod(lambda: round(Bench.now * 1e9))
        time_ns = staticmethod(lambda: 1_800_000_000_000_000_000 + round(Bench.now * 1e9))

    monkeypatch.setattr(perception, "time", Clock)
    yield
    Bench.now = 100.0


@pytest.mark.parametrize("size", [(5, 7), (12, 20), (3, 10), (30, 33), (1, 1)])
@pytest.mark.parametrize("resize", ["area", "bilinear", "nearest"])
@pytest.mark.parametrize("layout", ["chw", "hwc"])
@pytest.mark.parametrize("depth", [False, True])
def test_pixels_are_those_of_a_plain_loop(size: Any, resize: Any, layout: Any, depth: bool) -> None:
    given: Any = {"crop": (1, 2, 3, 0), "resize": resize, "layout": layout}
    dice, message = np.random.default_rng(0), DEPTHS if depth else COLORS
    if depth:
        given |= {"range": (0.5, 2.0), "scale": (0.5,), "offset": (-1.0,)}
        pixels = dice.uniform(0.0, 3.0, (H, W)).astype(np.float32)
        pixels.flat[::7], pixels.flat[3], pixels.flat[50] = np.nan, np.inf, -np.inf
    else:
        given |= {"scale": (4.0, 2.0, 1.0), "offset": (-2.0, 0.5, 0.0)}
        pixels = dice.integers(0, 256, (H, W, 3), np.uint8)
    spec = ImageSpec(size, "eye_handle", **given)
    bench = Bench(spec, message)
    bench.shoot(pixels)
    bench.tick()
    seen = bench.states["rgb_image"]
    assert seen.shape == spec.shape
    seen = seen.transpose(1, 2, 0) if layout == "chw" else seen
    np.testing.assert_allclose(seen, plain(pixels, spec), atol=2e-6)


def test_resizing_is_that_of_pillow() -> None:
    image = pytest.importorskip("PIL.Image")
    pixels = np.random.default_rng(1).uniform(0.0, 1.0, (48, 64)).astype(np.float32)
    ways = {"area": ("BOX", (12, 16)), "nearest": ("NEAREST", (13, 17)),
            "bilinear": ("BILINEAR", (96, 70))}  # fmt: skip
    for resize, (theirs, (height, width)) in ways.items():
        ours = pixels[..., None]
        for edge in (taps(48, height, resize), taps(64, width, resize)):
            ours = sum(ours[index] * share for index, share in edge).swapaxes(0, 1)
        way = getattr(image.Resampling, theirs)
        expected = np.asarray(image.fromarray(pixels).resize((width, height), way))
        np.testing.assert_allclose(ours[..., 0], expected, atol=1e-5, err_msg=resize)


@pytest.mark.parametrize("dated", [True, False])
def test_a_frame_is_seen_after_its_delay_at_most_so_often_and_grows_old(dated: bool) -> None:
    spec = ImageSpec((1, 1), "eye_handle", scale=(255.0,), rate=10.0, delay=0.05, max_age=0.3)
    bench = Bench(spec, COLORS)
    bench.dated = dated
    assert np.isnan(bench.tick()[0])
    assert bench.tick()[1] == math.inf
    seen = []
    for k in range(1, 26):  # a frame in each tick of 0.02 s
        bench.shoot(k)
        seen.append(bench.tick())
    values, ages = zip(*seen)
    assert np.isnan(values[:2]).all()
    np.testing.assert_allclose(values[2:], [1 + 5 * (k // 5) for k in range(23)], rtol=1e-6)
    assert min(ages[2:]) == pytest.approx(0.06, abs=1e-6)
    assert max(ages[2:]) == pytest.approx(0.14, abs=1e-6)
    while not np.isnan(bench.tick()[0]):
        assert bench.states["rgb_image_age"] < 0.3
    assert bench.states["rgb_image_age"] == pytest.approx(0.3, abs=0.021)
    bench.shoot(9)
    assert bench.tick(0.06)[0] == pytest.approx(9.0)


@pytest.mark.parametrize("lost", ["frozen", "overwritten", "unplugged", "torn"])
@pytest.mark.parametrize("on_stale", ["fault", "last"])
def test_without_frames_a_picture_is_refused_or_the_last(lost: str, on_stale: Any) -> None:
    bench = Bench(ImageSpec((1, 1), "eye_handle", max_age=0.2, on_stale=on_stale), COLORS)
    bench.shoot(255)
    assert bench.tick()[0] == 1.0
    ring = bench.camera.ring
    for _ in range(12):
        if lost == "unplugged":
            bench.states["eye_handle"][...] = 0
        elif lost in ("overwritten", "torn"):
            bench.shoot(0)
            if lost == "overwritten":  # the ring has gone round, the handle stays behind
                for _ in range(4):
                    ring.fill()
                    ring.commit(0)
            else:  # while it is read
                bench.term._picture = lambda _: [ring.fill() for _ in range(4) if ring.commit(0)]  # type: ignore
        bench.tick()
    expected = math.nan if on_stale == "fault" else 1.0
    np.testing.assert_equal(bench.states["rgb_image"], np.float32(expected))
    assert bench.states["rgb_image_age"] == pytest.approx(0.26)


def test_a_simulation_that_begins_anew_goes_on_seeing() -> None:
    spec, stamp = ImageSpec((1, 1), "eye_handle", scale=(255.0,), delay=0.05), "stamp_ns"
    bench = Bench(spec, COLORS)
    frames = bench.term._frames
    frames._clock = bench.states[stamp]  # as of a camera of the model
    clock, ring = bench.states[stamp], bench.camera.ring

    def shoot(value: int, seconds: float) -> int:
        bench.camera.message.data(ring.fill())[...] = value
        bench.states["eye_handle"][...] = ring.commit(round(seconds * 1e9))
        return int(np.nan_to_num(bench.tick()[0] + 0.5))

    for seconds in (50.0, 50.1):
        clock[...] = round(seconds * 1e9)
        shoot(3, seconds)
    clock[...] = 0
    assert shoot(4, 50.2) == 3  # drawn before it began anew
    assert bench.states["rgb_image_age"] == 0.0
    clock[...] = round(0.1e9)
    assert shoot(5, 0.02) == 5
    assert bench.states["rgb_image_age"] == pytest.approx(0.08)


def test_wrong_cameras_are_refused() -> None:
    depth = ImageSpec((4, 4), "eye_handle", range=(0.1, 3.0))
    color = ImageSpec((4, 4), "eye_handle")
    cloud = cloud_message(W, np.dtype([("x", "<f4")]), "eye")
    for spec, message, text in (
        (depth, COLORS, "rgb_image: 'eye_handle' has no depths; take another camera's handle, or "
         "leave range out"),
        (depth, frame_message("cloud", W, H, "eye"), "has no depths"),
        (depth, cloud, "has no depths"),
        (color, DEPTHS, "has no raw colours; take another camera's handle, or give range"),
        (color, jpeg_message(100, "eye"), "has no raw colours"),
        (ImageSpec((4, 4), "eye_handle", crop=(5, 7, 0, 0)), COLORS,
         r"crop \[5, 7, 0, 0\] leaves nothing of 12 x 20 pixels; give less"),
        (ImageSpec((4, 4), "stamp_ns"), COLORS, r"no block before it fills 'stamp_ns'.*eye_handle"),
    ):  # fmt: skip
        with pytest.raises(UniconError, match=text):
            Bench(spec, message)
    with pytest.raises(UniconError, match="leave num_robots out"):
        Bench(color, COLORS, num_robots=2)
    with pytest.raises(UniconError, match="fills 'eye_handle'; list a camera under deferred"):
        Bench(color, COLORS, blocks=[])
    Bench(color, DEPTHS, dry=True).tick()  # nothing is opened, so nothing is known of its frames


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"size": [0, 8]}, "images.rgb_image.size.0 is 0"),
        ({"size": [8, 99999]}, "images.rgb_image.size.1 is 99999"),
        ({"size": None}, "images.rgb_image: missing key 'size'"),
        (
            {"scale": [1.0, 2.0]},
            "rgb_image.scale has other than one value, or one for each",
        ),
        (
            {"range": [0.1, 3.0], "offset": [1.0, 2.0, 3.0]},
            "rgb_image.offset has other than one",
        ),
        ({"range": [3.0, 0.1]}, "is [3, 0.1]; the lowest must come first"),
        ({"crop": [1, 2]}, "images.rgb_image.crop is [1, 2]; write the pixels cut off"),
        ({"crop": [-1, 0, 0, 0]}, "images.rgb_image.crop.0 is -1"),
        ({"max_age": float("nan")}, "images.rgb_image.max_age is nan"),
        ({"delay": 0.5}, "images.rgb_image.max_age is not more than delay; give more"),
        ({"rate": 0.0}, "images.rgb_image.rate is 0.0"),
        ({"resize": "cubic"}, "images.rgb_image.resize 'cubic' is not known"),
        ({"fps": 3}, "images.rgb_image: unknown key 'fps'"),
    ],
)
def test_a_wrong_picture_is_told(tmp_path: Path, changed: dict[str, Any], message: str) -> None:
    said = {k: v for k, v in ({"size": [8, 8]} | changed).items() if v is not None}
    with pytest.raises(PolicyError) as caught:
        load_policy(write_toy(tmp_path, toy_values(images={"rgb_image": said})))
    assert message in str(caught.value)


# -- in a policy --------------------------------------------------------------------------------

GRAPH = """\
flat = Reshape(image, size)
seen = MatMul(flat, p)
felt = MatMul(obs, w)
action = Add(seen, felt)
"""


def write_seeing(folder: Path, moved: int = 4, **changes: Any) -> np.ndarray:
    """Write a policy: observation times weights, plus 2 x 3 pixels times what is returned."""
    dice = np.random.default_rng(2)
    w, p = (dice.normal(size=(n, moved)).astype(np.float32) * 0.01 for n in (3 + 3 * moved, 18))
    shapes = {"obs": ["n", len(w)], "image": ["n", 3, 2, 3], "action": ["n", moved]}
    constants = {"w": w, "p": p, "size": [-1, 18]}
    folder.mkdir()
    write_graph(folder / "policy.onnx", GRAPH, ["obs", "image"], shapes, constants)
    said: Any = {
        "images": {"rgb_image": {"size": [2, 3], "handle": "eye_handle", "max_age": 5.0}},
        "inputs": {"observation": "obs", "rgb_image": "image"},
        "outputs": {"action": "action"},
    }
    write_toy(folder, toy_values(**{**said, **changes}))
    return p


def test_a_contract_survives_being_written_and_is_printed(tmp_path: Path) -> None:
    said = {"size": [4, 3], "range": [0.1, 3.0], "crop": [0, 1, 2, 3], "on_stale": "last"}
    terms = [*toy_values()["observation"]["terms"], {"name": "depth_image", "state": "depth_image"}]
    values = toy_values(images={"depth_image": said}, observation={"terms": terms})
    contract = load_policy(write_toy(tmp_path / "a", values, 27))
    written = write_policy_yaml(contract, tmp_path / "b")
    assert "chw" not in written.read_text("utf-8")  # what is not said is left out
    assert load_policy(written).images == contract.images
    table = policy_table(contract)
    assert "image        depth_image: 4 x 3 of camera_handle, chw, at most 0.5 s old" in table
    assert contract.images["depth_image"].shape == (1, 4, 3)


@pytest.mark.parametrize("as_input", [True, False])
def test_the_network_sees_the_state_and_refuses_what_is_too_old(
    tmp_path: Path, as_input: bool
) -> None:
    toy = robot()
    if as_input:
        p = write_seeing(tmp_path / "p")
        contract = load_policy(tmp_path / "p")
    else:
        terms = [{"name": "rgb_image", "state": "rgb_image"}]
        images = {"rgb_image": {"size": [2, 3]}}
        values = toy_values(observation={"terms": terms}, images=images)
        contract = load_policy(write_toy(tmp_path / "p", values, 18))
        p = np.random.default_rng(1).normal(size=(18, 4)).astype(np.float32) * 0.1
    own = policy_states(contract, toy.joint_names, prefix="walk_")
    states = States(standard_states(toy.joint_names) | own)
    policy = Policy(contract, states, toy, prefix="walk_")
    states["joint_pos"][...] = (0.1, 0.2, 0.3, 0.4)  # the default pose, at rest
    with pytest.raises(Fault, match=r"rgb_image shows no frame of the last .* see to '.*_handle'"):
        policy()
    picture = np.random.default_rng(3).uniform(size=(3, 2, 3)).astype(np.float32)
    states["walk_rgb_image"][...] = picture
    policy()
    np.testing.assert_allclose(states["walk_action"], picture.reshape(-1) @ p, rtol=1e-5)
    assert "walk_rgb_image" in policy.reads


@pytest.mark.parametrize("size", [[3, 3], [2, 4]])
def test_a_network_of_another_size_is_refused(tmp_path: Path, size: list[int]) -> None:
    images = {"rgb_image": {"size": size}}
    write_seeing(tmp_path / "p", images=images)
    contract, toy = load_policy(tmp_path / "p"), robot()
    states = States(standard_states(toy.joint_names) | policy_states(contract, toy.joint_names))
    with pytest.raises(PolicyError, match=r"takes 18 values and state 'rgb_image' has .*images"):
        Policy(contract, states, toy)


def test_torchscript_takes_pictures_with_their_axes(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")

    class Seeing(torch.nn.Module):  # type: ignore[name-defined,misc]
        def forward(self, obs: Any, image: Any) -> Any:
            return obs[:, :4] + image.mean(dim=(2, 3)).sum(dim=1, keepdim=True)

    (tmp_path / "p").mkdir()
    example = torch.zeros(1, 15), torch.zeros(1, 3, 2, 3)
    torch.jit.trace(Seeing(), example).save(str(tmp_path / "p/policy.pt"))
    values = toy_values(
        onnx=None,
        torchscript="policy.pt",
        images={"rgb_image": {"size": [2, 3]}},
        inputs={"observation": "obs", "rgb_image": "image"},
    )
    contract, toy = load_policy(write_toy(tmp_path / "p", values)), robot()
    states = States(standard_states(toy.joint_names) | policy_states(contract, toy.joint_names))
    policy = Policy(contract, states, toy)
    states["rgb_image"][...] = 0.25
    policy()
    obs = states["observation"][:4]
    np.testing.assert_allclose(states["action"], obs + 0.75, atol=1e-6)


# -- in a workflow ------------------------------------------------------------------------------

WORKFLOW = """\
robot: go2
platform: fake
policies: {walk: ./policy}
flow: {chain: [{loop: {do: hold, until: "rgb_image_age < 5"}}, {policy: walk}]}
safety: [finite]
commands: [{call: {function: "test_images:eye"}}]
"""


def eye(context: BuildContext) -> Block:
    """Return a camera whose picture gets brighter from tick to tick."""
    camera, states = Camera(COLORS), context.states
    count = [0]

    def see() -> None:
        if not context.dry:
            count[0] += 1
            camera.message.data(camera.ring.fill())[...] = min(5 * count[0], 255)
            states["eye_handle"][...] = camera.ring.commit(perception.time.time_ns())

    tick: Any = see
    tick.sources, tick.outside = camera.sources, True
    return Block("eye", see, writes=tuple(STATES), endless=True, stage=Stage.RECV)


def _declares(**_: Any) -> dict[str, StateSpec]:
    return STATES


eye.declares = _declares  # type: ignore[attr-defined]


@pytest.fixture
def workflow(tmp_path: Path) -> Path:
    """Return a workflow of a Go2 whose policy sees what `eye` does."""
    from unicon_core.robots import load_robot

    go2 = load_robot("go2")
    pose = [float(x) for x in go2.default_joint_pos]
    terms = toy_values()["observation"]["terms"][:1]  # and nothing that its own action moves
    network: Any = {"joints": list(go2.joint_names), "default_joint_pos": pose}
    network |= {"stiffness": 30.0, "damping": 1.0}
    terms += [{"name": "pose", "state": "joint_pos", "subtract": "default_joint_pos"}]
    terms += [{"name": "last", "state": "joint_vel"}, {"name": "also", "state": "action"}]
    write_seeing(tmp_path / "policy", 12, observation={"terms": terms}, **network)
    (tmp_path / "see.yaml").write_text(WORKFLOW, "utf-8")
    return tmp_path / "see.yaml"


def test_a_workflow_waits_for_the_first_picture_and_replays_bit_exact(
    workflow: Path, tmp_path: Path
) -> None:
    out = tmp_path / "record"
    run = ["run", str(workflow), "--no-ros", "--speed", "max", "--duration", "0.4"]
    assert main([*run, "--record", str(out)]) == 0
    record = open_record(out)
    seen, action = record.states("rgb_image"), record.states("action")
    assert np.isnan(seen[:-1]).any(axis=(1, 2, 3)).sum() == 0  # the eye sees in the first tick
    assert len({*seen[:, 0, 0, 0]}) > 10
    assert np.ptp(action[:, 0]) > 0.0
    assert main(["replay", str(out), "--verify"]) == 0


@pytest.mark.parametrize("child", [True, {"delay": 3}])
def test_a_child_sees_the_same_pictures(workflow: Path, tmp_path: Path, child: Any) -> None:
    out = tmp_path / "record"
    run = ["run", str(workflow), "--no-ros", "--speed", "max", "--duration", "0.4"]
    run += ["--set", f"policies.walk={json.dumps({'path': './policy', 'child': child})}"]
    assert main([*run, "--record", str(out)]) == 0
    record, p, w = open_record(out), *weights_of(workflow.parent / "policy/policy.onnx")
    names = ("rgb_image", "action", "observation", "action_age")
    seen, action, observation, age = (record.states(name) for name in names)
    for k in range(10, len(action)):
        asked = k - round(float(age[k]) / record.period)
        # A picture comes behind `send`, and the policy sees it in the next tick.
        expected = seen[asked - 1].reshape(-1) @ p + observation[asked] @ w
        np.testing.assert_allclose(action[k], expected, atol=1e-5)
    assert np.ptp(seen[10:, 0, 0, 0]) > 0.1
    assert main(["replay", str(out), "--verify"]) == 0


def weights_of(path: Path) -> list[np.ndarray]:
    """Return the weights of the pixels and of the observation."""
    found = {
        each.name: numpy_helper.to_array(each) for each in onnx.load(str(path)).graph.initializer
    }
    return [found["p"], found["w"]]


def test_what_a_workflow_lacks_is_told_and_found(
    workflow: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for changed, text in (
        ({"commands": []}, "rgb_image: no block before it fills 'eye_handle'; list a camera"),
        ({"policies.walk": {"path": "./policy", "given": {"images.rgb_image.range": [0.1, 3.0]}}},
         "takes 18 values and state 'rgb_image' has 6"),
    ):  # fmt: skip
        with pytest.raises(UniconError, match=text):
            Program(load_document(workflow, changed))
    assert main(["check", str(workflow), "--set", "commands=[]"]) != 0
    assert "no block before it fills 'eye_handle'" in capsys.readouterr().out
    assert main(["check", str(workflow)]) == 0
    exported = ["export", str(workflow), "--set", "platform=mujoco", "--cpp", str(tmp_path / "c")]
    assert main(exported) != 0
    assert "a policy with pictures" in capsys.readouterr().err


def test_without_a_first_picture_the_policy_is_a_fault(workflow: Path) -> None:
    program = Program(load_document(workflow, {"flow": {"policy": "walk"}}))
    report = Runner(program, RunOptions(duration=0.1)).run()
    assert len(report.faults) == 1
    assert "rgb_image shows no frame of the last 5 s; see to 'eye_handle'" in report.faults[0]
