"""Services of type std_srvs/srv/Trigger, what they act on (`Controls`), and when they are served.

`SlackServer` is a block after `send`: services, parameters, timers and events are asked in rounds,
25 to 200 a second, as there is work. A round is made of pieces of some 10 µs, one for each service;
a piece is done where it ends before the next tick's warm-up begins, else in a later tick. So a tick
pays for a piece and not for a round, and one with little slack still hears its services.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

from unicon_base import TextSink
from unicon_core.blocks.controls.modes import Skills
from unicon_core.platforms.platform import Pausable
from unicon_core.runtime import Runner
from unicon_core.workflow import Program
from unicon_core.workflow.flow_yaml import skills_of
from unicon_core.workflow.policies import shadowed_in
from unicon_ros import compat
from unicon_ros.bridge.estop import EmergencyStop
from unicon_ros.bridge.own_node import Answer


class Controls:
    """Acts on one runner; every method returns success and a line for the caller.

    Args:
        serve: serves callbacks for up to a time in [s]; keeps services alive during a pause.
        estop: the emergency stop, which ends a pause too; None where the host has none.

    Attributes:
        runner: the run; None before `attach`.
        paused: ticks are paused.
        others: looked at during a pause too, when no block is.
    """

    def __init__(self, serve: Callable[[float], None], estop: EmergencyStop | None = None) -> None:
        self.runner: Runner | None = None
        self.paused = False
        self.others: list[Callable[[], object]] = []
        self._steps = 0
        self._serve = serve
        self._estop = estop

    def stop(self) -> Answer:
        """End the run after the present tick: wind-down, then damping."""
        if self.runner is None:
            return False, "nothing runs"
        self.paused = False
        self.runner.stop()
        soft = self.runner.program.wind_down is not None
        return True, f"stopping: {'it winds down, then ' if soft else ''}the platform damps"

    def start(self) -> Answer:
        """Say the operator's go; go on after a pause."""
        if self.runner is None:
            return False, "nothing runs"
        refusal = self._estop.refusal() if self._estop else ""
        if refusal:
            return False, refusal
        if self.runner.go():
            return True, "go"
        if waits_for := self.runner.waits_for:
            return False, f"not yet: it waits for {waits_for}"
        if not self.paused:
            return False, "it runs already"
        self.paused = False
        return True, "going on"

    def reset(self) -> Answer:
        """Bring a simulator and the flow back to their beginning."""
        refusal = self._only_simulators("reset")
        if refusal or self.runner is None:
            return False, refusal
        self.runner.call_soon(self.runner.reset)
        return True, "reset before the next tick"

    def pause(self) -> Answer:
        """Let a simulator stand still until `start` or `step`."""
        refusal = self._only_simulators("pause")
        if refusal or self.runner is None:
            return False, refusal
        if not self.paused:
            self.paused, self._steps = True, 0
            self.runner.call_soon(self._stand_still)
        return True, "paused; ~/start goes on, ~/step ticks once"

    def step(self) -> Answer:
        """Run one tick of a paused simulator."""
        refusal = self._only_simulators("step")
        if refusal:
            return False, refusal
        if not self.paused:
            return False, "it is not paused; call ~/pause first"
        self._steps += 1
        return True, "one tick"

    def swap(self) -> Answer:
        """Let the policy that ticks beside the present one drive, or the first one again."""
        if self.runner is None:
            return False, "nothing runs"
        shadowed = shadowed_in(self.runner.program.blocks)
        if shadowed is None:
            return False, "this workflow has no shadow; name a policy under shadow:"
        return shadowed.ask()

    def _only_simulators(self, what: str) -> str:
        if self.runner is None:
            return "nothing runs"
        platform = self.runner.program.platform
        if not platform.facts.simulated:
            return (
                f"platform {platform.facts.name!r} is a real robot, which has no {what}; use ~/stop"
            )
        return ""

    def _stand_still(self) -> None:
        runner = self.runner
        assert runner is not None
        platform = runner.program.platform
        pause = platform.pause if isinstance(platform, Pausable) else bool
        pause()
        while self.paused and not runner.stopping:
            self._serve(0.005)
            if self._estop is not None:
                self._estop.look()
            for look in self.others:
                look()
            if self._steps:
                self._steps -= 1
                if runner.tick(time.perf_counter_ns()):
                    runner.stop()
                pause()
        self.paused = False


def skill_handlers(program: Program, runs: Callable[[], bool]) -> dict[str, Callable[[], Answer]]:
    """Return `skills/NAME` for each skill of a workflow, which asks for it.

    Args:
        program: the workflow.
        runs: tells whether it ticks.
    """
    skills = skills_of(program)

    def asking(skills: Skills, name: str) -> Callable[[], Answer]:
        def ask() -> Answer:
            if not runs():
                return False, "nothing runs"
            reason = skills.ask(name)
            told = f"{name} from the next tick on" if skills.now != name else "it runs already"
            return not reason, f"refused: {reason}" if reason else told

        return ask

    return {} if skills is None else {f"skills/{n}": asking(skills, n) for n in skills.names}


INTERVAL_NS = 40_000_000
"""A round every 40 ms where nobody asks for anything: 0.3 % of a core."""
BUSY_NS = 5_000_000
"""After a round that found something to do the next one after 5 ms, and then ever less often."""
PATIENCE_NS = 20_000_000
"""A round that is late by so much uses the warm-up's share too."""
LAST_NS = 1_000_000_000
"""So late, it is done whatever the slack: an overloaded loop must still hear its services."""
TAIL_NS = 50_000
"""Left for the blocks behind this one, such as a recorder's."""
CALLBACKS = 16
"""Callbacks served in one tick at most."""
FIRST_COST_NS = 200_000
"""Taken for the cost of a piece before one of its kind was done: the first is cold."""


class SlackServer:
    """Serves an executor in the slack.

    Args:
        executor: rclpy executor with the node in it; None for none yet.
        warn: takes warnings.

    Attributes:
        runner: whose deadlines count; None until it is known.
        served: callbacks run.
        forced: rounds that were due to `LAST_NS`.
        always: begin a round in every tick; where subscriptions cannot be polled.
    """

    name = "ros services"

    def __init__(self, executor: Any, warn: TextSink) -> None:
        self.runner: Runner | None = None
        self.served = self.forced = 0
        self.always = False
        self._warn = warn
        self.use(executor)
        self._due_ns = time.perf_counter_ns() + INTERVAL_NS
        self._interval_ns = INTERVAL_NS
        self._costs: dict[str, float] = {}
        self._dead = False

    def use(self, executor: Any) -> None:
        """Serve this executor from now on; None for none."""
        self._executor = executor
        self.responses = compat.Responses()
        self._serving = None if executor is None else compat.Serving(executor, self.responses.watch)
        self._round: Iterator[compat.Piece] | None = None
        self._piece: compat.Piece | None = None
        self._found = False

    def look(self) -> None:
        """See what the nodes have, before ticks begin: that takes longer than their slack."""
        if self._serving is not None:
            self._serving.look()

    def __call__(self) -> None:
        now = time.perf_counter_ns()
        late = now - self._due_ns
        if (late < 0 and not self.always) or self._dead or self._serving is None:
            return
        end, forced = self._end(late), late >= LAST_NS
        served = 0
        while served < CALLBACKS:
            piece = self._piece or self._next()
            if piece is None:
                return
            fits = now + self._cost(piece.kind) <= end
            if not fits and not forced:
                self._piece = piece
                return
            if not fits and end:
                self.forced += 1
                end = 0  # once told, the round goes to its end
            self._piece = None
            served += self._done(piece)
            began, now = now, time.perf_counter_ns()
            # Fast up and slowly down, so that one slow callback makes the next one wait.
            cost, known = now - began, self._costs.get(piece.kind, 0.0)
            self._costs[piece.kind] = cost if cost > known else 0.95 * known + 0.05 * cost

    def _end(self, late: int) -> int:
        """Return until when pieces may take, in [ns] of `time.perf_counter_ns`."""
        runner = self.runner
        due = 0 if runner is None else runner.next_due_ns
        if not due or runner is None:
            return 1 << 62
        lead = runner.lead_ns if late < PATIENCE_NS else 0
        return due - max(lead, round(1e3 * runner.pacing.spin_us), TAIL_NS)

    def _cost(self, kind: str) -> float:
        cost = self._costs.get(kind, FIRST_COST_NS)
        return cost if self.runner is None else min(cost, 0.5 * self.runner.period_ns)

    def _next(self) -> compat.Piece | None:
        """Return the next piece of the round, None at its end; a round begins with the first."""
        try:
            if self._round is None:
                assert self._serving is not None
                self.responses.retry()
                self._round = self._serving.round()
                self._found = False
            piece = next(self._round, None)
        except Exception as error:  # the context is gone
            self._failed(error)
            piece = None
        if piece is None:
            self._round = None
            wider = min(2 * self._interval_ns, INTERVAL_NS)
            self._interval_ns = BUSY_NS if self._found else wider
            self._due_ns = time.perf_counter_ns() + self._interval_ns
        return piece

    def _done(self, piece: compat.Piece) -> bool:
        try:
            ran = piece.run()
        except Exception as error:  # a callback's mistake, or the context is gone
            ran = True
            self._failed(error)
        self.served += ran
        self._found |= ran
        return ran

    def _failed(self, error: Exception) -> None:
        if type(error).__name__ in ("ExternalShutdownException", "InvalidHandle"):
            self._dead = True
            self._warn("the ROS context was shut down; services and parameters are served no more")
        else:
            self._warn(f"a ROS callback failed: {type(error).__name__}: {error}")

    def _call_found(self) -> None:
        """Call what a round has found and ticks had no time for."""
        for piece in () if self._serving is None else self._serving.callbacks():
            self._done(piece)

    def rest(self) -> None:
        """Ticks have ended: what answers from now on may block."""
        self._call_found()
        self.responses.release()

    def spin(self, timeout: float) -> None:
        """Serve one callback, waiting up to `timeout` in [s]: while ticks are paused."""
        self._call_found()
        self.responses.retry()
        try:
            if self._executor is None:
                time.sleep(timeout)
            else:
                self._executor.spin_once(timeout)
        except Exception as error:
            self._failed(error)
            time.sleep(timeout if self._dead else 0.0)
