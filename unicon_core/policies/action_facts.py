"""What facts say of actions, gains and filters, checked; for `build_contract`."""

from __future__ import annotations

from collections.abc import Mapping, Set
from fnmatch import fnmatchcase
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from unicon_core.bounds import ACTION_SCALE, DAMPING, EFFORT, POSITION, STIFFNESS, VELOCITY
from unicon_core.errors import alternatives
from unicon_core.policies.contract import ActionKind, ActionSpec, CommandSpec, FilterSpec
from unicon_core.policies.fact_value import FactValue, is_whole
from unicon_core.robots import joint_index

Floats = NDArray[np.float32]

KINDS: tuple[ActionKind, ...] = ("position", "velocity", "torque")
ACTION_KEYS = ("kind", "scale", "offset", "clip", "joints", "filter", "feedback")
_FILTER = ("low_pass", "alpha", "moving_average", "start")
_SCALES = {"position": ACTION_SCALE, "velocity": VELOCITY, "torque": EFFORT}
_OFFSETS = {"position": POSITION, "velocity": VELOCITY, "torque": EFFORT}
_UNITS = {"position": "rad", "velocity": "rad/s", "torque": "N·m"}
LONGEST_FILTER = 100
"""Samples of a moving average; a policy at 50 Hz sees two seconds then."""
LARGEST_SLEW = 1000.0
"""Of a command in [1/s] of its unit: what is more jumps within a tick."""


def action_spec(
    action: FactValue, joints: tuple[str, ...], default: Floats, period: float
) -> ActionSpec:
    """Return the meaning of the network's output.

    Args:
        action: the facts under `action`.
        joints: of the policy.
        default: its pose in [rad], shape (n,).
        period: of the policy in [s].

    Raises:
        PolicyError: a fact is wrong.
    """
    action.mapping(ACTION_KEYS)
    listed, offset = action.at("joints"), action.at("offset")
    moved = joints if listed.value is None else listed.names()
    for name in moved:
        if name not in joints:
            raise listed.fail(
                f"names {name!r}, which is not in joints; {alternatives(name, joints)}"
            )
    count = len(moved)
    kinds = _kinds(action.at("kind"), moved)
    scale = _figures(action.at("scale"), _SCALES, kinds, count)
    offsets = default[joint_index(moved, joints)]
    if offset.value is not None:
        offsets = _figures(offset, _OFFSETS, kinds, count)
    elif kinds:
        offsets = np.where(np.array(kinds) == "position", offsets, np.float32(0.0))
    clip = action.at("clip").clip(count)
    if clip is not None:
        clip = np.array(np.broadcast_to(clip, (2, count)))
    smoothing = filter_spec(action.at("filter"), period, "zeros")
    feedback = action.choice("feedback", "raw", "clipped", "filtered")
    if feedback == "filtered" and smoothing is None:
        raise action.at("feedback").refuse("there is no action.filter; add it, or give raw")
    return ActionSpec(moved, scale, offsets, clip, feedback, kinds, smoothing)


def _kinds(kind: FactValue, moved: tuple[str, ...]) -> tuple[ActionKind, ...]:
    """One for each joint; nothing where all are positions."""
    said = kind.value
    if isinstance(said, Mapping):
        kinds: list[Any] = ["position"] * len(moved)
        for pattern, word in said.items():
            places = [i for i, name in enumerate(moved) if fnmatchcase(name, str(pattern))]
            if not places:
                raise kind.fail(
                    f"names {pattern!r}, which is none of the joints that are moved; "
                    f"{alternatives(str(pattern), moved)}"
                )
            for i in places:
                kinds[i] = _kind(kind.part(str(pattern), word))
    elif isinstance(said, (list, tuple)):
        if len(said) != len(moved):
            raise kind.fail(
                f"has {len(said)} words for {len(moved)} joints; give one word, one for each "
                "joint, or a mapping {'*_wheel_joint': velocity}"
            )
        kinds = [_kind(kind.at(i)) for i in range(len(said))]
    else:
        kinds = [_kind(kind.part("", said or "position"), kind)] * len(moved)
    return () if set(kinds) == {"position"} else cast(tuple[ActionKind, ...], tuple(kinds))


def _kind(word: FactValue, named: FactValue | None = None) -> ActionKind:
    if word.value not in KINDS:
        raise (named or word).refuse(f"known: {', '.join(KINDS)}")
    return cast(ActionKind, word.value)


def _figures(
    value: FactValue, most: Mapping[str, float], kinds: tuple[ActionKind, ...], count: int
) -> Floats:
    """Numbers, one for each joint, each within the bounds of its kind."""
    if not kinds:
        return value.vector(-most["position"], most["position"], count)
    array = value.vector(-max(most.values()), max(most.values()), count)
    for i, kind in enumerate(kinds):
        if abs(array[i]) > np.float32(most[kind]):
            raise value.part(i, None).fail(
                f"is {array[i]:g}; a {kind} has at most {most[kind]:g} {_UNITS[kind]}"
            )
    return array


def joint_gains(
    root: FactValue, joints: tuple[str, ...], action: ActionSpec
) -> tuple[Floats, Floats]:
    """Return stiffness [N·m/rad] and damping [N·m·s/rad], shape (n,).

    One number is that of all joints whose action is a position; of a joint that takes velocities
    the stiffness then is 0, of one that takes torques the damping, too.

    Raises:
        PolicyError: a joint that is given velocities has a stiffness, or no damping.
    """
    given = root.at("stiffness"), root.at("damping")
    stiffness, damping = (
        value.vector(0.0, most, len(joints)).copy()
        for value, most in zip(given, (STIFFNESS, DAMPING))
    )
    at = joint_index(action.joints, joints)
    single = [not isinstance(value.value, (list, tuple, np.ndarray)) for value in given]
    for place, kind in zip(at, action.kinds):
        if kind == "position":
            continue
        if single[0]:
            stiffness[place] = 0.0
        if single[1] and kind == "torque":
            damping[place] = 0.0
        name = joints[place]
        if kind == "velocity" and stiffness[place] > 0.0:
            raise given[0].fail(
                f"is {stiffness[place]:g} at {name}, which is given velocities: it would be held "
                "where it stands; give 0 there"
            )
        if kind == "velocity" and damping[place] == 0.0:
            raise given[1].fail(
                f"is 0 at {name}, which is given velocities: nothing would turn it; give the "
                "damping that it was trained with"
            )
    return stiffness, damping


def filter_spec(said: FactValue, period: float, start: str) -> FilterSpec | None:
    """Return a filter of an action or a term.

    Args:
        said: the facts under `filter`.
        period: of the policy in [s].
        start: what it begins with unless that is said.

    Raises:
        PolicyError: a fact is wrong, or not exactly one filter is named.
    """
    if said.value is None:
        return None
    said.mapping(_FILTER)
    named = [key for key in _FILTER[:-1] if said.value.get(key) is not None]
    if len(named) != 1:
        what = f"gives {' and '.join(named)}" if named else "names no filter"
        raise said.fail(f"{what}; give one of low_pass: Hz, alpha: SHARE, moving_average: SAMPLES")
    begin: Any = said.choice("start", *dict.fromkeys((start, "zeros", "first")))
    value = said.at(named[0])
    if named[0] == "moving_average":
        if not is_whole(value.value, 2) or value.value > LONGEST_FILTER:
            raise value.refuse(f"give a whole number of samples from 2 to {LONGEST_FILTER}")
        return FilterSpec(moving_average=value.value, start=begin)
    number = value.single()
    if named[0] == "alpha":
        if not 0.0 < number <= 1.0:
            raise value.refuse("give the weight of the newest sample, above 0 and at most 1")
        return FilterSpec(alpha=float(value.value), start=begin)
    highest = 0.5 / period
    if not 0.0 < number <= highest:
        raise value.refuse(
            f"give the cut-off frequency in [Hz], above 0 and at most {highest:g}, half the "
            "policy's rate"
        )
    return FilterSpec(low_pass=float(value.value), start=begin)


def command_spec(said: FactValue, reads: Set[str]) -> CommandSpec | None:
    """Return how fast the command may change that the policy sees.

    Args:
        said: the facts under `command`.
        reads: states that the policy's terms and its clock take.

    Raises:
        PolicyError: a fact is wrong.
    """
    if said.value is None:
        return None
    said.mapping(("slew",))
    if "velocity_command" not in reads:
        raise said.fail("limits velocity_command, and no term reads that; leave it out")
    if said.value.get("slew") is None:
        raise said.fail("says no slew; give the largest change of vx, vy, wz in [m/s², rad/s²]")
    slew = said.at("slew")
    rates = slew.numbers()
    if rates.size not in (1, 3):
        raise slew.fail(f"has {rates.size} values; give one, or those of vx, vy and wz")
    for i, rate in enumerate(rates):
        if not (0.0 < rate <= LARGEST_SLEW or np.isposinf(rate)):
            raise (slew.part(i, None) if rates.size > 1 else slew).fail(
                f"is {rate:g}; give a change above 0 and at most {LARGEST_SLEW:g} in [m/s², "
                "rad/s²], .inf for any"
            )
    vx, vy, wz = (float(rate) for rate in np.broadcast_to(rates, 3))
    return CommandSpec((vx, vy, wz))
