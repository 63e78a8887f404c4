"""Unitree's driver against the robot's end on loopback: both ways, attacks, release."""

from __future__ import annotations

import json
import math
import os
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-unitree]'")

from dds_ends import ticking
from unitree_helpers import (
    DOMAIN,
    LOOPBACK,
    PATIENCE,
    Pair,
    encode_of,
    reader_of,
    states_of,
    until,
    writer_of,
)

from unicon_base.errors import Fault, PlatformError, UniconError
from unicon_core.blocks.controls.device import Controls, unitree
from unicon_core.blocks.controls.gamepad import EVENT
from unicon_core.platforms.platform import Prepares, ReportsVariant, SeesCommanders, WaitsForData
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states
from unicon_core.states.layout import StateSpec
from unicon_core.states.standard import BUTTONS, COMMAND_STATES, CONTROL_STATES, control_states
from unicon_hardware.dds import participant as dds
from unicon_hardware.dds.participant import OCTETS, Participant, dds_type
from unicon_hardware.unitree import facts as release
from unicon_hardware.unitree import platform as wire
from unicon_hardware.unitree.face import face
from unicon_hardware.unitree.platform import Unitree, make
from unicon_msgs_map.codec.binding import unitree_crc
from unicon_msgs_map.layout.messages import shared_messages
from unicon_msgs_map.layout.paths import Reference, parse_path
from unicon_msgs_map.spec import FieldSpec
from unicon_ros.bench.report import free_domain

TELLS = ("joint_pos", "joint_vel", "joint_effort", "base_quat", "base_ang_vel", "base_lin_acc")
TELLS += ("motor_temperature",)


@pytest.fixture(params=["go2", "g1_29dof"])
def pair(request: pytest.FixtureRequest) -> Iterator[Pair]:
    made = Pair(load_robot(request.param))
    yield made
    made.close()


@pytest.fixture
def go2() -> Iterator[Pair]:
    made = Pair(load_robot("go2"))
    yield made
    made.close()


def summed(pair: Pair, raw: bytes) -> bytes:
    """Return a LowState with a right checksum."""
    field = FieldSpec("crc", parse_path("crc"), Reference("const", value=0))
    message = shared_messages().struct(f"{pair.robot.transport['protocol']}/msg/LowState")
    buffer = bytearray(raw)
    buffer[1] = 0  # the checksum's own padding
    crc = unitree_crc(field, message, buffer)()
    return raw[:-4] + crc.to_bytes(4, "little")


def sent(pair: Pair, raw: bytes) -> int:
    """Let the robot's own writer send something else, and take it."""
    writer_of(pair.face).write(raw)
    assert pair.wire.wait(5.0)
    return pair.wire.take()


def test_both_ways_everything_is_equal(pair: Pair) -> None:
    rng = np.random.default_rng(1)
    n = pair.robot.num_joints
    for _ in range(20):
        for name in TELLS[:3]:
            pair.theirs[name][...] = rng.normal(size=n)
        quat = rng.normal(size=4)
        pair.theirs["base_quat"][...] = quat / np.linalg.norm(quat)
        pair.theirs["base_ang_vel"][...] = rng.normal(size=3)
        pair.face.remote[:] = bytes(rng.integers(0, 256, 40, dtype=np.uint8))
        for name in COMMAND_STATES:
            pair.ours[name][...] = rng.normal(size=n)
        assert pair.told() == 1
        for name in TELLS:
            np.testing.assert_allclose(pair.ours[name], pair.theirs[name], rtol=1e-6, err_msg=name)
        assert pair.wire.remote == pair.face.remote
        pair.wire.put()
        until(pair.face.hear)
        for name in COMMAND_STATES:
            np.testing.assert_array_equal(pair.theirs[name], pair.ours[name])
    assert not pair.wire.counts.refused
    assert not pair.face.counts.refused
    assert not pair.wire.wait(0.0)


def test_errors_and_the_hotter_temperature_of_each_motor_are_told() -> None:
    pair = Pair(load_robot("g1_29dof"))
    try:
        pair.theirs["motor_error"][3] = -2  # on the wire a uint32 with the highest bit set
        pair.theirs["motor_temperature"][...] = np.arange(29.0)
        assert pair.told() == 1
        assert pair.ours["motor_error"].tolist() == [0, 0, 0, -2, *[0] * 25]
        np.testing.assert_array_equal(pair.ours["motor_temperature"], np.arange(29.0))
        pair.face.own["tick"] += 2
        raw = bytearray(encode_of(pair.face)())
        struct.pack_into("<h", raw, 4 + 70 + 20, 77)  # the second one of motor 0
        assert sent(pair, summed(pair, bytes(raw))) == 1
        assert pair.ours["motor_temperature"][0] == 77.0
    finally:
        pair.close()


def test_a_backlog_is_drained_to_the_newest(pair: Pair) -> None:
    for value in (1.0, 2.0, 3.0):
        pair.theirs["joint_pos"][...] = value
        pair.face.tell()
    taken = until(pair.wire.take)
    while taken < 3:
        taken += pair.wire.take()
    assert pair.ours["joint_pos"][0] == 3.0
    for _ in range(200):  # a flood is not kept
        pair.face.tell()
    assert 1 <= until(pair.wire.take) <= dds.DEPTH


def test_wrong_frames_are_counted_and_left(go2: Pair) -> None:
    go2.face.clock.count = 123456789
    go2.told()
    before = go2.ours["joint_pos"].copy()
    good = encode_of(go2.face)()
    assert sent(go2, good) == 0
    assert go2.wire.counts.refused["old tick"] == 1  # the same number again
    newer = bytearray(good)
    tick = int(go2.face.own["tick"])
    at = good.index(tick.to_bytes(4, "little"))
    struct.pack_into("<I", newer, at, tick - 100)
    assert sent(go2, summed(go2, bytes(newer))) == 0
    assert go2.wire.counts.refused["old tick"] == 2
    struct.pack_into("<I", newer, at, tick + 1)
    assert sent(go2, bytes(newer)) == 0
    assert go2.wire.counts.refused["wrong CRC"] == 1
    for value in (np.nan, np.inf):
        tick += 2
        struct.pack_into("<I", newer, at, tick)
        struct.pack_into("<f", newer, 4 + 80, value)  # q of motor 0
        assert sent(go2, summed(go2, bytes(newer))) == 0
    assert go2.wire.counts.refused["impossible values"] == 2
    zero = bytearray(good)
    struct.pack_into("<I", zero, at, tick + 5)
    zero[4 + 24 : 4 + 40] = bytes(16)  # an IMU that is not there
    assert sent(go2, summed(go2, bytes(zero))) == 0
    assert go2.wire.counts.refused["impossible values"] == 3
    np.testing.assert_array_equal(go2.ours["joint_pos"], before)
    go2.face.clock.count = tick + 10
    assert go2.told() == 1
    go2.face.clock.count = 2**32 - 5  # behind: half a turn or more
    assert go2.told() == 0


def test_the_frame_number_may_wrap() -> None:
    made = face(states_of(load_robot("go2")), load_robot("go2"), domain=DOMAIN, mode="")
    made.clock.count = 2**32 - 4
    made.close()
    pair = Pair(load_robot("go2"))
    try:
        pair.wire._last = 2**32 - 3
        pair.face.clock.count = 2**32 - 2
        assert pair.told() == 1
        assert int(pair.wire._tick) == 0
    finally:
        pair.close()


def test_a_bad_frame_does_not_hide_the_good_one_before_it(go2: Pair) -> None:
    go2.theirs["joint_pos"][...] = 0.5
    go2.face.tell()
    go2.face.own["tick"] += 2
    bad = bytearray(encode_of(go2.face)())
    struct.pack_into("<f", bad, 4 + 80, np.nan)
    assert sent(go2, summed(go2, bytes(bad))) + go2.wire.take() >= 0
    until(lambda: go2.wire.counts.refused["impossible values"] == 1, go2.wire.take)
    assert go2.ours["joint_pos"][0] == 0.5


def test_senders_are_known_by_the_same_number_everywhere(go2: Pair) -> None:
    others = [Participant(DOMAIN, LOOPBACK, f"robot {i}") for i in range(6)]
    try:
        message, frame = shared_messages().struct("unitree_go/msg/LowState"), encode_of(go2.face)()
        for number, other in enumerate(others, 2):
            writer = other.writer("rt/lowstate", message)
            until(lambda: len(reader_of(go2.wire).sources) == number)  # noqa: B023
            writer.write(frame)
            _, info = until(reader_of(go2.wire).take)[-1]
            assert info.publication_handle in reader_of(go2.wire).sources
    finally:
        for other in others:
            other.close()


def test_strangers_and_a_robot_that_comes_back(go2: Pair) -> None:
    go2.told()
    stranger = face(states_of(go2.robot), go2.robot, domain=DOMAIN, mode="")
    stranger.own["tick"][...] = 10**6
    counts = go2.wire.counts
    until(lambda: counts.refused["another sender"], lambda: (stranger.tell(), go2.wire.take()))
    assert go2.ours["joint_pos"][0] == go2.theirs["joint_pos"][0]
    assert go2.told() + go2.wire.take() >= 0
    go2.face.close()  # the robot dies: whoever tells now is the robot
    stranger.own["tick"][...] = 0
    until(go2.wire.take, stranger.tell)
    assert go2.ours["joint_pos"][0] == 0.0
    stranger.close()


def test_a_change_of_the_variant_is_a_fault() -> None:
    pair = Pair(load_robot("g1_29dof"))
    try:
        assert pair.wire.variant == {"protocol": "unitree_hg", "mode_machine": 5}
        pair.face._variant[...] = 4
        pair.face.tell()
        assert pair.wire.wait(5.0)
        with pytest.raises(Fault, match="mode_machine is 4, and was 5"):
            pair.wire.take()
        pair.wire.put()  # damping, which the robot as it is now obeys
        until(pair.face.hear)
    finally:
        pair.close()


def test_the_robot_leaves_bad_commands(pair: Pair) -> None:
    good = encode_of(pair.wire)()
    writer_of(pair.wire).write(good[:-1] + bytes((good[-1] ^ 1,)))
    refused = pair.face.counts.refused
    until(lambda: refused["wrong CRC"], pair.face.hear)
    pair.face._facts.modes[0] = 7
    pair.wire.put()
    until(lambda: refused["motor mode"], pair.face.hear)
    pair.face.mode = "ai"
    pair.face._facts.modes[0] = pair.robot.transport["motor_mode"]
    pair.wire.put()
    until(lambda: refused["its own controller commands"], pair.face.hear)
    assert pair.face.counts.good == 0


def released(pair: Pair) -> list[str]:
    """Ask the robot's controller to let go, and return what was waited for."""
    seen: list[str] = []

    def step() -> bool:
        pair.face.hear()
        reason = pair.wire.prepare()
        if reason and reason not in seen:
            seen.append(reason)
        return not reason

    until(step)
    return seen


@pytest.mark.parametrize("name", ["go2", "g1_29dof"])
def test_its_own_controller_is_asked_to_let_go(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = load_robot(name)
    robot.transport["release"]["wait"] = 0.05  # type: ignore[index]
    pair = Pair(robot, release=True)
    try:
        pair.wire.put()
        until(lambda: pair.face.counts.refused["its own controller commands"], pair.face.hear)
        seen = released(pair)
        assert pair.face.obeys
        assert pair.face.asked["motion_switcher"] == [1001, 1003, 1001]
        assert pair.face.asked.get("sport") == ([1005] if name == "go2" else None)
        assert any("mode 'normal', to let go of the motors" in reason for reason in seen)
        assert pair.wire.prepare() == ""
        pair.wire.put()
        until(pair.face.hear)
    finally:
        pair.close()


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        (
            (0, json.dumps({"form": "0", "name": "ai"})),
            "mode 'ai' again after ReleaseMode, 5 times",
        ),
        ((3203, ""), "refuses request 1001 with code 3203: the service does not know the request"),
        ((7, ""), "with code 7: switch the robot's own controller off"),
        ((0, "no json"), "answers 'no json', which names no mode"),
        ((0, "[1]"), "which names no mode"),
        ((0, '{"name": null}'), "which names no mode"),
        (None, "does not answer request 1001 within"),
    ],
)
def test_a_controller_that_does_not_let_go_is_a_fault(
    answer: tuple[int, str] | None, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(release.Release, "timeout", 0.2 if answer is None else 5.0)
    robot = load_robot("go2")
    robot.transport["release"]["wait"] = 0.0  # type: ignore[index]
    pair = Pair(robot, release=True)

    def reply(service: str, server: Any, asked: Any) -> None:
        if answer is not None:
            switches = service == "motion_switcher" and asked.header.identity.api_id == 1001
            server.reply(asked, *(answer if switches else (0, "")))

    monkeypatch.setattr(pair.face, "_answer", reply)
    try:
        with pytest.raises(Fault) as raised:
            released(pair)
        assert told in str(raised.value)
    finally:
        pair.close()


def test_check_mode_is_asked_again_where_its_answer_was_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(release, "AGAIN", 0.05)
    robot = load_robot("g1_29dof")
    robot.transport["release"]["wait"] = 0.0  # type: ignore[index]
    pair = Pair(robot, release=True)
    answer, asked = pair.face._answer, []

    def reply(service: str, server: Any, request: Any) -> None:
        asked.append(request.header.identity.api_id)
        if len(asked) > 2:  # the first two answers are lost
            answer(service, server, request)

    monkeypatch.setattr(pair.face, "_answer", reply)
    try:
        released(pair)
        assert asked[:3] == [1001, 1001, 1001]
        assert asked.count(1003) == 1
        assert pair.face.obeys
    finally:
        pair.close()


def test_a_robot_without_the_service_is_a_fault_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(release.Release, "timeout", 0.1)
    participant = Participant(free_domain(), LOOPBACK, "test")
    asking = release.Release(participant, None, 0.0, "test")
    try:
        with pytest.raises(Fault, match=r"nobody serves 'motion_switcher' within .*peer: unit"):
            until(lambda: not asking())
    finally:
        participant.close()


def test_others_who_command_are_counted(go2: Pair) -> None:
    assert go2.wire.commanders() == {"rt/lowcmd": 0}
    other = Participant(DOMAIN, LOOPBACK, "another program")
    other.writer("rt/lowcmd", shared_messages().struct("unitree_go/msg/LowCmd"))
    other.writer("rt/other", shared_messages().struct("unitree_go/msg/LowCmd"))
    until(lambda: go2.wire.commanders() == {"rt/lowcmd": 1})
    other.close()
    until(lambda: go2.wire.commanders() == {"rt/lowcmd": 0})


def test_the_platform_says_what_it_is_and_opens_again() -> None:
    robot = load_robot("go2")
    ours = states_of(robot)
    with ticking(face(states_of(robot), robot, domain=DOMAIN, mode="")):
        for _ in range(2):
            platform = make(ours, robot, 0.002, address=LOOPBACK, domain=DOMAIN)
            for protocol in (Prepares, ReportsVariant, SeesCommanders, WaitsForData):
                assert isinstance(platform, protocol)
            assert "motor_error" not in platform.facts.writes
            assert "battery_charge" in platform.facts.writes
            assert platform.variant() == {"protocol": "unitree_go"}
            platform.close()
            platform.close()


def test_states_that_a_workflow_declares_are_written() -> None:
    robot = load_robot("go2")
    specs = standard_states(robot.joint_names)
    specs |= {"foot_force": StateSpec((4,)), "wireless_remote": StateSpec((40,), "uint8")}
    specs |= control_states()
    ours = States(specs)
    theirs = States(standard_states(robot.joint_names) | {"foot_force": StateSpec((4,))})
    theirs["foot_force"][...] = (20, 21, -22, 23)
    made = face(theirs, robot, domain=DOMAIN, mode="")
    made.remote[2:4] = b"\x01\x02"

    ends = wire.UnitreeWire(ours, robot, DOMAIN, LOOPBACK)
    try:
        until(ends.take, made.tell)
        assert ours["foot_force"].tolist() == [20, 21, -22, 23]
        assert ours["wireless_remote"][2:4].tolist() == [1, 2]
        pressed = [name for name, value in zip(BUTTONS, ours["buttons"]) if value]
        assert (pressed, int(ours["controls_alive"])) == (["R1", "B"], 1)
    finally:
        ends.close()
        made.close()


def test_a_peer_without_checksums_and_numbers_is_heard_as_such() -> None:
    robot = load_robot("go2")
    theirs, ours = states_of(robot), states_of(robot)
    made = face(theirs, robot, domain=DOMAIN, mode="")
    theirs["battery_charge"][...] = 0.0
    bare = encode_of(made)()[:-4] + bytes(4)
    ended = Event()

    def tick() -> None:
        while not ended.wait(0.002):
            writer_of(made).write(bare)

    thread = Thread(target=tick)
    thread.start()
    try:
        options: dict[str, Any] = {"address": LOOPBACK, "domain": DOMAIN}
        with pytest.raises(PlatformError, match=r"refused: \d+ wrong CRC; the last one: wrong CRC"):
            make(ours, robot, 0.02, connect=0.5, **options)
        platform = make(ours, robot, 0.02, peer="unitree_mujoco", **options)
        assert platform.prepare() == ""
        assert "battery_charge" not in platform.facts.writes
        assert ours["battery_charge"] == 1.0
        assert until(platform.arrivals)
        platform.close()
    finally:
        ended.set()
        thread.join()
        made.close()


def test_a_simulator_that_leaves_its_mode_machine_at_zero_does_not_tell_a_variant() -> None:
    robot = load_robot("g1_29dof")
    made = face(states_of(robot), robot, domain=DOMAIN, mode="", variant=0)
    ended = Event()

    def tick() -> None:
        while not ended.wait(0.002):
            made.tell()

    thread = Thread(target=tick)
    thread.start()
    try:
        options: dict[str, Any] = {"address": LOOPBACK, "domain": DOMAIN}
        for peer, told in (
            ("robot", {"protocol": "unitree_hg", "mode_machine": 0}),
            ("unitree_mujoco", {"protocol": "unitree_hg"}),
        ):
            platform = make(states_of(robot), robot, 0.02, peer=peer, **options)
            assert platform.variant() == told
            platform.close()
    finally:
        ended.set()
        thread.join()
        made.close()


def test_wrong_options_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = load_robot("go2")

    def opened(**options: Any) -> str:
        with pytest.raises(PlatformError) as raised:
            make(states_of(robot), robot, 0.02, **{"connect": 0.05, **options})
        return str(raised.value)

    assert "domain is -1" in opened(domain=-1)
    told = opened(domain=DOMAIN, address='"/><x a="')
    assert "neither an address nor the name" in told
    assert "cannot use address 'eth77'" in opened(domain=DOMAIN, address="eth77")
    assert "cannot use address '10.1.2.3'" in opened(domain=DOMAIN, address="10.1.2.3")
    assert "silence is 0" in opened(domain=DOMAIN, address=LOOPBACK, silence=0.0)
    assert "no peer 'mujoco'; known" in opened(peer="mujoco")
    first = Participant(DOMAIN, LOOPBACK, "first")
    assert f"domain {DOMAIN} is open on 127.0.0.1 in this process" in opened(
        domain=DOMAIN, address="lo"
    )
    first.close()
    first.close()
    monkeypatch.setattr(dds.metadata, "version", lambda _: "0.10.2")
    assert "cyclonedds is 0.10.2, and only 11.0.1 is known" in opened(domain=DOMAIN)


def members(kind: Any) -> Iterator[Any]:
    """Give every type in a DDS type, however deep."""
    if hasattr(kind, "__idl_typename__"):
        for each in kind.__annotations__.values():
            yield from members(each)
        return
    yield kind
    for inner in getattr(kind, "__metadata__", ()):
        if hasattr(inner, "subtype"):
            yield from members(inner.subtype)


def test_without_an_address_the_environment_chooses(monkeypatch: pytest.MonkeyPatch) -> None:
    interfaces = '<Interfaces><NetworkInterface name="lo"/></Interfaces>'
    monkeypatch.setenv("CYCLONEDDS_URI", f"<General>{interfaces}</General>")
    Participant(free_domain(), None, "test").close()
    monkeypatch.setenv("CYCLONEDDS_URI", "<General><Nonsense/></General>")
    with pytest.raises(PlatformError, match=r"cannot join DDS domain .* see CYCLONEDDS_URI"):
        Participant(free_domain(), None, "test")


def test_what_the_robot_does_without_commands_is_an_assumption_that_has_to_be_made() -> None:
    robot = load_robot("go2")
    for given, dead_man in ((None, math.inf), (0.1, 0.1)):
        made = face(states_of(robot), robot, domain=DOMAIN, dead_man=given)
        assert made.dead_man == dead_man
        made.close()
    for wrong in (0.0, -1.0, 0.002, 11.0, math.nan, True, "soon"):
        with pytest.raises(
            UniconError, match=r"emulated unitree: dead_man is .* above 0\.002 to 10"
        ):
            face(states_of(robot), robot, domain=DOMAIN, dead_man=wrong)  # type: ignore[arg-type]


def test_a_pipe_is_held_as_the_robot_s_remote(tmp_path: Path) -> None:
    path = tmp_path / "pad"
    os.mkfifo(path)
    writer = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    pair = Pair(load_robot("go2"), remote=str(path))
    seen = States(control_states())
    for code, value, buttons, forward in ((0x130, 1, {"A"}, 0.0), (0x13B, 1, {"A", "start"}, 1.0)):
        os.write(writer, EVENT.pack(0, 0, 1, code, value))
        os.write(writer, EVENT.pack(0, 0, 3, 0x01, -32768 if forward else 0))
        assert pair.told() == 1
        unitree(pair.wire.remote, Controls(seen))
        assert {name for name, held in zip(BUTTONS, seen["buttons"]) if held} == buttons
        assert seen["sticks"].tolist() == pytest.approx([0.0, forward, 0.0, 0.0], abs=1e-4)
    os.close(writer)  # nobody holds it any more
    assert pair.told() == 1
    assert not any(pair.wire.remote)
    pair.close()
    (tmp_path / "file").write_text("")
    with pytest.raises(UniconError, match="is not an input device"):
        Pair(load_robot("go2"), remote=str(tmp_path / "file"))


DDS_MESSAGES = ("go/msg/LowCmd", "go/msg/LowState", "hg/msg/LowCmd", "hg/msg/LowState")
DDS_MESSAGES += ("go/msg/MotorCmds", "hg/msg/HandCmd", "hg/msg/HandState")
DDS_MESSAGES += ("api/msg/Request", "api/msg/Response")


@pytest.mark.parametrize("name", DDS_MESSAGES)
def test_no_octet_is_a_uint8_and_names_are_the_vendor_s(name: str) -> None:
    from cyclonedds.idl import types

    made = dds_type(shared_messages().struct(f"unitree_{name}"))
    package, _, message = f"unitree_{name}".split("/")
    assert made.__idl_typename__ == f"{package}.msg.dds_.{message}_"
    found = list(members(made))
    assert types.byte in found
    assert types.uint8 not in found
    assert types.int8 not in found
    assert {"uint8", "int8"} < set(OCTETS)


@pytest.mark.parametrize(
    "name", ["go_lowcmd", "go_lowstate", "hg_lowcmd", "hg_lowstate", "hg_handstate"]
)
def test_cyclonedds_lays_our_types_out_as_the_vendor_does(assets: Any, name: str) -> None:
    text = (assets / "frames" / f"dds_{name}.hex").read_text()
    raw = bytes.fromhex("".join(text.split()))
    names = {"lowcmd": "LowCmd", "lowstate": "LowState", "handstate": "HandState"}
    package, message = name.split("_")
    made = dds_type(shared_messages().struct(f"unitree_{package}/msg/{names[message]}"))
    assert made.deserialize(raw).serialize(use_version_2=False) == raw


def test_what_is_read_ahead_reaches_the_states_with_take_alone(pair: Pair) -> None:
    before = pair.ours.buffer.copy()
    pair.theirs["joint_pos"][...] += 0.25
    pair.face.tell()
    assert pair.wire.wait(PATIENCE)
    good = pair.wire.counts.good
    pair.wire.warm_up()
    assert pair.wire.counts.good == good + 1
    assert not pair.wire._inlets[0]._reader.take()
    np.testing.assert_array_equal(pair.ours.buffer, before)
    assert pair.wire.wait(0.0)  # it is there for who waits, too
    assert pair.wire.take() == 1
    np.testing.assert_allclose(pair.ours["joint_pos"], pair.theirs["joint_pos"], atol=1e-6)
    assert not pair.wire.wait(0.0)
    assert pair.wire.take() == 0


def test_a_fault_that_is_read_ahead_is_told_by_take() -> None:
    pair = Pair(load_robot("g1_29dof"))
    try:
        assert pair.told() == 1
        pair.face._variant[...] = 4
        pair.face.tell()
        assert pair.wire.wait(PATIENCE)
        pair.wire.warm_up()
        pair.wire.warm_up()
        assert pair.wire.wait(0.0)
        with pytest.raises(Fault, match="mode_machine is 4, and was 5"):
            pair.wire.take()
        assert pair.wire.take() == 0
    finally:
        pair.close()


def test_a_warm_up_sends_the_robot_nothing(pair: Pair) -> None:
    pair.wire.put()
    until(pair.face.hear)
    for _ in range(10):
        pair.wire.warm_up()
    time.sleep(0.05)
    assert not pair.face.hear()


def test_its_remote_takes_the_place_of_a_gamepad() -> None:
    robot = load_robot("go2")
    states = States(standard_states(robot.joint_names) | control_states())
    for peer in ("robot", "unitree_mujoco"):
        examined = Unitree.facts.examine(states, robot, 0.02, peer=peer)  # type: ignore[misc]
        assert {*CONTROL_STATES} <= {*examined.facts.writes}
    assert {*CONTROL_STATES} <= {*Unitree.facts.writes}
