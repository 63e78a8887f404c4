"""ROS messages from and to NumPy arrays, by a mapping file; for bridges, recorders and replays.

Knows message definitions (through rosbags) and CDR bytes; needs no ROS installation and knows
neither nodes nor blocks. A mapping is compiled once against arrays; then a message is one call.

    from unicon_msgs_map import Decoder, Encoder, load_map

    arrays = {"joint_pos": np.zeros(12, np.float32), "stamp_ns": np.zeros((), np.int64), …}
    names = {"joint_pos": ("FR_hip_joint", …)}                # optional, element names per array
    variables = {"joint_names": ["FR_hip_joint", …]}          # values of $joint_names in the file

    mapping = load_map("config/maps/default.yaml")            # MessageMap: .publish, .subscribe
    for spec in mapping.publish:                              # .topic .type .rate .qos .optional
        encoder = Encoder.build(spec, arrays, names, variables)
        raw = encoder.encode()                                # bytes: publish, record, stream them
    for spec in mapping.subscribe:                            # … .timeout .on_timeout
        decoder = Decoder.build(spec, arrays, names, variables)
        decoder.decode(raw)                                   # True: states written; False: refused
        decoder.received, decoder.rejected, decoder.last_error, decoder.stamp_ns
        decoder.lapse()                                       # what a time-out does

    message_definition("sensor_msgs/msg/JointState").text     # with .rihs and .md5, for MCAP

`encode` and `decode` raise nothing; all that can be wrong is said when a file is loaded
(`MapFileError`, `MessageTypeError`) or a mapping is built (`MapStateError`). `spec.states` names
the arrays that a topic needs; where `spec.optional` is set, leave out a topic whose build raises
`MapStateError` because its states are not there.

The mapping file
----------------
    schema: unicon.map/1                # optional
    include: default                    # optional; names or paths of maps to begin with
    typestore: jazzy                    # optional; ROS distribution of the common interfaces
    messages: [my_msgs/msg]             # optional; .msg files or folders, or package://my_msgs/msg
    publish:
      - topic: joint_states             # relative: namespaces and remaps work
        type: sensor_msgs/msg/JointState
        rate: 100                       # Hz; default every tick
        qos: {reliability: reliable, depth: 10}   # or default, sensor_data, latest, latched
        optional: true                  # leave out where a state or the ROS type is missing
        fields: {header.stamp: stamp_ns, header.frame_id: =base_link, name: $joint_names,
                 position: joint_pos}
    subscribe:
      - topic: cmd_vel
        type: geometry_msgs/msg/Twist
        timeout: 0.5                    # s without a message, then
        on_timeout: zero                # zero (default), hold, or unset: NaN
        missing: hold                   # our elements that it lacks: hold, zero or error
        extra: ignore                   # its elements that we lack: ignore or error
        unnamed: error                  # no names where they are mapped: error, or order
        nonfinite: reject               # NaN and infinities: reject or accept
        fields: {linear.x: velocity_command[0], angular.z: velocity_command[2]}

An entry whose topic an included map has changes that one: keys that are given count, `fields` one
by one (an empty value removes it), `remove: true` removes the entry, another `type` replaces it.
Types of installed packages (`share/PACKAGE/msg/NAME.msg`) need no `messages:`.

Message side: `header.stamp`, `axes[1]`, `motor_state[:12].q`, `points[0].positions`, and in
subscriptions `transforms[child_frame_id=base_link].transform`. Our side: a state (`joint_pos`,
`joint_pos[3:6]`, `joint_pos[FR_hip_joint]`), a `$variable`, or a constant: `=text`, or a YAML
number, boolean or list; `=NAME` is the message's own constant NAME where it has one. A Vector3,
Point or Quaternion takes a whole state. Fields that are not mapped are zero, empty, and the
identity for a Quaternion. In a subscription a constant is **required**: a message with another
value is refused.

A mapping instead of a word converts, `value × unit × scale + offset`, per element:
`{state: joint_pos, unit: deg, scale: 2, sign: [1, -1], offset: 0.1}`; `unit` names the message's
unit (`unicon_msgs_map.spec`). **Quaternions are wxyz in states, xyzw in messages.** A
geometry_msgs/Quaternion is converted by itself; elsewhere, such as a plain `float64[4]`, say
`quat: xyzw_from_wxyz` (publish) or `quat: wxyz_from_xyzw` (subscribe); `quat: none` switches the
automatic conversion off. This happens here and nowhere else. Times are int64 ns in states and
become sec and nanosec. `{state: battery_soc, text: 8.2f}` prints a number into a string field;
`{checksum: unitree}` on the last field is the CRC that Unitree's motors want.

On receive, a `$variable` on an array of strings (`name: $joint_names`) orders every whole
sequence of the entry by name; `{state: …, by: none}` takes one by position.
"""

from unicon_msgs_map.codec.decoder import Decoder
from unicon_msgs_map.codec.encoder import Encoder
from unicon_msgs_map.errors import (
    MapDependencyError,
    MapError,
    MapFileError,
    MapStateError,
    MessageTypeError,
)
from unicon_msgs_map.layout.messages import MessageDefinition, Messages, message_definition
from unicon_msgs_map.mapfile.load import load_map, parse_map
from unicon_msgs_map.spec import (
    FieldSpec,
    MessageMap,
    PublishSpec,
    Qos,
    SubscribeSpec,
    TrajectorySpec,
)

__all__ = [
    "Decoder",
    "Encoder",
    "FieldSpec",
    "MapDependencyError",
    "MapError",
    "MapFileError",
    "MapStateError",
    "MessageDefinition",
    "MessageMap",
    "MessageTypeError",
    "Messages",
    "PublishSpec",
    "Qos",
    "SubscribeSpec",
    "TrajectorySpec",
    "load_map",
    "message_definition",
    "parse_map",
]
