"""The `twin:` of a workflow: a simulator beside the robot, under the same commands, in the slack.

    twin: {platform: mujoco, window: 0.2, over: 1.0, bound: 0.15}

Behind `send` the simulator takes what was sent and simulates a tick. Each window begins where the
robot was measured, so that a gap is one of the joints and their motors, and does not grow for ever.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from unicon_base import AnyDict, AnyMapping, Fault, PlatformError, UniconError, WorkflowError
from unicon_base.schema.marks import positive
from unicon_core.bounds import POSITION
from unicon_core.flow import Block
from unicon_core.memory import Library
from unicon_core.metrics import aligned_mse
from unicon_core.platforms.kit.disturbances import PLACE, Beside
from unicon_core.robots import Robot
from unicon_core.states import States, StateSpec
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow.autowire import BuildContext
from unicon_core.workflow.document import WorkflowDocument, read_part
from unicon_core.workflow.hardware import declared_facts, read_scene
from unicon_core.workflow.registry import find_factory

TWIN_STATES = ("twin_joint_pos", "twin_gap", "twin_lag", "twin_flag")
"""What a twin writes."""
LONGEST = 10.0
"""Of `window` and `over` in [s]."""
LAG = 0.2
"""Largest lag that is looked for, either way, in [s]."""
STILL = 0.02
"""In [rad]: a joint that moves less within `over` has no lag that could be seen."""


@dataclass(frozen=True)
class TwinSettings:
    """What a workflow says of its twin.

    Attributes:
        platform: a simulator.
        window: after which the twin is put where the robot was measured, in [s].
        over: how much of the past gap and lag are taken over in [s].
        bound: gap of a joint beyond which its flag is raised, in [rad].
    """

    platform: str
    window: Annotated[float, positive(LONGEST, "s")] = 0.2
    over: Annotated[float, positive(LONGEST, "s")] = 1.0
    bound: Annotated[float, positive(POSITION, "rad")] = 0.15


def twin_of(document: WorkflowDocument) -> TwinSettings | None:
    """Return what `twin:` says, a simulator's name or a mapping; None where there is none.

    Raises:
        WorkflowError: it is neither, or a value is wrong.
    """
    said = document.values.get("twin")
    if said is None:
        return None
    if document.values.get("num_robots") is not None:
        raise document.error("twin: a twin is of one robot; leave num_robots out", "twin")
    if isinstance(said, str):
        return TwinSettings(said)
    settings: TwinSettings = read_part(document, TwinSettings, said, "twin")
    return settings


def twin_states(robot: Robot) -> dict[str, StateSpec]:
    """Return the states that a twin writes, each of shape (n,)."""

    def joints(unit: str, description: str, dtype: str = "float32") -> StateSpec:
        names = robot.joint_names
        return StateSpec((len(names),), dtype, unit, names=names, description=description)

    told = (
        joints("rad", "where the twin expected the joints to be by now"),
        joints("rad", "root of the mean squared difference to the twin"),
        joints("s", "by which the robot is later than the twin"),
        joints("", "1 where the gap is beyond the twin's bound", "int32"),
    )
    return dict(zip(TWIN_STATES, told))


def build_twin(
    document: WorkflowDocument, settings: TwinSettings, context: BuildContext, measured: set[str]
) -> Block:
    """Return the block that simulates a twin behind `send`.

    Args:
        document: the workflow.
        settings: of the twin.
        context: of the robot's side.
        measured: states that the robot's platform or an estimate writes.

    Raises:
        WorkflowError: no such simulator, it cannot be a twin, or too little is measured.
    """

    def wrong(text: str) -> WorkflowError:
        return document.error(f"twin: {text}", "twin")

    try:
        factory = find_factory("platforms", settings.platform, PlatformError)
    except PlatformError as error:
        raise wrong(str(error)) from error
    facts = declared_facts(factory, settings.platform)
    if not facts.simulated:
        raise wrong(f"platform {settings.platform!r} is a robot; write twin: {{platform: mujoco}}")
    if "joint_pos" not in measured or "joint_vel" not in measured:
        raise wrong("the platform measures no joint_pos and joint_vel; leave the twin out")
    options = (document.get("platforms", {}) or {}).get(settings.platform) or {}
    # Joints that the scene changes are what a twin is there to find: its own are the robot file's.
    said = document.get("scene", {}) | {"joints": None}
    plain = replace(document, values=document.values | {"scene": said})
    scene = read_scene(plain, context, facts)
    try:
        beside = Beside(factory, context.robot, context.period, scene, options)
    except TypeError as error:  # its factory takes no scene, or not these options
        raise wrong(
            f"platform {settings.platform!r} cannot be a twin ({error}); write twin: "
            "{platform: mujoco}, and correct its options under platforms"
        ) from error
    except UniconError as error:
        raise wrong(str(error)) from error
    if beside.moves and "base_quat" not in measured:
        beside.close()
        raise wrong("the base moves and the platform measures no base_quat; leave the twin out")
    place = [name for name in PLACE if name in measured]
    # What is made at the first use is made now: 50 ms of a tick.
    beside.put({name: context.states[name] for name in place})
    aligned_mse(np.zeros((1, 2, 1)), np.zeros((1, 2, 1)))
    tick = LiveTwin(beside, context.states, place, settings, context.period)
    return Block(
        "twin",
        tick,
        reads=(*place, *COMMAND_STATES),
        writes=TWIN_STATES,
        close=beside.close,
        endless=True,
    )


class LiveTwin:
    """The tick of a twin; see the module."""

    def __init__(
        self,
        beside: Beside,
        states: States,
        place: list[str],
        settings: TwinSettings,
        period: float,
    ) -> None:
        self._beside, self._states, self._period = beside, states, period
        self._measured = {name: states[name] for name in place}
        self._pos, self._expected = states["joint_pos"], states["twin_joint_pos"]
        self._gap, self._lag, self._flag = (states[f"twin_{w}"] for w in ("gap", "lag", "flag"))
        self._bound = settings.bound
        self._window = max(round(settings.window / period), 1)
        self._rows = max(round(settings.over / period), self._window)
        self._shift = min(round(LAG / period), self._rows // 2)
        self._past = np.zeros((2, self._rows, *self._pos.shape))
        self.reset()

    def reset(self) -> None:
        """Forget the past, and begin where the robot is at the next tick."""
        self._kept = self._in_window = 0
        self._alone = True  # it has not been put anywhere yet

    def __call__(self) -> None:
        if not self._alone:
            self._past[0, self._kept % self._rows] = self._pos
            self._past[1, self._kept % self._rows] = self._expected
            self._kept += 1
            self._in_window += 1
            if self._in_window >= self._window:
                self._judge()
                self._alone = True
        try:
            if self._alone:
                # What is not a number is a safety block's business; the twin waits.
                if not all(math.isfinite(float(v.sum())) for v in self._measured.values()):
                    return
                self._beside.put(self._measured)
                self._alone, self._in_window = False, 0
            self._expected[...] = self._beside.step(self._states)
        except Fault:  # of the twin's physics: it begins anew, and the robot goes on
            self._alone = True

    def _judge(self) -> None:
        count = min(self._kept, self._rows)
        first = self._kept % self._rows if self._kept > self._rows else 0
        order = (first + np.arange(count)) % self._rows
        real, twin = self._past[:, order]
        apart = real - twin
        if not math.isfinite(float(apart.sum())):
            return
        self._gap[...] = np.sqrt(np.mean(apart * apart, axis=0))
        self._flag[...] = self._gap > self._bound
        self._lag[...] = 0.0
        moved = np.flatnonzero(np.ptp(real, axis=0) > STILL)
        if len(moved) and self._shift:
            moving = real.T[moved, :, None], twin.T[moved, :, None]
            found = aligned_mse(*moving, max_shift=min(self._shift, count - 1))
            self._lag[moved] = found.shift * self._period

    def save(self) -> AnyDict:
        """Return what gap, lag and simulation go on from, for a replay."""
        past = (self._kept, self._in_window, self._alone)
        simulator = self._beside.platform
        return {
            "past": self._past.copy(),
            "counts": past,
            "simulator": simulator.save() if isinstance(simulator, Library) else None,
        }

    def load(self, saved: AnyMapping) -> None:
        """Go on as another twin would that was built alike."""
        self._past[...] = saved["past"]
        self._kept, self._in_window, self._alone = saved["counts"]
        simulator = self._beside.platform
        if isinstance(simulator, Library) and saved["simulator"] is not None:
            simulator.load(saved["simulator"])
        else:
            self._alone = True
