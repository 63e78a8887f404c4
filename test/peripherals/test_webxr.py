"""A headset's messages: poses in our axes, and whatever is wrong refused; certificate and doors."""

from __future__ import annotations

import asyncio
import math
import re
import ssl
import stat
import struct
import time
import urllib.error
import urllib.request
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from unicon_base.errors import UniconError, WorkflowError
from unicon_core.robots import load_robot
from unicon_core.states import States
from unicon_core.workflow.autowire import BuildContext, read_options
from unicon_hardware.peripherals.webxr import webxr as frames
from unicon_hardware.peripherals.webxr.webxr import Frame, Refused, webxr
from unicon_ros.peripheral import Peripheral

clients = pytest.importorskip("websockets.asyncio.client", reason="pip install websockets")


def pose(position: tuple[float, ...], quat: tuple[float, ...] = (0, 0, 0, 1)) -> tuple[float, ...]:
    """Return a pose as the page has it: WebXR's axes, quaternion xyzw."""
    return (*position, *quat)


def message(
    number: int = 0,
    page_ms: float = 1000.0,
    poses: dict[int, tuple[float, ...]] | None = None,
    flags: int = 0b1,
    buttons: tuple[float, ...] = (0.0,) * 16,
    axes: tuple[float, ...] = (0.0,) * 8,
) -> bytes:
    """Return a message, written by hand."""
    rows = [(0.0,) * 7] * 55
    for place, row in (poses or {0: pose((0.1, 1.6, -0.3))}).items():
        rows[place] = row
    values = [*sum(rows, ()), *buttons, *axes]
    return struct.pack("<HHId", 1, flags, number, page_ms) + struct.pack("<409f", *values)


def test_poses_are_turned_into_our_axes() -> None:
    half = math.sqrt(0.5)
    # 1.6 m up, 0.3 m ahead, 0.1 m to the right; looks left: turned by 90 deg about up.
    frame = Frame(message(poses={0: pose((0.1, 1.6, -0.3), (0, half, 0, half))}))
    np.testing.assert_allclose(frame.poses[0], [0.3, -0.1, 1.6, half, 0, 0, half], atol=1e-6)
    # Rolled to the right: about where it looks, which is -z there and x here.
    frame = Frame(message(poses={0: pose((0, 0, 0), (0, 0, -half, half))}))
    np.testing.assert_allclose(frame.poses[0], [0, 0, 0, half, half, 0, 0], atol=1e-6)
    # Looks up: about the axis to the right, which is -y here.
    frame = Frame(message(poses={0: pose((0, 0, 0), (half, 0, 0, half))}))
    np.testing.assert_allclose(frame.poses[0], [0, 0, 0, half, 0, -half, 0], atol=1e-6)


def test_what_is_not_tracked_is_neutral() -> None:
    bad = pose((math.nan, 9.0, math.inf), (0, 0, 0, 0))
    frame = Frame(message(poses={0: pose((0, 1, 0)), 1: bad, 51: bad}, flags=1))
    assert list(frame.valid) == [1, 0, 0, 0, 0, 0, 0]
    assert (frame.poses[1:] == [0, 0, 0, 1, 0, 0, 0]).all()
    everything = {place: pose((place, 0, 0)) for place in range(55)}
    frame = Frame(message(poses=everything, flags=0x7F))
    np.testing.assert_array_equal(frame.poses[:, 1], -np.arange(55))
    assert frame.valid.all()


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "wrong length"),
        (message()[:-1], "wrong length"),
        (message() + b"\0", "wrong length"),
        (b"\2" + message()[1:], "wrong version"),
        (message(flags=0x80), "unknown parts"),
        (message(page_ms=math.nan), "no time"),
        (message(page_ms=-1.0), "no time"),
        (message(poses={0: pose((math.nan, 0, 0))}), "not finite"),
        (message(poses={0: pose((1e9, 0, 0))}), "not finite"),
        (message(poses={0: pose((0, 0, 0), (0, 0, math.inf, 1))}), "not finite"),
        (message(poses={0: pose((0, 0, 0), (0, 0, 0, 0))}), "not a rotation"),
        (message(flags=0b11), "not a rotation"),
        (message(buttons=(math.nan,) * 16), "not a button"),
        (message(buttons=(1.5,) * 16), "not a button"),
        (message(axes=(-1.1,) * 8), "not a button"),
    ],
)
def test_whatever_is_wrong_is_refused(data: bytes, why: str) -> None:
    with pytest.raises(Refused, match=why):
        Frame(data)


def test_garbage_never_raises_anything_else() -> None:
    rng = np.random.default_rng(5)
    for _ in range(500):
        data = rng.bytes(1652 if rng.random() < 0.8 else int(rng.integers(3000)))
        try:
            Frame(b"\1\0" + bytes([rng.integers(128), 0]) + data[4:])
        except Refused:
            continue


def test_joints_are_those_of_the_standard() -> None:
    assert len(frames.JOINTS) == 25
    assert frames.JOINTS[0] == "wrist"
    assert frames.JOINTS[4] == "thumb-tip"
    assert frames.JOINTS[9] == "index-finger-tip"
    assert frames.JOINTS[24] == "pinky-finger-tip"


def wrong(text: str, *_: str) -> WorkflowError:
    return WorkflowError(f"webxr{text}")


class Rig:
    """The block with its states, and what it tells."""

    def __init__(self, **options: Any) -> None:
        self.states, self.lines = States(webxr.declares()), list[str]()  # type: ignore[attr-defined]
        context = BuildContext(self.states, load_robot("go2"), 0.005, tell=self.lines.append)
        self.block = webxr(context, **read_options(webxr, {"port": 0, **options}, wrong))
        assert isinstance(self.block.tick, Peripheral)
        self.address = str(self.block.tick.first["address"])

    @property
    def alive(self) -> bool:
        return bool(self.states["webxr_alive"])

    def until(self, holds: Callable[[], bool], patience: float = 5.0) -> float:
        """Tick until something holds; return for how long, in [s]."""
        begin = time.monotonic()
        while not holds():
            assert time.monotonic() - begin < patience, self.lines
            self.block.tick()
            time.sleep(0.001)
        return time.monotonic() - begin

    def close(self) -> None:
        assert self.block.close is not None
        self.block.close()


class Headset:
    """A client that says what it is told to; its clock began when we did."""

    def __init__(self, rig: Rig, **options: Any) -> None:
        self._rig = rig
        self._address = rig.address.replace("http", "ws", 1) + "poses"
        self._options = {"origin": rig.address.rstrip("/"), "compression": None} | options
        self.number = 0

    async def __aenter__(self) -> Headset:
        self.socket = await clients.connect(self._address, **self._options)
        await self.answered()
        return self

    async def answered(self) -> None:
        """Answer what our clock is."""
        asked = await asyncio.wait_for(self.socket.recv(), 2.0)
        await self.socket.send(asked + struct.pack("<d", self.now()))

    @staticmethod
    def now() -> float:
        return 1e-6 * (time.monotonic_ns() - BEGAN)

    async def __aexit__(self, *_: object) -> None:
        await self.socket.close()

    async def send(self, data: bytes | str | None = None, **given: Any) -> None:
        """Send a message, by itself a good one."""
        if data is None:
            data = message(self.number, given.pop("page_ms", self.now()), **given)
            self.number += 1
        await self.socket.send(data)

    async def until(self, holds: Callable[[], bool], sending: bool = False) -> float:
        """Tick until something holds; return for how long, in [s]."""
        begin = time.monotonic()
        while not holds():
            assert time.monotonic() - begin < 5.0, self._rig.lines
            if sending:
                await self.send()
            self._rig.block.tick()
            await asyncio.sleep(0.005)
        return time.monotonic() - begin


BEGAN = time.monotonic_ns()


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    made = Rig()
    yield made
    made.close()


def run(work: Awaitable[None]) -> None:
    asyncio.run(asyncio.wait_for(work, 20.0))  # type: ignore[arg-type]


def neutral(states: States) -> bool:
    """Tell whether all is as before the first message."""
    for name, spec in webxr.declares().items():  # type: ignore[attr-defined]
        if not (np.ravel(states[name]) == spec.initial).all():
            return False
    return True


def test_poses_come_and_nothing_wrong_does(rig: Rig) -> None:
    states = rig.states

    async def work() -> None:
        assert neutral(states)
        async with Headset(rig) as headset:
            await headset.until(lambda: rig.alive, sending=True)
            np.testing.assert_allclose(states["webxr_head"], [0.3, -0.1, 1.6, 1, 0, 0, 0])
            assert list(states["webxr_valid"]) == [1, 0, 0, 0, 0, 0, 0]
            assert 0.0 <= float(states["webxr_latency"]) < 0.2
            await headset.send(
                flags=0x7F,
                poses={place: pose((0, 0, -place)) for place in range(55)},
                buttons=tuple(i / 16 for i in range(16)),
                axes=tuple(i / 8 - 0.5 for i in range(8)),
            )
            await headset.until(lambda: bool(states["webxr_valid"].all()))
            np.testing.assert_allclose(states["webxr_left_hand"][:, 0], np.arange(1, 26))
            np.testing.assert_allclose(states["webxr_right_hand"][24], [50, 0, 0, 1, 0, 0, 0])
            assert states["webxr_right_aim"][0] == 54
            np.testing.assert_allclose(states["webxr_right_buttons"], np.arange(8, 16) / 16)
            np.testing.assert_allclose(states["webxr_left_axes"], np.arange(4) / 8 - 0.5)
            before = int(states["webxr_refused"])
            bad: list[bytes | str] = [
                "text",
                b"",
                message()[:100],
                message(headset.number, headset.now(), {0: pose((math.nan, 0, 0))}),
                message(0, headset.now()),  # an old number
                message(headset.number + 7, headset.now() - 1000.0),
                message(headset.number + 7, headset.now() + 1000.0),
                struct.pack("<qd", 12345, 0.0),  # nobody has asked
            ]
            for data in bad:
                await headset.send(data)
            headset.number += 3  # three frames were not sent
            await headset.until(
                lambda: int(states["webxr_refused"]) == before + len(bad), sending=True
            )
            assert int(states["webxr_missed"]) == 3
            assert rig.alive
            # Silent: after 0.2 s all is neutral; it goes on as soon as it is heard.
            assert await headset.until(lambda: not rig.alive) < 0.6
            assert neutral(states)
            await headset.until(lambda: rig.alive, sending=True)
        waited = await headset.until(lambda: not rig.alive)
        assert waited < 0.15  # at once: it was heard until now, and 0.2 s have not passed
        assert neutral(states)
        async with Headset(rig) as headset:
            await headset.until(lambda: rig.alive, sending=True)
            await headset.send(bytes(100_000))
            await asyncio.wait_for(headset.socket.wait_closed(), 2.0)
            assert headset.socket.close_code == 1009
        await headset.until(lambda: not rig.alive)
        await headset.until(lambda: any("too long" in line for line in rig.lines))

    run(work())


def test_one_headset_at_a_time(rig: Rig) -> None:
    async def work() -> None:
        async with Headset(rig) as first:
            await first.until(lambda: rig.alive, sending=True)
            second = await clients.connect(first._address, origin=rig.address.rstrip("/"))
            await second.wait_closed()
            assert (second.close_code, second.close_reason) == (
                4001,
                "another headset is connected",
            )
            await first.until(lambda: rig.alive, sending=True)
            assert rig.alive
            await asyncio.sleep(1.1)  # it hangs: the next one takes its place
            async with Headset(rig) as third:
                await third.until(lambda: rig.alive, sending=True)

    run(work())


def answer(address: str, **headers: str) -> tuple[int, str]:
    """Return status and text of a page."""
    context = ssl._create_unverified_context()
    try:
        request = urllib.request.Request(address, headers=headers)
        with urllib.request.urlopen(request, timeout=5.0, context=context) as response:
            return response.status, response.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def test_pages_of_other_sites_get_nothing(rig: Rig) -> None:
    status, text = answer(rig.address)
    assert (status, "<h1>Headset</h1>" in text) == (200, True)
    assert answer(rig.address + "page.js")[0] == 200
    assert answer(rig.address + "certificate.pem")[0] == 404
    assert answer(rig.address + "../process.py")[0] == 404
    assert answer(rig.address, Host="evil.example")[0] == 403
    assert answer(rig.address, Origin="http://evil.example")[0] == 403

    async def work() -> None:
        with pytest.raises(Exception, match="403"):
            await clients.connect(rig.address.replace("http", "ws") + "poses", origin="http://x.y")

    run(work())


@pytest.mark.slow
def test_over_tls_with_a_token(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cryptography", reason="pip install cryptography")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    rig = Rig(host="127.0.0.9", token="open-sesame-84")
    try:
        path = tmp_path / "unicon" / "webxr" / "certificate.pem"
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert rig.address.startswith("https://127.0.0.9:")
        rig.until(lambda: bool(rig.lines))
        assert "SHA-256 " in rig.lines[0]
        assert "open-sesame" not in rig.lines[0]
        assert answer(rig.address)[0] == 403
        assert answer(rig.address + "?token=wrong")[0] == 403
        status, text = answer(rig.address + "?token=open-sesame-84")
        assert (status, "Headset" in text) == (200, True)
        trusting = ssl.create_default_context(cafile=str(path))
        url = rig.address + "?token=open-sesame-84"
        with urllib.request.urlopen(url, timeout=5.0, context=trusting) as response:
            assert response.status == 200  # its names are those of the address

        async def work() -> None:
            with pytest.raises(Exception, match="403"):
                async with Headset(rig, ssl=trusting):
                    pass
            known = Headset(rig, ssl=trusting)
            known._address += "?token=open-sesame-84"
            async with known as headset:
                await headset.until(lambda: rig.alive, sending=True)

        run(work())
        before = path.read_bytes()
        rig.close()
        rig = Rig(host="127.0.0.9", token="open-sesame-84")
        assert path.read_bytes() == before  # made once
        rig.close()
        rig = Rig(host="127.0.0.8", token="open-sesame-84")
        assert path.read_bytes() != before  # for another address
        rig.close()
        path.write_text("garbage")
        path.chmod(0o600)
        rig = Rig(tls=True)
        assert b"PRIVATE KEY" in path.read_bytes()
    finally:
        rig.close()


@pytest.mark.slow
def test_a_port_that_is_taken_is_an_error(rig: Rig) -> None:
    port = int(rig.address.rsplit(":", 1)[1].strip("/"))
    with pytest.raises(UniconError, match=f"cannot be served at 127.0.0.1:{port}.*give another"):
        Rig(port=port)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"host": "0.0.0.0"}, "lets everybody in the network move the robot; give a token"),
        ({"host": "10.0.0.1", "token": "short"}, "too plain; give 12 or more"),
        ({"host": "10.0.0.1", "token": "a" * 20, "tls": False}, "leave tls out"),
        ({"port": 70000}, "port is 70000; write a whole number from 0 to 65535"),
        ({"stale": math.nan}, "stale is nan; write a number from 0.02 to 2"),
    ],
)
def test_wrong_options_are_named(options: dict[str, Any], why: str) -> None:
    with pytest.raises(WorkflowError, match=why):
        Rig(**options)


def test_the_document_names_options_and_states_that_there_are() -> None:
    text = (Path(__file__).parents[2] / "docs" / "reference" / "peripherals.md").read_text(
        encoding="utf-8"
    )
    examples = [yaml.safe_load(block) for block in re.findall(r"```yaml\n(.*?)```", text, re.S)]
    listed = [each for one in examples for each in one.get("commands", ())]
    found = [x["webxr"] if isinstance(x, dict) else {} for x in listed if "webxr" in x]
    assert len(found) == 2
    declared = webxr.declares()  # type: ignore[attr-defined]
    for options in found:
        block = webxr(BuildContext(States(declared), load_robot("go2"), 0.005, dry=True), **options)
        assert block.writes == tuple(declared)
    for name in declared:
        assert f"`{name}`" in text, name
