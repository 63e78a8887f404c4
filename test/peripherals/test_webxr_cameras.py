"""Pictures of `webxr`: the newest one for who asks, and nothing waits for who does not."""

from __future__ import annotations

import asyncio
import io
import os
import signal
import struct
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from coded_camera import BITS, WIDTH, coded
from test_webxr import answer, run

from unicon_base.errors import WorkflowError
from unicon_core.flow import Block
from unicon_core.handles import FrameRing
from unicon_core.robots import load_robot
from unicon_core.states import States
from unicon_core.workflow.autowire import BuildContext
from unicon_hardware.peripherals.webxr.webxr import Eye, webxr
from unicon_ros.bridge.images import frame_message, jpeg_message
from unicon_ros.peripheral import FrameSource

clients = pytest.importorskip("websockets.asyncio.client", reason="pip install websockets")
pillow = pytest.importorskip("PIL.Image", reason="pip install pillow")


class Rig:
    """A headset's block with cameras, ticked at 100 Hz as a workflow does."""

    def __init__(self, cameras: tuple[str, ...] = ("front",), **options: Any) -> None:
        specs = webxr.declares()  # type: ignore[attr-defined]
        for name in ("front", "rear"):
            specs = specs | coded.declares(prefix=name)  # type: ignore[attr-defined]
        self.lines: list[str] = []
        context = BuildContext(
            States(specs), load_robot("go2"), 0.01, tell=self.lines.append, blocks=(blocks := [])
        )
        self.block = webxr(context, port=0, cameras=cameras)
        self.blocks: list[Block] = blocks  # a camera may be built later
        blocks += [coded(context=context, prefix=name, **options) for name in ("front", "rear")]
        self.address = str(self.block.tick.first["address"])
        self.slowest = 0.0

    def page(self, eye: int = 0) -> Any:
        """Open a page's websocket."""
        address = f"{self.address.replace('http', 'ws', 1)}camera/{eye}"
        return clients.connect(address, origin=self.address.rstrip("/"), compression=None)

    async def tick(self) -> None:
        """Tick until cancelled; keep how long the slowest tick took."""
        while True:
            begin = time.thread_time()
            for block in (self.block, *self.blocks):
                block.tick()
            self.slowest = max(self.slowest, time.thread_time() - begin)
            await asyncio.sleep(0.01)

    def close(self) -> None:
        for block in (self.block, *self.blocks):
            assert block.close is not None
            block.close()


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig()
    yield made
    made.close()


async def picture(page: Any) -> tuple[int, float, float, np.ndarray]:
    """Ask for a picture; return its number, age and wait in [ms], and pixels."""
    await page.send(b"")
    data = await asyncio.wait_for(page.recv(), 10.0)
    pixels = np.asarray(pillow.open(io.BytesIO(data[12:])).convert("RGB"))
    return *struct.unpack("<Iff", data[:12]), pixels


def coded_age(pixels: np.ndarray) -> float:
    """Return how old a picture is by its time code, in [ms]."""
    step = WIDTH // BITS
    bits = pixels[240, step // 2 :: step, 0] > 127
    taken = int("".join("01"[int(bit)] for bit in bits), 2)
    return float((time.time_ns() // 1_000_000 - taken) % (1 << BITS))


def test_the_newest_picture_with_number_and_age(rig: Rig) -> None:
    async def work() -> None:
        ticking = asyncio.ensure_future(rig.tick())
        async with rig.page() as page:
            first, _, _, pixels = await picture(page)
            assert pixels.shape == (480, 640, 3)
            await asyncio.sleep(1.0)  # a slow page: what came meanwhile does not wait for it
            second, age, waited, pixels = await picture(page)
            assert second >= first + 10
            assert age < 1000.0  # not that of the first
            assert 0.0 <= waited < 1000.0
            assert abs(coded_age(pixels) - age) < 200.0
            third, *_ = await picture(page)
            assert third > second
        ticking.cancel()

    run(work())


def test_who_floods_or_stands_still_costs_neither_tick_nor_memory(rig: Rig) -> None:
    process = rig.block.tick.process.pid

    def memory() -> int:
        with open(f"/proc/{process}/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE")

    async def work() -> None:
        ticking = asyncio.ensure_future(rig.tick())
        async with rig.page() as good, rig.page() as bad:
            await picture(good)
            before = memory()

            async def flood() -> None:  # asks, and reads nothing
                while True:
                    for _ in range(100):
                        await bad.send(b"")
                    await asyncio.sleep(0.0)

            bad.transport.pause_reading()  # as a page that SIGSTOP has caught
            flooding = asyncio.ensure_future(flood())
            numbers = [(await picture(good))[0] for _ in range(60)]
            flooding.cancel()
            assert numbers == sorted(set(numbers))
            assert memory() - before < 32 << 20
            assert rig.slowest < 0.01
            bad.transport.abort()
        ticking.cancel()

    run(work())


def test_too_many_pages_garbage_and_a_missing_eye(rig: Rig) -> None:
    async def work() -> None:
        ticking = asyncio.ensure_future(rig.tick())
        pages = [await rig.page() for _ in range(8)]
        async with rig.page() as ninth:
            await ninth.wait_closed()
            assert (ninth.close_code, ninth.close_reason) == (
                4001,
                "too many pages look at the cameras",
            )
        for page in pages[1:]:
            page.transport.abort()
        await pages[0].send("text")
        assert len(await pages[0].recv()) > 1000
        await pages[0].send(bytes(100_000))
        await pages[0].wait_closed()
        assert pages[0].close_code == 1009
        async with rig.page() as again:
            assert (await picture(again))[0] > 0
        with pytest.raises(Exception, match="404"):
            await rig.page(1)  # there is one camera
        with pytest.raises(Exception, match="403"):
            await clients.connect(
                f"{rig.address.replace('http', 'ws')}camera/0", origin="http://x.y"
            )
        ticking.cancel()

    run(work())
    assert 'data-cameras="1"' in answer(rig.address)[1]


@pytest.mark.slow
def test_a_process_that_was_killed_shows_the_cameras_again(rig: Rig) -> None:
    async def work() -> None:
        ticking = asyncio.ensure_future(rig.tick())
        async with rig.page() as page:
            await picture(page)
        os.kill(rig.block.tick.process.pid, signal.SIGKILL)
        begin = time.monotonic()
        while rig.block.tick.started < 2 or not any("runs again" in line for line in rig.lines):
            assert time.monotonic() - begin < 15.0, rig.lines
            await asyncio.sleep(0.05)
        rig.address = rig.block.tick.first["address"]
        async with rig.page() as page:
            assert (await picture(page))[0] > 0
        ticking.cancel()

    run(work())


def test_wrong_cameras_are_named() -> None:
    with pytest.raises(WorkflowError, match="webxr: no camera 'frnt'; did you mean 'front'"):
        Rig(("frnt",))
    with pytest.raises(WorkflowError, match="3 cameras; give one, or the left and right eye's"):
        Rig(("front", "rear", "front"))


def test_depths_are_no_pictures(rig: Rig) -> None:
    ring = FrameRing.create(64)
    rig.blocks[0].tick.sources["front"] = FrameSource(ring, frame_message("depth", 2, 2, "x"))
    rig.block.tick()
    rig.block.tick()
    shown = "webxr: front has no colour pictures here; it is not shown"
    assert [line for line in rig.lines if "front" in line] == [shown]
    ring.close()


def test_a_jpeg_goes_as_it_is_and_a_torn_frame_not_at_all() -> None:
    message = jpeg_message(100, "x")
    ring = FrameRing.create(len(message.template), 2)
    eye = Eye(str(ring.path), message.offset, message.shape)
    assert eye.jpeg() == (0, 0, b"")
    slot = ring.fill()
    slot[:] = np.frombuffer(message.template, np.uint8)
    message.put(slot, memoryview(b"\xff\xd8 and so on"))
    now = time.monotonic_ns()
    ring.commit(now)
    assert eye.jpeg() == (1, now, b"\xff\xd8 and so on")
    ring.fill()
    ring.commit(now + 1)
    ring.fill()  # over the first one
    eye.ring.holds = lambda handle: False  # type: ignore[method-assign]  # over this one, too
    assert eye.jpeg() == (1, now, b"\xff\xd8 and so on")
    ring.close()


@pytest.mark.parametrize("begun", [0, 5_000_000_000])
def test_the_time_of_a_frame_by_any_clock(begun: int) -> None:
    ring = FrameRing.create(1)
    now = time.monotonic_ns()
    for stamp in (now - 10**9, time.time_ns() - 10**9):
        assert abs(ring.true_ns(ring.commit(stamp)) - (now - 10**9)) < 10**8
    ring.set_offset(now - begun)  # a simulator's time
    assert ring.true_ns(ring.commit(begun)) == now
    ring.close()
