"""Every mistake in a mapping, beside the exact line that it gets."""

# ruff: noqa: E501 - each message stands whole, to be searched for

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from map_helpers import JAZZY, NAMES, publish, subscribe

from unicon_base.errors import UniconError
from unicon_base.packages import share_folder, shares
from unicon_msgs_map import (
    Decoder,
    Encoder,
    MapError,
    MapFileError,
    MapStateError,
    MessageTypeError,
    load_map,
    parse_map,
)

SHARE = share_folder("geometry_msgs")
LOOKED = shares() if SHARE is None else f"looked in {SHARE / 'msg'}"
TWIST = "type: geometry_msgs/msg/Twist"
OUT = "publish:\n  - topic: a\n    type: geometry_msgs/msg/Twist\n"
IN = "subscribe:\n  - topic: a\n    type: geometry_msgs/msg/Twist\n"
STATE = "publish:\n  - topic: js\n    type: sensor_msgs/msg/JointState\n    fields:\n"

FILES: list[tuple[str, str]] = [
    # YAML and the top level
    ("publish: [", "m.yaml:1: not valid YAML: expected the node content, but found '<stream end>'"),
    (
        "- a\n",
        "m.yaml:1: a message map is a mapping; begin with publish: or subscribe:",
    ),
    (
        "publsh: []\n",
        "m.yaml:1: unknown key 'publsh'; did you mean 'publish'? known: description, include, messages, publish, schema, subscribe, trajectory, typestore",
    ),
    (
        "publish: []\n",
        "m.yaml:1: the message map maps nothing; add entries under 'publish' or 'subscribe'",
    ),
    (
        "publish: 3\n",
        "m.yaml:1: publish is 3; write a list of entries: - {topic: …, type: …, fields: …} or null",
    ),
    (
        "publish: []\npublish: []\n",
        "m.yaml:2: not valid YAML: key 'publish' stands twice, first in line 1; remove one",
    ),
    (
        "typestore: jazy\npublish: []\n",
        "m.yaml:1: typestore 'jazy' is unknown; did you mean 'jazzy'? known: dashing, eloquent, "
        "foxy, galactic, humble, iron, jazzy, kilted, lyrical",
    ),
    (
        "messages: [nowhere/X.msg]\n",
        "m.yaml:1: cannot read message file 'nowhere/X.msg': No such file or directory",
    ),
    (
        "messages: X.msg\n",
        "m.yaml:1: messages is 'X.msg'; write a list, each a text or null",
    ),
    ("schema: unicon.map/2\n", "m.yaml:1: schema is 'unicon.map/2'; write unicon.map/1"),
    ("messages: [3]\n", "m.yaml:1: messages.0 is 3; write a text"),
    # entries
    (
        "publish:\n  - topic: a\n    " + TWIST + "\n",
        "m.yaml:2: publish.a: missing key 'fields'; an entry needs topic, type and fields",
    ),
    (
        OUT + "    timeout: 1\n    fields: {}\n",
        "m.yaml:4: publish.a: unknown key 'timeout'; known: fields, optional, qos, rate, remove, topic, type",
    ),
    (
        OUT + "    qos: {history: keep_all}\n    fields: {}\n",
        "m.yaml:4: publish.a.qos is reliable and keep_all, so a reader that hangs would stop the tick; say history: keep_last and a depth, or reliability: best_effort",
    ),
    (
        "publish:\n  - topic: a b\n    " + TWIST + "\n    fields: {}\n",
        "m.yaml:2: publish.a b.topic is 'a b'; write a ROS name: words of letters, digits and '_' between slashes, like imu/data",
    ),
    (
        "publish:\n  - topic: a\n    type: geometry_msgs/msg/Twst\n    fields: {}\n",
        "m.yaml:3: a: message type 'geometry_msgs/msg/Twst' is unknown; did you mean "
        "'geometry_msgs/msg/Twist'? known: geometry_msgs/msg/Accel, "
        "geometry_msgs/msg/AccelStamped, geometry_msgs/msg/AccelWithCovariance, "
        "geometry_msgs/msg/AccelWithCovarianceStamped, geometry_msgs/msg/Inertia, "
        "geometry_msgs/msg/InertiaStamped, geometry_msgs/msg/Point, geometry_msgs/msg/Point32, "
        "geometry_msgs/msg/PointStamped, geometry_msgs/msg/Polygon, "
        "geometry_msgs/msg/PolygonInstance, geometry_msgs/msg/PolygonInstanceStamped, "
        f"… (32 in all); {LOOKED}; or name its .msg file under 'messages'",
    ),
    (
        "publish:\n  - topic: a\n    type: Twist\n    fields: {}\n",
        "m.yaml:3: a: message type 'Twist' is not a type name; write pkg/msg/Name, such as "
        "sensor_msgs/msg/JointState",
    ),
    (
        OUT + "    fields: {}\n" + OUT.split("\n", 1)[1] + "    fields: {}\n",
        "m.yaml:5: publish.a: the topic is there twice (first m.yaml:2); merge the two or rename one",
    ),
    (
        OUT + "    rate: 0\n    fields: {}\n",
        "m.yaml:4: publish.a.rate is 0; write a number above 0 to 10000 [Hz], or null",
    ),
    (
        OUT + "    rate: fast\n    fields: {}\n",
        "m.yaml:4: publish.a.rate is 'fast'; write a number above 0 to 10000 [Hz] or null",
    ),
    (
        OUT + "    optional: maybe\n    fields: {}\n",
        "m.yaml:4: publish.a.optional is 'maybe'; write true or false",
    ),
    (
        IN + "    missing: skip\n    fields: {linear.x: x}\n",
        "m.yaml:4: subscribe.a.missing 'skip' is not known; known: error, hold, zero",
    ),
    (
        IN + "    on_timeout: stop\n    fields: {linear.x: x}\n",
        "m.yaml:4: subscribe.a.on_timeout 'stop' is not known; known: hold, unset, zero",
    ),
    (
        IN + "    timeout: -1\n    fields: {linear.x: x}\n",
        "m.yaml:4: subscribe.a.timeout is -1; write a number above 0 to 60 [s], or null",
    ),
    # quality of service
    (
        OUT + "    qos: sensors\n    fields: {}\n",
        "m.yaml:4: publish.a.qos is 'sensors'; write default or sensor_data or latest or latched or a mapping such as {reliability: reliable, depth: 10} or null",
    ),
    (
        OUT + "    qos: {reliability: best}\n    fields: {}\n",
        "m.yaml:4: publish.a.qos.reliability 'best' is not known; known: best_effort, reliable",
    ),
    (
        OUT + "    qos: {depth: 1.5}\n    fields: {}\n",
        "m.yaml:4: publish.a.qos.depth is 1.5; write a whole number from 1",
    ),
    (
        OUT + "    qos: {deep: 1}\n    fields: {}\n",
        "m.yaml:4: publish.a.qos: unknown key 'deep'; did you mean 'depth'? known: deadline, depth, durability, history, lifespan, liveliness, liveliness_lease, reliability",
    ),
    # fields
    (IN + "    fields: {}\n", "m.yaml:2: a: the entry writes no state; map a field to one"),
    (
        OUT + "    fields:\n      linear.q: x\n",
        "m.yaml:5: a: linear.q: geometry_msgs/msg/Vector3 has no field 'q'; known: x, y, z",
    ),
    (
        OUT + "    fields:\n      linear.x.y: x\n",
        "m.yaml:5: a: linear.x.y: x has no fields below it",
    ),
    (
        OUT + "    fields:\n      linear..x: x\n",
        "m.yaml:5: a: message path 'linear..x' does not parse; write it like header.stamp, "
        "axes[1], motor_state[:12].q or transforms[child_frame_id=base_link].transform",
    ),
    (
        OUT + "    fields:\n      linear[0]: x\n",
        "m.yaml:5: a: linear[0]: linear of geometry_msgs/msg/Twist is not an array; drop the [...]",
    ),
    (
        OUT + "    fields:\n      linear: a b\n",
        "m.yaml:5: a: 'a b' does not parse; write a state such as joint_pos, velocity_command[0] "
        "or joint_pos[3:6], a variable such as $joint_names, or a constant such as =base_link",
    ),
    (
        OUT + "    fields:\n      linear: a[3:2]\n",
        "m.yaml:5: a: [3:2] in 'a[3:2]' is an empty range; stop must exceed start",
    ),
    (
        OUT + "    fields:\n      linear: a[-1]\n",
        "m.yaml:5: a: [-1] in 'a[-1]' selects nothing; count from 0, as in [3] or [:12]",
    ),
    (
        OUT + "    fields:\n      linear[=a]: x\n",
        "m.yaml:5: a: [=a] in message path 'linear[=a]' selects nothing; write [3], [:12] or "
        "[field=text]",
    ),
    (
        "publish:\n  - topic: tf\n    type: tf2_msgs/msg/TFMessage\n    fields:\n"
        "      transforms.header: x\n",
        "m.yaml:5: tf: transforms.header: transforms of tf2_msgs/msg/TFMessage is an array; "
        "select elements, as in transforms[0] or transforms[:12]",
    ),
    (
        "publish:\n  - topic: tf\n    type: tf2_msgs/msg/TFMessage\n    fields:\n"
        "      transforms[child_frame_id=a].header.frame_id: =x\n",
        "m.yaml:5: tf: transforms[child_frame_id=a].header.frame_id: elements are selected by "
        "text in subscriptions only; use a number, as in transforms[0]",
    ),
    (
        "subscribe:\n  - topic: tf\n    type: tf2_msgs/msg/TFMessage\n    fields:\n"
        "      transforms[header=a].transform.translation: x\n",
        "m.yaml:5: tf: transforms[header=a].transform.translation: elements of transforms have no "
        "string field 'header' to select by",
    ),
    (
        "publish:\n  - topic: imu\n    type: sensor_msgs/msg/Imu\n    fields:\n"
        "      orientation_covariance[9]: x\n",
        "m.yaml:5: imu: orientation_covariance[9]: orientation_covariance of sensor_msgs/msg/Imu "
        "has at most 9 elements",
    ),
    (
        OUT + "    fields:\n      linear.x: {state: a, const: 1}\n",
        "m.yaml:5: publish.a.fields.linear.x: give either 'state' or 'const'",
    ),
    (
        OUT + "    fields:\n      linear.x: {state: a, factor: 1}\n",
        "m.yaml:5: publish.a.fields.linear.x: unknown key 'factor'; known: by, checksum, const, offset, quat, scale, sign, state, text, unit",
    ),
    (
        OUT + "    fields:\n      linear.x: {state: a, unit: degree}\n",
        "m.yaml:5: publish.a.fields.linear.x.unit 'degree' is not known; did you mean 'deg'? known: A, N, N*m, V, cm, deg, deg/s, g, kN, kg, km/h, m, m/s, m/s^2, mA, mN*m, mV, mm, mm/s, mrad, ms, ns, percent, rad, … (30 in all)",
    ),
    (
        OUT + "    fields:\n      linear.x: {state: a, scale: 0}\n",
        "m.yaml:5: publish.a.fields.linear.x.scale is 0; drop the field instead",
    ),
    (
        OUT + "    fields:\n      linear.x: {state: a, sign: 2}\n",
        "m.yaml:5: publish.a.fields.linear.x.sign is 2; write 1 or -1, and other factors as scale",
    ),
    (
        OUT + "    fields:\n      linear: {state: a, sign: [1, -1], scale: [1, 1, 1]}\n",
        "m.yaml:5: publish.a.fields.linear: sign has 2 entries, scale has 3; give equally many",
    ),
    (
        OUT + "    fields:\n      linear: {state: a, quat: wxyz_from_xyzw}\n",
        "m.yaml:5: a: linear: quat wxyz_from_xyzw is of subscriptions; write xyzw_from_wxyz",
    ),
    (
        OUT + "    fields:\n      linear.x: {state: a, by: name}\n",
        "m.yaml:5: a: linear.x: 'by' orders received arrays; publish with a $variable of names",
    ),
    (
        OUT + "    fields:\n      linear.x: {state: a, text: .2f}\n",
        "m.yaml:5: publish.a.fields.linear.x.text is '.2f', which has no fixed width; write one, as in 8.2f",
    ),
    (
        OUT + "    fields:\n      linear.x: {state: a, text: 8.2q}\n",
        "m.yaml:5: publish.a.fields.linear.x.text is '8.2q', which is not a format; write a width, as in 8.2f",
    ),
    (
        IN + "    fields:\n      linear.x: {state: a, text: 8.2f}\n",
        "m.yaml:5: a: linear.x: 'text' formats published strings; drop it",
    ),
    (
        OUT + "    fields:\n      linear.x: {checksum: crc8}\n",
        "m.yaml:5: publish.a.fields.linear.x.checksum is 'crc8'; write unitree, or null",
    ),
    (
        OUT + "    fields:\n      linear.x: {checksum: unitree, state: a}\n",
        "m.yaml:5: publish.a.fields.linear.x: a checksum is computed; drop 'state'",
    ),
    (
        IN + "    fields:\n      linear.x: {checksum: unitree}\n",
        "m.yaml:5: a: linear.x: checksums are written, not checked on receive; drop it",
    ),
    (
        IN + "    fields:\n      linear.x: $a\n",
        "m.yaml:5: a: linear.x: a variable in a subscription names the elements of an array and "
        "stands on an array of strings; write =text for a required text",
    ),
    (
        IN + "    fields:\n      linear.x: 1\n",
        "m.yaml:2: a: the entry writes no state; map a field to one",
    ),
    (
        STATE.replace("publish", "subscribe") + "      position: {state: p, by: names}\n",
        "m.yaml:5: js: position: by 'names' is not a mapped array of names; known: none",
    ),
    (
        OUT + "    fields: {true: a, 'true': b}\n",
        "m.yaml:4: publish.a.fields: unknown key true; write a path such as linear.x",
    ),
    (
        OUT + "    fields: {linear.x: a, 1: b}\n",
        "m.yaml:4: publish.a.fields: unknown key 1; write a path such as linear.x",
    ),
]


@pytest.mark.parametrize(("text", "message"), FILES, ids=[m[:60] for _, m in FILES])
def test_every_mistake_in_a_file_has_its_line(text: str, message: str) -> None:
    with pytest.raises(MapError) as caught:
        parse_map(text, name="m.yaml")
    assert str(caught.value) == message
    assert isinstance(caught.value, (MapFileError, MessageTypeError))
    assert isinstance(caught.value, UniconError)
    assert caught.value.where is not None
    assert str(caught.value) == f"{caught.value.where}: {caught.value.message}"


def test_all_mistakes_are_told_at_once_first_those_of_the_form() -> None:
    wrong = (
        OUT + "    rate: fast\n    qos: {depth: 0}\n    fields: {linear.x: {state: b, scale: 0}}\n"
    )
    with pytest.raises(MapFileError) as caught:
        parse_map(wrong + "trajectory: {topic: 3}\n", name="m.yaml")
    assert str(caught.value).splitlines() == [
        "message map m.yaml has 4 mistakes:",
        "  1. m.yaml:4: publish.a.rate is 'fast'; write a number above 0 to 10000 [Hz] or null",
        "  2. m.yaml:5: publish.a.qos.depth is 0; write a whole number from 1",
        "  3. m.yaml:6: publish.a.fields.linear.x.scale is 0; drop the field instead",
        "  4. m.yaml:7: trajectory.topic is 3; write a ROS name: words of letters, digits and '_' "
        "between slashes, like imu/data or null",
    ]
    wrong = OUT + "    fields:\n      linear[a=]: b\n      linear..x: x\n"
    with pytest.raises(MapError) as told:
        parse_map(
            wrong + "subscribe:\n  - {topic: b, type: Twist, fields: {x: y}}\n", name="m.yaml"
        )
    assert str(told.value).splitlines() == [
        "message map m.yaml has 3 mistakes:",
        "  1. m.yaml:5: a: linear[a=]: linear of geometry_msgs/msg/Twist is not an array; drop the "
        "[...]",
        "  2. m.yaml:6: a: message path 'linear..x' does not parse; write it like header.stamp, "
        "axes[1], motor_state[:12].q or transforms[child_frame_id=base_link].transform",
        "  3. m.yaml:8: b: message type 'Twist' is not a type name; write pkg/msg/Name, such as "
        "sensor_msgs/msg/JointState",
    ]


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    path = tmp_path / "no.yaml"
    with pytest.raises(MapFileError) as caught:
        load_map(path)
    told = f"{path}: cannot be read: No such file or directory; give a readable YAML file"
    assert str(caught.value) == told


STAMPS = {"t": np.zeros((), np.int64), "f": np.zeros(()), "b": np.zeros((), np.bool_)}
ARRAYS = STAMPS | {
    "three": np.zeros(3, np.float32),
    "four": np.zeros(4),
    "half": np.zeros(3, np.float16),
    "complex": np.zeros(3, complex),
    "big": np.zeros(3, ">f8"),
    "ragged": np.zeros((4, 4))[:3, :2],
    "six": np.zeros(6),
}
JS, ODOM = "sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry"
TWIST_TYPE, DIAG = "geometry_msgs/msg/Twist", "diagnostic_msgs/msg/DiagnosticArray"

PUBLISHED: list[tuple[str, dict[str, object], str]] = [
    (
        TWIST_TYPE,
        {"linear": "thre"},
        "linear: no state 'thre'; did you mean 'three'? known: b, big, complex, f, four, half, "
        "ragged, six, t, three; write =thre for the text",
    ),
    (
        TWIST_TYPE,
        {"linear": "four"},
        "linear takes 3 elements, four has 4; select them, as in four[:3]",
    ),
    (TWIST_TYPE, {"linear": "three[2:5]"}, "linear: three[2:5] is out of range; state 'three' has 3 elements"),
    (TWIST_TYPE, {"linear.x": "three[3]"}, "linear.x: three[3] is out of range; state 'three' has 3 elements"),
    (
        TWIST_TYPE,
        {"linear.x": "four[hip]"},
        "linear.x: state 'four' has no element names; use a number, as in four[0]",
    ),
    (
        TWIST_TYPE,
        {"linear.x": "six[hips]"},
        "linear.x: state 'six' has no element 'hips'; did you mean 'hip'? known: ankle, calf, "
        "hip, neck, thigh, waist",
    ),
    (
        TWIST_TYPE,
        {"linear": "half"},
        "linear: state 'half' has dtype float16; use bool, native integers, float32 or float64",
    ),
    (
        TWIST_TYPE,
        {"linear": "complex"},
        "linear: state 'complex' has dtype complex128; use bool, native integers, float32 or float64",
    ),
    (
        TWIST_TYPE,
        {"linear": "big"},
        "linear: state 'big' has dtype >f8; use bool, native integers, float32 or float64",
    ),
    (
        JS,
        {"position": "ragged"},
        "position: state 'ragged' with shape (3, 2) and strides (32, 8) is not one evenly spaced "
        "run; give a contiguous array",
    ),
    (
        JS,
        {"header.stamp": "f"},
        "header.stamp: builtin_interfaces/msg/Time takes integer nanoseconds, state 'f' has dtype "
        "float64; use an int64 state",
    ),
    (
        JS,
        {"header.stamp": 1.5},
        "header.stamp: builtin_interfaces/msg/Time takes integer nanoseconds, not 1.5",
    ),
    (
        JS,
        {"header.frame_id": "six"},
        "header.frame_id takes 1 element, six has 6; select them, as in six[:1]",
    ),
    (
        JS,
        {"header.frame_id": "f"},
        "header.frame_id: a string cannot hold state 'f'; write {state: f, text: 8.2f} for a "
        "number of fixed width, or =f for the word",
    ),
    (
        JS,
        {"name": "six"},
        "name: an array of strings cannot hold state 'six'; map the fields of its elements, as in "
        "name[0], or give a $variable",
    ),
    (JS, {"name": "$nam"}, "name: no variable $nam; did you mean 'names'? known: names, word; variables are given when the map is built"),
    (JS, {"position": "$word"}, "position is a sequence and takes a list, not 'word'; write [word]"),
    (JS, {"name": 3}, "name is a sequence and takes a list, not 3; write [3]"),
    (JS, {"position": "six", "position[2]": "f"}, "position[2]: already mapped by position; drop one of the two"),
    (JS, {"position[2]": "f", "position": "six"}, "position: already mapped by position[2]; drop one of the two"),
    (
        JS,
        {"header": "six"},
        "header: std_msgs/msg/Header holds more than numbers; map its fields, as in header.frame_id",
    ),
    (
        DIAG,
        {"status": "six"},
        "status: an array of diagnostic_msgs/msg/DiagnosticStatus cannot hold state 'six'; map the "
        "fields of its elements, as in status[0], or give a $variable",
    ),
    (DIAG, {"status[:].level": 1}, "status[:].level: an open range takes its end from a state; give a number after ':'"),
    (
        DIAG,
        {"status[0].level": "=WARM"},
        "status[0].level: 'WARM' is not a byte; did you mean 'WARN'? known: ERROR, OK, STALE, WARN",
    ),
    (DIAG, {"status[0].level": 256}, "status[0].level: 256 is not a byte; give an integer from 0 to 255"),
    (DIAG, {"status[0].level": 1.5}, "status[0].level: 1.5 is not a byte; give an integer from 0 to 255"),
    (DIAG, {"status": [1]}, "status: 1 cannot fill a diagnostic_msgs/msg/DiagnosticStatus; map the fields of its elements"),
    (TWIST_TYPE, {"linear": [1, 2]}, "linear takes 3 values, 2 are given"),
    (TWIST_TYPE, {"linear.x": "=fast"}, "linear.x: 'fast' is not a float64; no constant is named"),
    (JS, {"header.frame_id": "=a\0b"}, "header.frame_id: a string cannot hold a NUL character"),
    (ODOM, {"pose.covariance": "six"}, "pose.covariance takes 36 elements, six has 6; select them, as in six[:36]"),
    (ODOM, {"pose.pose.orientation": "three"}, "pose.pose.orientation: a quaternion has 4 elements, three has 3"),
    (TWIST_TYPE, {"linear.x": {"state": 0, "checksum": "unitree"}}, "linear.x: Unitree's checksum is a uint32 at the end of the message; geometry_msgs/msg/Twist ends in angular"),
    (JS, {"position": {"state": "six", "scale": (1.0, 2.0)}}, "position: scale has 2 entries for 6 elements; give one number or one per element"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "mapping", "message"), PUBLISHED)
def test_every_mistake_of_a_publish_entry(
    kind: str, mapping: dict[str, object], message: str
) -> None:
    variables = {"names": NAMES, "word": "word"}
    with pytest.raises((MapStateError, MessageTypeError)) as caught:
        Encoder.build(publish(kind, mapping), ARRAYS, {"six": NAMES}, variables)
    assert str(caught.value) == message


FROZEN = np.zeros(6)
FROZEN.flags.writeable = False
SUBSCRIBED: list[tuple[str, dict[str, object], str]] = [
    (JS, {"position": "none"}, "position: no state 'none'; known: b, big, complex, f, four, frozen, half, ragged, six, t, three; write =none for the text"),
    (JS, {"position": "frozen"}, "position: state 'frozen' is read-only; a subscription needs a writable array"),
    (JS, {"position": "six", "velocity": "six[2]"}, "velocity: six[2] is already written by position; drop one of the two"),
    (JS, {"name": "$word", "position": "six"}, "name: $word must be a list of names, not 'word'"),
    (JS, {"name": "$twice", "position": "six"}, "name: $twice holds 'a' twice; names must differ"),
    (JS, {"name": "$names", "position": "three"}, "position: three has 3 elements, $names names 6; give a state of that size, element names for it, or by: none"),
    (JS, {"header.stamp": "f"}, "header.stamp: a time is integer nanoseconds, state 'f' has dtype float64; use an int64 state"),
    (JS, {"header.frame_id": "f"}, "header.frame_id: text cannot be read into state 'f'; write =f to require the word"),
    (JS, {"name": ["a"], "position": "six"}, "name: a subscription can require the value of one number or text only; name it, as in header.frame_id"),
    (DIAG, {"status": "six"}, "status: an array of diagnostic_msgs/msg/DiagnosticStatus cannot fill state 'six'; map the fields of its elements, as in status[0]"),
    (TWIST_TYPE, {"linear": "four"}, "linear has 3 elements, four has 4; select them, as in four[:3]"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "mapping", "message"), SUBSCRIBED)
def test_every_mistake_of_a_subscribe_entry(
    kind: str, mapping: dict[str, object], message: str
) -> None:
    variables = {"names": NAMES, "word": "word", "twice": ["a", "b", "a"]}
    with pytest.raises((MapStateError, MessageTypeError)) as caught:
        Decoder.build(subscribe(kind, mapping), ARRAYS | {"frozen": FROZEN}, None, variables)
    assert str(caught.value) == message


def test_several_names_need_a_choice() -> None:
    store = type(JAZZY)("jazzy")
    store.register({"own_msgs/msg/Two": "string[] a\nstring[] b\nfloat64[] x\n"})
    given = {"names": NAMES}
    mapping: dict[str, object] = {"a": "$names", "b": "$names", "x": "six"}
    with pytest.raises(MapStateError) as caught:
        Decoder.build(subscribe("own_msgs/msg/Two", mapping, store), ARRAYS, None, given)
    assert str(caught.value) == (
        "x: several fields carry names (a, b); say which one orders it, as in {state: …, by: …}"
    )
    mapping["x"] = {"state": "six", "by": "b"}
    Decoder.build(subscribe("own_msgs/msg/Two", mapping, store), ARRAYS, None, given)


def test_an_open_range_over_a_fixed_array_ends_where_the_state_ends() -> None:
    path = "motor_state[:].q"
    Decoder.build(subscribe("unitree_hg/msg/LowState", {path: "six"}), ARRAYS)
    many = {"many": np.zeros(36)}
    with pytest.raises(MapStateError) as caught:
        Decoder.build(subscribe("unitree_hg/msg/LowState", {path: "many"}), many)
    assert str(caught.value) == (
        "motor_state[:].q has 35 elements, many has 36; select fewer, as in many[:3]"
    )


def test_errors_of_a_loaded_map_keep_their_line_when_built() -> None:
    mapping = parse_map(OUT + "    fields:\n      linear: six\n", name="m.yaml")
    with pytest.raises(MapStateError) as caught:
        Encoder.build(mapping.publish[0], ARRAYS)
    assert str(caught.value) == (
        "m.yaml:5: a: linear takes 3 elements, six has 6; select them, as in six[:3]"
    )
