"""Platform `ros`: a robot (or Gazebo) that lives behind plain ROS 2 topics, for workflows.

    platform: ros
    platforms:
      ros: {map: ros_robot}       # its states in, its commands out
    pacing: {trigger: state}      # tick when joint states arrive

What the map subscribes is what `recv` writes, polled raw and drained to the latest; what it
publishes is what `send` reads. A topic that is needed and silent for its `timeout` is a fault, and
so are commands that cannot be published. Needed is what the map does not call optional, and what
the workflow's critical path reads, whatever the map says. A topic whose map says no `qos` is heard
with best effort, which hears robots of either kind. A map may publish `joint_effort_target`, the
torques of a servo here, where the robot takes nothing else.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np

from unicon_base import (
    AnyMapping,
    Fault,
    MissingDependencyError,
    PlatformError,
    Silence,
    UniconError,
)
from unicon_base.resources import find_config
from unicon_base.schema.marks import Within, positive
from unicon_core.blocks.maps import projected_gravity
from unicon_core.platforms.kit.command import (
    DAMPING_TIME,
    Damping,
    FiniteCheck,
    LastSent,
    Servo,
    repeated,
)
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.signals import SIGNALS
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_msgs_map import load_map
from unicon_msgs_map.spec import TopicSpec
from unicon_ros import compat
from unicon_ros.bridge.diagnostics import other_types
from unicon_ros.bridge.map_fit import (
    EFFORT,
    MEASURED,
    ORIENTATION,
    Exchange,
    examine_platform,
    message_class,
    robot_codecs,
)
from unicon_ros.bridge.own_node import OwnNode, calm_middleware_threads
from unicon_ros.bridge.qos import LATEST
from unicon_ros.bridge.topics import TopicIn, TopicOut

TIMEOUT = 0.5
"""Silence that is a fault where the map gives no `timeout`, [s]."""

SEND_FAILURES = 5
"""So many failures in a row to publish a command are a fault."""

LONGEST_DAMPING = 0.8
"""Largest option `damping`, [s]: a request to end a run waits for it."""


def _reached(options: AnyMapping) -> str:
    """Return what tells a robot behind topics from others, for its latch: domain and namespace."""
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    names = str(options.get("namespace") or "").strip("/").split("/")
    return "/".join(["ros", f"domain{domain}", *filter(None, names)])


class RosPlatform:
    """A robot behind topics; build it with `make`.

    Attributes:
        topics: full names of the topics that it reads and writes.
        incoming: the topics that it hears.
        outgoing: the topics of its commands; none where it is silent.
    """

    facts = Facts("ros", examine=examine_platform)
    remedy: ClassVar[str] = "start the robot"

    def __init__(
        self,
        states: States,
        robot: Robot,
        period: float,
        path: Path,
        own: OwnNode,
        connect: float,
        damping: float,
        silent: bool,
    ) -> None:
        self._states, self._robot, self._own, self._path = states, robot, own, path
        self._period, self._patience, self._damping = period, connect, damping
        mapping = load_map(path, heard=LATEST)
        # Silence is a fault here; zeros in its place would be commanded by the last damping.
        heard = (
            replace(each, on_timeout="hold", timeout=each.timeout or TIMEOUT)
            for each in mapping.subscribe
        )
        rows = [states[name] for name in COMMAND_STATES]
        self._measured = [states[name] for name in MEASURED]
        self._servo = Servo(rows, robot.effort_limit)
        decoders, encoders = robot_codecs(
            replace(mapping, subscribe=tuple(heard)), states, robot, self._servo.torque
        )
        group = compat.polled_group()
        self.incoming, self.outgoing = list[TopicIn](), list[TopicOut]()
        self._warnings, self._awaited = list[str](), list[str]()
        warn = self._warnings.append
        for decoder in decoders:
            message = message_class(decoder.spec)
            if message is not None:
                self.incoming.append(TopicIn(own.node, decoder, message, False, group, warn))
        said: list[TopicSpec] = []
        for encoder in encoders:
            message, every = message_class(encoder.spec), encoder.spec.every(period)
            if message is None:
                continue
            said.append(encoder.spec)
            if not silent:  # without a publisher nothing can be sent
                self.outgoing.append(TopicOut(own.node, encoder, message, every, 0, group, warn))
        self._commands = [own.node.resolve_topic_name(spec.topic) for spec in said]
        self._needed = [topic for topic in self.incoming if not topic.spec.optional]
        self._torques = any(EFFORT in spec.states for spec in said)
        self._exchange = Exchange(path, states, [topic.decoder for topic in self.incoming], said)
        if not all(topic.polled for topic in self.incoming):
            raise PlatformError("this rclpy cannot be polled; use one of Humble, Jazzy or Kilted")
        self.topics = (*(topic.topic for topic in self.incoming), *self._commands)
        self._stamped = any("stamp_ns" in topic.spec.states for topic in self.incoming)
        self._gravity: Callable[[], None] | None = None
        if self._exchange.turned:
            self._gravity = projected_gravity(states[ORIENTATION], states["projected_gravity"])
        reads, writes = self._exchange.reads, self._exchange.writes
        notes = self.notes(reads, period)
        self.facts = replace(self.facts, reads=reads, writes=writes, notes=notes)
        # A map without gains moves motors that look at nothing but their targets.
        self._hold = {"joint_stiffness", "joint_damping"}.isdisjoint(reads)
        self._finite = FiniteCheck(
            {name: states[name] for name in COMMAND_STATES}, robot.joint_names
        )
        self._sent = LastSent(states)
        self._wait_set = compat.ReusedWaitSet([self.incoming[0].subscription], own.context)
        self._closed = False

    @staticmethod
    def notes(reads: Sequence[str], period: float) -> tuple[str, ...]:
        """Return remarks on a robot that reads these states, with ticks of a period in [s]."""
        return ()

    def connect(self) -> None:
        """Wait for the first message of every topic that is needed.

        Raises:
            PlatformError: none came in time.
        """
        end = time.monotonic() + self._patience
        while missing := self._missing():
            SIGNALS.check()
            for topic in self.incoming:
                topic.poll()
            if time.monotonic() > end:
                node, silent = self._own.node, [topic for topic in self.incoming if not topic.heard]
                errors = [topic.decoder.last_error for topic in self._needed]
                errors += [other_types(node, t.topic, t.spec.type) for t in silent]
                said = "; ".join(each for each in dict.fromkeys([*self._warnings, *errors]) if each)
                raise PlatformError(
                    f"platform {self.facts.name!r}: no message {missing} within "
                    f"{self._patience:g} s{f' ({said})' if said else ''}; {self.remedy}, or "
                    f"correct namespace, remaps or the map {self._path}"
                )
            self._own.executor.spin_once(0.005)  # tells what a peer's QoS does not match
        calm_middleware_threads()

    def _missing(self) -> str:
        """Return what no message has told yet, in the words of an error; empty if all is there."""
        silent = [topic for topic in self._needed if not topic.heard]
        if silent:
            return f"on {silent[0].topic}"
        for name in self._awaited:
            untold = np.flatnonzero(np.isnan(self._states[name]))
            if len(untold):
                names = self._states.layout.specs[name].names
                return f"tells {name} of {names[untold[0]] if names else f'element {untold[0]}'}"
        return ""

    def require(self, states: Mapping[str, str]) -> None:
        """Need what the critical path reads, optional or not, and wait until messages told all.

        Args:
            states: each state that a block on the critical path reads, and that block's name.

        Raises:
            PlatformError: the map writes some elements of a state only, or messages do.
        """
        for name in self._exchange.wanted(states):
            sources = [topic for topic in self.incoming if name in topic.spec.states]
            for topic in sources:
                if name == ORIENTATION:
                    topic.decoder.need_orientation(name)
                topic.heard = False  # what came so far may have told less than is needed
                if topic not in self._needed:
                    self._needed.append(topic)
            if sources and self._states[name].dtype.kind == "f":
                self._states[name][...] = np.nan
                self._awaited.append(name)
        self.connect()

    def wait(self, timeout: float) -> bool:
        """Return True when the first topic of the map has a message, False after `timeout` [s]."""
        first = self.incoming[0]
        if first.prefetch():
            return True
        if not timeout:  # a look costs 1 µs, the wait set 10
            return False
        self._wait_set.sleep(timeout)
        return first.prefetch()

    def arrivals(self) -> int:
        """Return how many messages of that topic have come so far."""
        return self.incoming[0].received

    def recv(self) -> bool | None:
        """Bring the latest messages into the states.

        Raises:
            Fault: a topic that the robot needs was silent for its time-out.
        """
        self.incoming[0].accept()
        for topic in self.incoming[1:]:
            topic.poll()
        for topic in self._needed:
            if topic.stale:
                raise Silence(f"{topic.silence}; the robot is silent")
        if self._gravity is not None:
            self._gravity()
        if not self._stamped:
            self._states.stamp_ns[...] = time.monotonic_ns()
        return None

    def warm_up(self) -> None:
        """Do what `send` does up to the publishing, to warm up."""
        self._finite()
        for out in self.outgoing:
            out.warm_up()

    def send(self) -> bool | None:
        """Publish the commands that are due.

        Raises:
            Fault: a command is not finite, or commands cannot be published.
        """
        self._finite()
        if self._torques:
            self._servo(*self._measured)
        for out in self.outgoing:
            out.tick()
            if out.failing >= SEND_FAILURES:
                raise Fault(
                    f"topic {out.topic}: {out.failing} commands in a row were not published "
                    f"({out.last_error})"
                )
        self._sent.note()
        return None

    def close(self) -> None:
        """Send the damping command for a while, then let go."""
        if self._closed:
            return
        self._closed = True
        with ExitStack() as rest:  # all of it, whatever fails
            rest.callback(self._own.close)
            for topic in self.incoming:
                rest.callback(topic.close)
            for said in self.outgoing:
                rest.callback(said.close)
            rest.callback(self._wait_set.close)
            # A robot that got nothing of ours is somebody else's.
            if self._sent.any:
                damping = Damping(self._states, self._robot, self._sent, self._period)
                damped = self._sent.limp and not self._hold  # by the tick, and reported before
                again = partial(self._send_again, damping)
                repeated(again, self._period, 0.0 if damped else self._damping)
                self._servo.torque[...] = 0.0  # a controller of efforts keeps the last for ever
                for out in self.outgoing:
                    out.flush()

    def _send_again(self, damping: Damping) -> None:
        damping()
        if self._torques:
            for topic in self.incoming:
                topic.poll()
            self._servo(*self._measured)
            if any(topic.stale for topic in self._needed):
                self._servo.torque[...] = 0.0  # nothing damps a robot that is not seen
        self._states["stamp_ns"][...] += round(self._period * 1e9)  # or a reader takes it for old
        for out in self.outgoing:
            out.now()

    def commanders(self) -> Mapping[str, int]:
        """Return the topics of the commands, with the number of others that publish there."""
        own = {out.topic for out in self.outgoing}
        count = self._own.node.count_publishers
        return {topic: count(topic) - (topic in own) for topic in self._commands}

    def info(self) -> AnyMapping:
        """Return map, topics and what came in."""
        return {
            "map": str(self._path),
            "topics": list(self.topics),
            "received": {topic.topic: topic.received for topic in self.incoming},
            "published": {out.topic: out.published for out in self.outgoing},
            "notes": [*self._warnings, *self.facts.notes],
        }


def maker(kind: type[RosPlatform], own_map: str, patience: float) -> Callable[..., RosPlatform]:
    """Return the factory of such a platform.

    Args:
        kind: of the platform.
        own_map: its map where none is named.
        patience: how long it waits for the robot where nothing is said, in [s].
    """
    name = f"platform {kind.facts.name!r}"

    def make(
        states: States,
        robot: Robot,
        period: float,
        *,
        map: str = own_map,
        node_name: str = "unicon_platform",
        namespace: str | None = None,
        ros_args: Sequence[str] = (),
        connect: Annotated[float, positive(unit="s")] = patience,
        damping: Annotated[float, Within(0.0, LONGEST_DAMPING, "s")] = DAMPING_TIME,
        relative_to: Path | None = None,
        silent: bool = False,
    ) -> RosPlatform:
        """Build the platform and wait for the robot.

        Args:
            period: of a tick in [s].
            map: name in `config/maps/` or path; its subscriptions write the robot's states, its
                publications read the commands. For Gazebo `gazebo` sends targets to controllers in
                gz, and `gazebo_effort` torques.
            node_name: of the node of its own that the platform makes.
            namespace: of that node.
            ros_args: ROS arguments of that node, such as remaps.
            connect: how long to wait for the first message of each topic in [s].
            damping: how long the last command is repeated at the end in [s], at most 0.8.
            relative_to: folder of the workflow, for a relative map path.
            silent: receive only: nothing is published, at the end either.

        Raises:
            MissingDependencyError: rclpy is not installed.
            PlatformError: the map does not fit, or no message came in time.
        """
        path = find_config("maps", map, error=PlatformError, relative_to=relative_to)
        own = OwnNode(node_name, namespace, ros_args)
        try:
            platform = kind(states, robot, period, path, own, connect, damping, silent)
        except UniconError as error:
            own.close()
            if isinstance(error, MissingDependencyError):
                raise
            raise PlatformError(f"{name}: {error}") from error
        try:
            platform.connect()
        except BaseException:
            platform.close()
            raise
        return platform

    # By the annotation its facts are known; a child process imports it by its name.
    make.__annotations__["return"] = kind
    make.__module__, make.__qualname__ = kind.__module__, "make"
    return make


make = maker(RosPlatform, "ros_robot", 5.0)
setattr(make, "reached", _reached)  # noqa: B010  a function has none to mypy
