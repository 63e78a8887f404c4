"""Face `ros`: what it takes of commands and gains, and what it leaves."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest

from unicon_base.errors import PlatformError
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states
from unicon_hardware.emulate.ros_face import RosEndpoint, face

pytestmark = pytest.mark.ros
ROBOT = load_robot("go2")
NAMES = list(ROBOT.joint_names)


def message(
    name: list[str], position: list[float] | None = None, effort: list[float] | None = None
) -> SimpleNamespace:
    return SimpleNamespace(name=name, position=position or [], effort=effort or [])


@pytest.fixture
def built() -> Iterator[tuple[RosEndpoint, States]]:
    states = States(standard_states(ROBOT.joint_names))
    found = face(states, ROBOT)
    yield found, states
    found.close()
    found.close()


def test_what_is_no_command_is_left(built: tuple[RosEndpoint, States]) -> None:
    face, states = built
    for bad in (
        message([]),
        message(NAMES),
        message(NAMES, [0.1] * 11),
        message(["nobody"], [0.1]),
        message([NAMES[0], NAMES[0]], [0.1, 0.2]),
    ):
        face._commanded(bad)
        assert face._came == 0
    assert not states["joint_stiffness"].any()
    assert not states["joint_pos_target"].any()
    face._commanded(message(NAMES[3:5], [0.25, -0.5]))
    assert face._came == 1
    assert list(states["joint_pos_target"][3:5]) == [0.25, -0.5]


def test_gains_go_by_name_and_bad_ones_are_left(built: tuple[RosEndpoint, States]) -> None:
    face, states = built
    order = NAMES[::-1]
    face._gained(message(order, effort=[float(i) for i in range(12)]))
    for bad in (
        message(NAMES, effort=[np.nan] * 12),
        message(NAMES, effort=[-1.0] * 12),
        message(NAMES[:11], effort=[1.0] * 12),
        message(["nobody"], effort=[1.0]),
        message([]),
    ):
        face._gained(bad)
    face._commanded(message(NAMES, [0.0] * 12))
    assert list(states["joint_stiffness"]) == list(range(11, -1, -1))


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_a_wrong_rate_is_told(rate: float) -> None:
    with pytest.raises(PlatformError, match=r"face 'ros': rate is .* give more than 0, at most"):
        face(States(standard_states(ROBOT.joint_names)), ROBOT, rate=rate)
