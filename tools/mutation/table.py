"""The mutations of what keeps a robot safe, and the tests that have to notice each.

A row is where, what stands there, and what takes its place. "" as what stands there returns from
the function at once, with the third as its value: the block is removed, the gate holds.
"""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["ROWS", "Row"]

BLOCKS = (
    "test/blocks/test_blocks_trips.py",
    "test/blocks/test_blocks_safety.py",
    "test/blocks/test_blocks_detectors.py",
    "test/blocks/test_joint_sensor_stop.py",
)
COUNTED = ("test/blocks/test_excite.py",)
LEARNED = ("test/blocks/test_blocks_trips.py",)
GATES = "test/gates/test_gates.py", "test/gates/test_gates_edges.py"
BEGINNING = ("test/gates/test_beginning.py",)
PHASES = "test/runtime/test_transitions.py", "test/runtime/test_phases.py"
ENDS = *PHASES, "test/attack/test_c24_threads.py", "test/attack/test_c20_exceptions.py"
SIGNALS = *PHASES, "test/attack/test_a05_signals.py", "test/runtime/test_runner.py"
DAMPING = *PHASES, "test/platforms/test_damping.py"
HANGS = (
    "test/runtime/test_transitions.py",
    "test/runtime/test_triggered.py",
    "test/attack/test_a06_hangs.py",
)
CLOSED = "test/attack/test_c24_threads.py", *HANGS
CHILD = "test/platforms/test_child.py", "test/attack/test_child_processes.py"
CHILD_POLICY = ("test/policies/test_child_policy.py",)
REMOTE_POLICY = ("test/policies/test_remote_policy.py",)
FOLLOWED = ("test/blocks/test_forward_command.py",)
CARRIED = ("test/whole_body/test_gravity.py",)
REACHED = (
    "test/ik/test_quadratic.py",
    "test/ik/test_differential.py",
    "test/ik/test_reach.py",
)
PLAYED = "test/trajectory/test_accepted.py", "test/trajectory/test_player.py"
SETS = ("test/workflow/test_safety_set.py",)


class Row(NamedTuple):
    """One mutation.

    Attributes:
        file: below the root of the repository.
        where: `Class.method` or function in which it stands; "" for the whole module.
        old: stands there exactly once; "" for the whole body.
        new: takes its place.
        tests: files, of which one test has to fail.
    """

    file: str
    where: str
    old: str
    new: str
    tests: tuple[str, ...]


def _rows(
    file: str, tests: tuple[str, ...], *rows: tuple[str, str] | tuple[str, str, str]
) -> list[Row]:
    made = []
    path = file if file.startswith("unicon_") else f"unicon_core/{file}"
    for where, *rest in rows:
        old, new = rest if len(rest) == 2 else ("", rest[0])
        made.append(Row(path, where, old, new, tests))
    return made


REMOVED = "None"

ROWS = [
    *_rows(
        "blocks/safety/stops.py",
        BLOCKS,
        ("TiltStop.__call__", REMOVED),
        ("TiltStop.__init__", "-math.cos(angle)", "-math.cos(10 * angle)"),
        (
            "TiltStop.__call__",
            "not self._largest() <= self._bound",
            "self._largest() > self._bound",
        ),
        ("TiltStop.__init__", ")] = 1.0", ")] = 1.5"),
        ("height_stop", "lowest), (np.inf", "-HEIGHT), (np.inf"),
        ("height_stop", "(np.inf, np.inf, highest)", "(np.inf, np.inf, HEIGHT)"),
        ("VelocityStop.__call__", REMOVED),
        ("VelocityStop.__init__", "-bound, bound)", "-bound, 10 * bound)"),
        ("VelocityStop.__init__", "-bound, bound)", "-10 * bound, bound)"),
        ("VelocityStop.__init__", ")] = 1.5", ")] = 2.0"),
        (
            "VelocityStop.__init__",
            "limits * np.float32(factor)",
            "limits * np.float32(10 * factor)",
        ),
        ("StaleStop.__call__", REMOVED),
        ("StaleStop.__call__", "self._same >= self._ticks", "self._same > self._ticks"),
        ("StaleStop.__call__", "stamp != self._last", "stamp == self._last"),
        ("StaleStop.__init__", "stamp_ns.min if", "stamp_ns.max if"),
        ("StaleStop.reset", REMOVED),
        ("StaleStop.__init__", "timeout: Timeout = 0.1", "timeout: Timeout = 1.0"),
        ("Finite.__init__", "-most, most)", "-np.inf, np.inf)"),
        *(
            (
                "Finite.__init__",
                "vars(command)",
                f"{{k: v for k, v in vars(command).items() if k != {state!r}}}",
            )
            for state in ("joint_damping", "joint_effort_ff")
        ),
    ),
    *_rows("flow/critical_path.py", SETS, ("is_patient", REMOVED)),
    *_rows("blocks/safety/stops.py", SETS, ("", "PATIENT = 5", "PATIENT = 1")),
    *_rows(
        "platforms/kit/command.py",
        (*BLOCKS, "test/platforms/test_kit.py"),
        ("FiniteCheck.__call__", REMOVED),
    ),
    *_rows(
        "blocks/safety/limits.py",
        BLOCKS,
        ("Clamp.__call__", REMOVED),
        ("Clamp.__call__", "np.maximum(self._target, self._lower, out=self._target)", "pass"),
        ("Clamp.__call__", "np.minimum(self._target, self._upper, out=self._target)", "pass"),
        ("Trip.__call__", REMOVED),
        ("Trip.__call__", "(self._target >= self._lower) & ", ""),
        ("Trip.__call__", " & (self._target <= self._upper)", ""),
        ("joint_limits", "lower += np.float32(margin)", "pass"),
        ("joint_limits", "upper -= np.float32(margin)", "pass"),
        ("joint_limits", 'if beyond == "trip"', 'if beyond != "trip"'),
        ("EffortLimits.__call__", REMOVED),
        (
            "EffortLimits.__call__",
            "np.maximum(torque, self._lower, out=clipped)",
            "clipped[...] = torque",
        ),
        ("EffortLimits.__call__", "np.minimum(clipped, self._upper, out=clipped)", "pass"),
        ("EffortLimits._act", REMOVED),
        (
            "EffortLimits._act",
            "np.copyto(servo.joint_effort_ff, clipped, where=self._limp)",
            "pass",
        ),
        ("EffortLimits._act", "clipped -= rest", "pass"),
        ("EffortStop._act", REMOVED),
        ("limits_of", "None else scale)", "None else 10 * scale)"),
        ("effort_limits", "2.0 if trip", "10.0 if trip"),
        ("RateLimit.__call__", REMOVED),
        ("RateLimit._act", "np.maximum(self._target, self._bound, out=self._target)", "pass"),
        ("RateLimit._act", "np.minimum(self._target, self._bound, out=self._target)", "pass"),
        ("RateLimit.__call__", "self._last[...] = self._pos", "self._last[...] = self._target"),
        ("RateLimit.reset", REMOVED),
        ("RateStop._act", REMOVED),
        ("RateStop._act", "self._step * ROUNDING", "self._step * 10"),
        ("rate_limit", "rate * np.float32(period)", "rate * np.float32(10 * period)"),
    ),
    *_rows(
        "blocks/safety/limits.py",
        BLOCKS,
        ("velocity_limits", "robot.velocity_limit,", "10 * robot.velocity_limit,"),
        ("velocity_limits", 'if beyond == "trip"', 'if beyond != "trip"'),
    ),
    *_rows(
        "blocks/safety/ranges.py",
        BLOCKS,
        ("RangeStop.__call__", REMOVED),
        ("", "ANGULAR_VELOCITY = 70.0", "ANGULAR_VELOCITY = 700.0"),
        ("", "QUATERNION = 1.01", "QUATERNION = 10.1"),
        ("", "DIRECTION = 1.25", "DIRECTION = 12.5"),
        ("", "UNBOUNDED = 1e6", "UNBOUNDED = 1e7"),
        *(
            ("", f'    "{state}",\n', "")
            for state in (
                "joint_pos",
                "joint_vel",
                "joint_effort",
                "base_quat",
                "base_ang_vel",
                "base_lin_acc",
                "projected_gravity",
            )
        ),
        ("range_stop", ")] = 0.5", ")] = 5.0"),
        ("range_stop", "10.0)] = 3.0", "10.0)] = 10.0"),
        ("range_stop", "lower -= np.float32(margin)", "lower -= np.float32(10 * margin)"),
        ("range_stop", "upper += np.float32(margin)", "upper += np.float32(10 * margin)"),
        ("range_stop", "robot.velocity_limit * factor", "robot.velocity_limit * 10 * factor"),
        ("command_stop", "(0.0, stiffness)", "(-stiffness, stiffness)"),
        ("command_stop", "(0.0, damping)", "(-damping, damping)"),
        ("command_stop", "(0.0, stiffness)", "(0.0, 10 * stiffness)"),
        ("command_stop", "(0.0, damping)", "(0.0, 10 * damping)"),
        ("command_stop", "(-speed, speed)", "(-10 * speed, 10 * speed)"),
        ("command_stop", "(-effort, effort)", "(-10 * effort, 10 * effort)"),
        ("command_stop", "np.float32(2.0 * POSITION)", "np.float32(20.0 * POSITION)"),
        ("command_stop", "np.where(robot.endless, ", "np.where(robot.endless | True, "),
        ("command_stop", ")] = 2.0", ")] = 10.0"),
    ),
    *_rows(
        "states/states.py",
        (*BLOCKS, "test/workflow/test_safety_set.py"),
        ("Screen.__call__", "True"),
    ),
    *_rows(
        "blocks/safety/servo_stops.py",
        BLOCKS,
        ("TrackingStop.__call__", REMOVED),
        ("TrackingStop.__call__", "self._count >= self._ticks", "self._count >= 10 * self._ticks"),
        ("TrackingStop.__call__", "self._bound**2", "(10 * self._bound)**2"),
        (
            "TrackingStop.__call__",
            "~(np.abs(self._apart) <= self._bound)",
            "np.abs(self._apart) > self._bound",
        ),
        ("TrackingStop.__call__", "self._count *= far", "pass"),
        ("TrackingStop.reset", REMOVED),
        ("TrackingStop.__init__", "bound: Motion = 1.0", "bound: Motion = 2.0"),
        ("TrackingStop.__init__", "timeout: Timeout = 0.5", "timeout: Timeout = 5.0"),
        ("PowerStop.__call__", REMOVED),
        ("PowerStop.__call__", "most <= self._limit", "most <= 10 * self._limit"),
        ("PowerStop.__call__", "most <= self._limit", "not most > self._limit"),
        ("PowerStop.__call__", "self._count >= self._ticks", "self._count > self._ticks"),
        ("PowerStop.__call__", "torque *= self._loss", "torque *= 0"),
        ("PowerStop.__call__", "self._count = 0\n", "pass\n"),
        ("PowerStop.reset", REMOVED),
        ("PowerStop.__init__", "timeout: Timeout = 0.1", "timeout: Timeout = 1.0"),
    ),
    *_rows(
        "blocks/safety/servo_stops.py",
        ("test/blocks/test_twin_stop.py",),
        ("TwinStop.__call__", REMOVED),
        ("TwinStop.__call__", "self._count *= self._flag", "pass"),
        ("TwinStop.__call__", "[worst] >= self._ticks", "[worst] > self._ticks"),
        ("TwinStop.reset", REMOVED),
        ("TwinStop.__init__", "timeout: Timeout = 0.2", "timeout: Timeout = 2.0"),
    ),
    *_rows(
        "blocks/safety/stops.py",
        ("test/controls/test_modes.py",),
        ("ButtonStop.__call__", REMOVED),
        ("ButtonStop.__call__", "0 if self._alive else self._silent + 1", "0"),
        ("ButtonStop.__call__", "self._silent > self._lost", "self._silent >= self._lost"),
        ("ButtonStop.__call__", "self._silent > self._lost", "self._silent > 9 * self._lost"),
        ("ButtonStop.reset", REMOVED),
        ("RemoteStop.__call__", REMOVED),
        ("RemoteStop.reset", REMOVED),
    ),
    *_rows(
        "blocks/safety/stuck.py",
        BLOCKS,
        ("EncoderStop.__call__", REMOVED),
        ("EncoderStop._look", REMOVED),
        (
            "EncoderStop._look",
            "self._asked_at + 1 >= self._ticks",
            "self._asked_at + 1 >= 10 * self._ticks",
        ),
        ("EncoderStop._look", "where=over & (self._asked_at <= self._since)", "where=over & False"),
        ("EncoderStop.__call__", "self._motion**2", "(10 * self._motion)**2"),
        (
            "EncoderStop._look",
            "~(np.abs(self._asked) <= self._motion)",
            "(np.abs(self._asked) <= self._motion)",
        ),
        ("EncoderStop.reset", REMOVED),
        ("EncoderStop.__init__", "timeout: Timeout = 0.1", "timeout: Timeout = 1.0"),
        ("EncoderStop.__init__", "motion: Motion = 0.1", "motion: Motion = 1.0"),
        ("ImuStop.__call__", REMOVED),
        ("ImuStop._compare", REMOVED),
        ("ImuStop._frozen", REMOVED),
        ("ImuStop._frozen", "self._same < self._ticks", "self._same < 10 * self._ticks"),
        ("ImuStop._frozen", "moved > self._motion", "moved > 10 * self._motion"),
        ("ImuStop._integrate", REMOVED),
        ("ImuStop._integrate", "> self._angle**2", "> 100 * self._angle**2"),
        ("ImuStop._integrate", "self._apart >= self.PERSISTS", "self._apart >= 9.0"),
        ("ImuStop._integrate", "dt <= self.LONGEST", "dt"),
        ("ImuStop._compare", "<= 3 * self._allowed", "<= 30 * self._allowed"),
        ("ImuStop._compare", "if not abs(qx", "if abs(qx"),
        ("ImuStop.reset", REMOVED),
        ("ImuStop.__init__", "timeout: Timeout = 0.2", "timeout: Timeout = 2.0"),
        ("ImuStop.__init__", ")] = 0.3,", ")] = 3.0,"),
        ("ImuStop.__init__", ")] = 0.35", ")] = 1.5"),
    ),
    *_rows(
        "blocks/safety/sensors.py",
        BLOCKS,
        ("JointSensorStop.__call__", REMOVED),
        ("JointSensorStop._look", REMOVED),
        ("JointSensorStop._look_at_motion", REMOVED),
        ("JointSensorStop.__call__", "self._same >= self.FROZEN", "self._same >= 9.0"),
        ("JointSensorStop._look", "beyond[k] > step", "False"),
        ("JointSensorStop._look", "sum_of > self._drift + ", "sum_of > 100 * self._drift + "),
        ("JointSensorStop._look", "total[...] = self._excused[...] = 0.0", "pass"),
        ("JointSensorStop.__call__", "dt <= self._longest", "dt"),
        ("JointSensorStop.__call__", "off *= self.looked_at", "pass"),
    ),
    *_rows(
        "blocks/safety/ranges.py",
        BLOCKS,
        ("hardware_stop", '"motor_temperature": (COLDEST, temperature),', ""),
        ("hardware_stop", '"motor_error": (0, 0),', ""),
        ("hardware_stop", '"battery_charge": (charge, 1.0),', ""),
        ("hardware_stop", "(voltage, HIGHEST_VOLTAGE)", "(0.1 * voltage, HIGHEST_VOLTAGE)"),
        ("hardware_stop", ")] = 90.0", ")] = 120.0"),
        ("hardware_stop", "1.0)] = 0.05", "1.0)] = 0.0"),
        ("", "COLDEST = -40.0", "COLDEST = -400.0"),
    ),
    *_rows(
        "blocks/safety/servo_stops.py",
        BLOCKS,
        ("OverrunStop.__call__", REMOVED),
        ("OverrunStop.__call__", "<= self._window_ns", "<= 0.1 * self._window_ns"),
        ("OverrunStop.__call__", "took < self._late_ns", "took < 10 * self._late_ns"),
        ("OverrunStop.__init__", "maxlen=count", "maxlen=10 * count"),
        ("OverrunStop.reset", REMOVED),
        ("OverrunStop.__init__", "Within(1)] = 10", "Within(1)] = 50"),
        ("OverrunStop.__init__", "platform is None or not platform.facts.simulated", "False"),
    ),
    *_rows(
        "blocks/safety/ranges.py",
        LEARNED,
        ("ObservationStop._raise", REMOVED),
        ("ObservationStop.__init__", "margin * (upper - lower)", "10 * margin * (upper - lower)"),
        ("ObservationStop.__init__", "MARGIN)] = 0.5", "MARGIN)] = 5.0"),
        ("action_stop", "(-limit, limit)", "(-limit, 10 * limit)"),
        ("action_stop", "(-limit, limit)", "(-10 * limit, limit)"),
        ("action_stop", ")] = 50.0", ")] = 500.0"),
        ("_bounds_of", "allow_pickle=False", "allow_pickle=True"),
    ),
    *_rows(
        "workflow/tick_tree.py",
        SETS,
        *(
            ("", f'    "{name}",\n', "")
            for name in (
                "command_stop",
                "range_stop",
                "velocity_stop",
                "tilt_stop",
                "hardware_stop",
            )
        ),
        *(
            ("", old, new)
            for old, new in (
                ('LAST = ("joint_limits", ', "LAST = ("),
                ('"stale_stop", ', ""),
                ('"imu_stop", ', ""),
                ('"joint_sensor_stop", ', ""),
                (', "encoder_stop")', ")"),
            )
        ),
        ("left_out", "[]"),
        ("completed", "() if begin else add(FIRST)", "()"),
    ),
    *_rows(
        "gates/data.py",
        GATES,
        ("Told.__call__", "''"),
        ("Told.__call__", "~np.isfinite(view)", "np.zeros(view.shape, np.bool_)"),
        ("Told.__call__", "untold &= view == self._marks[name]", "untold[...] = False"),
        ("Rate.__call__", "''"),
        ("Rate.__call__", "self.hz >= self._needed", "self.hz >= 0.1 * self._needed"),
        ("Rate.__call__", "count > self._last", "count >= self._last"),
        ("", "SHARE = 0.8", "SHARE = 0.1"),
        ("Changing.__call__", "''"),
        (
            "Changing.__call__",
            "self._same[side] >= self._ticks",
            "self._same[side] >= 100 * self._ticks",
        ),
        ("Changing._frozen", "''"),
        ("", "FROZEN = 1.0", "FROZEN = 10.0"),
    ),
    *_rows(
        "gates/data.py",
        GATES,
        ("Imu.__call__", "''"),
        ("Imu._orientation", "''"),
        ("Imu._gravity", "''"),
        ("", "ACCELERATION = 1.5", "ACCELERATION = 15.0"),
        ("", "ANGLE = 0.2", "ANGLE = 2.0"),
        ("", "TURNING = 0.5", "TURNING = 50.0"),
        ("", "NORM = 0.01", "NORM = 1.0"),
        ("Imu.__call__", "if not gyro <= TURNING", "if gyro > TURNING"),
        ("Imu._orientation", 'return "" if self._stop is None else self._stop()', 'return ""'),
    ),
    *_rows(
        "gates/gate.py",
        GATES,
        ("Variant.__call__", "''"),
        ("Variant.__call__", "value != expected", "False"),
        ("Variant.__call__", "if not told:", "if False:"),
        ("NoCommand.__call__", "''"),
        ("SoleCommander.__call__", "''"),
    ),
    *_rows(
        "gates/gate.py",
        GATES,
        ("Heeding.__call__", "''"),
        ("Heeding.__call__", "self._lasting\n", "0\n"),
        ("Heeding.__call__", "self._reset()", "pass"),
    ),
    *_rows(
        "gates/build.py",
        GATES,
        ("gates_of", "[]"),
        ("gates_of", "if program.platform.facts.simulated", "if True"),
        ("_gates", "gates.append(Told(states, readers, source))", "pass"),
        ("_gates", "gates.append(Rate(platform.arrivals, period, rate, source))", "pass"),
        ("_gates", 'gates.append(Rate(states["stamp_ns"].item, period, rate, source))', "pass"),
        (
            "_gates",
            'gates.append(Changing([*imu.values()], joints, told.get("joint_vel"), period))',
            "pass",
        ),
        ("_gates", "gates.append(Imu(imu, readers, period, _imu_stop(program, told)))", "pass"),
        ("_gates", "gates.append(Variant(each.variant, own))", "pass"),
        ("_gates", "gates.append(SoleCommander(each.commanders))", "pass"),
        ("_gates", 'gates.append(NoCommand(states["velocity_command"]))', "pass"),
        ("_gates", "gates += _tilt(program, told)", "pass"),
        ("_gates", "gates += _stops(program, measured)", "pass"),
        ("_gates", 'if "joint_pos" in told:', "if False:"),
        ("_imu_stop", "None"),
        ("", "MARGIN = 0.05", "MARGIN = 0.5"),
        ("", "TILT = 1.0", "TILT = 1.5"),
        ("_tilt", "isinstance(block.tick, TiltStop)", "False"),
    ),
    *_rows(
        "gates/build.py",
        (*BEGINNING, *PHASES),
        (
            "beginning",
            "measured[own] = np.where(stays, measured[own], default)",
            "pass",
        ),
        ("beginning", "stiffness = np.zeros_like(stiffness)", "pass"),
        ("beginning", "gains[own] = said", "pass"),
        ("first_command", "graph.reset()", "pass"),
        ("first_command", "states.restore(before)", "pass"),
    ),
    *_rows(
        "blocks/approach.py",
        PHASES,
        ("Approach.__call__", "True"),
        ("Approach.__init__", "distance / speed / period", "0.1 * distance / speed / period"),
        ("Approach.__init__", "fade_in / period", "0.1 * fade_in / period"),
        ("Approach.__call__", 'states["joint_pos_target"] += self._from', "pass"),
        ("Approach.__call__", 'states["joint_effort_ff"][...] = 0.0', "pass"),
        ("Approach.__call__", 'states["joint_vel_target"][...] = 0.0', "pass"),
        ("Approach.__call__", "self._beginning.stiffness, grown", "self._beginning.stiffness, 1.0"),
        ("Approach.__call__", "max(self._move, self._fade)", "min(self._move, self._fade)"),
        ("Entry.__call__", REMOVED),
        ("Entry.__call__", "self._tick >= self._ticks", "10 * self._tick >= self._ticks"),
        ("Entry.__call__", "self._pairs[0][1][...] = self._measured", "pass"),
        ("Entry.__call__", "held[...] = self._last.states[name]", "pass"),
    ),
    *_rows("blocks/postures.py", COUNTED, ("Counting.reset", REMOVED)),
    *_rows(
        "runtime/startup_sequence.py",
        PHASES,
        ("Waiting.__call__", "True"),
        ("Waiting._missing", "if reason := gate():", "if (reason := gate()) and False:"),
        ("Waiting._missing", "if self._go:", "if True:"),
        ("Waiting.go", "ready = self._what == GO", "ready = True"),
        ("Waiting.go", "self._go |= ready", "pass"),
        ("Waiting.__call__", "if not self._operator and", "if False and"),
        ("", "PATIENCE = 30.0", "PATIENCE = 300.0"),
        ("", "REPEAT = 5.0", "REPEAT = 500.0"),
    ),
    *_rows(
        "runtime/runner.py",
        ENDS,
        ("Runner._wind_down", REMOVED),
        ("Runner._wind_down", 'self.program.states["velocity_command"][...] = 0.0', "pass"),
        ("Runner._wind_down", "self._ending_ticks, full_speed", "1 << 62, full_speed"),
        ("Runner._wind_down", "or not self.program.gate.sent.any", ""),
        ("Runner._damped", REMOVED),
        ("Runner._damped", "not program.gate.sent.any or", "False or"),
        ("Runner._damped", "not isinstance(fault, Hung)", "True"),
        ("Runner._close", REMOVED),
        ("Runner.close", "self.program.gate.close()", "pass"),
        ("Runner.run", "for act in self.at_fault:", "for act in []:"),
        ("Runner._ticked", "if ticker.stop:", "if False:"),
    ),
    *_rows(
        "runtime/startup_sequence.py",
        ENDS,
        ("StartupSequence.__call__", "True"),
        ("StartupSequence.__call__", "return self._approached()", "return True"),
        ("StartupSequence.__call__", "Waiting(program.gates, ", "Waiting([], "),
        ("StartupSequence.__call__", "asks, warn", "False, warn"),
        ("StartupSequence._approached", "True"),
        ("waiting_tree", "Zip(*program.hearing, ", "Zip("),
    ),
    *_rows(
        "runtime/startup_sequence.py",
        GATES,
        ("prepared", 'next(filter(None, (gate() for gate in alone)), "")', "''"),
    ),
    *_rows("runtime/phases.py", ENDS, ("refuse_pace", REMOVED)),
    *_rows(
        "runtime/runner.py",
        SIGNALS,
        ("Runner._damp_now", "False"),
        ("Runner.stop", REMOVED),
        ("Runner._ticked", "if run.stop:", "if False:"),
        ("Runner.run", "if SIGNALS.asked:  #", "if False:  #"),
    ),
    *_rows(
        "runtime/phases.py",
        PHASES,
        ("Damp.run", REMOVED),
        ("Damp.run", "damping()", "pass"),
        ("Damp.run", "program.sending()", "pass"),
        ("Damp.run", "if gate.closed:", "if False:"),
        ("Damp.run", "if paced:\n                clock", "if False:\n                clock"),
        ("Damp.run", "hears = _tried(hears)", "pass"),
        ("Damp.run", "look = _tried(look)", "pass"),
        ("Damp.run", "DAMPING_TIME / program.period", "0.01 * DAMPING_TIME / program.period"),
        ("_tried", "except BaseException:", "except ZeroDivisionError:"),
        ("_tried", "return None", "pass"),
    ),
    *_rows(
        "platforms/kit/command.py",
        DAMPING,
        ("", "BLEND = 0.3", "BLEND = 3.0"),
        ("", "DAMPING_TIME = 0.5", "DAMPING_TIME = 0.05"),
        ("Damping.__call__", REMOVED),
        ("Damping.__call__", "self._share - self._step", "self._share"),
        ("Damping.__call__", 'states["joint_pos_target"][...] = self._target', "pass"),
        ("Damping.__call__", 'states["joint_vel_target"][...] = 0.0', "pass"),
        ("Damping.__call__", 'states["joint_effort_ff"][...] = 0.0', "pass"),
        ("Damping.__call__", 'states["joint_damping"][...] = self._damping', "pass"),
        (
            "Damping.__init__",
            "np.clip(np.where(good, target, pose), lower, upper)",
            "np.where(good, target, pose)",
        ),
        ("Damping.__init__", "np.where(good, target, pose)", "target"),
        ("Damping.__init__", "(target >= lower - ABSURD) & ", ""),
        ("Damping.__init__", " & (target <= upper + ABSURD)", ""),
        ("_bounded", "0.0, np.float32(most)", "-np.float32(most), np.float32(most)"),
        ("_bounded", "0.0, np.float32(most)", "0.0, np.float32(10 * most)"),
        ("LastSent.note", "self._copies.pack()", "pass"),
        ("LastSent.note", "self.any = True", "pass"),
        ("repeated", "if due > end:", "if True:"),
        ("repeated", "except Exception as raised:", "except ZeroDivisionError as raised:"),
        ("repeated", "raise error", "pass"),
    ),
    *_rows(
        "workflow/program_data.py",
        CLOSED,
        ("Gate.before", "if self.closed or now() > self.until_ns:", "if now() > self.until_ns:"),
        ("Gate.before", "if self.closed or now() > self.until_ns:", "if self.closed:"),
        ("Gate.before", "note()\n", "pass\n"),
        ("Gate.close", REMOVED),
    ),
    *_rows(
        "runtime/ticker.py",
        HANGS,
        ("Ticker._paced", "gate.until_ns = due + self.hang_ns", "pass"),
        ("Ticker._paced", "self._missed(now() - due)", "pass"),
        ("Ticker._paced", "if late > self.hang_ns:", "if False:"),
        ("Ticker._missed", "raise Hung(", "str("),
        ("Ticker._triggered", "gate.until_ns = last + self.hang_ns", "pass"),
        ("Ticker._triggered", "self._missed(last - before)", "pass"),
        ("Ticker._act", "self._program.gate.until_ns = NEVER_NS", "pass"),
    ),
    *_rows(
        "platforms/child/platform.py",
        CHILD,
        ("ChildPlatform.send", "self._finite()", "pass"),
        ("ChildPlatform._look", "if gone or told:", "if told:"),
        ("ChildPlatform._look", "if hung:", "if False:"),
        ("ChildPlatform._newest", "silent_ns > self._silence * 1e9", "False"),
        ("ChildPlatform._wait", "time.monotonic() >= end", "False"),
        ("", "SILENCE = {True: 1.0, False: 0.02}", "SILENCE = {True: 1.0, False: 2.0}"),
        ("", "WATCHDOG = {True: 2.0, False: 0.1}", "WATCHDOG = {True: 2.0, False: 10.0}"),
    ),
    *_rows(
        "platforms/child/pipe.py",
        CHILD,
        ("Pipe.close", "process.kill()", "pass"),
        ("Pipe.close", "self._into.close()", "pass"),
    ),
    *_rows(
        "platforms/child/process.py",
        CHILD,
        ("_Driver.run", "now - self._heard > self._watchdog", "False"),
        ("_Driver.run", "if not commands.alive():", "if False:"),
        ("_Driver.run", "if not self._obey():", "if self._obey() and False:"),
        ("main", "platform.close()  # damps first", "pass"),
        ("main", "signal.signal(signal.SIGTERM, driver.stop)", "pass"),
        ("_Driver.stop", REMOVED),
    ),
    *_rows(
        "policies/child_policy.py",
        CHILD_POLICY,
        ("ChildPolicy._answer", "if age > self._timeout:", "if False:"),
        ("ChildPolicy._take", "if not lane.action_finite():", "if False:"),
        ("ChildPolicy._hold", "np.where(stiffness > 0.0, target, measured)", "measured"),
    ),
    *_rows(
        "policies/networks/child.py",
        CHILD_POLICY,
        ("ChildNetwork.look", "if self.process.poll() is not None:", "if False:"),
        ("Question.take", "and self._answered == self._due", ""),
    ),
    *_rows(
        "policies/networks/remote.py",
        REMOTE_POLICY,
        ("RemoteNetwork._hear", "if digest != self._digest:", "if False:"),
        ("RemoteNetwork._hear", "number == self.number != self._number", "True"),
        ("RemoteNetwork.look", "self.publish()", "pass"),
        ("fill", "len(body) == states.buffer.size", "True"),
    ),
    *_rows(
        "policies/networks/remote_server.py",
        REMOTE_POLICY,
        ("PolicyServer._hear", "elif digest != self.digest:", "elif False:"),
    ),
    *_rows(
        "blocks/forward_command.py",
        FOLLOWED,
        ("ForwardCommand.__call__", "np.maximum(wanted, self._bound, out=wanted)", "pass"),
        (
            "ForwardCommand.__call__",
            "np.minimum(wanted, self._bound, out=held)",
            "held[...] = wanted",
        ),
        ("ForwardCommand.__call__", "np.maximum(wanted, self._lower, out=wanted)", "pass"),
        ("ForwardCommand.__call__", "np.minimum(wanted, self._upper, out=wanted)", "pass"),
        ("ForwardCommand.__call__", "command.entry(held)", "pass"),
        ("ForwardCommand.__call__", "np.minimum(self._offset, FARTHEST, out=self._offset)", "pass"),
        ("ForwardCommand.reset", REMOVED),
        ("ForwardCommand._begin", REMOVED),
        ("ForwardCommand._begin", "self._wanted[...] = self.held", "pass"),
        ("ForwardCommand._feed_forward", "np.minimum(fed, most, out=fed)", "pass"),
        ("ForwardCommand._feed_forward", "np.maximum(fed, self._bound, out=fed)", "pass"),
        ("ForwardCommand._feed_forward", "np.copyto(fed, 0.0, where=self._silent)", "pass"),
        ("ForwardCommand._head_home", REMOVED),
        ("ForwardCommand._head_home", "np.copyto(self._steps, step, where=goes)", "pass"),
        (
            "ForwardCommand._head_home",
            "goes &= np.isnan(said[at]).all(axis=-1, keepdims=True)",
            "pass",
        ),
    ),
    *_rows(
        "blocks/whole_body/frames.py",
        CARRIED,
        ("Gravity.__call__", "self.torque[:] = asked", "pass"),
        ("Gravity.__call__", "if math.isfinite(float(asked.sum())):", "if True:"),
        ("Gravity.__call__", "np.maximum(total, self._least, out=total)", "pass"),
        ("_carried", "if bears.any():", "if False:"),
    ),
    *_rows(
        "unicon_manipulation/ik/differential.py",
        REACHED,
        ("DifferentialIk.begin", "np.clip(joint_pos, *self._limits)", "joint_pos"),
        ("DifferentialIk.__call__", "np.maximum(bounds, self._least, out=bounds)", "pass"),
        ("DifferentialIk.__call__", "np.minimum(bounds, self._most, out=bounds)", "pass"),
        ("DifferentialIk._keep_apart", "", "0"),
        ("DifferentialIk._hold_back", REMOVED),
    ),
    *_rows(
        "unicon_manipulation/ik/differential.py",
        REACHED,
        ("Quadratic.solve", "total - total == 0.0", "True"),
        ("Quadratic.solve", "self.solution[:] = 0.0", "pass"),
    ),
    *_rows(
        "unicon_manipulation/ik/tasks.py",
        REACHED,
        ("Target.__call__", "abs(length - 1.0) <= _UNIT", "True"),
        ("Target.__call__", "not all(map(math.isfinite, velocity))", "False"),
        ("Target.__call__", "self.look_ahead + max(age, 0.0)", "self.look_ahead + age"),
    ),
    *_rows(
        "unicon_manipulation/reach.py",
        REACHED,
        ("Reach.__call__", "measured.dot(measured) < _SENSE", "True"),
        ("Reach.__call__", "pos[self._silent] = vel[self._silent] = np.nan", "pass"),
        ("Reach._change", "& np.isfinite(held)", ""),
        ("Reach.reset", REMOVED),
    ),
    *_rows(
        "trajectory/accepted.py",
        PLAYED,
        ("_within_limits", REMOVED),
        ("_within_limits", "if beyond.max() > 0.0:", "if False:"),
        ("_within_limits", "if over.max() > 0.0:", "if False:"),
        ("_begins_here", REMOVED),
        ("_filled", "if not np.isfinite(values).all():", "if False:"),
        ("_filled", "if np.abs(last).max() > ROUNDING:", "if False:"),
        ("_times", "if len(falling):", "if False:"),
        ("_times", "if not times[-1] > 0.0:", "if False:"),
        ("_times", "if not wait <= FARTHEST:", "if False:"),
        ("_times", "len(points.times) > MOST_POINTS", "False"),
        ("_places", "if len(set(names)) != len(names):", "if False:"),
        ("_places", "if not limits.partial and len(names) < len(own):", "if False:"),
    ),
    *_rows(
        "trajectory/player.py",
        PLAYED,
        ("Player.cancel", "self._position[...] = self._velocity[...] = np.nan", "pass"),
        ("Player.cancel", "self._spline = None", "pass"),
        ("Player.play", "if not self._followed:", "if False:"),
        ("Player.__call__", "if not self._followed:", "if False:"),
        ("Player.__call__", "count == self._count + 1", "True"),
        ("Player._on_the_way", "if (self._off > tolerances.path).any():", "if False:"),
    ),
]
