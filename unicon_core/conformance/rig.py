"""A small robot in any simulator, driven joint by joint; what the conformance suite stands on.

rig = Rig("pybullet", tmp_path)
rig.command(joint_effort_ff={"knee": 0.5})
measured = rig.run(10)          # rows of ticks by state
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from unicon_base import AnyMapping, PlatformError
from unicon_base.arrays import Array
from unicon_core.platforms.kit.disturbances import disturb
from unicon_core.platforms.kit.scene import SCENE_KEYS, Scene
from unicon_core.platforms.platform import Platform, info_of
from unicon_core.robots import Robot, load_robot
from unicon_core.states import States, standard_states
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow.autowire import read_options
from unicon_core.workflow.registry import find_factory

TIMESTEP = 0.001
"""Of the physics in [s], which every platform takes as its option `timestep`."""

JOINTS = ("left", "knee", "right", "yaw")
"""Of the robot file: the model has them in the order yaw, right, left, knee."""

EFFORT_LIMIT = 6.0
"""Of each joint in [N·m]."""

FRICTION = 0.5
"""Coefficient of sliding friction of box and floor."""

IMU_POSITION = (0.05, 0.02, 0.03)
"""On the base in [m]."""

STAND: AnyMapping = {"floating": False, "model": {"gravity": 0.0}}
"""Of a robot whose joints alone move."""

_JOINT = (
    "  - {{name: {name}, lower: {lower}, upper: {upper}, velocity: 60.0, effort: {effort}, "
    "default: 0.0, rest: 0.0, stiffness: 10.0, damping: 0.5}}"
)


class Told(dict[str, Array]):
    """What was measured before the first tick and after each: state to values.

    They are float64 of shape (ticks + 1, ..., shape of the state).
    """

    joint_names: Sequence[str]

    def of(self, state: str, joint: str) -> Array:
        """Return what was measured of one joint, shape (ticks + 1, ...)."""
        return self[state][..., self.joint_names.index(joint)]


class Rig:
    """The robot on a platform; close it.

    Args:
        platform: registered name, or `module:factory`.
        folder: takes robot file and model.
        options: of the platform.
        order: joints in the order of the robot file.
        floating: whether the box can move.
        num_robots: batch axis of the states, None for none.
        steps: physics steps in a tick.
        model: values of the model: `gravity` [m/s²], `friction`, `lower` and `upper` limits [rad],
            `joint` (attributes of all joints), `motor` (of the mast's), `height` [m], `quat`.
        effort: limit of each joint in [N·m].
        scene: keys of a workflow's `scene:`.
    """

    def __init__(
        self,
        platform: str,
        folder: Path,
        options: AnyMapping | None = None,
        *,
        order: Sequence[str] = JOINTS,
        floating: bool = True,
        num_robots: int | None = None,
        steps: int = 10,
        model: AnyMapping | None = None,
        effort: float = EFFORT_LIMIT,
        **scene: Any,
    ) -> None:
        says = {
            "gravity": -9.81,
            "friction": FRICTION,
            "lower": -3.0,
            "upper": 3.0,
            "joint": "",
            "motor": "",
            "height": 2.0,
            "quat": "1 0 0 0",
        } | dict(model or {})
        file, path = folder / "probe.yaml", folder / "probe.xml"
        joints = "\n".join(_JOINT.format(name=name, effort=effort, **says) for name in order)
        kind, feet = ("quadruped", "feet: [box]\n") if floating else ("arm", "")
        base = "<freejoint/>" if floating else ""
        says |= {"kind": kind, "joints": joints, "imu": list(IMU_POSITION), "feet": feet}
        for each in (file, path):  # the templates have the same names beside this module
            template = Path(__file__).with_name(each.name).read_text("utf-8")
            each.write_text(template.format(base=base, **says), "utf-8")
        self.robot: Robot = load_robot(str(file))
        self.states = States(standard_states(self.robot.joint_names), num_robots)
        self.period = steps * TIMESTEP
        said = {"initial_pose": "model", "model": str(path)} | scene
        if set(said) - set(SCENE_KEYS):
            raise TypeError(f"no key of a scene: {', '.join(set(said) - set(SCENE_KEYS))}")
        begin = Scene(**said)
        make = find_factory("platforms", platform, PlatformError)
        whole = read_options(
            make,
            {"timestep": TIMESTEP, **(options or {})},
            lambda text, *_: PlatformError(f"platform {platform!r}{text}"),
        )
        built = make(self.states, self.robot, self.period, scene=begin, **whole)
        self.platform: Platform = disturb(built, begin, self.states, self.robot, self.period)
        self.info = info_of(self.platform)
        self.platform.recv()

    def close(self) -> None:
        """Close the platform."""
        self.platform.close()

    def command(self, robot: int | None = None, **values: Mapping[str, float] | float) -> Rig:
        """Set command states, one number for all joints or by name; what is not said is 0.

        Args:
            robot: of a batch, all if None.
            values: command state to value.

        Returns:
            The rig itself.
        """
        for state in COMMAND_STATES:
            view = self.states[state] if robot is None else self.states[state][robot]
            said = values.get(state, 0.0)
            view[...] = 0.0 if isinstance(said, Mapping) else said
            if isinstance(said, Mapping):
                for name, value in said.items():
                    view[..., self.joint(name)] = value
        return self

    def run(self, ticks: int) -> Told:
        """Tick; return what was measured before the first tick and after each."""
        names = ("stamp_ns", *self.platform.facts.writes)
        rows = {name: [np.array(self.states[name], np.float64)] for name in names}
        for _ in range(ticks):
            self.platform.send()
            self.platform.recv()
            for name, row in rows.items():
                row.append(np.array(self.states[name], np.float64))
        told = Told((name, np.array(row)) for name, row in rows.items())
        told.joint_names = self.robot.joint_names
        return told

    def after(self, ticks: int, state: str, joint: str) -> float:
        """Tick; return what was measured of a joint in the end."""
        return float(self.run(ticks).of(state, joint)[-1])

    def joint(self, name: str) -> int:
        """Return where a joint stands in the robot's order."""
        return self.robot.joint_names.index(name)

    def bytes(self) -> bytes:
        """Return all that is measured now."""
        return b"".join(self.states[name].tobytes() for name in self.platform.facts.writes)


# Before they are imported: else pytest says of an assertion of theirs only that it failed.
pytest.register_assert_rewrite(*(f"{__package__}.{part}" for part in ("contract", "mechanics")))

Build = Callable[..., Rig]
"""As `Rig`, without platform and folder; `options` are over those of the case."""


class Case:
    """A platform under test; a subclass names it."""

    platform: ClassVar[str]
    options: ClassVar[AnyMapping] = {}
    near: ClassVar[float] = 1e-4
    """Relative difference that is taken for rounding: of engines in float32 more."""

    def alike(self, values: Any, times: float = 10.0) -> Any:
        """Return what equals such values up to so many times rounding."""
        return pytest.approx(values, rel=times * self.near, abs=times * self.near)

    @pytest.fixture
    def rig(self, tmp_path: Path) -> Iterator[Build]:
        """Build robots on the platform; all are closed in the end."""
        built: list[Rig] = []

        def build(**how: Any) -> Rig:
            folder = tmp_path / f"rig{len(built)}"
            folder.mkdir()
            one = Rig(self.platform, folder, {**self.options, **how.pop("options", {})}, **how)
            built.append(one)
            return one

        yield build
        for one in built:
            one.close()
