"""unicon_node: a lifecycle node that hosts a workflow, for robots and launch files.

unconfigured → configure (builds the workflow) → inactive → activate (ticks) → active. A robot waits
for its gates first, then for the operator's go, which is a call of `~/start`. When the flow is
done, `~/stop` is called or a block trips, the platform damps and closes and the node is inactive
again; a transition that ends a run is answered when the run has ended. `~/start` or activate builds
the workflow anew and runs it, unless `~/estop` was pressed and not cleared, in this process or one
before. After an end with status 3 the next process does not start by itself. Whatever raises in a
build, a run or a callback is told, and the node lives on.

Ticks run in the thread that calls `spin`. While active, the executor is served in the slack between
ticks only; otherwise as usual. To share a process and an executor with nodes of your own:

    executor = SingleThreadedExecutor(); executor.add_node(mine)
    node = UniconNode(); executor.add_node(node)
    node.spin(executor)                         # in place of executor.spin()
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from unicon_base import UniconError, one_line
from unicon_core.check import refuse_errors
from unicon_core.latches import FAULT as ENDED_BY_FAULT
from unicon_core.runtime import Runner, RunOptions
from unicon_core.runtime.phases import Phase
from unicon_core.signals import SIGNALS
from unicon_core.workflow import Program, load_document
from unicon_ros import compat
from unicon_ros.attachments import Asked, Attachment, attached, said_at_end
from unicon_ros.bridge import RosSession
from unicon_ros.bridge.diagnostics import Diagnostics
from unicon_ros.bridge.estop import FAULT, STOP_SERVICES, EmergencyStop, latch_of
from unicon_ros.bridge.own_node import Answer, NodeLog, add_services, explained
from unicon_ros.parameter_table import SERVICES
from unicon_ros.parameters import Parameters, Tuning

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE
ENDING = ("deactivate", "shutdown")
"""Transitions that end a run."""


class UniconNode(LifecycleNode):
    """Hosts one workflow at a time.

    Args:
        name: node name.
        options: of `rclpy.node.Node`, such as `namespace`, `context`, `parameter_overrides`.

    Attributes:
        runner: the present or last run; None before the first.
        session: its bridge; None before the first.
        log: what it says; no tick waits for it.
        estop: its emergency stop, which stays latched from run to run.
        error: why the last transition failed, one line; "" if it did not.
        fault: why the last run was cut off, one line; "" if it was not.
    """

    def __init__(self, name: str = "unicon", **options: Any) -> None:
        super().__init__(name, **options)
        self.tuning = Tuning()
        self.settings = Parameters(self, self.tuning)
        self.runner: Runner | None = None
        self.session: RosSession | None = None
        self._attachments: list[Attachment] = []
        self.error = self.fault = ""
        self._executor: Any = None
        self._fresh = False  # the runner was built and has not run
        self._running = self._wanted = self._ending = self._starting = False
        self._activations = 0
        self._told_to_go = False  # by ~/start, which is the operator's go
        handlers: dict[str, Callable[[], Answer]] = {
            word: getattr(self, f"_{word}", None) or partial(self._ask, word)
            for word in SERVICES
            if word not in STOP_SERVICES
        }
        self.log = NodeLog(self.get_logger())
        for line in self.settings.unknown:
            self.log.warning(line)
        self.estop = EmergencyStop(self, lambda: self._running, self.log.warning)
        self.estop.keep()
        self._faulted = latch_of(self, ENDED_BY_FAULT, self.log.warning)
        add_services(self, handlers, self.log.error)
        self._transitions = compat.Transitions(self, self._transition_refused, self._ends_later)
        self.diagnostics = Diagnostics(self, self.estop)
        self._timer = compat.steady_timer(self, 1.0, self.diagnostics.publish)

    # -- the host's loop ------------------------------------------------------------------------

    def spin(self, executor: Any) -> int:
        """Run until a signal or a shutdown; return the exit status: 0, 1 bad input, 3 fault.

        Args:
            executor: that this node (and others) was added to.
        """
        self._executor = executor
        # A second signal damps at once, in the middle of a tick or of a build.
        with SIGNALS, SIGNALS.guard(self._end, self._damp_now):
            if SIGNALS.asked:  # `|=` would undo what a signal sets in the middle of it
                self._ending = True
            try:
                if self.settings["autostart"] and not self._held() and not self._autostart():
                    if not self.estop.latched:
                        return 1
                    self.fault = self.diagnostics.fault = FAULT  # pressed during the build
                    if self.settings["exit_on_fault"]:
                        return self._end_by_fault()
                while not self._ending and self.context.ok():
                    if self._wanted:
                        self._run()
                        if self.fault and self.settings["exit_on_fault"]:
                            return self._end_by_fault()
                    else:
                        self._serve(executor)
            finally:
                self._release()
        return 0

    def _held(self) -> bool:
        """Tell whether an earlier process left what keeps this one from starting by itself."""
        if reason := self.estop.holds(self._faulted):
            self.fault = self.diagnostics.fault = f"not started by itself: {reason}"
            self.log.error(f"{self.fault}, and ~/start when it is safe")
        return bool(reason)

    def _end_by_fault(self) -> int:
        self._faulted.set(self.fault)
        self._faulted.kept()
        return 3

    def _autostart(self) -> bool:
        """Start; what is wrong is the caller's to tell, not the log's."""
        self._starting = True
        started, _ = self._start()
        self._starting = False
        return started

    def _serve(self, executor: Any) -> None:
        """Wait for a callback and run it."""
        try:
            executor.spin_once(0.1)
        except ExternalShutdownException:
            self._ending = True
        except Exception as error:  # of a callback, ours or that of a node beside us
            self.log.error(f"a ROS callback failed: {explained(error)}")

    def _end(self) -> None:
        self._ending = True

    def _damp_now(self) -> bool:
        """Close the workflow that is open, if it is not running: a run closes itself."""
        runner = self.runner
        return runner is not None and not self._running and runner.program.damp_now()

    def _run(self) -> None:
        """Tick until something ends the run, then let the lifecycle follow."""
        activation = self._activations
        if not self._fresh and not self._build():
            self._wanted = False
            self._change(self.trigger_deactivate)
            return
        runner, session = self.runner, self.session
        assert runner is not None
        assert session is not None
        session.slack.use(self._executor)
        runner.operator, self._told_to_go = not self._told_to_go, False
        self._running, self._fresh, self.fault = True, False, ""
        self.diagnostics.fault = ""
        self.diagnostics.runner = runner
        self.log.info(
            f"running {runner.program.name} on {runner.program.robot.name} "
            f"({runner.program.platform.facts.name}) at {1.0 / runner.program.period:g} Hz"
        )
        try:
            report = runner.run()
            faults = report.faults
            for name, text in said_at_end(self._attachments, report):
                self.log.info(f"{name}: {text}")
            counts = session.counts()
            self.log.info(
                f"ended after {report.ticks} ticks, {report.overruns} overruns; "
                f"published {counts['published']}, received {counts['received']}"
            )
        except Exception as error:  # the runner damps and closes whatever raises
            faults = [*runner.faults, explained(error)]
        finally:
            self._running = False
            self.diagnostics.runner = None
            session.controls.runner = None
            session.slack.rest()
        self._ending |= runner.interrupted
        if runner.pressed and not self.estop.latched:  # by a viewer or a remote
            self.estop.press()
        if faults:
            self.fault = self.diagnostics.fault = "; ".join(faults)
            self.log.error(f"fault: {self.fault}")
        self._transitions.settle()
        if self._activations == activation:  # nobody activated it again meanwhile
            self._wanted = False
            if self._label() == "active":
                self._change(self.trigger_deactivate)
        if self._label() in ("unconfigured", "finalized"):
            self._release()

    # -- lifecycle ------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Build the workflow; a wrong one is told and leaves the node unconfigured."""
        if self._running:  # a node of ours has let it deactivate and clean up from a callback
            self.error = "the run before has not ended; configure the node again when it has"
            self.log.error(self.error)
            return FAILURE
        return SUCCESS if self._build() else FAILURE

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to tick, unless ~/estop is latched; after a run the workflow is built anew."""
        refused = self.estop.refusal()
        if not refused and not self._running and not self._fresh and not self._build():
            return FAILURE
        refused = refused or self.estop.refusal()  # a build takes its time
        if refused:
            self.error = refused
            self.log.error(f"not activated: {refused}")
            return FAILURE
        if stays := self._faulted.release():
            self.log.warning(stays)
        self._activations += 1
        self._wanted = True
        return SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the run after the present tick; it winds down, the platform damps and closes.

        Asked for by `~/change_state`, it comes when that has happened.
        """
        self._halt()
        return SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let workflow and topics go."""
        if not self._running:
            self._release()
        return SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the run and the node's `spin`."""
        self._halt()
        self._ending = True
        return SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let everything go after a transition that raised; the node is unconfigured then."""
        self._halt()
        if not self._running:
            self._release()
        return SUCCESS

    def destroy_node(self) -> None:
        """Let the services go, then the node."""
        self.estop.close()
        self._faulted.close()
        self.log.close()
        super().destroy_node()

    def _halt(self) -> None:
        self._wanted = False
        if self.runner is not None and self._running and self.runner.phase is not Phase.SOFT:
            self.runner.stop()

    def _ends_later(self, label: str) -> bool:
        """Whether a transition is true only once the run has ended, which is asked to end."""
        if not self._running or self._label() != "active" or label not in ENDING:
            return False
        self._halt()
        return True

    def _build(self) -> bool:
        """Build workflow, bridge and runner; what goes wrong is told, and False returned."""
        self._release()
        self.error = ""
        try:
            self._build_or_raise()
        except Exception as error:
            self._release()
            self.error = str(error) if isinstance(error, UniconError) else explained(error)
            if not self._starting:
                self.log.error(self.error)
            return False
        self._fresh = True
        return True

    def _build_or_raise(self) -> None:
        settings = self.settings
        warn = self.log.warning
        document = load_document(settings["workflow"], settings.overrides)
        self.tuning.declare(document)
        map_name = settings["map"] or document.get("map")
        session = self.session = RosSession(
            map_name,
            warn=warn,
            frame_prefix=settings["frame_prefix"],
            node=self,
            executor=self._executor,
            estop=self.estop,
        )
        hooks = [session.hook, self.tuning.hook]
        words = ("record", "record_split", "record_frames", "record_jpeg")
        options = {word: settings[word] for word in words} | {"speed": settings.speed}
        self._attachments = attached(Asked(options, document, map_name, session, warn))
        hooks += [each.hook for each in self._attachments]
        program = Program(document, hooks=hooks, part=settings["part"])
        try:
            for line in refuse_errors(program, settings.force):
                warn(line)
            self.runner = Runner(program, RunOptions(speed=settings.speed, warn=warn))
        except BaseException:
            program.close()
            raise
        session.attach(self.runner)
        for each in self._attachments:
            each.attach(self.runner)
        self.diagnostics.neighbours = session.neighbours

    def _release(self) -> None:
        """Close what was built; the platform damps first."""
        runner, session = self.runner, self.session
        attachments, self._attachments = self._attachments, []
        self.runner, self.session, self._fresh = None, None, False
        for what in (runner, *attachments, session):
            try:
                if what is not None:
                    what.close()
            except Exception as error:  # everything is closed, and each error told
                self.log.error(f"closing failed: {explained(error)}")
        self.diagnostics.neighbours = None

    def _label(self) -> str:
        return str(self._state_machine.current_state[1])

    def _change(self, transition: Callable[[], TransitionCallbackReturn]) -> bool:
        try:
            return bool(transition() == SUCCESS)
        except Exception as error:  # rclpy's RCLError: not allowed in this state
            self._transition_refused(error)
            return False

    def _transition_refused(self, error: Exception) -> None:
        """Tell of a transition that another process asked for and rclpy raised at."""
        reason = one_line(error).split(", at /")[0]
        self.log.warning(f"transition refused in state {self._label()!r}: {reason}")

    # -- services -------------------------------------------------------------------------------

    def _start(self) -> Answer:
        """Configure and activate as needed; after a pause go on."""
        if refused := self.estop.refusal():
            return False, refused
        if self._label() == "active":
            return self._ask("start")
        if self._label() == "unconfigured" and not self._change(self.trigger_configure):
            return False, self.error or "not configured"
        if not self._change(self.trigger_activate):
            return False, self.error or "not activated"
        self._told_to_go = not self._starting
        return True, "started"

    def _list_states(self) -> Answer:
        if self.session is None:
            return False, "no workflow is built; call ~/start, or configure the node"
        return self.session.introspection.list_states()

    def _ask(self, word: str) -> Answer:
        if self.session is None or not self._running:
            return False, "nothing runs; call ~/start"
        answer: Answer = getattr(self.session.controls, word)()
        return answer
