"""`--view=foxglove`: a client of the protocol gets ROS's bytes, drives, tunes and calls."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np
import pytest

pytest.importorskip("foxglove", reason="pip install 'unicon_ros[foxglove]'")
pytest.importorskip("websockets")
pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")

from foxglove_client import Client
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from velocity_sent import VelocitySent
from websockets.exceptions import ConnectionClosed, InvalidStatus
from worn_meshes import go2_with_meshes, write_stl

from unicon_base.errors import UniconError
from unicon_base.resources import find_config, same_modules
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.runtime.phases import Phase
from unicon_core.workflow import Program, load_document
from unicon_lab.recording.ticks import term_names, tick_channel
from unicon_lab.view.driver import FAULT
from unicon_lab.view.view import View
from unicon_msgs_map import Encoder, load_map
from unicon_ros.bridge.bindings import arrays_of, names_of, robot_variables
from unicon_ros.cli.main import main

OPTIONS = {"sink": "foxglove", "host": "127.0.0.1", "port": 8760, "token": "", "fps": 30.0}
TOPICS = ("/joint_states", "/tf", "/odom")


class Rig:
    """go2_teleop in a thread, seen through Foxglove."""

    def __init__(self, *settings: str, **options: Any) -> None:
        self.lines = list[str]()
        document = load_document("go2_teleop", ["ros=false", *settings])
        self.view = View({**OPTIONS, **options}, warn=self.lines.append)
        self.view.declare(document)
        self.sent = VelocitySent()
        self.program = Program(document, hooks=[self.view.hook, self.sent.hook])
        self.runner = Runner(self.program, RunOptions(duration=60.0, warn=self.lines.append))
        self.view.attach(self.runner)
        self.report: Report | None = None
        self.thread = threading.Thread(target=self._run)
        self.thread.start()

    def _run(self) -> None:
        self.report = self.runner.run()
        self.view.close()

    def command(self) -> list[float]:
        return self.sent.last

    def until(self, holds: Callable[[], bool], patience: float = 3.0) -> float:
        begin = time.monotonic()
        while not holds():
            assert time.monotonic() - begin < patience, (self.command(), self.lines)
            time.sleep(0.002)
        return time.monotonic() - begin

    def end(self) -> None:
        if self.thread.is_alive():
            self.runner.close()
        self.thread.join(10.0)


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    made = Rig()
    yield made
    made.end()


@pytest.fixture
def client(rig: Rig) -> Iterator[Client]:
    made = Client(rig.view.address)
    yield made
    made.close()
    rig.until(lambda: rig.command() == [0.0, 0.0, 0.0])


def twist(vx: float, wz: float = 0.0) -> bytes:
    return b"\x00\x01\x00\x00" + struct.pack("<6d", vx, 0, 0, 0, 0, wz)


def test_a_client_gets_the_bytes_that_ros_gets(rig: Rig, client: Client) -> None:
    client.subscribe(*TOPICS, "/robot_description", "/tf_static")
    client.until(lambda: {*TOPICS, "/tf_static"} <= {topic for topic, _, _ in client.messages})
    schema = client.channels["/joint_states"]
    assert (schema["encoding"], schema["schemaEncoding"]) == ("cdr", "ros2msg")
    assert schema["schemaName"] == "sensor_msgs/msg/JointState"
    assert "float64[] position" in schema["schema"]
    # What our own encoders make of the states of that very tick.
    rig.view.controls.pause()
    client.until(lambda: rig.view.controls.paused)
    time.sleep(0.1)
    now = int(rig.program.states["stamp_ns"])
    mapping = load_map(find_config("maps", "default"))
    program = rig.program
    bindings = arrays_of(program), names_of(program), robot_variables(program.robot)
    assert rig.view.controls.step()[0]
    rig.until(lambda: int(rig.program.states["stamp_ns"]) > now)
    now = int(rig.program.states["stamp_ns"])
    client.until(lambda: any(stamp == now for _, stamp, _ in client.messages))
    expected = {
        f"/{spec.topic.lstrip('/')}": bytes(Encoder.build(spec, *bindings).encode())
        for spec in mapping.publish
        if spec.topic in ("joint_states", "odom")
    }
    got = {topic: raw for topic, stamp, raw in client.messages if stamp == now}
    assert len(expected) == 2
    for topic in {*got} & {*expected}:
        assert got[topic] == expected[topic]
    assert "/joint_states" in got
    rig.view.controls.start()
    text = next(raw for topic, _, raw in client.messages if topic == "/robot_description")
    assert b"<robot" in text


def test_a_client_drives_and_stands_when_it_is_not_heard(rig: Rig, client: Client) -> None:
    client.advertise("/cmd_vel", "geometry_msgs/msg/Twist")
    client.publish(twist(0.4, 0.2))
    assert rig.until(lambda: rig.command() == [0.4, 0.0, 0.2]) < 0.2
    rig.until(lambda: rig.command() == [0.0, 0.0, 0.0], 1.0)  # silent
    time.sleep(0.2)
    client.publish(twist(0.4))  # queued by a page that had stalled, for all we know
    client.until(lambda: any("publish zeros first" in line for line in client.statuses))
    assert rig.command() == [0.0, 0.0, 0.0]
    client.publish(twist(0.0))
    client.publish(twist(0.3))
    rig.until(lambda: rig.command() == [0.3, 0.0, 0.0])
    client.publish(twist(0.0))


def test_json_counts_too_and_what_is_not_finite_or_a_message_does_not(
    rig: Rig, client: Client
) -> None:
    client.advertise("cmd_vel", "geometry_msgs/Twist", "json")
    client.publish(b'{"linear":{"x":0.2,"y":0,"z":0},"angular":{"x":0,"y":0,"z":0.1}}')
    rig.until(lambda: rig.command() == [0.2, 0.0, 0.1])
    for wrong in (b"", b"{", b"[]", b'{"linear":{"x":NaN,"y":0,"z":0},"angular":0}', b"\xff" * 99):
        client.publish(wrong)
    client.advertise("/cmd_vel", "geometry_msgs/msg/Twist", number=2)
    for raw in (twist(np.nan), twist(np.inf), b"", b"\x00\x01", twist(0.5)[:-1], b"\xff" * 400):
        client.publish(raw, 2)
    client.advertise("/cmd_vel", "std_msgs/msg/String", number=3)
    client.publish(twist(0.5), 3)
    client.advertise("/joint_states", "sensor_msgs/msg/JointState", number=4)
    client.publish(b"\x00\x01\x00\x00", 4)
    client.publish(twist(0.5), 99)  # never advertised
    for _ in range(2000):
        client.publish(b"\x00" * 100, 2)
    time.sleep(0.2)
    assert rig.command() in ([0.2, 0.0, 0.1], [0.0, 0.0, 0.0])
    client.until(lambda: bool(client.statuses))
    client.publish(twist(0.0), 2)


def test_only_one_client_drives(rig: Rig, client: Client) -> None:
    other = Client(rig.view.address)
    time.sleep(1.0)  # of a flood of refusals no more than a few are told
    for each in (client, other):
        each.advertise("/cmd_vel", "geometry_msgs/msg/Twist")
    client.publish(twist(0.2))
    rig.until(lambda: rig.command() == [0.2, 0.0, 0.0])
    other.publish(twist(-0.5))
    client.publish(twist(0.2))
    other.until(lambda: any("another client drives" in line for line in other.statuses))
    assert rig.command() == [0.2, 0.0, 0.0]
    # Whoever else says zero does not say it for a driver who has stalled.
    other.publish(twist(0.0))
    rig.until(lambda: rig.command() == [0.0, 0.0, 0.0], 1.0)
    time.sleep(0.2)
    client.publish(twist(0.2))
    client.until(lambda: any("publish zeros first" in line for line in client.statuses))
    assert rig.command() == [0.0, 0.0, 0.0]
    client.publish(twist(0.0))
    other.close()


def test_parameters_are_set_within_their_ranges(rig: Rig, client: Client) -> None:
    client.say(op="getParameters", parameterNames=[], id="1")
    client.until(lambda: "stiffness_scale" in client.parameters)
    assert client.parameters["stiffness_scale"] == 1.0
    wished = [{"name": "max_vx", "value": 0.7, "type": "float64"}]
    client.say(op="setParameters", parameters=wished, id="2")
    client.until(lambda: client.parameters.get("max_vx") == 0.7)
    time.sleep(1.0)  # of a flood of refusals no more than a few are told
    for name, value in (("max_vx", -1.0), ("stiffness_scale", 9.0), ("max_vx", "much")):
        client.say(op="setParameters", parameters=[{"name": name, "value": value}], id="3")
    client.until(lambda: any("stiffness_scale is 9" in line for line in client.statuses), 8.0)
    assert client.parameters["max_vx"] == 0.7
    assert client.parameters["stiffness_scale"] == 1.0


def test_services_are_called_and_answered(rig: Rig, client: Client) -> None:
    assert client.call("/unicon/pause") == (True, "paused; ~/start goes on, ~/step ticks once")
    assert client.call("/unicon/step") == (True, "one tick")
    assert client.call("/unicon/start") == (True, "going on")
    assert client.call("/unicon/step")[0] is False


def test_another_sites_page_does_not_come_in(rig: Rig) -> None:
    others = ("http://localhost:8080", "http://127.0.0.1:3000")  # another server's of this machine
    for origin in ("https://evil.example", "null", "http://127.0.0.1.evil.example", *others):
        with pytest.raises(InvalidStatus) as refused:
            Client(rig.view.address, origin)
        assert refused.value.response.status_code == 403
    Client(rig.view.address, "https://app.foxglove.dev").close()


def test_the_meshes_that_the_description_names_are_given_and_no_other_files(
    tmp_path: Path,
) -> None:
    model = go2_with_meshes(tmp_path / "my robot")
    write_stl(model.parent / "meshes" / "other.stl")
    rig = Rig(f"scene.model={model}", port=8785)
    client = Client(rig.view.address)
    try:
        client.until(lambda: bool(client.info))
        assert "assets" in client.info["capabilities"]
        client.subscribe("/robot_description")
        client.until(lambda: bool(client.messages))
        _, _, raw = client.messages[0]
        assert struct.unpack_from("<I", raw, 4)[0] == len(raw) - 8
        text = raw[8:-1].decode()
        uris = re.findall(r'<mesh filename="([^"]+)"', text)
        # Foxglove asks a server for `package:` alone.
        base = f"package://unicon{quote(str(model.parent))}/meshes/"
        assert uris == [f"{base}coque%20%C3%A9.stl", f"{base}thigh.STL"]
        for uri, name in zip(uris, ("coque é.stl", "thigh.STL")):
            assert client.fetch(uri) == (model.parent / "meshes" / name).read_bytes()
        neighbour = f"{base}other.stl"
        others = ("file:///etc/passwd", "/etc/passwd", "package://unicon/etc/passwd", "", neighbour)
        wrong = (model.as_uri(), (model.parent / "meshes" / "thigh.STL").as_uri(), unquote(uris[0]))
        near = (f"{base}../meshes/thigh.STL", f"{uris[1]}/", f"{uris[1]}%00", uris[1].lower(), base)
        for uri in (*others, *wrong, *near):
            assert client.fetch(uri) is None, uri
        (model.parent / "meshes" / "thigh.STL").unlink()
        assert client.fetch(uris[1]) is None
        assert client.fetch(uris[0]) is not None  # still there
    finally:
        client.close()
        rig.end()


# -- ticks, state, layout --------------------------------------------------------------------------


def decoded(client: Client, topic: str) -> list[Any]:
    """Return the messages of a topic, as rosbags reads them by the schema that was advertised."""
    channel, store = client.channels[topic], get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(channel["schema"], channel["schemaName"]))
    found = [raw for name, _, raw in client.messages if name == topic]
    return [store.deserialize_cdr(raw, channel["schemaName"]) for raw in found]


def test_targets_commands_and_observations_come_by_name_bit_by_bit(
    rig: Rig, client: Client
) -> None:
    client.subscribe("/unicon/ticks")
    client.until(lambda: len(client.messages) > 20)
    rig.view.controls.pause()
    client.until(lambda: rig.view.controls.paused)
    time.sleep(0.2)  # the tick that was running has ended
    client.until(lambda: client.messages[-1][1] == int(rig.program.states["stamp_ns"]))
    states, last = rig.program.states, decoded(client, "/unicon/ticks")[-1]
    for state in ("joint_pos_target", "joint_pos", "action"):
        values, names = states[state], states.spec(state).names
        for name, value in zip(names, values, strict=True):
            assert getattr(getattr(last.sent, state), name.lower()) == value, (state, name)
    assert last.sent.velocity_command.wz == states["velocity_command"][2]
    seen = [*vars(last.sent.observation).items()]
    names = [name for name, value in seen if not name.startswith("__")]
    assert len(names) == states["observation"].size
    assert names[-1] == f"last_action_{states.spec('action').names[-1].lower()}"
    assert [value for name, value in seen if name in names] == states["observation"].tolist()
    ticks = [message.tick for message in decoded(client, "/unicon/ticks")]
    assert set(np.diff(ticks)) == {1}
    assert last.phase == getattr(last, [phase.value for phase in Phase][last.phase].upper())
    rig.view.controls.start()


def test_the_live_topic_has_the_type_that_a_recording_has(rig: Rig, client: Client) -> None:
    client.until(lambda: "/unicon/ticks" in client.channels)
    live, layout = client.channels["/unicon/ticks"], rig.program.states.layout
    kept = tick_channel(1, layout, {"sent": None}, term_names(rig.program))
    assert (live["schemaName"], live["schema"]) == (kept.type, kept.definition)


def test_the_state_tells_phase_times_contacts_and_waits(rig: Rig, client: Client) -> None:
    client.subscribe("/unicon/state")
    client.until(lambda: len(client.messages) > 20)
    found = decoded(client, "/unicon/state")
    last = found[-1]
    assert (last.phase, last.paused, last.driven) == (last.RUN, False, False)
    assert 0.0 < last.took_us < 1e6
    assert max(message.late_us for message in found) >= 0.0
    assert (last.waits_for, last.fault) == ("", "")
    feet = {field.lower() for field in rig.program.robot.feet}
    stands = {name: getattr(last.contacts, name) for name in feet}
    assert len(stands) == 4
    assert all(stands.values())  # it stands still by itself
    assert last.overruns >= 0


def resolved(message: Any, path: str) -> Any:
    """Return what a path of a layout means in a message."""
    for field in path.split(".")[1:]:
        message = getattr(message, field)
    return message


def test_a_layout_plots_what_is_there(tmp_path: Path) -> None:
    file = tmp_path / "layout.json"
    rig = Rig(port=8775, layout=str(file))
    client = Client(rig.view.address)
    try:
        layout = json.loads(file.read_text("utf-8"))
        topics = ("/unicon/ticks", "/unicon/state", "/robot_description", "/tf", "/odom")
        client.subscribe(*topics)
        client.until(lambda: {topic for topic, *_ in client.messages} >= {*topics})
        panels = layout["configById"]
        kinds = {name.partition("!")[0] for name in panels}
        assert {"3D", "Plot", "StateTransitions", "RawMessages", "Teleop"} <= kinds
        assert {*re.findall(r"\w+!\w+", json.dumps(layout["layout"]))} == {*panels}
        newest = {topic: decoded(client, topic)[-1] for topic in topics[:2]}
        paths = [path for panel in panels.values() for path in panel.get("paths", ())]
        for path in paths:
            value = resolved(newest[path["value"].partition(".")[0]], path["value"])
            assert isinstance(value, int | float | np.number), path
        shown = [path["value"] for path in panels["Plot!joint"]["paths"] if path["enabled"]]
        joint = rig.program.robot.joint_names[0].lower()
        assert shown == [
            f"/unicon/ticks.sent.joint_pos_target.{joint}",
            f"/unicon/ticks.sent.joint_pos.{joint}",
        ]
        assert {panels["3D!robot"]["followTf"]} <= {"base_link", "base"}
        assert {*panels["3D!robot"]["topics"]} <= {*client.channels}
        # A process that is started again leaves a layout that was changed meanwhile.
        file.write_text("{}")
        assert rig.view._peripheral is not None
        os.kill(rig.view._peripheral.process.pid, signal.SIGKILL)
        rig.until(lambda: any("runs again" in line for line in rig.lines), 20.0)
        assert file.read_text() == "{}"
    finally:
        client.close()
        rig.end()


def test_a_layout_that_cannot_be_written_or_used_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(UniconError, match=r"cannot write .*: .*; give a path in a writable folder"):
        Rig(port=8776, layout=str(tmp_path / "none" / "layout.json"))
    for given, said in (
        (["--view"], "--view-layout is a file for Foxglove; show it there, or leave it out"),
        ([], "--view-layout goes with --view=foxglove; add it"),
    ):
        assert main(["run", "go2_stand", *given, "--view-layout", f"{tmp_path}/x.json"]) == 1
        assert said in capsys.readouterr().err
    assert not [*tmp_path.iterdir()]


@pytest.mark.slow
def test_beyond_this_machine_a_token_is_needed() -> None:
    with pytest.raises(UniconError, match="lets everybody in the network drive the robot"):
        Rig(host="0.0.0.0")
    with pytest.raises(UniconError, match="is not a token"):
        Rig(host="0.0.0.0", token="short")
    rig = Rig(host="0.0.0.0", token="correcthorse", port=8795)
    address = rig.view.address.replace("0.0.0.0", "127.0.0.1")
    assert address.endswith("/correcthorse")
    for wrong in (address[:-1], address.rsplit("/", 1)[0], address + "s"):
        with pytest.raises(InvalidStatus):
            Client(wrong)
    Client(address).close()
    Client(address, "http://localhost:8080").close()  # a page of one's own that has the token
    rig.end()


def test_its_estop_ends_the_run() -> None:
    rig = Rig(port=8790)
    client = Client(rig.view.address)
    client.subscribe("/unicon/state")
    begin = time.monotonic()
    client.call("/unicon/estop")
    rig.thread.join(5.0)
    assert rig.report is not None
    assert rig.report.faults == [FAULT]
    assert time.monotonic() - begin < 3.0
    with suppress(ConnectionClosed):  # all that was sent before it ended
        client.until(lambda: False, 2.0)
    assert decoded(client, "/unicon/state")[-1].fault == FAULT
    client.close()


@pytest.mark.slow
def test_stalled_clients_cost_the_others_nothing(rig: Rig) -> None:
    """Of five, one is stopped and one never reads what it has asked for."""
    folder = Path(__file__).parent
    command = [sys.executable, str(folder / "foxglove_client.py"), rig.view.address]
    kinds = ("reads", "reads", "reads", "reads", "stalls")
    started = [
        subprocess.Popen([*command, kind, "12"], stdout=subprocess.PIPE, env=same_modules())
        for kind in kinds
    ]
    for each in started:
        assert each.stdout is not None
        assert each.stdout.readline() == b"connected\n"
    stopped = started[3]
    os.kill(stopped.pid, signal.SIGSTOP)
    period = round(rig.program.period * 1e9)
    for each in started[:3]:
        out, _ = each.communicate(timeout=40)
        counts, stamps = json.loads(out)
        assert counts["/joint_states"] > 400
        assert len(stamps) > 500
        assert set(np.diff(stamps)) == {period}, "every tick, once, in order"
    os.kill(stopped.pid, signal.SIGCONT)
    for each in started[3:]:
        each.communicate(timeout=40)


@pytest.mark.slow
def test_killed_it_is_served_again_where_it_was() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        rig = Rig(port=port)
    try:
        assert not rig.view.address.endswith(f":{port}")
        assert rig.view._peripheral is not None
        os.kill(rig.view._peripheral.process.pid, signal.SIGKILL)
        rig.until(lambda: any("runs again" in line for line in rig.lines), 10.0)
        assert rig.lines[-1] == f"view: its process runs again: {rig.view.address}"
        client = Client(rig.view.address)
        client.subscribe("/joint_states")
        client.until(lambda: bool(client.messages))
        client.close()
    finally:
        rig.end()
