"""RosSession: a running workflow's place in ROS 2; for `unicon run --ros` and the node.

    session = RosSession(map="default", node_name="unicon")
    runner = Runner(load_workflow(name, hooks=[session.hook])); session.attach(runner)
    report = runner.run(); report.bridge = session.counts()
    session.close()

In the tick: subscriptions are polled before the flow; after `send` the states are published as
bytes and services are served in the slack. No thread, no executor on the path to the motors.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unicon_base import AnyDict, TextSink, UniconError, one_line
from unicon_base.resources import find_config
from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow import HookBlocks, Program
from unicon_msgs_map import Decoder, Encoder, MapStateError, load_map
from unicon_msgs_map.spec import PublishSpec, SubscribeSpec, TopicSpec
from unicon_ros import compat
from unicon_ros.bridge.bindings import (
    WallStamp,
    arrays_of,
    checked_prefix,
    names_of,
    robot_variables,
    told_states,
)
from unicon_ros.bridge.diagnostics import CLOCK, Diagnostics, Neighbours
from unicon_ros.bridge.estop import STOP_SERVICES, EmergencyStop
from unicon_ros.bridge.introspection import Introspection
from unicon_ros.bridge.map_fit import contested_states, installing, message_class
from unicon_ros.bridge.own_node import OwnNode, add_services, calm_middleware_threads
from unicon_ros.bridge.robot_frames import RobotFrames
from unicon_ros.bridge.ros_platform import RosPlatform
from unicon_ros.bridge.services import Controls, SlackServer, skill_handlers
from unicon_ros.bridge.topics import TopicIn, TopicOut
from unicon_ros.parameter_table import SERVICES

if TYPE_CHECKING:
    from unicon_ros.bridge.trajectories import Trajectories

COMMANDED = frozenset(COMMAND_STATES)


class RosSession:
    """A ROS node for one workflow.

    Args:
        map: name in `config/maps/` or path of a message map; None is `default`.
        node_name: name of the node, unless `ros_args` remap it.
        namespace: its namespace; topics of the map are relative to it.
        ros_args: ROS arguments (`-r a:=b`, `-p name:=value`), with or without `--ros-args`.
        warn: takes warnings, one line each.
        frame_prefix: stands before the names of all frames, as of robot_state_publisher; such as
            `robot1/` where several robots share /tf.
        node: an rclpy node to live in; then the caller owns it, its services and its context.
        executor: the executor of that node.
        estop: the emergency stop of that node; without one the session has none, and the caller
            has to stop the runner by other means.

    Raises:
        MissingDependencyError: rclpy is not installed.
        UniconError: the map, a name or a ROS argument is wrong.
    """

    def __init__(
        self,
        map: str | Path | None = None,
        node_name: str = "unicon",
        namespace: str | None = None,
        ros_args: Sequence[str] = (),
        warn: TextSink = print,
        frame_prefix: str = "",
        *,
        node: Any = None,
        executor: Any = None,
        estop: EmergencyStop | None = None,
    ) -> None:
        compat.import_rclpy()
        self.map = load_map(find_config("maps", map or "default"))
        self.frame_prefix = checked_prefix(frame_prefix)
        self.warn = warn
        self._own = OwnNode(node_name, namespace, ros_args) if node is None else None
        if self._own is not None:
            node, executor = self._own.node, self._own.executor
        self.node = node
        self.slack = SlackServer(executor, warn)
        self.diagnostics: Diagnostics | None = None
        if self._own is not None:
            estop = EmergencyStop(node, self._runs, warn)
            if compat.message_class("diagnostic_msgs/msg/DiagnosticArray") is not None:
                self.diagnostics = Diagnostics(node, estop)
        self.estop = estop
        self.controls = Controls(self.slack.spin, estop)
        self.outgoing: list[TopicOut] = []
        self.incoming: list[TopicIn] = []
        self.skipped: list[str] = []
        self.trajectories: Trajectories | None = None
        self.frames: RobotFrames | None = None
        self.neighbours = Neighbours(node, self.outgoing, self.incoming, warn)
        self._group = compat.polled_group()
        self.introspection = Introspection(
            node, self._group, lambda: self.controls.runner is not None
        )
        self.arrays: AnyDict = {}  # the states as they are published
        self._others: list[Callable[[], None]] = []
        self._timers: list[Any] = []
        self._stamp: WallStamp | None = None
        self._closed = False
        self._started_ns = time.perf_counter_ns()
        if self._own is not None:
            acts = SERVICES.keys() - {*STOP_SERVICES, "list_states"}
            handlers = {name: getattr(self.controls, name) for name in SERVICES if name in acts}
            handlers["list_states"] = self.introspection.list_states
            add_services(node, handlers, warn)

    # -- hooks ----------------------------------------------------------------------------------

    def hook(self, program: Program) -> HookBlocks:
        """Return the blocks that poll subscriptions and ~/estop, publish and serve.

        Raises:
            UniconError: the map does not fit, or the emergency stop of a robot is latched.
        """
        self._keep_latch(program)
        for service in add_services(self.node, skill_handlers(program, self._runs), self.warn):
            self._others.append(partial(self.node.destroy_service, service))
        stages = {Stage.INPUT: [self._inputs(program)]}
        if self.estop is not None:
            stages[Stage.SAFETY] = [self.estop.before_send()]
        if self.map.trajectory is None:
            return stages | {Stage.OBSERVE: self._observers(program)}
        from unicon_ros.bridge.trajectories import Trajectories  # few need them

        played = self.trajectories = Trajectories(
            self.node, self.map.trajectory, program, self.warn
        )
        self._others.append(played.close)
        stages[Stage.INPUT].append(played.before_flow())
        return stages | {Stage.OBSERVE: [played.after_send(), *self._observers(program)]}

    def _inputs(self, program: Program) -> Block:
        bindings = (
            arrays_of(program),
            names_of(program),
            robot_variables(program.robot, self.frame_prefix),
        )
        written = told_states(program)

        def build(spec: SubscribeSpec) -> Decoder:
            for what, remedy in contested_states(spec, program.platform.facts):
                raise UniconError(f"{spec.where or spec.topic}: {what}; {remedy}")
            return Decoder.build(spec, *bindings)

        for spec in self.map.subscribe:
            contested = not written.isdisjoint(spec.states)
            topic = self._made(spec, build, partial(TopicIn, contested=contested))
            if topic is not None:
                self.incoming.append(topic)
                self.slack.always |= not topic.polled
        states = {state for topic in self.incoming for state in topic.spec.states}
        return Block(
            "ros inputs",
            _poll_all(self.incoming),
            warm_up=_warm_up(self.incoming, self.outgoing),
            writes=tuple(sorted(states - written)),
            amends=tuple(sorted(states & written)),
        )

    def _observers(self, program: Program) -> list[Block]:
        arrays, names = arrays_of(program), names_of(program)
        variables = robot_variables(program.robot, self.frame_prefix)
        blocks: list[Block] = []
        platform = program.platform
        if not platform.facts.simulated:
            source = arrays["stamp_ns"] if "stamp_ns" in platform.facts.writes else None
            self._stamp = WallStamp(source)
            arrays["stamp_ns"] = self._stamp.out
            blocks.append(Block(self._stamp.name, self._stamp, reads=self._stamp.reads))

        def build(spec: PublishSpec) -> Encoder:
            return Encoder.build(spec, arrays, names, variables)

        self.arrays = arrays
        phases: dict[int, int] = {}
        for spec in self.map.publish:
            if spec.topic == CLOCK and not platform.facts.simulated:
                continue  # only a simulator makes the time of others
            taken = platform.topics if isinstance(platform, RosPlatform) else ()
            if taken and self.node.resolve_topic_name(spec.topic) in taken:
                self._skip(spec, f"platform {platform.facts.name!r} has it already")
                continue
            if program.silent and not COMMANDED.isdisjoint(spec.states):
                self._skip(spec, "it tells commands, and a silent run sends none")
                continue
            every = spec.every(program.period)
            phase = phases.get(every, 0)
            topic = self._made(spec, build, partial(TopicOut, every=every, phase=phase))
            if topic is not None:
                phases[every] = phase + 1
                self.outgoing.append(topic)
                blocks.append(topic.block)
        frames = self.frames = RobotFrames(
            self.node, program, arrays["stamp_ns"], self._group, self.warn, self.frame_prefix
        )
        self._others.append(frames.close)
        self.outgoing += frames.outs
        blocks += frames.blocks
        blocks.append(Block(self.slack.name, self.slack))
        if self.estop is not None:
            self.slack.always |= not self.estop.polled
            blocks.append(self.estop.after_send())
        return blocks

    def attach(self, runner: Runner) -> None:
        """Let services act on this runner, and its deadlines bound what they may take."""
        self.controls.runner = self.slack.runner = runner
        self.introspection.attach(runner.program, self._topics(), self.arrays)
        calm_middleware_threads()
        calls, told = [self._look], self.diagnostics
        if told is not None:
            told.runner, told.neighbours = runner, self.neighbours
            calls.append(told.publish)
        for call in calls if not self._timers else ():
            self._timers.append(compat.steady_timer(self.node, 1.0, call, self._group))
        self.slack.look()

    def counts(self) -> AnyDict:
        """Return what passed: totals, and per topic `published`, or `received`, `rejected`, …"""
        seconds = max((time.perf_counter_ns() - self._started_ns) * 1e-9, 1e-9)
        topics: dict[str, AnyDict] = {}
        for out in self.outgoing:
            sent = topics.setdefault(out.topic, {"published": 0, "failed": 0})
            sent["published"] += out.published  # several of ours may share a topic, such as /tf
            sent["failed"] += out.failed
        for topic in self.incoming:
            topics.setdefault(topic.topic, {}).update(
                received=topic.received,
                dropped=topic.dropped,
                rejected=topic.decoder.rejected,
                stale=topic.stale,
            )
        if self.trajectories is not None:
            topics |= self.trajectories.counts()
        for each in self._topics():
            told = each.events.counts()
            topics[each.topic].update({name.replace(" ", "_"): n for name, n in told.items()})
        return {
            "published": sum(out.published for out in self.outgoing),
            "received": sum(topic.received for topic in self.incoming)
            + (0 if self.trajectories is None else self.trajectories.received),
            "services": {"served": self.slack.served, "forced": self.slack.forced},
            "seconds": round(seconds, 3),
            "skipped": list(self.skipped),
            "topics": topics,
        }

    def close(self) -> None:
        """Destroy publishers, subscriptions and our own node, once; then ROS is shut down."""
        if self._closed:
            return
        self._closed = True
        with ExitStack() as rest:  # all of it, whatever fails; the last named goes first
            if self._own is not None:
                rest.callback(self._own.close)
                if self.estop is not None:
                    rest.callback(self.estop.close)
            rest.callback(self.introspection.close)
            for close in self._others:
                rest.callback(close)
            for topic in self._topics():
                rest.callback(topic.close)
            for timer in self._timers:
                rest.callback(self.node.destroy_timer, timer)
            if self.diagnostics is not None:
                rest.callback(self.diagnostics.close)
            self.slack.rest()

    # -- helpers --------------------------------------------------------------------------------

    def _keep_latch(self, program: Program) -> None:
        """No new start of a robot, by a person or a supervisor, gets round the latch."""
        estop, moves = self.estop, not (program.platform.facts.simulated or program.silent)
        if estop is not None and (moves or self._own is None):
            estop.keep(program.latches)
            if moves and self._own is not None:
                estop.refuse_start()

    def _runs(self) -> bool:
        return self.controls.runner is not None and not self._closed

    def _topics(self) -> list[TopicOut | TopicIn]:
        return [*self.outgoing, *self.incoming]

    def _look(self) -> None:
        """Once a second: what is over by now, and who else is there."""
        for topic in self._topics():
            topic.events.settle()
        self.neighbours.look()

    def _made(
        self,
        spec: TopicSpec,
        build: Callable[[Any], Decoder | Encoder],
        make: Callable[..., Any],
    ) -> Any:
        """Return the topic of an entry; None where it is left out."""
        message = message_class(spec)
        if message is None:
            self._skip(spec, f"type {spec.type} is not installed ({installing(spec)})")
            return None
        try:
            codec = build(spec)
        except MapStateError as error:
            if not spec.optional:
                raise
            self._skip(spec, str(error))
            return None
        try:
            return make(self.node, codec, message, group=self._group, warn=self.warn)
        except Exception as error:
            raise UniconError(
                f"{spec.where or spec.topic}: topic {spec.topic!r} was refused by ROS "
                f"({one_line(error)}); correct its name or qos"
            ) from error

    def _skip(self, spec: TopicSpec, reason: str) -> None:
        if spec.topic not in self.skipped:
            self.skipped.append(spec.topic)
            self.warn(f"topic {spec.topic} is left out: {reason}")


def _poll_all(topics: list[TopicIn]) -> Callable[[], None]:
    def poll() -> None:
        for topic in topics:
            topic.poll()

    return poll


def _warm_up(incoming: list[TopicIn], outgoing: list[TopicOut]) -> Callable[[], None]:
    def warm_up() -> None:
        # What fails here fails again in the tick, which tells it.
        with suppress(Exception):
            for topic in incoming:
                topic.prefetch()
            for out in outgoing:
                out.warm_up()

    return warm_up
