"""Hands whose models are not among the assets: sticks and hinges where the vendors have them.

Figures of jefferzn2001/XhandControl xhandurdf/xhand_left/urdf/xhand_left.urdf (right: mirrored)
and of oymotion/rohand_urdf_ros2 urdf/rohand_left.urdf; what couples ROHand's links is a curve like
theirs, not theirs.
"""

from __future__ import annotations

from pathlib import Path

__all__ = ["HANDS", "rohand_model", "xhand_model"]

HANDS = (
    *("inspire_rh56_left", "inspire_rh56_right", "dex3_left", "dex3_right"),
    *("xhand1_left", "xhand1_right", "rohand_left", "rohand_right"),
)

_XHAND = (  # joint, parent, child, origin xyz, rpy, axis
    (
        "thumb_bend_joint",
        "link",
        "thumb_bend_link",
        (0.0095, -0.0228, 0.0305),
        (0, 0, 0),
        (0, 0, 1),
    ),
    (
        *("thumb_rota_joint1", "thumb_bend_link", "thumb_rota_link1"),
        *((0.0083177, -0.028599, -0.00178), (0, 0.2618, 0.0407), (-1, 0, 0)),
    ),
    (
        *("thumb_rota_joint2", "thumb_rota_link1", "thumb_rota_link2"),
        *((0, -0.0553, 0), (0, 0, 0), (-1, 0, 0)),
    ),
    ("", "thumb_rota_link2", "thumb_rota_tip", (0, -0.049988, 0), (0, 0, 0), (0, 0, 0)),
    (
        "index_bend_joint",
        "link",
        "index_bend_link",
        (0.0065, -0.0265, 0.0899),
        (0, 0, 0),
        (1, 0, 0),
    ),
    ("index_joint1", "index_bend_link", "index_rota_link1", (0, 0, 0.0178), (0, 0, 0), (0, 1, 0)),
    ("index_joint2", "index_rota_link1", "index_rota_link2", (0, 0, 0.0558), (0, 0, 0), (0, 1, 0)),
    ("", "index_rota_link2", "index_rota_tip", (0, 0, 0.042248), (0, 0, 0), (0, 0, 0)),
    *(
        row
        for finger, y, z in (
            ("mid", -0.004, 0.1082),
            ("ring", 0.016, 0.1052),
            ("pinky", 0.036, 0.1022),
        )
        for row in (
            (f"{finger}_joint1", "link", f"{finger}_link1", (0.0065, y, z), (0, 0, 0), (0, 1, 0)),
            (
                f"{finger}_joint2",
                f"{finger}_link1",
                f"{finger}_link2",
                (0, 0, 0.0558),
                (0, 0, 0),
                (0, 1, 0),
            ),
            ("", f"{finger}_link2", f"{finger}_tip", (0, 0, 0.042248), (0, 0, 0), (0, 0, 0)),
        )
    ),
)
_INERTIAL = (
    '<inertial><mass value="0.01"/><inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" '
    'iyz="0"/></inertial>'
)


def xhand_model(folder: Path, side: str) -> Path:
    """Write a URDF with the joints of an XHand1 and return its path."""
    m = 1.0 if side == "left" else -1.0

    def name(part: str) -> str:
        return f"{side}_hand_{part}"

    def text(vector: tuple[float, ...]) -> str:
        return " ".join(f"{x:.9g}" for x in vector)

    rows = [f'<link name="{name("link")}">{_INERTIAL}</link>']
    for joint, parent, child, (x, y, z), (roll, pitch, yaw), (ax, ay, az) in _XHAND:
        rows.append(f'<link name="{name(child)}">{_INERTIAL}</link>')
        kind = "revolute" if joint else "fixed"
        # A mirror in y: places with y turned over; turns about y the same, others backwards.
        rows.append(
            f'<joint name="{name(joint or child + "_joint")}" type="{kind}">'
            f'<parent link="{name(parent)}"/><child link="{name(child)}"/>'
            f'<origin xyz="{text((x, m * y, z))}" rpy="{text((m * roll, pitch, m * yaw))}"/>'
            + (f'<axis xyz="{text((m * ax, ay, m * az))}"/>' if joint else "")
            + ('<limit lower="-1" upper="2" effort="1" velocity="9"/>' if joint else "")
            + "</joint>"
        )
    path = folder / f"xhand_{side}.urdf"
    path.write_text(f'<robot name="xhand_{side}">{"".join(rows)}</robot>', "utf-8")
    return path


_FINGERS = (  # name, where it begins, to its distal joint, angle of the register at the pose drawn
    ("if", (-0.11269, 0.030668, -0.0011639), (-0.03406, 0.0, -0.011405), 2.8069),
    ("mf", (-0.11597, 0.010472, 0.0031442), (-0.038293, 0.0, -0.014673), 2.7765),
    ("rf", (-0.1131, -0.0097, 0.0024), (-0.033643, 0.0, -0.012583), 2.7806),
    ("lf", (-0.10947, -0.029635, -0.00016701), (-0.029737, 0.0, -0.011632), 2.7543),
)


def rohand_model(folder: Path, side: str) -> Path:
    """Write an MJCF of a ROHand whose joints count as its registers do, and return its path."""
    m = 1.0 if side == "left" else -1.0
    bodies, couplings = [], []
    shape = '<geom type="sphere" size="0.004" mass="0.005"/>'
    for finger, (x, y, z), (dx, dy, dz), drawn in _FINGERS:
        bodies.append(
            f'<body name="{finger}_proximal_link" pos="{x} {m * y} {z}">{shape}'
            f'<joint name="{finger}_proximal_link" axis="0 1 0" ref="{drawn}"/>'
            f'<body name="{finger}_distal_link" pos="{dx} {m * dy} {dz}">{shape}'
            f'<joint name="{finger}_distal_link" axis="0 1 0"/></body></body>'
        )
        couplings.append((f"{finger}_distal_link", f"{finger}_proximal_link", "0 1.1 0.15 0 0"))
    bodies.append(
        f'<body name="th_root_link" pos="-0.046082 {m * 0.019841} -0.026844">{shape}'
        f'<joint name="th_root_link" axis="{-m} 0 0"/>'
        f'<body name="th_proximal_link" pos="-0.0067545 {m * 0.02098} -0.0027">{shape}'
        f'<joint name="th_proximal_link" axis="0 0 {-m}" ref="0.42431"/>'
        f'<body name="th_distal_link" pos="-0.050881 {m * 0.013011} -0.0020153">{shape}'
        f'<joint name="th_distal_link" axis="0 0 {-m}"/></body></body></body>'
    )
    couplings.append(("th_distal_link", "th_proximal_link", "0 0.8 -0.2 0.05 0"))
    path = folder / f"rohand_{side}.xml"
    rows = "".join(
        f'<joint joint1="{one}" joint2="{other}" polycoef="{curve}"/>'
        for one, other, curve in couplings
    )
    path.write_text(
        f'<mujoco><compiler angle="radian"/><worldbody><body name="base_link">{shape}'
        f"{''.join(bodies)}</body></worldbody><equality>{rows}</equality></mujoco>",
        "utf-8",
    )
    return path
