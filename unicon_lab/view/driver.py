"""Driver: what comes back from a viewer: velocity, emergency stop, and what it wishes.

A viewer that drives replaces what commands the velocity, as /cmd_vel does. Once it is not heard
for `DEAD_MAN` seconds the command is zero, and stays so until somebody begins to drive anew, by a
touch; only a driver who lets go gives the command back to the workflow.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from unicon_base import AnyDict, AnyMapping, EmergencyStopPressed, UniconError, alternatives
from unicon_base.arrays import Array
from unicon_core.flow import Block, Stage
from unicon_core.models.frames import yaw_of
from unicon_core.platforms.platform import Pushable, TakesForces
from unicon_core.runtime.phases import Phase
from unicon_core.runtime.rollouts import Rewind
from unicon_core.states import States
from unicon_core.states.standard import EXTERNAL_FORCE, EXTERNAL_PUSH, external_states
from unicon_core.workflow import HookBlocks, Program
from unicon_core.workflow.flow_yaml import skills_of
from unicon_lab.view.shown import DEAD_MAN, DRIVING, GIVEN_BACK, pushable
from unicon_ros.bridge.bindings import told_states
from unicon_ros.bridge.own_node import Answer
from unicon_ros.bridge.services import Controls
from unicon_ros.parameter_table import RANGES
from unicon_ros.parameters import Tuning
from unicon_ros.peripheral import short

if TYPE_CHECKING:
    from unicon_core.runtime import Runner
    from unicon_ros.peripheral import Peripheral

COMMAND = "velocity_command"
FAULT = "emergency stop by a viewer"

OFTEN = 0.02
"""How often a viewer is heard that does not drive, in [s]."""

LONGEST = 1000
"""Of names and answers, in [B]."""

_ACTS = ("start", "stop", "reset", "pause", "step", "swap")
_OTHERS = ("skill", "push", "set_parameter", "branch")


SHARE, REACH = 0.5, 0.5
"""Largest force of a drag as a part of the robot's weight, and over how much it grows, in [m]."""

LARGEST_PUSH = 2.0
"""Of a button, in [m/s]."""


class Pull:
    """Lets a simulated robot feel what a viewer drags: a spring from the body to the cursor.

    The force stands in states, which the platform applies and records keep.

    Args:
        platform: takes the force.
        states: of the run.
        told: the states of `PAGE`.
    """

    def __init__(self, platform: TakesForces, states: States, told: States) -> None:
        self._largest, self._platform = SHARE * platform.weight, platform
        self._bodies = len(platform.bodies)
        words = ("body", "place", "goal")
        self._body, self._place, self._goal = (told[f"view_pull_{word}"] for word in words)
        mine = (0, ...) if states.num_robots else ...
        names = (EXTERNAL_FORCE, f"{EXTERNAL_FORCE}_point", f"{EXTERNAL_FORCE}_body")
        self._force, self._point, self._number = (states[name][mine] for name in names)

    def __call__(self, fresh: bool) -> None:
        """Write the force of this tick: none unless the viewer is heard."""
        body = int(self._body) if fresh and np.isfinite(self._goal + self._place).all() else 0
        self._number[...] = body = body if 0 < body < self._bodies else 0
        if not body:
            self._force[:] = self._point[:] = 0.0
            return
        point = self._platform.point(body, self._place.astype(float))
        force = self._largest / REACH * (self._goal - point)
        self._force[:] = force / max(1.0, float(np.linalg.norm(force)) / self._largest)
        self._point[:] = point


class Driver:
    """The blocks that hear a viewer.

    Args:
        program: of the run.
        told: the states of `PAGE`, which the viewer's process tells.
        controls: what acts do.
        tuning: the parameters; None where there are none.
        press: presses the emergency stop of ROS too, where there is one.

    Attributes:
        driving: 1 while the viewer's velocity is the command.
        interval: between two looks at a viewer that does not drive, in [s].
    """

    def __init__(
        self,
        program: Program,
        told: States,
        controls: Controls,
        tuning: Tuning | None = None,
        press: Callable[[], object] = bool,
    ) -> None:
        self._program, self._controls, self._tuning, self._press = program, controls, tuning, press
        self._velocity = told["view_velocity"]
        words = ("view_mode", "view_touch", "view_estop", "view_acts", "view_stamp_ns")
        one = (memoryview(told[word].reshape(-1).data) for word in words)
        self._mode, self._touch, self._estop, self._acts, self._stamp = one
        command = program.states[COMMAND]
        self._command = command if command.ndim == 1 else command.reshape(-1, 3)
        self._heard_acts = self._heard_estop = self._lapsed = self._driven = self._started = 0
        self._replaces = False
        self._left = memoryview(np.zeros(1, np.int32).data)  # ticks until the viewer is heard
        self._drives = memoryview(np.zeros(1, np.int8).data)  # each tick has to look
        self._often = max(1, round(OFTEN / program.period))
        self.interval = self._often * program.period
        self._is_pressed = memoryview(np.zeros(1, np.int8).data)
        self.driving = 0
        self._peripheral: Peripheral | None = None
        self._runner: Runner | None = None
        self._rewind: Rewind | None = None
        self._stands = False  # between two ticks
        self._skills = skills_of(program)
        self._pull: Callable[[bool], object] = bool
        states, platform = program.states, program.platform
        if isinstance(platform, TakesForces) and EXTERNAL_FORCE in states:
            self._pull = Pull(platform, states, told)
        self._kick = states[EXTERNAL_PUSH] if pushable(program) else None
        self._pushes: list[float] = []

    def attach(self, peripheral: Peripheral, runner: Runner) -> None:
        """Get to know the viewer's process, and the run."""
        self._peripheral, self._runner = peripheral, runner
        self._rewind = Rewind(runner, tuning=self._tuning)
        peripheral.heard = self._act

    def blocks(self) -> HookBlocks:
        """Return the blocks: before the flow, right before `send`, and after it.

        A viewer that does not drive is heard after `send`: no command waits for it.
        """
        contested = COMMAND in told_states(self._program)
        amends, writes = ((COMMAND,), ()) if contested else ((), (COMMAND,))
        own = tuple(name for name in external_states() if name in self._program.states)
        hear = Block("viewer", self.hear, amends=amends, writes=(*writes, *own), endless=True)
        hear.inline = "drives[0] and hear()"
        hear.inline_names = {"drives": self._drives, "hear": self.hear}
        stop = Block("viewer e-stop", self.stop_if_pressed, endless=True)
        stop.inline = "pressed[0] and stop()"
        stop.inline_names = {"pressed": self._is_pressed, "stop": self.stop_if_pressed}
        listen = Block("viewer is heard", self.listen, endless=True)
        listen.inline = "left[0] -= 1\nleft[0] > 0 or listen()"
        listen.inline_names = {"left": self._left, "listen": self.listen}
        return {Stage.INPUT: [hear], Stage.SAFETY: [stop], Stage.OBSERVE: [listen]}

    def hear(self) -> None:
        """Take what a viewer that drives tells, and let it drive."""
        peripheral = self._peripheral
        if peripheral is None:
            return
        if peripheral():
            self._take(peripheral)
        self._drive()
        if self._kick is not None:
            self._push_base(self._kick)
        self._drives[0] = self._replaces or self._mode[0] == DRIVING or bool(self._pushes)

    def listen(self) -> None:
        """Take what a viewer tells; one that drives does so from the next tick on.

        Raises:
            EmergencyStopPressed: the emergency stop was pressed, and nothing is sent yet.
        """
        self._left[0] = self._often
        peripheral, runner = self._peripheral, self._runner
        if self._rewind is not None:
            self._rewind()
        if peripheral is None or runner is None or not peripheral():
            return
        self._take(peripheral)
        if self._mode[0] == DRIVING:
            self._drives[0] = 1  # others write the command in each tick
        if self._is_pressed[0] and runner.phase is Phase.WAIT:
            raise EmergencyStopPressed(FAULT)

    def look(self) -> None:
        """Take it in a pause, in which nobody is driven.

        Raises:
            EmergencyStopPressed: the emergency stop was pressed.
        """
        if self._peripheral is not None:
            self._stands = True
            self._peripheral()  # it may hear an act by itself
            self._take(self._peripheral)
            self._stands = False
            self.stop_if_pressed()

    def _take(self, peripheral: Peripheral) -> None:
        if peripheral.started != self._started:  # a new process counts anew
            self._started = peripheral.started
            self._heard_acts = self._heard_estop = self._lapsed = self._driven = 0
        if self._acts[0] > self._heard_acts:
            self._heard_acts = self._acts[0]
            peripheral.listen()
        if self._estop[0] > self._heard_estop:
            self._heard_estop = self._estop[0]
            self._is_pressed[0] = 1
            self._press()

    def stop_if_pressed(self) -> None:
        """End the run before the command leaves.

        Raises:
            EmergencyStopPressed: the emergency stop was pressed.
        """
        if self._is_pressed[0]:
            raise EmergencyStopPressed(FAULT)

    def _push_base(self, state: Array) -> None:
        """Push the base where a viewer wished it before this tick."""
        pushes, self._pushes = self._pushes, [0.0, 0.0] if any(self._pushes) else []
        if not pushes:
            return
        heading = np.exp(1j * yaw_of(self._program.states["base_quat"].reshape(-1, 4)[0]))
        push = complex(*pushes) * heading
        state[...] = push.real, push.imag
        platform = self._program.platform
        if push and isinstance(platform, Pushable):
            platform.push(state.astype(float))

    def _drive(self) -> None:
        mode, touch = self._mode[0], self._touch[0]
        if mode == DRIVING and touch > self._lapsed:
            self._replaces, self._driven = True, touch
            fresh = time.monotonic_ns() - self._stamp[0] <= DEAD_MAN * 1e9
            if fresh and np.isfinite(self._velocity).all():
                self._command[...] = self._velocity
                self.driving = 1
                self._pull(True)
                return
        elif mode == GIVEN_BACK and self._replaces and touch >= self._driven:
            self._replaces, self._driven = False, touch
            self.driving = 0
            self._program.tell("viewer: the driver has given the command back to the workflow")
        self._pull(False)
        if not self._replaces:
            return
        self._lapsed = max(self._lapsed, self._driven)  # a new touch is needed
        moved = bool(self._command.any())
        self._command[...] = 0.0
        if self.driving and moved:
            self._program.tell(
                "viewer: the driver is not heard any more: the velocity command is zero until "
                "somebody drives again"
            )
        self.driving = 0

    # -- acts -----------------------------------------------------------------------------------

    def _act(self, words: AnyMapping) -> None:
        act = words.get("act")
        if not isinstance(act, list) or not act:
            return
        name, number, arguments = act
        try:
            done, text = self._done(str(name), dict(arguments))
        except (UniconError, KeyError, TypeError, ValueError) as error:
            done, text = False, f"{name} is refused: {error}"
        if self._peripheral is not None:
            self._peripheral.wish("answer", number, done, short(text, LONGEST))

    def _done(self, name: str, arguments: AnyDict) -> Answer:
        if name in _ACTS:
            answer: Answer = getattr(self._controls, name)()
            return answer
        if name == "push":
            return self._wish_push([float(x) for x in arguments["velocity"]])
        if name == "skill":
            return self._skill(str(arguments["name"])[:LONGEST])
        if name == "branch":
            return self._branch(float(arguments["tick"]), str(arguments["then"])[:LONGEST])
        if name == "set_parameter":
            return self._set(str(arguments["name"]), float(arguments["value"]))
        return (
            False,
            f"no act {name!r}; {alternatives(name, (*_ACTS, *_OTHERS))}",
        )

    def _wish_push(self, velocity: list[float]) -> Answer:
        if self._kick is None:
            name = self._program.platform.facts.name
            return False, f"platform {name!r} cannot push a base; use a simulator that can"
        if len(velocity) != 2 or not np.linalg.norm(velocity) <= LARGEST_PUSH:
            return False, f"push is {velocity}; give two numbers, at most {LARGEST_PUSH:g} m/s long"
        self._pushes, self._drives[0] = velocity, 1
        return True, f"pushed by {np.linalg.norm(velocity):g} m/s"

    def _skill(self, name: str) -> Answer:
        skills = self._skills
        if skills is None or name not in skills.names:
            there = () if skills is None else skills.names
            return False, f"no skill {name!r}; {alternatives(name, there)}"
        reason = skills.ask(name)
        return not reason, f"refused: {reason}" if reason else f"{name} from the next tick on"

    def _branch(self, tick: float, then: str) -> Answer:
        """Let the run go on from the newest moment that is kept up to a tick.

        Parameters are those of today; `then` swaps policies there, or is a skill that takes over.
        """
        runner, rewind = self._runner, self._rewind
        if runner is None or rewind is None:
            return False, "nothing runs"
        moment, period, program = rewind.moment(tick), self._program.period, self._program
        text = f"the run goes on from {moment[0] * period:.2f} s"

        def back() -> None:
            left = int(program.states["tick"]) * period
            rewind.back(moment)
            change = then and (self._controls.swap() if then == "swap" else self._skill(then))[1]
            program.tell(f"viewer: {text}, set back from {left:.2f} s {change}".rstrip())

        back() if self._stands else runner.call_soon(back)
        return True, text

    def _set(self, name: str, value: float) -> Answer:
        tuning = self._tuning
        if tuning is None or name not in RANGES or name == "rate":
            return False, f"no parameter {name!r}"
        low, high = RANGES[name]
        if not low <= value <= high:
            return False, f"{name} is {value:g}; give {low:g} to {high:g}"
        wrong = tuning.refusal({name: value})
        if not wrong:
            tuning.apply({name: value})
        return not wrong, wrong or f"{name} is {value:g}"
