"""C++ twins of blocks: what a block's tick does, statement by statement in the same types.

A twin is exact by construction: additions, products, quotients, comparisons, the larger and the
smaller of two numbers, in the order and the types of NumPy's operations (a Python float beside a
float32 array counts as float32); sines and cosines only where Python takes them of `math`, which
calls the same library. In a text `$path` is an attribute of the block, `#path` its number of
elements; `each(n)` loops over i; `BAIL` runs the Python twin of this tick instead, and stands
before anything is written: it is a fault, or with `PYTHON` what C++ does not do, or with `WARN` a
warning besides what follows in C++. `DONE(x)` returns whether the block is done.

A twin belongs to the function of this package that it repeats, not to a class: a subclass that
overrides one of them is called back.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from unicon_core.blocks.postures import LONGEST
from unicon_core.native.operands import NotNative

Twin: TypeAlias = str | Callable[[Any], str]

GAINS = "joint_stiffness", "joint_damping"


def _gains(gains: Any, path: str = "gains") -> str:
    if gains is None:
        return ""
    return "".join(
        f"each(#{path}.{k}) $_command.{name}[i] = ${path}.{k}[i];\n" for k, name in enumerate(GAINS)
    )


_ENTRY = (
    "($_command.joint_stiffness[i] > 0.0f ? $_command.joint_pos_target[i] : $_command.joint_pos[i])"
)
_STILL = "".join(
    f"each(#_command.{name}) $_command.{name}[i] = 0.0f;\n"
    for name in ("joint_vel_target", "joint_effort_ff")
)


def _pose(pose: Any) -> str:
    first = "".join(f"each(#_fades.{k}.0) $_fades.{k}.1[i] = $_fades.{k}.0[i];\n" for k in (0, 1))
    faded = "".join(
        f"""each(#_fades.{k}.0) {{
          if (faded == 1.0) {{ $_fades.{k}.0[i] = $_fades.{k}.2[i]; continue; }}
          float x = $_fades.{k}.2[i] - $_fades.{k}.1[i];
          x = x * (float)faded;
          $_fades.{k}.0[i] = x + $_fades.{k}.1[i];
        }}
        """
        for k in (0, 1)
    )
    return f"""
    if ($_tick == 0) {{
      float farthest = 0.0f;
      each(#_start) {{
        $_start[i] = {_ENTRY};
        float way = $_goal[i] - $_start[i];
        $_way[i] = way * $_said[i];
        farthest = greater(farthest, magnitude($_way[i]));
      }}
      if (finite(farthest)) {{
        double ticks = __builtin_ceil(smaller((double)farthest * $_ticks_per_rad, {LONGEST!r}));
        $_ticks = larger($_asked, (int64_t)ticks);
      }}
      {first}
    }}
    $_tick += 1;
    bool done = $_tick >= $_ticks;
    double angle = 3.141592653589793 * (double)$_tick / (double)$_ticks;
    double share = done ? 1.0 : 0.5 - 0.5 * __builtin_cos(angle);
    each(#_way) {{
      float x = $_way[i] * (float)share;
      $_command.joint_pos_target[i] = x + $_start[i];
    }}
    {_STILL}
    double faded = smaller((double)$_tick / (double)$_fade_ticks, 1.0);
    {faded}
    DONE(done);
    """


def _hold(hold: Any) -> str:
    return f"""
    if ($_tick == 0) each(#_held) $_held[i] = {_ENTRY};
    $_tick += 1;
    each(#_held) $_command.joint_pos_target[i] = $_held[i];
    {_STILL}{_gains(hold.gains)}
    DONE($_tick >= $_ticks);
    """


_DAMP = f"""
    each(#_gain) {{
      $_command.joint_pos_target[i] = $_command.joint_pos[i];
      $_command.joint_stiffness[i] = 0.0f;
      $_command.joint_damping[i] = $_gain[i];
    }}
    {_STILL}
    $_tick += 1;
    DONE($_tick >= $_ticks);
    """


def _velocity_command(block: Any) -> str:
    write = "$_out[i] = wanted;"
    if block._step is not None:
        write = """
        float change = wanted - $_out[i];
        $_out[i] = $_out[i] + lesser(greater(change, -$_step[i]), $_step[i]);
        """
        if not np.ndim(block._step):
            write = write.replace("$_step[i]", "$_step")
    return f"""
    while ($_row + 1 < #_starts && $_tick >= $_starts[$_row + 1]) $_row += 1;
    each(3) {{
      float wanted = $_row >= 0 ? $_values[3 * $_row + i] : 0.0f;
      {write}
    }}
    $_tick += 1;
    DONE($_tick >= $_ticks);
    """


def _finite(block: Any) -> str:
    return "".join(
        f"each(#_flat.{k}) if (!finite($_flat.{k}[i])) BAIL;\n" for k in range(len(block._flat))
    )


def _fade_in(block: Any) -> str:
    return (
        "if ($_tick < $_ticks) {\n$_tick += 1;\n"
        "float share = (float)((double)$_tick / (double)$_ticks);\n"
        + "".join(
            f"""each(#_views.{k}.0) {{
              if ($_views.{k}.0[i] != $_views.{k}.2[i]) $_views.{k}.1[i] = $_views.{k}.0[i];
              $_views.{k}.0[i] = $_views.{k}.1[i] * share;
              $_views.{k}.2[i] = $_views.{k}.0[i];
            }}
            """
            for k in range(len(block._views))
        )
        + "}"
    )


def _blend_in(block: Any) -> str:
    mixed = "".join(
        f"""each(#_live.{k}) {{
          if ($_live.{k}[i] != $_mixed.{k}[i]) $_own.{k}[i] = $_live.{k}[i];
          float x = $_own.{k}[i] - $_held.{k}[i];
          x = x * share;
          $_live.{k}[i] = x + $_held.{k}[i];
          $_mixed.{k}[i] = $_live.{k}[i];
        }}
        """
        for k in range(len(block._live))
    )
    return f"""
    if ($_tick >= $_ticks) return 0;
    if ($_tick == 0) PYTHON;
    $_tick += 1;
    float share = (float)((double)$_tick / (double)($_ticks + 1));
    {mixed}
    """


def _remote_stop(block: Any) -> str:
    pressed = " && ".join(f"$_buttons[{place}]" for place in block._places)
    return f"if (!({pressed})) $_ticks = 0; else if ($_ticks + 1 >= 2) BAIL; else $_ticks += 1;"


def _button_stop(block: Any) -> str:
    pressed = " || ".join(f"$_buttons[{place}]" for place in block._places)
    return f"""
    int64_t silent = $_alive[0] ? 0 : $_silent + 1;
    if ({pressed} || silent > $_lost) BAIL;
    $_silent = silent;
    """


def _drive(block: Any) -> str:
    hand = "" if block._held is None else "$_buttons[$_held] && "
    axes = "".join(
        f"$_out[{element}] = (float)($_axes.{element}.1 * steady($_sticks[{axis}], $_dead_zone));\n"
        for element, (axis, _) in enumerate(block._axes)
    )
    return f"if (!({hand}$_alive[0])) {{ each(3) $_out[i] = 0.0f; return 0; }}\n{axes}"


def _forward_command(block: Any) -> str:
    if block._tolerance < np.inf:
        raise NotNative("a start_tolerance")
    home = ""
    if block._home is not None:
        home = """
        bool goes = true;
        each(#_places) {
          int64_t p = $_places[i];
          float v = $_commanded.joint_vel_command[p], f = $_commanded.joint_effort_command[p];
          goes &= $_silent[p] && v != v && f != f;
        }
        each(#held) {
          $_steps[i] = goes ? $_home.1[i] : $_step[i];
          if (goes) { $_wanted[i] = $_home.0[i]; $_silent[i] = 0; }
        }
        """
    integral = ""
    if block._share:
        integral = """
        each(#held) {
          float more = $held[i] - $_command.joint_pos[i];
          $_offset[i] = $_offset[i] + more * $_share;
          $_offset[i] = lesser(greater($_offset[i], -0.25f), 0.25f);
        }
        each(#_places) {
          int64_t p = $_places[i];
          $_command.joint_pos_target[p] = $_command.joint_pos_target[p] + $_offset[p];
        }
        """
    fed = "".join(
        f"""float said{k} = $_commanded.{said}[p];
        if (said{k} != said{k}) said{k} = 0.0f;
        $_command.{out}[p] = greater(lesser(said{k}, ${most}[p]), -${most}[p]);
        """
        for k, (said, most, out) in enumerate(
            (
                ("joint_vel_command", "max_rate", "joint_vel_target"),
                ("joint_effort_command", "_effort", "joint_effort_ff"),
            )
        )
    )
    return f"""
    if ($ticks == 0) each(#held) {{ $held[i] = {_ENTRY}; $_offset[i] = 0.0f; }}
    $ticks += 1;
    each(#held) {{
      $_wanted[i] = $_commanded.joint_pos_command[i];
      $_silent[i] = $_wanted[i] != $_wanted[i];
      if ($_silent[i]) $_wanted[i] = $held[i];
    }}
    {home}
    each(#held) {{
      float wanted = lesser(greater($_wanted[i], $_lower[i]), $_upper[i]);
      if ($_silent[i]) wanted = $held[i];
      $held[i] = lesser(greater(wanted, $held[i] - $_steps[i]), $held[i] + $_steps[i]);
    }}
    each(#_places) $_command.joint_pos_target[$_places[i]] = $held[$_places[i]];
    {integral}
    each(#_places) {{
      int64_t p = $_places[i];
      {fed}
      $_command.joint_stiffness[p] = $gains.0[p];
      $_command.joint_damping[p] = $gains.1[p];
    }}
    DONE($ticks >= $_ends);
    """


_TORQUE = """
      float rest = $_servo.joint_vel_target[i] - $_servo.joint_vel[i];
      rest = rest * $_servo.joint_damping[i];
      float torque = $_servo.joint_pos_target[i] - $_servo.joint_pos[i];
      torque = torque * $_servo.joint_stiffness[i];
      torque = torque + rest;
      torque = torque + $_servo.joint_effort_ff[i];
      float clipped = lesser(greater(torque, $_lower[i]), $_upper[i]);
"""
_RATE = """
    each(#_target) {{
      float last = $_fresh ? $_pos[i] : $_last[i];
      {act}
    }}
    $_fresh = 0;
    each(#_target) $_last[i] = $_target[i];
"""

TWINS: dict[tuple[str, ...], Twin] = {
    ("blocks.postures:Pose.__call__", "blocks.postures:Pose._write_gains"): _pose,
    ("blocks.postures:Hold.__call__",): _hold,
    ("blocks.postures:Damp.__call__",): _DAMP,
    ("blocks.velocity_command:VelocityCommand.__call__",): _velocity_command,
    (
        "workflow.program_data:CommandBounds.__call__",
        "workflow.program_data:CommandBounds.within",
    ): """
    double x = $_first[0], y = $_first[1], z = $_first[2];
    if (!($_x0 <= x && x <= $_x1 && $_y0 <= y && y <= $_y1 && $_z0 <= z && z <= $_z1)) {
      WARN;
      bool clips = finite(x) && finite(y) && finite(z);
      each(3) $_first[i] = clips ? lesser(greater($_first[i], $_low[i]), $_high[i]) : 0.0f;
    }
    """,
    ("blocks.velocity_command:Drive.__call__", "blocks.velocity_command:Drive._steady"): _drive,
    (
        "blocks.forward_command:ForwardCommand.__call__",
        "blocks.forward_command:ForwardCommand._head_home",
        "blocks.forward_command:ForwardCommand._feed_forward",
    ): _forward_command,
    ("blocks.safety.stops:Elapsed.__call__",): "$_tick += 1; DONE($_tick >= $_ticks);",
    ("blocks.safety.stops:tilted.<locals>.is_tilted",): "DONE(!((double)$most[0] <= $bound));",
    ("blocks.safety.stops:Commanded.__call__",): """
    double most = magnitude((double)$_command[0]);
    for (int64_t i = 1; i < #_command; ++i) {
      double x = magnitude((double)$_command[i]);
      if (x > most) most = x;
    }
    if (most > $_least) { $_left = $_ticks; return 1; }
    $_left = larger($_left - 1, INT64_C(0));
    DONE($_left > 0);
    """,
    ("blocks.safety.stops:Settled.__call__",): """
    float most = 0.0f;
    each(#_vel) { $_speed[i] = magnitude($_vel[i]); most = greater(most, $_speed[i]); }
    $_slow = most <= (float)$_bound ? $_slow + 1 : 0;
    DONE($_slow >= $_ticks);
    """,
    ("blocks.maps:projected_gravity.<locals>.of_one_robot",): """
    double w = $base_quat[0], x = $base_quat[1], y = $base_quat[2], z = $base_quat[3];
    $projected_gravity[0] = (float)(2.0 * (w * y - x * z));
    $projected_gravity[1] = (float)(-2.0 * (w * x + y * z));
    $projected_gravity[2] = (float)(2.0 * (x * x + y * y) - 1.0);
    """,
    ("platforms.kit.command:FiniteCheck.__call__",): _finite,
    ("blocks.safety.limits:Clamp.__call__",): """
    each(#_target) $_target[i] = lesser(greater($_target[i], $_lower[i]), $_upper[i]);
    """,
    ("blocks.safety.limits:Trip.__call__",): """
    each(#_target) if (!($_target[i] >= $_lower[i] && $_target[i] <= $_upper[i])) BAIL;
    """,
    ("blocks.safety.limits:EffortLimits.__call__", "blocks.safety.limits:EffortLimits._act"): f"""
    each(#_lower) {{
      {_TORQUE}
      if (torque == clipped) continue;
      bool stiff = $_servo.joint_stiffness[i] > 0.0f;
      clipped = clipped - rest;
      if (!stiff) {{ $_servo.joint_effort_ff[i] = clipped; continue; }}
      clipped = clipped - $_servo.joint_effort_ff[i];
      clipped = clipped / $_servo.joint_stiffness[i];
      $_servo.joint_pos_target[i] = clipped + $_servo.joint_pos[i];
    }}
    """,
    ("blocks.safety.limits:EffortLimits.__call__", "blocks.safety.limits:EffortStop._act"): f"""
    each(#_lower) {{ {_TORQUE} if (torque != clipped) BAIL; }}
    """,
    (
        "blocks.safety.limits:RateLimit.__call__",
        "blocks.safety.limits:RateLimit._act",
    ): _RATE.format(
        act="$_target[i] = lesser(greater($_target[i], last - $_step[i]), last + $_step[i]);"
    ),
    ("blocks.safety.limits:RateLimit.__call__", "blocks.safety.limits:RateStop._act"): _RATE.format(
        act="if (!(magnitude($_target[i] - last) <= $_step[i] * 1.0001f)) BAIL;"
    ),
    ("blocks.safety.ranges:RangeStop.__call__",): "if (!(RANGES)) BAIL;",
    ("blocks.safety.stops:TiltStop.__call__",): """
    if (!((double)$_largest[0] <= $_bound)) BAIL;
    """,
    ("blocks.safety.stops:VelocityStop.__call__",): "if (!(RANGES)) BAIL;",
    ("blocks.safety.stops:StaleStop.__call__",): """
    int64_t stamp = $_oldest[0];
    if (stamp != $_last) { $_last = stamp; $_same = 0; return 0; }
    if ($_same + 1 >= $_ticks) BAIL;
    $_same += 1;
    """,
    ("blocks.safety.stops:RemoteStop.__call__",): _remote_stop,
    ("blocks.safety.stops:ButtonStop.__call__",): _button_stop,
    # What a dot product of float32 decides is left to Python wherever it is close.
    ("blocks.safety.servo_stops:TrackingStop.__call__",): """
    double square = 0.0;
    each(#_pos) { $_apart[i] = $_target[i] - $_pos[i]; square += (double)$_apart[i] * $_apart[i]; }
    if ($_counting || !(square <= 0.999 * $_bound * $_bound)) PYTHON;
    """,
    ("blocks.safety.stuck:EncoderStop.__call__",): """
    each(#_pos) if (!($_pos[i] != $_last[i])) PYTHON;
    $_tick += 1;
    each(#_pos) { $_last[i] = $_pos[i]; $_reference[i] = $_target[i]; }
    $_all = $_tick;
    """,
    ("policies.phase:CommandSlew.__call__",): """
    each(#_seen) {
      float change = $_command[i] - $_seen[i];
      $_seen[i] = $_seen[i] + lesser(greater(change, $_least[i]), $_step[i]);
    }
    """,
    ("blocks.approach:FadeIn.__call__",): _fade_in,
    ("blocks.approach:BlendIn.__call__",): _blend_in,
}
"""Functions of this package that a block runs, the tick first, to their twin."""
