"""Foxglove: a WebSocket server of foxglove-sdk with the bytes that ROS gets, for `--view=foxglove`.

Topics are those of the run's message map, encoded by the bridge's own encoders; /tf, /tf_static and
robot_description besides, the meshes that this names, and every state (`/unicon/ticks`). A client
may publish what the map takes as a velocity (`cmd_vel`), set the parameters of `unicon_node` that
count at once, and call its services.
"""

from __future__ import annotations

import math
import struct
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from unicon_base import AnyMapping, imported
from unicon_core.page import write_json
from unicon_core.platforms.platform import Facts
from unicon_core.states import States
from unicon_core.workflow import Program
from unicon_lab.recording.recorded_topics import RecordedTopics
from unicon_lab.view.foxglove_topics import Publishers, Ticks, Topics, foxglove_layout
from unicon_lab.view.shown import Shown
from unicon_lab.view.source import Remote, Source
from unicon_ros.web_front import Front, hidden_address

APP = "https://app.foxglove.dev"
"""Whose pages may come in besides those of this machine."""

TRIGGER = "std_srvs/srv/Trigger"
BACKLOG, LARGEST = 4096, 64 << 20
"""Messages that are kept for a slow client, and bytes of ticks at most; older ones are dropped for
it alone."""
ANSWER = 2.0
"""How long a service waits for the run, in [s]."""
LOUD, LINES = 1.0, 10
"""Of what is told of refused messages: so many lines in that time [s]."""

_ACTS = ("start", "stop", "estop", "pause", "step", "reset", "swap")


class Foxglove:
    """The sink.

    Args:
        shown: the run.
        source: of its ticks.
        remote: what clients publish, set and call goes there.
        options: `host`, `port`, `token`, and `layout`, a file for a layout or "".

    Attributes:
        address: for Foxglove's "Open connection".

    Raises:
        MissingDependencyError: foxglove-sdk is not installed.
        UniconError: the map does not fit, no port is free, or the layout cannot be written.
    """

    def __init__(self, shown: Shown, source: Source, remote: Remote, options: AnyMapping) -> None:
        foxglove = imported("foxglove", "--view=foxglove", "foxglove", "foxglove-sdk")
        websocket = foxglove.websocket
        self._sdk, self._shown, self._source, self._remote = websocket, shown, source, remote
        self._states = States(shown.layout)
        self._context = foxglove.Context()
        self._lock = threading.Lock()
        self._answers: dict[int, tuple[bool, str]] = {}
        self._answered = threading.Condition(self._lock)
        self._handle, self._faults = 0, list[str]()
        self._topics = Topics(foxglove, self._context)
        program = cast(Program, _program_of(shown, self._states))
        recorder = cast(Any, self._topics)
        self._record = RecordedTopics(
            recorder, program, shown.map, frame_prefix=shown.frame_prefix
        ).block.tick
        self._ticks = Ticks(shown, self._topics)
        self._driver = Publishers(shown, remote, self._say)
        if options.get("layout"):
            write_json(Path(options["layout"]), foxglove_layout(shown, self._ticks.feet))
        self._loud_until, self._lines = 0.0, 0
        hidden = hidden_address()
        capability = websocket.Capability
        self._server = foxglove.start_server(
            name=f"unicon {shown.workflow} on {shown.robot.name}",
            host=hidden,
            port=0,
            capabilities=[capability.ClientPublish, capability.Parameters, capability.Services],
            server_listener=_listener(websocket.ServerListener, self),
            supported_encodings=["cdr", "json"],
            services=self._services(foxglove),
            asset_handler=self._topics.meshes.fetch,
            context=self._context,
            message_backlog_size=max(16, min(BACKLOG, LARGEST // shown.layout.nbytes)),
        )
        try:
            host, token = str(options["host"]), str(options["token"])
            self._front = Front(
                host, int(options["port"]), (hidden, self._server.port), [APP], token, self._say
            )
        except BaseException:
            self._server.stop()
            raise
        self.address = f"ws://{self._front.at}{f'/{token}' if token else ''}"

    def poll(self) -> None:
        """Log every tick that has come, and take the answers."""
        for tick in self._source.since(self._handle):
            self._handle = tick.handle
            self._states.buffer[:] = tick.buffer
            self._record()
            self._ticks(tick, self._source.texts)
        last, faults = self._source.latest(), [*self._source.texts["faults"]]
        if last is not None and faults != self._faults:  # no tick may follow it
            self._faults = faults
            self._ticks(last, self._source.texts, again=True)
        self._driver.look()
        answers, self._source.answers[:] = list(self._source.answers), []
        with self._answered:
            self._answers |= {answer.number: (answer.done, answer.text) for answer in answers}
            self._answered.notify_all()

    def close(self) -> None:
        """Close the server and its door."""
        self._front.close()
        self._server.stop()

    # -- in threads of the server ---------------------------------------------------------------

    def act(self, act: str, /, **arguments: Any) -> tuple[bool, str]:
        """Wish something, and wait for what becomes of it."""
        if act == "estop":
            self._remote.estop()
            return True, "emergency stop: the platform damps"
        number = self._remote.act(act, **arguments)
        with self._answered:
            there = self._answered.wait_for(lambda: number in self._answers, ANSWER)
            if not there:
                return False, f"the run has not answered for {ANSWER:g} s"
            return self._answers.pop(number)

    def parameters(self, names: list[str]) -> list[Any]:
        """Return the parameters of these names; all for none."""
        known = self._shown.parameters
        chosen = names or list(known)
        make = self._sdk.Parameter
        return [make(name, value=known[name].value) for name in chosen if name in known]

    def set_parameter(self, name: str, value: Any) -> None:
        """Set one, where the run takes it."""
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = math.nan
        if name not in self._shown.parameters or not math.isfinite(number):
            self._say(f"parameter {name}: {value!r} is refused")
            return
        done, text = self.act("set_parameter", name=name, value=number)
        if done:
            self._shown.tell({name: number})
        else:
            self._say(text)

    def heard(self, client: int, channel: Any, data: bytes) -> None:
        """Take a message of a client."""
        self._driver.heard(client, channel, data)

    def _say(self, line: str) -> None:
        server, now = getattr(self, "_server", None), time.monotonic()
        if now >= self._loud_until:
            self._loud_until, self._lines = now + LOUD, 0
        self._lines += 1
        if server is not None and self._lines <= LINES:
            server.publish_status(line, self._sdk.StatusLevel.Warning)

    def _services(self, foxglove: Any) -> list[Any]:
        websocket = foxglove.websocket

        def message(end: str, fields: str) -> Any:
            name, data = f"{TRIGGER}_{end}", fields.encode()
            schema = foxglove.Schema(name=name, encoding="ros2msg", data=data)
            return websocket.MessageSchema(encoding="cdr", schema=schema)

        told = message("Response", "bool success\nstring message")
        schema = websocket.ServiceSchema(TRIGGER, request=message("Request", ""), response=told)

        def service(place: str, act: str, /, **arguments: str) -> Any:
            def call(_: Any) -> bytes:
                return _trigger(*self.act(act, **arguments))

            return websocket.Service(name=f"/unicon/{place}", schema=schema, handler=call)

        skills = [service(f"skills/{name}", "skill", name=name) for name in self._shown.skills]
        return [service(act, act) for act in _ACTS] + skills


def _listener(base: Any, sink: Foxglove) -> Any:
    """Return what the server calls, in threads of its own.

    Args:
        base: foxglove-sdk's, which does nothing.
        sink: for whom it listens.
    """
    channels: dict[tuple[int, int], Any] = {}

    class Listener(base):
        def on_subscribe(self, client: Any, channel: Any) -> None:
            sink._topics.again(channel.id)

        def on_client_advertise(self, client: Any, channel: Any) -> None:
            if len(channels) < 1000:
                channels[client.id, channel.id] = channel

        def on_client_unadvertise(self, client: Any, client_channel_id: int) -> None:
            channels.pop((client.id, client_channel_id), None)

        def on_message_data(self, client: Any, client_channel_id: int, data: bytes) -> None:
            channel = channels.get((client.id, client_channel_id))
            if channel is not None:
                sink.heard(client.id, channel, data)

        def on_get_parameters(
            self, client: Any, param_names: list[str], request_id: Any = None
        ) -> Any:
            return sink.parameters(param_names)

        def on_set_parameters(self, client: Any, parameters: Any, request_id: Any = None) -> Any:
            for parameter in parameters:
                sink.set_parameter(parameter.name, parameter.get_value())
            return sink.parameters([])

    return Listener()


def _program_of(shown: Shown, states: States) -> SimpleNamespace:
    """Return what encoders ask of a program."""
    facts = Facts(shown.platform, simulated=shown.simulated, batch=True)
    platform = SimpleNamespace(facts=facts)
    if shown.model is not None:
        platform.model_path = shown.model
    return SimpleNamespace(
        states=states,
        robot=shown.robot,
        period=shown.period,
        platform=platform,
        name=shown.workflow,
    )


def _trigger(success: bool, message: str) -> bytes:
    """Return a std_srvs/srv/Trigger response as CDR."""
    raw = message.encode() + b"\0"
    return b"\x00\x01\x00\x00" + struct.pack("<?3xI", success, len(raw)) + raw
