"""Robot files and overlays: what they say, as classes that `unicon_base.schema` reads.

A file whose `manufacturer` is given describes a vendor's robot: every fact has a source, and what
was not found is null and named in `unknown`. A robot of one's own needs neither.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Annotated, Any, Literal, get_args

from unicon_base.schema.marks import (
    Checked,
    Like,
    Name,
    NotEmpty,
    Point,
    Quat,
    Text,
    Unit,
    Within,
    Write,
    positive,
)
from unicon_base.schema.records import largest, record_of
from unicon_base.schema.types import Here
from unicon_core.bounds import BUTTONS, EFFORT, POSITION, Button, Damping, Speed, Stiffness
from unicon_core.robots.file_rules import (
    joints_of,
    note_contacts,
    note_groups,
    note_joints_once,
    note_sources,
    note_unknown,
)
from unicon_core.robots.robot import JOINT_ORDER, Capsules, Hand, Places

SCHEMA = "unicon.robot/1"
Kind = Literal["quadruped", "humanoid", "wheeled", "hand", "arm"]
KINDS: tuple[str, ...] = get_args(Kind)

Angle = Annotated[float, Within(-POSITION, POSITION, "rad")]
Limit = Annotated[float, Unit("rad"), Within(-POSITION, POSITION, endless=True)]


@dataclass(frozen=True, eq=False, repr=False)
class Joint:
    """A joint: figures in SI units, for sliding joints [m] and [N]; null where not known.

    Attributes:
        name: as in URDF, TF and joint states.
        lower: smallest allowed position; -.inf of a wheel.
        upper: largest allowed position; .inf of a wheel.
        velocity: largest allowed speed.
        effort: largest allowed torque.
        default: position of the standing pose.
        stiffness: default proportional gain.
        damping: default derivative gain.
        rest: position of the lying or powered-off pose.
    """

    name: Name
    lower: Limit | None
    upper: Limit | None
    velocity: Speed | None
    effort: Annotated[float | None, positive(EFFORT, "N·m")]
    default: Angle | None
    stiffness: Stiffness | None
    damping: Damping | None
    rest: Angle | None = None

    @staticmethod
    def between(found: dict[str, Any], here: Here) -> None:
        """Note limits the wrong way round, and poses beyond them."""
        lower, upper = found.get("lower"), found.get("upper")
        lowest = -math.inf if lower is None else lower
        highest = math.inf if upper is None else upper
        if lowest >= highest:
            text = f"is {lower}, which is not below upper {upper}; swap or correct them"
            here.value(text, "lower")
            return
        for key, limit, other in (("lower", lower, upper), ("upper", upper, lower)):
            if limit is not None and math.isinf(limit) and (other is None or math.isfinite(other)):
                text = "is endless; a wheel has lower: -.inf and upper: .inf, write null if unknown"
                here.value(text, key)
        for key in ("default", "rest"):
            if found.get(key) is not None and not lowest <= found[key] <= highest:
                here.value(
                    f"is {found[key]}, outside its limits [{lower}, {upper}]; correct the pose or "
                    "the limits",
                    key,
                )


def joint_bounds() -> dict[str, float]:
    """Return key to the largest plausible size of a joint's figure in SI units; inf of names."""
    return {key: largest(field.type) for key, field in record_of(Joint).fields.items()}


@dataclass(frozen=True, eq=False, repr=False)
class ImuFacts:
    """The inertial sensor and its pose in the base frame.

    Attributes:
        frame: name of the sensor's frame.
        position: in the base frame in [m].
        quat: rotation sensor to base, unit quaternion wxyz.
    """

    frame: Name
    position: Point | None
    quat: Quat | None


def _wrong_path(path: str) -> str:
    pure = PurePath(path.removeprefix("assets:"))
    if pure.is_absolute() or ".." in pure.parts or path.startswith("~"):
        return (
            f"is {path!r}, which leads out of its folder; put it beside the robot file, or let the "
            "workflow name it: scene: {model: PATH}"
        )
    return ""


def _wrong_format(key: str) -> Checked:
    def wrong(path: str) -> str:
        suffix = PurePath(path).suffix.lower()
        if suffix and (suffix == ".urdf") != (key == "urdf"):
            other = "mjcf" if key == "urdf" else "urdf"
            return f"is {path!r}, which does not look so; write {other}: …"
        return ""

    return Checked(wrong)


@dataclass(frozen=True, eq=False, repr=False)
class Models:
    """Models by format: relative to a configuration root, `assets:PATH` or robot_descriptions:NAME.

    Attributes:
        mjcf: model of MuJoCo.
        urdf: model as URDF.
    """

    mjcf: Annotated[Text, Checked(_wrong_path), _wrong_format("mjcf")] = ""
    urdf: Annotated[Text, Checked(_wrong_path), _wrong_format("urdf")] = ""


@dataclass(frozen=True, eq=False, repr=False)
class Transport:
    """The platform adapter and its facts; vendors' keys beside these.

    Attributes:
        protocol: names the adapter.
        command: `position` where the vendor closes the loop, so that there are no gains.
        stop_buttons: of its remote, held together.
        motors: motor number of each joint, in the order of joints.
        rate_hz: frames per second.
    """

    protocol: Text | None
    command: Literal["position", "torque"] = "torque"
    stop_buttons: Annotated[
        list[Button] | None, NotEmpty, Write(f"a list of {', '.join(BUTTONS)}")
    ] = None
    motors: Annotated[
        list[Annotated[int, Within(0)]] | None, Write("the motor number of each joint")
    ] = None
    rate_hz: Annotated[float | None, positive(unit="Hz")] = None

    @staticmethod
    def between(found: dict[str, Any], here: Here) -> None:
        """Note figures that are NaN or infinite, however deep: they would go to the motors."""
        value = here.document
        for key in here.where:
            value = value[key]
        for where, number in _numbers(value):
            if not math.isfinite(number) and where[0] not in Transport.__dataclass_fields__:
                here.value(f"is {number}; write a number or null", *where)


def _numbers(value: Any, *where: Any) -> list[tuple[tuple[Any, ...], float]]:
    if isinstance(value, float):
        return [(where, value)]
    pairs: Any = value.items() if isinstance(value, Mapping) else ()
    pairs = enumerate(value) if isinstance(value, list) else pairs
    return [found for key, below in pairs for found in _numbers(below, *where, key)]


@dataclass(frozen=True, eq=False, repr=False)
class Figures:
    """What a simulator is told of a joint. Known motors have strengths of 0.5 to 1.2, friction up
    to 10 N·m, armatures up to 0.2 kg·m² and delays up to 0.05 s.

    Attributes:
        strength: factor on the torque that the motor gives, and on its limit.
        friction: torque of dry friction, in both directions.
        armature: inertia of the rotor, seen from the joint.
        delay: by which commands reach the motor late, in whole physics steps.
    """

    strength: Annotated[float, Within(0.0, 5.0)] = 1.0
    friction: Annotated[float, Within(0.0, EFFORT, "N·m")] = 0.0
    armature: Annotated[float, Within(0.0, 10.0, "kg·m²")] = 0.0
    delay: Annotated[float, Within(0.0, 1.0, "s")] = 0.0


Simulated = Annotated[
    Mapping[
        str, Annotated[Mapping[str, float], Like(Figures), Write("{strength: 0.8, friction: 0.3}")]
    ],
    Write("{JOINT: {strength: 0.8, friction: 0.3}}"),
]
"""Joint or pattern to figures."""


def _wrong_range(pair: Any) -> str:
    good = pair[0] <= 0.0 <= pair[1]
    return "" if good else f"is {list(pair)}; write [lowest, highest] with 0 between them"


Range = Annotated[
    tuple[float, float], Checked(_wrong_range), Write("[lowest, highest] with 0 between them")
]
Contacts = Annotated[list[Text], Write("a list of names")]
Group = Annotated[list[Text], NotEmpty, Write("a list of joints or patterns")]


@dataclass(frozen=True, eq=False, repr=False)
class RobotFile:
    """Facts about a robot.

    Attributes:
        schema: version of the format.
        name: the file's name without .yaml.
        kind: what it is.
        models: models by format, {} where there is none.
        base_frame: frame of the base, in which the IMU's pose is given.
        joints: the joints in the vendor's motor order.
        manufacturer: of a vendor's robot, whose facts all have sources.
        description: one line.
        imu: the inertial sensor, null where there is none.
        transport: the platform adapter and its facts.
        sources: group of facts to where it was taken from.
        unknown: facts that were not found, such as joints.velocity.
        feet: bodies, sites or geoms that touch the ground, of robots that walk.
        fingertips: bodies, sites or geoms of a hand.
        command_ranges: vx, vy [m/s] and wz [rad/s] to the lowest and highest command it may get.
        groups: joints by what they are part of: names or patterns with * and ?.
        mounts: where it carries hands: name of a member or of its robot to the place.
        end_effectors: frames that are brought to a target.
        capsules: what its links are to `reach`, which keeps them apart.
        hand: which part of it is which of a human hand.
        simulated: what simulators alone are told of joints.
    """

    schema: Literal["unicon.robot/1"]
    name: Text
    kind: Kind
    models: Annotated[
        Mapping[str, str], Like(Models), Write("{mjcf: PATH, urdf: PATH}, {} where there is none")
    ]
    base_frame: Name
    joints: Annotated[list[Joint], NotEmpty, Write("a list that names each joint in motor order")]
    manufacturer: Text | None = None
    description: Text = ""
    imu: Annotated[ImuFacts | None, Write("{frame: …, position: …, quat: …}")] = None
    transport: Annotated[
        Mapping[str, Any] | None, Like(Transport, open=True), Write("{protocol: …, …}")
    ] = None
    sources: Annotated[dict[str, Text], Write("one entry per group of facts")] = field(
        default_factory=dict
    )
    unknown: Annotated[list[str] | None, Write("a list of facts")] = None
    feet: Contacts = field(default_factory=list)
    fingertips: Contacts = field(default_factory=list)
    command_ranges: Mapping[Literal["vx", "vy", "wz"], Range] | None = None
    groups: Annotated[dict[str, Group] | None, Write('{legs: ["*_hip_*", "*_knee_*"], …}')] = None
    mounts: Places | None = None
    end_effectors: Places | None = None
    capsules: Capsules | None = None
    hand: Annotated[
        Hand | None,
        Write("{side: left, palm: {body: …, quat: […]}, fingers: {thumb: {body: …}, …}}"),
    ] = None
    simulated: Simulated | None = None

    remedies = {"joint_order": JOINT_ORDER}  # noqa: RUF012

    @staticmethod
    def between(found: dict[str, Any], here: Here) -> None:
        """Note what lies between keys: names that stand twice, contacts, sources and unknowns."""
        document = here.document
        note_joints_once(document, here)
        if found.get("kind"):
            note_contacts(found["kind"], document, here)
        note_groups(found.get("groups") or {}, document, here)
        note_unknown(document, here)
        if document.get("manufacturer") is not None:
            note_sources(document, here)
            for i, joint in enumerate(joints_of(document)):
                if "rest" not in joint:
                    here.note(
                        "joints: missing key 'rest'; add it, null where not known", "joints", i
                    )


@dataclass(frozen=True, eq=False, repr=False)
class Overlay:
    """What a file says beside another robot file.

    Attributes:
        schema: version of the format.
        extends: name or path of the robot file.
        simulated: what simulators alone are told of joints.
        description: one line.
    """

    schema: Literal["unicon.robot/1"]
    extends: Text
    simulated: Simulated
    description: Text | None = None
