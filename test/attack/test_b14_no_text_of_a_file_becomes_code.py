"""B14: names of files are checked and bound; no text of a file enters generated source."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from attack_files import REPOSITORY, workflow

import unicon_base.generated as generated
from unicon_base.errors import UniconError
from unicon_core.flow import compile_graph
from unicon_core.states import standard_states
from unicon_core.workflow import load_workflow
from unicon_msgs_map import Decoder, Encoder, parse_map
from unicon_msgs_map.errors import MapError

PWN = 'x";open("pwn","w").write("hi");"'
HOSTILE = (
    '"""\nopen("pwn", "w").write("hi")\n"""',
    'x""";open("pwn","w").write("hi");"""',
    PWN,
    "x';open('pwn','w').write('hi');'",
    "x\n    open('pwn', 'w')",
    "x #\\",
    "{open('pwn','w')}",
    "a-b",
    "ÄÖ",
    "x\x00",
)
MAP = """\
publish:
  - topic: {topic}
    type: {type}
    qos: sensor_data
    fields:
      header.stamp: stamp_ns
      header.frame_id: {frame}
      angular_velocity: {state}
      linear_acceleration.x: {{state: "base_lin_acc[0]", scale: 2.5, offset: -1.0e-3}}
"""
PLAIN = {
    "topic": "imu/data",
    "type": "sensor_msgs/msg/Imu",
    "frame": "=base_link",
    "state": "base_ang_vel",
}


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[list[ast.Module]]:
    """Every text that becomes code during a test; no test may leave a file `pwn`."""
    monkeypatch.chdir(tmp_path)
    seen: list[ast.Module] = []
    check = generated.check_source

    def watched(source: str, names: Any) -> ast.Module:
        tree = check(source, names)
        seen.append(tree)
        return tree

    monkeypatch.setattr(generated, "check_source", watched)
    yield seen
    assert not (tmp_path / "pwn").exists()
    for tree in seen:
        for node in ast.walk(tree):
            assert not (isinstance(node, ast.Constant) and isinstance(node.value, (str, bytes)))


def quoted(text: str) -> str:
    return json.dumps(text)


@pytest.mark.parametrize("field", PLAIN)
@pytest.mark.parametrize("text", HOSTILE)
def test_a_message_map_runs_nothing(field: str, text: str, compiled: list[ast.Module]) -> None:
    arrays = {k: np.zeros(v.shape, v.dtype) for k, v in standard_states(("a", "b")).items()}
    values = {key: quoted(value) for key, value in PLAIN.items()}
    values[field] = quoted(f"={text}" if field == "frame" else text)
    if field == "frame" and text == "a-b":
        encoder = Encoder.build(parse_map(MAP.format(**values)).publish[0], arrays)
        assert text.encode() in encoder.encode()
        assert compiled
        return
    with pytest.raises(MapError) as caught:
        Encoder.build(parse_map(MAP.format(**values)).publish[0], arrays)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", HOSTILE[:-1])
def test_a_text_that_is_no_name_is_bytes_of_the_message(
    text: str, compiled: list[ast.Module]
) -> None:
    spec = parse_map(
        "publish:\n  - topic: a\n    type: std_msgs/msg/String\n"
        f"    fields: {{data: {quoted('=' + text)}}}\n"
    ).publish[0]
    encoder = Encoder.build(spec, {})
    assert text.encode() in encoder.encode()
    assert "pwn" not in encoder.source
    assert compiled


@pytest.mark.parametrize("text", HOSTILE)
def test_a_format_is_no_code(text: str, compiled: list[ast.Module]) -> None:
    arrays = {"tick": np.zeros((), np.int64)}
    try:
        spec = parse_map(
            "publish:\n  - topic: a\n    type: std_msgs/msg/String\n"
            f"    fields: {{data: {{state: tick, text: {quoted(text)}}}}}\n"
        ).publish[0]
        Encoder.build(spec, arrays).encode()
    except MapError:
        pass


@pytest.mark.parametrize(
    "topic", ["a b", "a//b", "a/", "1a", "a__b", "{a}", "a.b", "/", "~", "a-b"]
)
def test_a_topic_follows_the_rules_of_ros(topic: str) -> None:
    values = {key: quoted(value) for key, value in {**PLAIN, "topic": topic}.items()}
    with pytest.raises(MapError, match="write a ROS name"):
        parse_map(MAP.format(**values))


@pytest.mark.parametrize("topic", ["a", "/a", "~/a", "a/b_1/C", "/clock", "_hidden"])
def test_topics_of_ros_are_read(topic: str) -> None:
    values = {key: quoted(value) for key, value in {**PLAIN, "topic": topic}.items()}
    assert parse_map(MAP.format(**values)).publish[0].topic == topic


def test_decoders_bind_what_they_read(compiled: list[ast.Module]) -> None:
    names = tuple(HOSTILE)
    arrays = {"joint_pos": np.zeros(len(names), np.float32)}
    spec = parse_map(
        "subscribe:\n  - topic: a\n    type: sensor_msgs/msg/JointState\n"
        "    fields: {name: $joint_names, position: joint_pos}\n"
    ).subscribe[0]
    variables = {"joint_names": [name.replace("\0", "") for name in names]}
    decoder = Decoder.build(spec, arrays, {"joint_pos": variables["joint_names"]}, variables)
    out = parse_map(
        "publish:\n  - topic: a\n    type: sensor_msgs/msg/JointState\n"
        "    fields: {name: $joint_names, position: joint_pos}\n"
    ).publish[0]
    encoder = Encoder.build(out, arrays, {"joint_pos": variables["joint_names"]}, variables)
    arrays["joint_pos"][:] = np.arange(len(names))
    raw = encoder.encode()
    arrays["joint_pos"][:] = 0.0
    assert decoder.decode(raw), decoder.last_error
    assert arrays["joint_pos"].tolist() == list(range(len(names)))
    assert compiled


@pytest.mark.parametrize("text", HOSTILE)
def test_labels_and_cases_of_a_workflow_are_no_code(
    text: str, tmp_path: Path, compiled: list[ast.Module]
) -> None:
    name = quoted(text.replace("\0", ""))
    path = workflow(
        tmp_path,
        f"name: {name}\nrobot: go2\nplatform: fake\nrate: 50\nflow:\n  zip:\n"
        f"    - switch: {{on: tick > 2, cases: {{{name}: {{hold: {{name: {name}}}}}, b: damp}}}}\n",
    )
    built = load_workflow(path)
    try:
        source = compile_graph(built.root, trace=True).source
    finally:
        built.close()
    assert "open(" not in source
    assert compiled


@pytest.mark.parametrize("text", HOSTILE)
def test_an_expression_holds_names_of_states_and_numbers(
    text: str, tmp_path: Path, compiled: list[ast.Module]
) -> None:
    path = workflow(tmp_path)
    with pytest.raises(UniconError):
        load_workflow(path, {"flow": {"loop": {"do": "hold", "until": text}}})


def test_a_message_definition_with_a_hostile_name_is_refused(
    tmp_path: Path, compiled: list[ast.Module]
) -> None:
    folder = tmp_path / 'x"""\nopen("pwn","w").close()\n"""'
    folder.mkdir()
    (folder / "Thing.msg").write_text("float64 x\n", "utf-8")
    text = (
        f"messages: [{quoted(str(folder))}]\n"
        "publish: [{topic: a, type: std_msgs/msg/Float64, fields: {data: tick}}]\n"
    )
    with pytest.raises(MapError):
        parse_map(text)


def test_generated_code_runs_through_one_door() -> None:
    seen = [*REPOSITORY.glob("unicon_*/**/*.py")]
    assert len(seen) > 400
    for path in seen:
        if path.name == "generated.py":
            continue
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            called = node.func if isinstance(node, ast.Call) else None
            if isinstance(called, ast.Name):
                assert called.id not in ("exec", "eval", "compile"), (path, node.lineno)


@pytest.mark.parametrize(
    "source",
    [
        "import os",
        "def f():\n    import os",
        "def f():\n    return 'text'",
        "def f():\n    return ().__class__",
        "def f():\n    return open",
        "def f():\n    return __import__",
        "def f(x=lambda: 0):\n    pass",
        "open('pwn', 'w')",
        "@print\ndef f():\n    pass",
    ],
)
def test_the_door_refuses_what_no_generator_writes(source: str, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="generated code is refused"):
        generated.define(source, {}, "<attack>")
