"""RosSession: a running workflow's place in ROS 2; for `unicon run --ros` and the node.

    session = RosSession(map="default", node_name="unicon")
    workflow = load_workflow(name, inputs=[session.inputs], observers=[session.observers])
    runner = Runner(workflow); session.attach(runner)
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
from typing import Any

from unicon_core.errors import UniconError
from unicon_core.flow import Block
from unicon_core.resources import find_config
from unicon_core.runtime import Runner
from unicon_core.workflow import Workflow
from unicon_msgs_map import Decoder, Encoder, MapError, MapStateError, MessageMap, load_map
from unicon_msgs_map.spec import PublishSpec, SubscribeSpec
from unicon_ros import compat
from unicon_ros.bridge.bindings import (
    arrays_of,
    checked_prefix,
    given_by_blocks,
    names_of,
    variables_of,
)
from unicon_ros.bridge.controls import SERVICES, Controls
from unicon_ros.bridge.estop import EmergencyStop
from unicon_ros.bridge.middleware_threads import calm_middleware_threads
from unicon_ros.bridge.own_node import OwnNode, one_line
from unicon_ros.bridge.robot_frames import RobotFrames
from unicon_ros.bridge.services import add_services
from unicon_ros.bridge.slack import SlackServer
from unicon_ros.bridge.stamps import WallStamp
from unicon_ros.bridge.topics_in import TopicIn
from unicon_ros.bridge.topics_out import TopicOut

__all__ = ["RosSession"]

CLOCK = "/clock"


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
        warn: Callable[[str], None] = print,
        frame_prefix: str = "",
        *,
        node: Any = None,
        executor: Any = None,
        estop: EmergencyStop | None = None,
    ) -> None:
        compat.import_rclpy()
        self.map = _read_map(map)
        self.frame_prefix = checked_prefix(frame_prefix)
        self.warn = warn
        self._own = OwnNode(node_name, namespace, ros_args) if node is None else None
        if self._own is not None:
            node, executor = self._own.node, self._own.executor
        self.node = node
        self.slack = SlackServer(executor, warn)
        if self._own is not None:
            estop = EmergencyStop(node, self._runs, warn)
        self.estop = estop
        self.controls = Controls(self.slack.spin, estop)
        self.outgoing: list[TopicOut] = []
        self.incoming: list[TopicIn] = []
        self.skipped: list[str] = []
        self._group = compat.polled_group()
        self._others: list[Callable[[], None]] = []
        self._timer: Any = None
        self._runner: Runner | None = None
        self._stamp: WallStamp | None = None
        self._closed = False
        self._started_ns = time.perf_counter_ns()
        if self._own is not None:
            add_services(node, {name: getattr(self.controls, name) for name in SERVICES}, warn)

    # -- hooks ----------------------------------------------------------------------------------

    def inputs(self, workflow: Workflow) -> list[Block]:
        """Return the blocks that poll subscriptions and ~/estop; a hook of `load_workflow`."""
        arrays, names = arrays_of(workflow), names_of(workflow)
        variables = variables_of(workflow, self.frame_prefix)
        written = given_by_blocks(workflow)
        taken = set(workflow.platform.writes)
        for spec in self.map.subscribe:
            message = self._message(spec, "subscribe")
            if message is None:
                continue
            for state in spec.states:
                if state in taken:
                    raise UniconError(
                        f"{spec.where or spec.topic}: topic {spec.topic!r} would write state "
                        f"{state!r}, which platform {workflow.platform.name!r} writes; "
                        "take the topic out of the map, or use platform 'ros'"
                    )
            decoder = self._built(spec, partial(Decoder.build, spec, arrays, names, variables))
            if decoder is None:
                continue
            contested = not written.isdisjoint(spec.states)
            try:
                topic = TopicIn(self.node, decoder, message, contested, self._group, self.warn)
            except Exception as error:
                raise self._refused(spec, error) from error
            self.incoming.append(topic)
            self.slack.always |= not topic.polled
        states = {state for topic in self.incoming for state in topic.states}
        poll = Block(
            "ros inputs",
            _poll_all(self.incoming),
            warm_up=_warm_up(self.incoming, self.outgoing),
            writes=tuple(sorted(states - written)),
            amends=tuple(sorted(states & written)),
        )
        return [poll] if self.estop is None else [poll, self.estop.before_send()]

    def observers(self, workflow: Workflow) -> list[Block]:
        """Return the blocks that publish and serve; a hook of `load_workflow`."""
        arrays, names = arrays_of(workflow), names_of(workflow)
        variables = variables_of(workflow, self.frame_prefix)
        blocks: list[Block] = []
        platform = workflow.platform
        if not platform.simulated:
            source = arrays["stamp_ns"] if "stamp_ns" in platform.writes else None
            self._stamp = WallStamp(source)
            arrays["stamp_ns"] = self._stamp.out
            blocks.append(Block(self._stamp.name, self._stamp, reads=self._stamp.reads))
        phases: dict[int, int] = {}
        for spec in self.map.publish:
            if spec.topic == CLOCK and not platform.simulated:
                continue  # only a simulator makes the time of others
            taken = getattr(platform, "topics", ())
            if taken and self.node.resolve_topic_name(spec.topic) in taken:
                self._skip(spec, f"platform {platform.name!r} has it already")
                continue
            message = self._message(spec, "publish")
            if message is None:
                continue
            encoder = self._built(spec, partial(Encoder.build, spec, arrays, names, variables))
            if encoder is None:
                continue
            every = spec.every(workflow.period)
            phase = phases[every] = phases.get(every, -1) + 1
            try:
                topic = TopicOut(self.node, encoder, message, every, phase, self._group, self.warn)
            except Exception as error:
                raise self._refused(spec, error) from error
            self.outgoing.append(topic)
            blocks.append(topic.block)
        frames = RobotFrames(
            self.node, workflow, arrays["stamp_ns"], self._group, self.warn, self.frame_prefix
        )
        self._others.append(frames.close)
        if frames.out is not None:
            self.outgoing.append(frames.out)
            blocks.append(frames.block)
        blocks.append(Block(self.slack.name, self.slack))
        if self.estop is not None:
            self.slack.always |= not self.estop.polled
            blocks.append(self.estop.after_send())
        return blocks

    def attach(self, runner: Runner) -> None:
        """Let services act on this runner, and its deadlines bound what they may take."""
        self._runner = self.controls.runner = self.slack.runner = runner
        calm_middleware_threads()
        if self._timer is None and any(topic.events.declared for topic in self._topics()):
            from rclpy.clock import Clock, ClockType

            # The steady clock, so that it goes on where nobody publishes /clock.
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self._timer = self.node.create_timer(1.0, self._settle, self._group, steady)

    def counts(self) -> dict[str, Any]:
        """Return what passed: totals, and per topic `published`, or `received`, `rejected`, …"""
        seconds = max((time.perf_counter_ns() - self._started_ns) * 1e-9, 1e-9)
        topics: dict[str, dict[str, Any]] = {}
        for out in self.outgoing:
            topics[out.topic] = {"published": out.published, "failed": out.failed}
        for topic in self.incoming:
            topics.setdefault(topic.topic, {}).update(
                received=topic.received,
                dropped=topic.dropped,
                rejected=topic.rejected,
                stale=topic.stale,
            )
        for each in self._topics():
            told = each.events.counts()
            topics[each.topic].update({name.replace(" ", "_"): n for name, n in told.items()})
        return {
            "published": sum(out.published for out in self.outgoing),
            "received": sum(topic.received for topic in self.incoming),
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
            for close in self._others:
                rest.callback(close)
            for topic in self._topics():
                rest.callback(topic.close)
            if self._timer is not None:
                rest.callback(self.node.destroy_timer, self._timer)
            self.slack.rest()

    # -- helpers --------------------------------------------------------------------------------

    def _runs(self) -> bool:
        return self.controls.runner is not None and not self._closed

    def _topics(self) -> list[TopicOut | TopicIn]:
        return [*self.outgoing, *self.incoming]

    def _settle(self) -> None:
        for topic in self._topics():
            topic.events.settle()

    def _message(self, spec: PublishSpec | SubscribeSpec, direction: str) -> Any:
        """Return the Python class of a topic's type; None where it is absent and optional."""
        message = compat.message_class(spec.type)
        if message is None:
            package = spec.type.split("/")[0]
            remedy = f"install the ROS package {package}"
            if not spec.optional:
                raise UniconError(
                    f"{spec.where or spec.topic}: cannot {direction} topic {spec.topic!r}: the "
                    f"type {spec.type} is not installed; {remedy}, or say optional: true"
                )
            self._skip(spec, f"type {spec.type} is not installed ({remedy})")
        return message

    def _built(self, spec: PublishSpec | SubscribeSpec, build: Callable[[], Any]) -> Any:
        try:
            return build()
        except MapStateError as error:
            if not spec.optional:
                raise UniconError(str(error)) from error
            self._skip(spec, str(error))
        except MapError as error:
            raise UniconError(str(error)) from error
        return None

    def _skip(self, spec: PublishSpec | SubscribeSpec, reason: str) -> None:
        if spec.topic not in self.skipped:
            self.skipped.append(spec.topic)
            self.warn(f"topic {spec.topic} is left out: {reason}")

    def _refused(self, spec: PublishSpec | SubscribeSpec, error: Exception) -> UniconError:
        return UniconError(
            f"{spec.where or spec.topic}: topic {spec.topic!r} was refused by ROS "
            f"({one_line(error)}); correct its name or qos"
        )


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


def _read_map(name: str | Path | None) -> MessageMap:
    path = find_config("maps", name or "default")
    try:
        return load_map(path)
    except MapError as error:
        raise UniconError(str(error)) from error
