"""What holds for all drivers over DDS: garbage, silence, silent platforms, wrong facts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-unitree]'")

from dds_ends import DOMAIN, LOOPBACK, ticking, until, whole_states

from unicon_base.errors import Fault, MissingDependencyError, PlatformError, RobotError
from unicon_core.robots import Robot, load_robot
from unicon_hardware.booster.codec import BoosterFacts
from unicon_hardware.booster.platform import make as booster
from unicon_hardware.booster.takeover import face as t1
from unicon_hardware.dds import participant
from unicon_hardware.dds.maps import arrays_of
from unicon_hardware.dobot.codec import DobotFacts
from unicon_hardware.dobot.codec import face as atom
from unicon_hardware.dobot.platform import make as dobot
from unicon_hardware.inspire.dds.wire import HandFacts
from unicon_hardware.inspire.dds.wire import face as rh56
from unicon_hardware.inspire.platform import make as inspire
from unicon_hardware.pnd.platform import PndFacts
from unicon_hardware.pnd.platform import face as adam
from unicon_hardware.pnd.platform import make as pnd
from unicon_hardware.unitree.face import face as go2
from unicon_hardware.unitree.facts import UnitreeFacts
from unicon_hardware.unitree.platform import make as unitree
from unicon_hardware.unitree_dex3.platform import Dex3Facts
from unicon_hardware.unitree_dex3.platform import face as dex3_face
from unicon_hardware.unitree_dex3.platform import make as dex3
from unicon_hardware.wire import Counts


@dataclass
class Vendor:
    """A robot behind DDS.

    Attributes:
        robot: name of its file.
        facts: reads them.
        make, face: build platform and endpoint.
        topic: of its state, for messages.
        extra: which installs cyclonedds.
        options: of the platform.
        holds: it keeps its last target, and has no stiffness.
    """

    robot: str
    facts: Callable[[Robot], Any]
    make: Any
    face: Any
    topic: str
    extra: str
    options: dict[str, Any] = field(default_factory=dict)
    holds: bool = False


SDK = {"layout": "sdk", "fsm_id": 2}
VENDORS = {
    "go2": Vendor("go2", UnitreeFacts.of, unitree, go2, "rt/lowstate", "hw-unitree"),
    "dex3": Vendor("dex3_left", Dex3Facts.of, dex3, dex3_face, "rt/dex3/left/state", "hw-unitree"),
    "pnd": Vendor("adam_lite", PndFacts.of, pnd, adam, "rt/lowstate", "hw-pnd"),
    "dobot": Vendor(
        "atom",
        partial(DobotFacts.of, layout="sdk"),
        dobot,
        atom,
        "rt/lower/state and rt/upper/state",
        "hw-dobot",
        SDK,
    ),
    "booster": Vendor("t1", BoosterFacts.of, booster, t1, "rt/low_state", "hw-booster"),
    "ftp": Vendor(
        "inspire_rh56_ftp_left", HandFacts.of, inspire, rh56, "rt/inspire", "hw-inspire", holds=True
    ),
    "dfx": Vendor(
        "inspire_rh56_dfx_left",
        HandFacts.of,
        inspire,
        rh56,
        "rt/inspire/state",
        "hw-inspire",
        holds=True,
    ),
}
REACHED = {"address": LOOPBACK, "domain": DOMAIN}
each = pytest.mark.parametrize("vendor", VENDORS.values(), ids=VENDORS)


@settings(max_examples=20, deadline=None)
@given(noise=st.binary(max_size=1800), at=st.integers(0, 1700), value=st.binary(min_size=1))
@each
def test_garbage_never_raises_and_never_writes_what_is_not_finite(
    vendor: Vendor, noise: bytes, at: int, value: bytes
) -> None:
    robot = load_robot(vendor.robot)
    facts, states = vendor.facts(robot), whole_states(robot)
    arrays = arrays_of(states) | facts.own(robot.num_joints)
    arrays["base_quat"][...] = (1, 0, 0, 0)
    messages = list(getattr(facts, "halves", (facts,)))
    if vendor.make is pnd:
        messages.append(replace(facts, battery=True))
    for half in messages:
        good = half.state.encoder(arrays).encode()
        for raw in (noise, good[:at], good[:at] + value[:4] + good[at + 4 :], good + noise):
            frames = half.state_in(arrays, Counts())
            if frames.good(raw):
                frames.read(raw)
            for name, array in arrays.items():
                assert np.isfinite(array).all(), name


@each
def test_the_platform_sends_nothing_silently_knows_silence_and_damps_at_its_end(
    vendor: Vendor,
) -> None:
    robot = load_robot(vendor.robot)
    theirs, ours = whole_states(robot), whole_states(robot)
    made = vendor.face(theirs, robot, domain=DOMAIN)
    with ticking(made) as mute:
        quiet = vendor.make(ours, robot, 0.01, silent=True, **REACHED, **vendor.options)
        assert quiet.prepare() == ""
        ours["joint_pos_target"][...] = 0.4
        ours["joint_stiffness"][...] = 9.0
        quiet.send()
        quiet.close()
        assert not theirs["joint_stiffness"].any()
        assert not theirs["joint_pos_target"].any()
        platform = vendor.make(ours, robot, 0.01, silence=0.4, **REACHED, **vendor.options)
        until(lambda: not platform.prepare(), platform.recv)
        assert made.obeys
        until(lambda: platform._wire.matched)
        ours["joint_pos_target"][...] = 0.2
        ours["joint_stiffness"][...], ours["joint_damping"][...] = 30.0, 2.0
        platform.send()
        until(lambda: abs(theirs["joint_pos_target"][0] - 0.2) < 2e-3, platform.send)
        until(lambda: vendor.holds or theirs["joint_stiffness"].max() == 30.0, platform.send)
        mute.set()
        with pytest.raises(Fault, match=f"nothing from {vendor.topic}"):
            until(platform.recv)
        platform.close()
        until(lambda: not theirs["joint_stiffness"].any())
        if vendor.make is unitree:
            np.testing.assert_array_equal(theirs["joint_damping"], robot.joint_damping)
        if vendor.holds:
            assert abs(theirs["joint_pos_target"][0] - 0.2) < 2e-3
        if vendor.make is dex3:  # stopped, without damping
            until(lambda: made.stopped)
            assert not theirs["joint_damping"].any()
        elif vendor.make is booster:
            until(lambda: int(made.mode) == 0)


@pytest.mark.parametrize(
    ("name", "key", "value", "words"),
    [
        ("dex3", "status", 8, "transport.status is 8; write a whole number from 0 to 7"),
        ("dex3", "motors", [0] * 7, "7 different slots of 0 to 6"),
        ("dex3", "motors", None, "7 different slots of 0 to 6"),
        ("dex3", "state_topic", "", "write a text"),
        ("dex3", "rate_hz", "fast", "a number from 1 to 10000"),
        ("pnd", "motors", list(range(22)), "23 different slots of 0 to 22"),
        ("pnd", "mode_pr", 2, "mode_pr is 2; write a whole number from 0 to 1"),
        ("pnd", "motor_mode", True, "motor_mode is True"),
        ("pnd", "domain", None, "domain is None"),
        ("dobot", "waist_joint", "neck", "transport.waist_joint is 'neck'; write one of"),
        ("dobot", "lower_motors", [1, 0], "0 to 11, the only order known"),
        ("dobot", "fsm_topic", None, "transport.fsm_topic is None"),
        ("booster", "command_type", "PARALLEL", "is 'PARALLEL'; write one of SERIAL"),
        ("booster", "torque_servo", {"motors": [40]}, "is .* with motors of this robot"),
        (
            "booster",
            "torque_servo",
            {"motors": [15], "motor_stiffness": 5},
            "motor_stiffness is 5; write 0.0",
        ),
        ("booster", "robot_modes", {"damping": 0}, "transport.robot_modes is"),
        ("booster", "rpc_topic", None, "transport.rpc_topic is None"),
        ("booster", "motors", [0, 0], "23 different slots of 0 to 22"),
        ("dfx", "protocol", "modbus", "write one of inspire_ftp, inspire_dfx"),
        ("dfx", "raw_lower", None, "transport.raw_lower is None"),
        ("dfx", "motors", [6] * 6, "6 different slots of 0 to 11"),
        ("dfx", "state_topic", 3, "transport.state_topic is 3; write a text"),
    ],
)
def test_wrong_facts_are_named(name: str, key: str, value: object, words: str) -> None:
    robot = load_robot(VENDORS[name].robot)
    with pytest.raises(RobotError, match=words):
        VENDORS[name].facts(replace(robot, transport={**robot.transport, key: value}))


@each
def test_wrong_options_and_what_is_missing_are_named(
    vendor: Vendor, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = load_robot(vendor.robot)

    def opened(**options: Any) -> str:
        given = {**REACHED, **vendor.options, "connect": 0.05, **options}
        with pytest.raises(PlatformError) as raised:
            vendor.make(whole_states(robot), robot, 0.02, **given)
        return str(raised.value)

    assert "domain is 231; give 0 to 230" in opened(domain=231)
    assert "domain is two; give" in opened(domain="two")
    assert f"no frame that it understands from {vendor.topic}" in opened()

    def absent(name: str) -> str:
        raise participant.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(participant.metadata, "version", absent)
    with pytest.raises(MissingDependencyError, match=rf"needs cyclonedds: .*\[{vendor.extra}\]"):
        vendor.make(whole_states(robot), robot, 0.02, **vendor.options)
