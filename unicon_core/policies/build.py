"""From facts to a checked PolicyContract, for every importer; every error is one line."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.bounds import ACTION_SCALE, DAMPING, POSITION, SCALE, STIFFNESS
from unicon_core.errors import PolicyError, alternatives
from unicon_core.located_yaml import Where
from unicon_core.policies.contract import (
    ActionSpec,
    ObservationSpec,
    ObservationTerm,
    PhaseSpec,
    PolicyContract,
    Recurrent,
)
from unicon_core.policies.facts import Facts, dotted, missing_facts
from unicon_core.robots import joint_index

__all__ = ["build_contract"]

SCHEMA = "unicon.policy/1"

_KEYS = (
    "schema", "name", "description", "onnx", "torchscript", "sha256", "period", "robot", "joints",
    "default_joint_pos", "action", "stiffness", "damping", "observation", "inputs", "outputs",
    "recurrent", "command_ranges", "phase", "sources",
)  # fmt: skip
_ACTION = ("scale", "offset", "clip", "joints", "feedback")
_OBSERVATION = ("terms", "layout", "newest", "start")
_TERM = ("name", "state", "index", "subtract", "scale", "clip", "history")
_PHASE = ("period", "offsets", "stand", "stand_below", "command")


def build_contract(facts: Facts) -> PolicyContract:
    """Check facts and build the contract.

    Raises:
        PolicyError: facts are missing (all are named, with how to give them) or wrong.
    """
    values = facts.values
    missing = missing_facts(facts)
    if missing:
        names = "; ".join(f"{name} ({what})" if what else name for name, what in missing.items())
        remedy = (
            f"add it to {facts.path.name}"
            if facts.source == "policy.yaml"
            else "give it under 'given' in the workflow, with the keys of policy.yaml"
        )
        raise PolicyError(f"{facts.path}: the {facts.source} does not say {names}; {remedy}")
    check = _Check(facts)
    check.keys((), values, _KEYS)
    schema = values.get("schema", SCHEMA)
    if schema != SCHEMA:
        raise facts.error(("schema",), f"schema is {schema!r}; this program reads {SCHEMA!r}")
    joints = check.names(("joints",), values["joints"])
    count = len(joints)
    default = check.vector(("default_joint_pos",), count, "joint", -POSITION, POSITION)
    stiffness = check.vector(("stiffness",), count, "joint", 0.0, STIFFNESS)
    damping = check.vector(("damping",), count, "joint", 0.0, DAMPING)
    inputs = check.mapping(("inputs",), values.get("inputs") or {})
    outputs = check.mapping(("outputs",), values.get("outputs") or {})
    sha256 = values.get("sha256")
    if sha256 is not None and not (isinstance(sha256, str) and len(sha256) == 64):
        raise facts.error(("sha256",), f"sha256 is {sha256!r}; give the 64 digits of 'sha256sum'")
    robot = values.get("robot")
    return PolicyContract(
        name=str(values.get("name") or facts.path.parent.name or facts.path.stem),
        path=facts.path,
        model=facts.model(),
        period=check.positive(("period",), values["period"], "the control period in [s]"),
        joints=joints,
        default_joint_pos=default,
        action=check.action(joints, default),
        stiffness=stiffness,
        damping=damping,
        observation=check.observation(bool(inputs) and "observation" not in inputs),
        inputs=MappingProxyType({str(k): str(v) for k, v in inputs.items()}),
        outputs=MappingProxyType({str(k): str(v) for k, v in outputs.items()}),
        recurrent=check.recurrent(),
        command_ranges=MappingProxyType(check.ranges()),
        phase=check.phase(),
        robot=None if robot is None else str(robot),
        sha256=None if sha256 is None else sha256.lower(),
        source=facts.source,
        notes=tuple(facts.notes),
    )


class _Check:
    """The checks of single values; every method raises PolicyError with the place."""

    def __init__(self, facts: Facts) -> None:
        self.facts = facts
        self.values = facts.values

    def fail(self, where: Where, message: str) -> PolicyError:
        return self.facts.error(where, message)

    def keys(self, where: Where, value: Mapping[str, Any], known: tuple[str, ...]) -> None:
        for key in value:
            if key not in known:
                inside = f" in {dotted(where)}" if where else ""
                raise self.fail(
                    (*where, key), f"unknown key {key!r}{inside}; {alternatives(str(key), known)}"
                )

    def mapping(self, where: Where, value: Any) -> Mapping[str, Any]:
        if not isinstance(value, Mapping):
            raise self.fail(where, f"{dotted(where)} is {value!r}; give a mapping")
        return value

    def names(self, where: Where, value: Any) -> tuple[str, ...]:
        if not isinstance(value, (list, tuple)) or not all(isinstance(v, str) for v in value):
            raise self.fail(where, f"{dotted(where)} is {value!r}; give a list of joint names")
        if not value:
            raise self.fail(where, f"{dotted(where)} is empty; name at least one joint")
        for name in value:
            if value.count(name) > 1:
                raise self.fail(
                    where, f"joint {name!r} stands twice in {dotted(where)}; name each joint once"
                )
        return tuple(value)

    def get(self, where: Where) -> Any:
        value: Any = self.values
        for key in where:
            value = value[key] if isinstance(key, int) else value.get(key)
        return value

    def numbers(self, where: Where, value: Any) -> NDArray[np.float32]:
        """One number or a list of numbers, as float32 of shape (k,)."""
        listed = list(value) if isinstance(value, (list, tuple, np.ndarray)) else [value]
        for i, item in enumerate(listed):
            place = (*where, i) if len(listed) > 1 else where
            if isinstance(item, bool) or not isinstance(item, (int, float, np.number)):
                raise self.fail(place, f"{dotted(place)} is {item!r}; give a number")
            if np.isnan(float(item)):
                raise self.fail(place, f"{dotted(place)} is nan; give a number")
        if not listed:
            raise self.fail(where, f"{dotted(where)} is empty; give one number or a list")
        array = np.array(listed, dtype=np.float32)
        array.flags.writeable = False
        return array

    def finite(self, where: Where, array: NDArray[np.float32]) -> NDArray[np.float32]:
        bad = np.flatnonzero(~np.isfinite(array))
        if bad.size:
            place = (*where, int(bad[0])) if array.size > 1 else where
            raise self.fail(place, f"{dotted(place)} is {array[bad[0]]}; give a finite number")
        return array

    def vector(
        self, where: Where, count: int, each: str, lowest: float, highest: float
    ) -> NDArray[np.float32]:
        array = self.finite(where, self.numbers(where, self.get(where)))
        if array.size == 1 and count > 1:
            array = np.full(count, array[0], np.float32)
        if array.size != count:
            raise self.fail(
                where,
                f"{dotted(where)} has {array.size} values for {count} {each}s; give one for each "
                f"{each} in policy order",
            )
        return self.plausible(where, array, lowest, highest)

    def plausible(
        self, where: Where, array: NDArray[np.float32], lowest: float, highest: float
    ) -> NDArray[np.float32]:
        bad = np.flatnonzero((array < lowest) | (array > np.float32(highest)))
        if bad.size:
            i = int(bad[0])
            bound = f"at least {lowest:g}" if array[i] < lowest else f"at most {highest:g}"
            raise self.fail((*where, i), f"{dotted((*where, i))} is {array[i]}; it must be {bound}")
        return array

    def positive(self, where: Where, value: Any, what: str) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 1e6:
            raise self.fail(where, f"{dotted(where)} is {value!r}; give {what}, above 0")
        return float(value)

    def choice(self, where: Where, values: Mapping[str, Any], *known: str) -> Any:
        """The word under the last key of `where`; the first known one where it is not said."""
        value = values.get(str(where[-1]), known[0])
        if value not in known:
            raise self.fail(where, f"{dotted(where)} is {value!r}; known: {', '.join(known)}")
        return value

    def clip(self, where: Where, value: Any, count: int | None) -> NDArray[np.float32] | None:
        """`[lowest, highest]`, each one number or a list; shape (2, 1) or (2, count)."""
        if value is None:
            return None
        if not isinstance(value, (list, tuple)) or len(value) != 2:
            raise self.fail(where, f"{dotted(where)} is {value!r}; give [lowest, highest] or null")
        sides = [self.numbers((*where, i), side) for i, side in enumerate(value)]
        width = max(side.size for side in sides)
        for i, side in enumerate(sides):
            if side.size not in (1, width) or (count is not None and side.size not in (1, count)):
                raise self.fail(
                    (*where, i),
                    f"{dotted((*where, i))} has {side.size} values; give 1 or {count or width}",
                )
        array = np.stack([np.broadcast_to(side, (width,)) for side in sides])
        bad = np.flatnonzero(array[0] > array[1])
        if bad.size:
            low, high = array[:, bad[0]]
            raise self.fail(
                where, f"{dotted(where)} is [{low:g}, {high:g}]; the lowest must come first"
            )
        return array

    def action(self, joints: tuple[str, ...], default: NDArray[np.float32]) -> ActionSpec:
        where: Where = ("action",)
        action = self.mapping(where, self.values["action"])
        self.keys(where, action, _ACTION)
        moved = joints
        if action.get("joints") is not None:
            moved = self.names((*where, "joints"), action["joints"])
            for name in moved:
                if name not in joints:
                    raise self.fail(
                        (*where, "joints"),
                        f"action.joints names {name!r}, which is not in joints; "
                        f"{alternatives(name, joints)}",
                    )
        count = len(moved)
        scale = self.vector((*where, "scale"), count, "joint", -ACTION_SCALE, ACTION_SCALE)
        if action.get("offset") is None:
            offset = default[joint_index(moved, joints)]
        else:
            offset = self.vector((*where, "offset"), count, "joint", -POSITION, POSITION)
        clip = self.clip((*where, "clip"), action.get("clip"), count)
        return ActionSpec(
            moved,
            scale,
            offset,
            None if clip is None else np.array(np.broadcast_to(clip, (2, count))),
            self.choice((*where, "feedback"), action, "raw", "clipped"),
        )

    def observation(self, optional: bool) -> ObservationSpec:
        where: Where = ("observation",)
        value = self.values.get("observation")
        if value is None and optional:
            return ObservationSpec(())
        observation = self.mapping(where, value)
        self.keys(where, observation, _OBSERVATION)
        place = (*where, "terms")
        listed = observation.get("terms") or []
        if not isinstance(listed, (list, tuple)):
            raise self.fail(place, "observation.terms is no list; give '- {name: …, state: …}'")
        terms = tuple(self.term((*place, i), term) for i, term in enumerate(listed))
        layout = self.choice((*where, "layout"), observation, "term_major", "frame_major")
        lengths = {term.history for term in terms}
        if layout == "frame_major" and len(lengths) > 1:
            odd = next(term for term in terms if term.history != terms[0].history)
            raise self.fail(
                (*where, "layout"),
                f"observation.layout is frame_major, but term {terms[0].name!r} has history "
                f"{terms[0].history} and term {odd.name!r} {odd.history}; "
                "give all terms one history, or use term_major",
            )
        return ObservationSpec(
            terms,
            layout,
            self.choice((*where, "newest"), observation, "last", "first"),
            self.choice((*where, "start"), observation, "first", "zeros"),
        )

    def term(self, where: Where, value: Any) -> ObservationTerm:
        if not isinstance(value, Mapping) or not isinstance(value.get("name"), str):
            raise self.fail(where, f"{dotted(where)} has no name; give 'name:' and 'state:'")
        self.keys(where, value, _TERM)
        state = value["state"]
        if not isinstance(state, str):
            raise self.fail((*where, "state"), f"{dotted((*where, 'state'))} is {state!r}; name it")
        index = value.get("index")
        if index is not None:
            index = list(index) if isinstance(index, (list, tuple)) else [index]
            for i in index:
                if isinstance(i, bool) or not isinstance(i, int) or i < 0:
                    raise self.fail(
                        (*where, "index"),
                        f"{dotted((*where, 'index'))} has {i!r}; give whole numbers from 0",
                    )
        subtract = value.get("subtract")
        if isinstance(subtract, str):
            if subtract != "default_joint_pos":
                raise self.fail(
                    (*where, "subtract"),
                    f"{dotted((*where, 'subtract'))} is {subtract!r}; "
                    "known: default_joint_pos, or numbers",
                )
        elif subtract is not None:
            subtract = self.finite(
                (*where, "subtract"), self.numbers((*where, "subtract"), subtract)
            )
        scale = value.get("scale")
        scale = self.numbers((*where, "scale"), 1.0 if scale is None else scale)
        history = value.get("history", 1)
        if isinstance(history, bool) or not isinstance(history, int) or history < 1:
            raise self.fail(
                (*where, "history"),
                f"{dotted((*where, 'history'))} is {history!r}; give a whole number from 1",
            )
        return ObservationTerm(
            value["name"],
            state,
            None if index is None else tuple(index),
            subtract,
            self.plausible((*where, "scale"), self.finite((*where, "scale"), scale), -SCALE, SCALE),
            self.clip((*where, "clip"), value.get("clip"), None),
            history,
        )

    def recurrent(self) -> tuple[Recurrent, ...]:
        pairs = self.values.get("recurrent") or []
        result = []
        for i, pair in enumerate(pairs if isinstance(pairs, (list, tuple)) else [pairs]):
            if not isinstance(pair, Mapping) or set(pair) != {"input", "output"}:
                raise self.fail(
                    ("recurrent", i), f"recurrent[{i}] is {pair!r}; give {{input: …, output: …}}"
                )
            result.append(Recurrent(str(pair["input"]), str(pair["output"])))
        return tuple(result)

    def ranges(self) -> dict[str, tuple[float, float]]:
        where: Where = ("command_ranges",)
        result = {}
        for name, value in self.mapping(where, self.values.get("command_ranges") or {}).items():
            pair = self.clip((*where, name), value, 1)
            if pair is not None:
                result[str(name)] = (float(pair[0, 0]), float(pair[1, 0]))
        return result

    def phase(self) -> PhaseSpec | None:
        where: Where = ("phase",)
        value = self.values.get("phase")
        if value is None:
            return None
        self.keys(where, self.mapping(where, value), _PHASE)
        offsets = self.finite(
            (*where, "offsets"),
            self.numbers((*where, "offsets"), value.get("offsets", [0.0, np.pi])),
        )
        stand = value.get("stand")
        if stand is not None:
            stand = float(self.numbers((*where, "stand"), stand)[0])
        below = float(self.numbers((*where, "stand_below"), value.get("stand_below", 0.01))[0])
        return PhaseSpec(
            self.positive((*where, "period"), value.get("period"), "the gait's period in [s]"),
            tuple(float(offset) for offset in offsets),
            stand,
            below,
            str(value.get("command", "velocity_command")),
        )
