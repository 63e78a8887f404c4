"""The observation: table of terms, sizes against the network, what cannot be measured, frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from unicon_core.blocks.velocity_command import VelocityCommand
from unicon_core.check.result import CheckResult, PolicyResult
from unicon_core.check.subject import Subject
from unicon_core.platforms.kit.base import rotation
from unicon_core.platforms.platform import info_of
from unicon_core.policies import PolicyContract, TermSlice, observation_rows, term_slices
from unicon_core.policies.hints import Feed
from unicon_core.policies.networks.onnx_file import read_onnx
from unicon_core.states.standard import ESTIMATORS
from unicon_core.text_table import figure, span

NOT_ON_HARDWARE = ("base_lin_vel", "base_pos_w")
"""What no sensor of a legged robot measures: it takes an estimator or a tracking system."""

SIGNED = ("projected_gravity", "base_ang_vel", "joint_pos", "joint_vel")
"""What policies see with the sign that it has here; joint velocities by a factor of 0.05 to 1."""


def check_observation(subject: Subject, result: CheckResult) -> None:
    """Add a table of terms, and of what the network takes, for each policy, and findings."""
    for policy in subject.policy_results(result):
        key, contract = policy.key, policy.contract
        _quaternions(policy)
        if not contract.terms:
            continue
        states = subject.states_of(key)
        slices = term_slices(contract, states, subject.robot.joint_names)
        (heads, *rows), meaning = observation_rows(contract, subject.robot, states)
        frames = [states.spec(part.term.state).frame or "-" for part in slices]
        lines = [meaning]
        if any(term.history > 1 for term in contract.terms):
            lines.append(f"histories begin with {contract.observation.start}")
        rows = [[*row, frame] for row, frame in zip(rows, frames)]
        lines += _networks(contract)
        result.table(f"Observation of policy {key}", [*heads, "frame"], rows, lines)
        for part in slices:
            _term(subject, policy, part)


def _quaternions(policy: PolicyResult) -> None:
    """An output whose own name says the other order of a quaternion than the state's."""
    for state, output in policy.contract.outputs.items():
        taken = "xyzw" if state.endswith("xyzw") else "wxyz"
        said = [order for order in ("xyzw", "wxyz") if order in output.lower()]
        if "quat" in state and said and taken not in said:
            policy.find(
                "observation.frame",
                f"outputs.{state}",
                f"it takes {taken}, and the network calls its output {output!r}",
                "write it into a state of that order: motion_ref_quat_xyzw or motion_body_quat_w",
            )


def _networks(contract: PolicyContract) -> list[str]:
    """Return what the networks take; the build refuses an observation of another size."""
    if contract.networks:
        chain = [_network(part.name, part.model, part.feeds) for part in contract.networks]
        last = _network("", contract.model, contract.feeds)
        return ["the networks and what fills them:", *chain, last]
    if contract.is_onnx:
        tensors = {tensor.name: tensor for tensor in read_onnx(contract.model).inputs}
        if tensor := tensors.get(contract.inputs.get("observation", "")):
            return [f"{contract.model.name} takes {tensor}"]
    return ["the network says no size"]


def _network(name: str, model: Path, feeds: Mapping[str, Sequence[Feed]]) -> str:
    """Return one network of several in a line: its file, inputs with what fills them, outputs."""
    file = read_onnx(model)
    taken = [
        f"{tensor} of {' + '.join(map(str, feeds[tensor.name]))}"
        if tensor.name in feeds
        else str(tensor)
        for tensor in file.inputs
    ]
    given = ", ".join(map(str, file.outputs))
    return f"{name or 'the action'}: {model.name} takes {', '.join(taken)}, gives {given}"


def _term(subject: Subject, policy: PolicyResult, part: TermSlice) -> None:
    term = part.term
    culprit = f"term {term.name!r}"
    none = np.flatnonzero(part.scale == 0.0)
    if 0 < none.size < part.scale.size:
        policy.note(
            "observation.scale",
            culprit,
            f"scale is 0 at {none.size} of {part.scale.size} elements: the network does not see "
            "them",
        )
    elif none.size:
        policy.find("observation.scale", culprit, "scale is 0: the network would not see it")
    for odd, hint in (
        ((part.scale < 0.0) & (term.state in SIGNED), "was it trained with the other sign?"),
        (
            (part.scale > 1.0) & (term.state == "joint_vel"),
            "was it trained with degrees? it is in rad/s here",
        ),
    ):
        if odd.any():
            policy.note(
                "observation.scale",
                culprit,
                f"scale is {figure(part.scale[odd][0])} at {np.count_nonzero(odd)} of {odd.size} "
                f"elements of {term.state}: {hint}",
            )
    if (part.low >= part.high).any():
        policy.find(
            "observation.clip", culprit, f"it is clipped to {span(part.low.max(), part.high.min())}"
        )
    if term.state == "base_quat" and term.index is None:
        policy.note(
            "observation.frame",
            culprit,
            "base_quat is w, x, y, z; for a policy trained with x, y, z, w give "
            "index: [1, 2, 3, 0]",
        )
    if term.state in NOT_ON_HARDWARE and term.state not in subject.written:
        text = f"reads {term.state}, which no sensor of the robot measures"
        remedy = (
            f"let {ESTIMATORS[term.state]} estimate it (estimate: [{ESTIMATORS[term.state]}]), or "
            "take a policy that was trained without it (it may stay in the critic)"
        )
        platform = subject.platform
        if platform.simulated or term.state in platform.writes:
            policy.note("observation.measured", culprit, f"{text}; on the robot: {remedy}")
        else:
            text += f" and platform {platform.name!r} does not deliver"
            policy.find("observation.measured", culprit, text, remedy)


def check_frames(subject: Subject, result: CheckResult) -> None:
    """Add the table of conventions; on a simulator compare orientation with gravity."""
    states = subject.program.states
    robot = subject.robot
    sources = info_of(subject.program.platform).get("imu") or {}
    of = {"base_quat": "quat", "base_ang_vel": "gyro", "base_lin_acc": "accelerometer"}
    rows = []
    for name in ("base_quat", "base_ang_vel", "base_lin_acc", "projected_gravity", "base_lin_vel"):
        spec = states.spec(name)
        source = str(sources.get(of.get(name, ""), "")) if subject.platform.simulated else ""
        rows.append([name, ", ".join(spec.names), spec.frame, spec.unit or "-", source or "-"])
    lines = ["quaternions are w, x, y, z and turn base into world; ROS messages are x, y, z, w"]
    if robot.imu is not None and np.isfinite(robot.imu.quat).all():
        turned = not np.allclose(np.abs(robot.imu.quat), (1, 0, 0, 0), atol=1e-6)
        how = f"turned by {_vector(robot.imu.quat, 4)}" if turned else "aligned"
        lines.append(f"IMU {robot.imu.frame}: {how} with {robot.base_frame}")
    result.table("Conventions", ["state", "elements", "frame", "unit", "source"], rows, lines)
    if not subject.platform.simulated:
        return
    subject.program.platform.recv()
    quat = states["base_quat"].reshape(-1, 4)[0].astype(np.float64)
    down, gravity = -rotation(quat)[2], states["projected_gravity"].reshape(-1, 3)[0]
    if abs(quat @ quat - 1.0) > 1e-3 or not np.allclose(down, gravity, atol=5e-3):
        result.find(
            "observation.frame",
            f"platform {subject.platform.name!r}",
            f"base_quat {_vector(quat)} puts gravity at {_vector(down)} and "
            f"projected_gravity says {_vector(gravity)}",
        )


def _vector(values: Iterable[float], digits: int = 3) -> str:
    return f"[{', '.join(figure(round(float(value), digits), '') for value in values)}]"


TURN = 2.0 * np.pi + 1e-3
"""In [rad]: phases beyond it are in degrees."""
GAIT = (0.1, 10.0)
"""Shortest and longest period of a gait in [s]; published ones have 0.4 to 1.5."""

_AXES = ("lin_vel_x", "lin_vel_y", "ang_vel_z")


def check_timing(subject: Subject, result: CheckResult) -> None:
    """Add the table of rates; an implausible period or command is a finding."""
    program = subject.program
    rows = [["workflow", f"{program.period:g}", f"{1.0 / program.period:g}", "each tick"]]
    policies = subject.policy_results(result)
    for policy in policies:
        key, period = policy.key, policy.contract.period
        n = round(period / program.period)
        often = "each tick" if n == 1 else f"every {n} ticks"
        rows.append([f"policy {key}", f"{period:g}", f"{1.0 / period:g}", often])
        if not 0.002 <= period <= 0.1:
            policy.find("timing.period", "period", f"{period:g} s ({1.0 / period:g} Hz)")
        check_clock(policy)
    info = info_of(program.platform)
    if "physics_step_s" in info:
        step, often = float(info["physics_step_s"]), f"{info['physics_steps_per_tick']} a tick"
        rows.append(["physics", f"{step:g}", f"{1.0 / step:g}", often])
    result.table("Timing", ["who", "period [s]", "rate [Hz]", "runs"], rows)
    platform = subject.platform
    told = subject.live  # by the runner
    if program.pacing.trigger == "state" and not subject.waits and not told:
        result.find(
            "timing.trigger",
            f"platform {platform.name!r}",
            "it cannot tell when its data arrive",
            where=subject.document.where("pacing", "trigger"),
        )
    if program.pacing.overrun == "catch_up" and not platform.simulated and not told:
        result.find(
            "timing.catch_up",
            f"platform {platform.name!r}",
            "catch_up would send old commands in one go to a robot",
            where=subject.document.where("pacing", "overrun"),
        )
    commands = [(b, b.tick.values) for b in subject.blocks if isinstance(b.tick, VelocityCommand)]
    for policy in policies:
        ranges = policy.contract.command_ranges
        low, high = np.transpose([ranges.get(axis, (-np.inf, np.inf)) for axis in _AXES])
        for block, values in commands:
            for row, i in np.argwhere((values < low - 1e-6) | (values > high + 1e-6)):
                result.find(
                    "command.range",
                    "velocity_command",
                    f"{_AXES[i]} {figure(values[row, i])} is outside "
                    f"[{span(low[i], high[i], ', ')}], for which policy {policy.key!r} was trained",
                    where=block.where,
                )


def check_commands(subject: Subject, result: CheckResult) -> None:
    """Note what is commanded without a bound of its own: cautious ones hold then."""
    open_ended = [each for each in subject.program.command_bounds if not each.given]
    if open_ended:
        held = ", ".join(f"{b.axis} to {span(b.low, b.high, '…')} {b.unit}" for b in open_ended)
        result.note(
            "command.bounds",
            "velocity_command",
            f"neither policy nor robot file says how much may be commanded: bounded are {held}",
            "give command_ranges in policy.yaml (lin_vel_x, lin_vel_y, ang_vel_z), or in the robot "
            "file (vx, vy, wz)",
            subject.robot.path,
        )


def check_clock(policy: PolicyResult) -> None:
    """Find phases in degrees and periods in milliseconds or in [Hz]."""
    phase = policy.contract.phase
    if phase is None:
        return
    stand = phase.stand if isinstance(phase.stand, float) else 0.0
    for part, values in (("phase.offsets", phase.offsets), ("phase.stand", (stand,))):
        most = max(values, key=abs)
        if abs(most) > TURN:
            policy.find(
                "timing.clock",
                part,
                f"{most:g} rad is more than a turn",
                f"give it in [rad]: {np.radians(most):.4g} if these were degrees",
            )
    if not GAIT[0] <= phase.period <= GAIT[1]:
        policy.find(
            "timing.clock",
            "phase.period",
            f"a gait of {phase.period:g} s; plausible are {GAIT[0]:g} to {GAIT[1]:g}",
        )
