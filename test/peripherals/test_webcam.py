"""Webcams: V4L2's ioctls field by field against a strict stand-in, pictures, and the hot plug."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import strict_v4l2
from numpy.typing import NDArray

from unicon_base.errors import UniconError
from unicon_core.flow import Block, Stage
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States
from unicon_core.workflow import HookBlocks, Program, load_workflow
from unicon_core.workflow.autowire import BuildContext
from unicon_hardware.peripherals import v4l2
from unicon_hardware.peripherals.v4l2 import Capture, Kernel
from unicon_hardware.peripherals.webcam import Rgb, _path, message_of, webcam
from unicon_ros.peripheral import Peripheral
from unicon_ros.peripheral_process import Gone

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "stand_in"


class Rig:
    """A block and its states."""

    def __init__(self, plug: Path, **options: Any) -> None:
        self.states, self.lines = States(webcam.declares()), list[str]()  # type: ignore[attr-defined]
        context = BuildContext(self.states, load_robot("go2"), 0.002, tell=self.lines.append)
        block = webcam(context=context, device=str(plug), system="strict_v4l2:Strict", **options)
        assert isinstance(block.tick, Peripheral)
        self.tick = block.tick
        given = {"size": [640, 480], "frame_id": "webcam_optical_frame", "format": "yuyv"}
        self.message = message_of({**given, **options})

    def value(self, state: str) -> int:
        return int(self.states[f"webcam_{state}"])

    def until(self, holds: Callable[[], object], patience: float = 10.0) -> float:
        begin = time.monotonic()
        while not holds():
            assert time.monotonic() - begin < patience, self.lines
            self.tick()
            time.sleep(0.002)
        return time.monotonic() - begin

    def frame(self) -> NDArray[np.uint8]:
        raw = self.tick.rings[""].frame(self.value("handle"))
        assert raw is not None
        return raw.copy()

    def neutral(self) -> bool:
        return not any(int(self.states[name]) for name in self.states.layout.specs)


@pytest.fixture
def plug(tmp_path: Path) -> Iterator[Path]:
    (tmp_path / "video0").touch()
    yield tmp_path / "video0"
    assert not (tmp_path / "violations").exists(), (tmp_path / "violations").read_text()


@pytest.fixture
def rigs(plug: Path) -> Iterator[Callable[..., Rig]]:
    made: list[Rig] = []

    def start(**options: Any) -> Rig:
        made.append(Rig(plug, **options))
        return made[-1]

    yield start
    for rig in made:
        rig.tick.close()


def test_pictures_come_and_an_unplugged_camera_is_neutral_at_once_and_comes_back(
    rigs: Callable[..., Rig], plug: Path
) -> None:
    rig = rigs()
    rig.until(lambda: rig.value("alive"))
    first, begin = rig.value("handle"), time.monotonic()
    rig.until(lambda: rig.value("handle") >= first + 30)
    assert time.monotonic() - begin < 2.0  # 30 a second
    assert 0 <= time.monotonic_ns() - rig.value("stamp_ns") < 0.3e9
    picture = rig.message.data(rig.frame())
    assert picture.shape == (480, 640, 3)
    gray = 255 / 219 * (np.arange(320) % 200)
    green = picture[9, ::2, 1] - picture[9, 0, 1].astype(float)  # clipped at 0 and 255
    inside = (picture[9, ::2, 1] > 0) & (picture[9, ::2, 1] < 255)
    slope = np.diff(green)[inside[1:] & inside[:-1]]
    assert np.median(slope) == pytest.approx(np.diff(gray)[0], abs=1.0)
    np.testing.assert_array_equal(picture[0], picture[-1])  # rows are padded
    plug.unlink()
    assert rig.until(lambda: not rig.value("alive"), 0.25) < 0.25
    assert rig.neutral()
    plug.touch()
    rig.until(lambda: rig.value("alive"))
    rig.until(lambda: len(rig.lines) == 2)
    assert rig.lines[0] == "webcam: it was unplugged; its values are neutral until it is back"


@pytest.mark.slow
def test_jpeg_comes_as_the_camera_gives_it(rigs: Callable[..., Rig]) -> None:
    rig = rigs(format="mjpg")
    rig.until(lambda: rig.value("handle") > 12)
    raw = rig.frame()
    offset = rig.message.offset
    count = int.from_bytes(raw[offset - 4 : offset].tobytes(), "little")
    data = raw[offset : offset + count].tobytes()
    assert data in [strict_v4l2.jpeg(number) for number in range(256)]


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["short", "broken", "stop"])
@pytest.mark.parametrize("format", ["yuyv", "mjpg"])
def test_garbage_is_left_out(rigs: Callable[..., Rig], plug: Path, fault: str, format: str) -> None:
    rig = rigs(format=format)
    rig.until(lambda: rig.value("alive"))
    plug.with_name(fault).touch()
    rig.until(lambda: not rig.value("alive"), 1.0)
    assert rig.neutral()
    rig.until(lambda: any("no pictures for 2 s" in line for line in rig.lines))
    if fault == "short":
        assert any("a picture has" in line for line in rig.lines)
    plug.with_name(fault).unlink()
    rig.until(lambda: rig.value("alive"))


@pytest.mark.slow
def test_a_stopped_and_a_killed_process_are_neutral(rigs: Callable[..., Rig]) -> None:
    rig = rigs()
    rig.until(lambda: rig.value("alive"))
    os.kill(rig.tick.process.pid, signal.SIGSTOP)
    rig.until(lambda: not rig.value("alive"), 0.6)
    assert rig.neutral()
    os.kill(rig.tick.process.pid, signal.SIGCONT)
    rig.until(lambda: rig.value("alive"))
    os.kill(rig.tick.process.pid, signal.SIGKILL)
    rig.until(lambda: not rig.value("alive"), 1.0)
    rig.until(lambda: rig.value("alive"), 20.0)


@pytest.mark.slow
def test_a_camera_of_somebody_else_is_used_once_it_is_free(
    rigs: Callable[..., Rig], plug: Path
) -> None:
    plug.with_name("busy").touch()
    rig = rigs(rate=15)
    rig.until(lambda: rig.lines)
    assert rig.lines == [f"webcam: {plug} is used by another process; it is used once it is there"]
    plug.with_name("busy").unlink()
    rig.until(lambda: rig.value("alive"))


def test_what_a_camera_has_not_is_one_line(plug: Path) -> None:
    def capture(size: tuple[int, int], pixels: str) -> Capture:
        return Capture(strict_v4l2.Strict(), str(plug), size, pixels, 30.0)

    for size, pixels in (((800, 600), "YUYV"), ((640, 480), "H264")):
        with pytest.raises(UniconError, match=r"has no .* it offers YUYV of 640 x 480") as told:
            capture(size, pixels)
        assert "\n" not in str(told.value)
    made = capture((320, 240), "YUYV")
    assert (made.card, made.rate, made.row, made.full) == ("Strict cam", 30.0, 704, False)
    made.close()
    assert Capture(strict_v4l2.Strict(), str(plug), (320, 240), "MJPG", 14.0).rate == 15.0
    with pytest.raises(Gone, match="No such file"):
        Capture(strict_v4l2.Strict(), f"{plug}1", (320, 240), "YUYV", 30.0)


def test_linux_is_asked_for_what_is_not_a_camera(tmp_path: Path) -> None:
    with pytest.raises(UniconError, match="/dev/null is not a video device"):
        Capture(Kernel(), "/dev/null", (640, 480), "YUYV", 30.0)
    with pytest.raises(Gone, match="No such file or directory"):
        Capture(Kernel(), str(tmp_path / "video9"), (640, 480), "YUYV", 30.0)
    assert _path("usb-x-video-index0") == "/dev/v4l/by-id/usb-x-video-index0"


@pytest.mark.parametrize("full", [False, True])
def test_colors_are_those_of_bt_601(full: bool) -> None:
    random = np.random.default_rng(3)
    packed = random.integers(0, 256, (8, 16, 4), dtype=np.uint8)
    packed[0, :4] = [[0, 0, 0, 0], [255] * 4, [255, 255, 255, 0], [0, 255, 0, 255]]
    found = np.zeros((8, 32, 3), np.uint8)
    Rgb(32, 8, full)(packed, found)
    lift, luma, chroma = (0.0, 1.0, 1.0) if full else (16.0, 255 / 219, 255 / 224)
    y = luma * (packed[..., ::2].reshape(8, 32) - lift)
    blue = chroma * (np.repeat(packed[..., 1], 2, axis=1) - 128.0)
    red = chroma * (np.repeat(packed[..., 3], 2, axis=1) - 128.0)
    green = y - (0.114 * 1.772 * blue + 0.299 * 1.402 * red) / 0.587
    expected = np.stack((y + 1.402 * red, green, y + 1.772 * blue), axis=-1)
    np.testing.assert_allclose(found, np.clip(expected, 0, 255), atol=0.6)


@pytest.mark.skipif(
    shutil.which("gcc") is None or not Path("/usr/include/linux/videodev2.h").exists(),
    reason="apt install gcc linux-libc-dev",
)
def test_structures_and_numbers_are_those_of_the_kernels_header(tmp_path: Path) -> None:
    names = {
        "QUERYCAP": "capability", "S_FMT": "format", "REQBUFS": "requestbuffers",
        "QUERYBUF": "buffer", "QBUF": "buffer", "DQBUF": "buffer", "S_PARM": "streamparm",
        "STREAMON": "", "STREAMOFF": "",
    }  # fmt: skip
    lines = [f'printf("{name} %lu\\n", (unsigned long)VIDIOC_{name});' for name in names]
    fields = {
        ("capability", "capabilities"): 84, ("capability", "device_caps"): 88,
        ("format", "fmt.pix.width"): 8, ("format", "fmt.pix.sizeimage"): 28,
        ("format", "fmt.pix.quantization"): 48, ("buffer", "timestamp"): 24,
        ("streamparm", "parm.capture.timeperframe.denominator"): 16, ("buffer", "sequence"): 56,
        ("buffer", "memory"): 60, ("buffer", "m.offset"): 64, ("buffer", "length"): 72,
    }  # fmt: skip
    for kind, field in fields:
        lines.append(f'printf("{kind}.{field} %lu\\n", offsetof(struct v4l2_{kind}, {field}));')
    source = "#include <linux/videodev2.h>\n#include <stddef.h>\n#include <stdio.h>\n"
    (tmp_path / "told.c").write_text(source + "int main(void) {" + "\n".join(lines) + "}")
    program = tmp_path / "told"
    subprocess.run(["gcc", str(tmp_path / "told.c"), "-o", str(program)], check=True)
    done = subprocess.run([str(program)], capture_output=True, text=True, check=True)
    told = dict(line.split() for line in done.stdout.splitlines())
    for name in names:
        assert int(told[name]) == getattr(v4l2, name) == getattr(strict_v4l2, name)
    for (kind, field), offset in fields.items():
        assert int(told[f"{kind}.{field}"]) == offset


WORKFLOW = """\
schema: unicon.workflow/1
robot: go2
platform: fake
rate: 100
flow: {{hold: {{}}}}
safety: [finite]
commands:
  - webcam: {{device: {first}, system: "strict_v4l2:Strict"}}
  - webcam: {{prefix: rear, device: {second}, system: "strict_v4l2:Strict", format: mjpg}}
"""


@pytest.mark.slow
def test_a_workflow_has_two_of_them_and_one_is_pulled_out(plug: Path) -> None:
    other = plug.with_name("video1")
    other.touch()
    path = plug.with_name("two.yaml")
    path.write_text(WORKFLOW.format(first=plug, second=other))
    seen: list[tuple[int, ...]] = []
    names = ("webcam_alive", "webcam_handle", "rear_alive", "rear_handle")

    def hook(program: Program) -> HookBlocks:
        def look() -> None:
            if int(program.states["tick"]) == 150:
                plug.unlink()
            seen.append(tuple(int(program.states[name]) for name in names))

        return {Stage.OBSERVE: [Block("look", look)]}

    report = Runner(load_workflow(path, hooks=[hook]), RunOptions(duration=3.0)).run()
    assert report.faults == []
    assert seen[149][0] == seen[149][2] == 1
    assert seen[149][1] > 20
    assert seen[-1][:3] == (0, 0, 1)
    assert seen[-1][3] > seen[149][3] + 30
