"""C22: every file that once gave a Python trace gives one line that names the culprit."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from attack_files import BASE, REPOSITORY, one_line, told, workflow

from unicon_base.errors import RobotError
from unicon_core.robots import load_robot
from unicon_core.states import standard_states
from unicon_msgs_map import Encoder, parse_map
from unicon_msgs_map.errors import MapError

LONG = "9" * 400
GO2 = REPOSITORY / "config" / "policies" / "go2_velocity"


def with_flow(flow: str) -> str:
    return BASE.replace("{hold: {duration: 0.1}}", flow)


def command(row: str) -> str:
    return BASE + f"commands: [{{velocity_command: {row}}}]\n"


def state(spec: str) -> str:
    return BASE + f"states: {spec}\n"


WORKFLOWS = {
    "pose to a number": (with_flow("{pose: {to: -1}}"), "block 'pose': to is -1; write a text or"),
    "pose to nan": (
        with_flow("{pose: {to: {'*_hip_joint': .nan}}}"),
        "block 'pose': to.*_hip_joint is ",
    ),
    "sway by a list": (with_flow("{sway: ['a']}"), "block 'sway': gains is ['a']; write a mapping"),
    "sway by rows": (
        with_flow("{sway: {gains: {'*': ['a', 1, 2]}}}"),
        "block 'sway': gains.*.0 is 'a'; write a number",
    ),
    "endless pose": (
        with_flow("{pose: {to: stand, duration: 1e308}}"),
        "duration is 1e+308; write",
    ),
    "hold for inf": (
        with_flow("{hold: {duration: .inf}}"),
        "duration is inf; write a number from 0",
    ),
    "hold for nan": (with_flow("{hold: {duration: .nan}}"), "duration is nan; write a number"),
    "schedule to inf": (
        command("{schedule: [[0, 0, 0, 0], [.inf, 1, 0, 0]]}"),
        "schedule.1.0 is inf; write a number from 0 to 1e+09 [s]",
    ),
    "schedule to nan": (
        command("{schedule: [[.nan, 1, 0, 0]]}"),
        "schedule.0.0 is nan; write a number",
    ),
    "schedule of digits": (command(f"{{schedule: [[{LONG}, 1, 0, 0]]}}"), "(400 digits)"),
    "schedule of words": (command("{schedule: [[a, b, c, d]]}"), "block 'velocity_command': sche"),
    "duration nan": (BASE + "duration: .nan\n", "duration is nan; write a number above 0"),
    "duration inf": (BASE + "duration: .inf\n", "duration is inf; write a number above 0"),
    "rate of digits": (BASE.replace("50", "9" * 5000), "(5000 digits)"),
    "rate nan": (BASE.replace("50", ".nan"), "rate is nan; write a number from 0.001 to 10000"),
    "shape 2^31": (state("{x: {shape: [2147483648]}}"), "at most 16777216 are held"),
    "shape 2^63": (state("{x: {shape: [9223372036854775808]}}"), "at most 16777216 are held"),
    "shape of shapes": (state("{x: {shape: [65536, 65536, 65536]}}"), "at most 16777216 are held"),
    "a million robots": (
        BASE + "num_robots: 1000000\n",
        "num_robots is 1000000; write a whole number from 1 to 4096",
    ),
    "many robots": (
        BASE + "num_robots: 4611686018427387904\n",
        "num_robots is 4611686018427387904; write a whole number from 1 to 4096",
    ),
    "nan in an integer": (state("{x: {dtype: int64, initial: .nan}}"), "nan does not fit into int"),
    "inf in a boolean": (state("{x: {dtype: bool, initial: .inf}}"), "inf does not fit into bool"),
    "a word in a float": (state("{x: {initial: a}}"), "'a' does not fit into float32"),
    "too large for int8": (state("{x: {dtype: int8, initial: 300}}"), "300 does not fit into int8"),
    "another tick": (state("{tick: {shape: [3]}}"), "state 'tick' is a standard one"),
    "another joint_pos": (state("{joint_pos: {shape: [3]}}"), "'joint_pos' is a standard one"),
    "a state by number": (state("{1: {shape: [3]}}"), "states: unknown key 1; write a text"),
    "states that are words": (state("{x: a}"), "state is 'a'; write a mapping with shape"),
    "names by number": (state("{x: {shape: [2], names: [1, 2]}}"), "names.0 is 1; write a text"),
    "a hostile dtype": (state("{x: {dtype: \"a';x='\"}}"), "is not a NumPy type"),
    "given a number": (
        BASE + "policies: {walk: {path: go2_velocity, given: 1e-30}}\n",
        "policies.walk.given is 1e-30; write a mapping of facts",
    ),
    "given twice": (
        BASE + "policies: {walk: {path: go2_velocity, given: {a: 1, a.b: 2}}}\n",
        "given a.b: a is given as 1 too",
    ),
    "options of a platform": (
        BASE + "platforms: {fake: {time_constant: [1]}}\n",
        "platform 'fake': time_constant is [1]; write a number",
    ),
}


@pytest.mark.parametrize("name", WORKFLOWS)
def test_a_bad_workflow(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, message = WORKFLOWS[name]
    path = workflow(tmp_path, text)
    assert message in one_line(capsys, "run", "--speed", "max", path)
    status, spoken = told(capsys, "check", path)
    assert status == 1
    assert "Traceback" not in spoken


@pytest.mark.parametrize("accept", ["[[]]", "[{}]", "{a: {}}", "[1, null]"])
def test_an_accepted_finding_is_a_word(
    accept: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = workflow(tmp_path, BASE + f"check: {{accept: {accept}}}\n")
    status, spoken = told(capsys, "check", path)
    assert status == 1
    assert "check.settings" in spoken or "check.accept is" in spoken
    assert "Traceback" not in spoken


@pytest.mark.parametrize("action", ["[1, 2]", "a word", "1.5", "null"])
def test_an_action_that_is_no_mapping(
    action: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`agree.py`: a contract beside a network with metadata of its own."""
    import onnx

    model = onnx.load(str(GO2 / "policy.onnx"))
    parts = ("hip", "thigh", "calf")
    joints = [f"{leg}_{part}_joint" for leg in ("FR", "FL", "RR", "RL") for part in parts]
    del model.metadata_props[:]
    for key, value in {
        "dof_names": json.dumps(joints),
        "kp": json.dumps([40.0] * 12),
        "kd": json.dumps([1.0] * 12),
    }.items():
        model.metadata_props.add(key=key, value=value)
    onnx.save(model, str(tmp_path / "policy.onnx"))
    text = (GO2 / "policy.yaml").read_text("utf-8")
    text = text.replace("action:\n  scale: 0.25\n  clip: [-8.0, 8.0]", f"action: {action}")
    lines = [line for line in text.splitlines() if not line.startswith("sha256")]
    (tmp_path / "policy.yaml").write_text("\n".join(lines), "utf-8")
    path = workflow(tmp_path, BASE + "policies: {walk: ./policy.yaml}\n")
    assert one_line(capsys, "run", path).startswith("policy 'walk': ")


@pytest.mark.parametrize(
    ("joints", "said"),
    [
        ("[1, 2]", "given joints.1 is 2; write a text"),
        ("[[a], [b]]", "given joints.1 is ['b']; write a text"),
        ("{a: b}", "given joints is {'a': 'b'}; write a list of names"),
        ("word", "given joints is 'word'; write a list of names"),
    ],
)
def test_joints_that_are_no_names(
    joints: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copyfile(GO2 / "policy.onnx", tmp_path / "policy.onnx")
    (tmp_path / "env.yaml").write_text(
        "sim: {dt: 0.005}\ndecimation: 4\nobservations: {policy: {}}\n"
        "actions: {joint_pos: {scale: 0.25}}\nscene: {robot: {init_state: {joint_pos: {a: 1}}}}\n",
        "utf-8",
    )
    given = f"{{path: ./env.yaml, given: {{joints: {joints}}}}}"
    path = workflow(tmp_path, BASE + f"policies: {{walk: {given}}}\n")
    assert said in one_line(capsys, "run", path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("rate_hz: 500", f"rate_hz: {LONG}"),
        ("rate_hz: 500", f"rate_hz: {LONG}.0"),
        ("rate_hz: 500", "rate_hz: 1e999"),
        ("sources:\n", "sources:\n  1: a\n"),
        ("name: go2\n", 'name: "go2\\e[2J"\n'),
        ("kind: quadruped", "kind: [quadruped]"),
        ("feet: [", "feet: [[], "),
    ],
    ids=lambda text: text[:30],
)
def test_a_bad_robot_file(old: str, new: str, tmp_path: Path) -> None:
    text = (REPOSITORY / "config" / "robots" / "go2.yaml").read_text("utf-8")
    assert old in text
    path = tmp_path / "go2.yaml"
    path.write_text(text.replace(old, new), "utf-8")
    with pytest.raises(RobotError, match=r"go2\.yaml:\d+: "):
        load_robot(path)


PUBLISH = "publish:\n  - topic: {}\n    type: {}\n    fields: {{{}}}\n"
MAPS = {
    "control in a topic": PUBLISH.format('"a\\ab"', "std_msgs/msg/Float64", "data: tick"),
    "control in a state": PUBLISH.format("a", "std_msgs/msg/Float64", 'data: "ti\\x01ck"'),
    "control in a field": PUBLISH.format("a", "std_msgs/msg/Float64", '"da\\x00ta": tick'),
    "newline in a topic": PUBLISH.format('"a\\nb"', "std_msgs/msg/Float64", "data: tick"),
    "quotes as topic": PUBLISH.format('\'"""\'', "std_msgs/msg/Float64", "data: tick"),
    "none in a constant": PUBLISH.format("a", "std_msgs/msg/Float64MultiArray", "data: [null]"),
    "a word in a constant": PUBLISH.format("a", "std_msgs/msg/Float64MultiArray", "data: ['a']"),
    "a list in a constant": PUBLISH.format("a", "std_msgs/msg/Float64MultiArray", "data: [[1]]"),
    "none as constant": PUBLISH.format("a", "std_msgs/msg/Float64", "data: {const: null}"),
    "a mapping as constant": PUBLISH.format("a", "std_msgs/msg/Float64", "data: {const: {a: 1}}"),
    "400 digits": PUBLISH.format("a", "std_msgs/msg/Float64", f"data: {LONG}"),
    "400 digits in a text": PUBLISH.format("a", "std_msgs/msg/Float64", f"data: ={LONG}"),
    "5000 digits in a text": PUBLISH.format("a", "std_msgs/msg/Int64", f"data: ={'9' * 5000}"),
    "more than a float32": PUBLISH.format("a", "std_msgs/msg/Float32", "data: 1.0e+300"),
    "a long type": PUBLISH.format("a", f"std_msgs/msg/{'F' * 5000}", "data: tick"),
    "a long topic": PUBLISH.format("a" * 5000, "std_msgs/msg/Float64", "data: tick"),
    "a long range": PUBLISH.format("a", "sensor_msgs/msg/Joy", "'axes[0:99999999999]': tick"),
    "a far element": PUBLISH.format("a", "sensor_msgs/msg/Joy", "'axes[9999999]': 'base_pos_w[0]'"),
    "a large message": PUBLISH.format(
        "a", "trajectory_msgs/msg/JointTrajectory", "'points[999999].positions[9999]': 1.0"
    ),
    "a wide text": PUBLISH.format(
        "a", "std_msgs/msg/String", "data: {state: tick, text: '999999999.2f'}"
    ),
    "an endless rate": PUBLISH.format("a", "std_msgs/msg/Float64", "data: tick").replace(
        "    fields", "    rate: .inf\n    fields"
    ),
}


@pytest.mark.parametrize("name", MAPS)
def test_a_bad_map(name: str) -> None:
    arrays = {k: np.zeros(v.shape, v.dtype) for k, v in standard_states(("a", "b")).items()}
    with pytest.raises(MapError) as caught:
        Encoder.build(parse_map(MAPS[name], name="m.yaml").publish[0], arrays)
    assert "m.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 12000


def test_a_message_that_holds_itself(tmp_path: Path) -> None:
    folder = tmp_path / "mine_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "A.msg").write_text("mine_msgs/B[] b\n", "utf-8")
    (folder / "B.msg").write_text("mine_msgs/A[] a\n", "utf-8")
    text = f"messages: [{folder}]\n" + PUBLISH.format("a", "mine_msgs/msg/A", "")
    with pytest.raises(MapError, match="holds itself"):
        parse_map(text)
