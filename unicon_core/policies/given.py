"""What a user gives beside a source, merged into its facts: for importers and `load_policy`.

Two sources of one policy, its file and the network's metadata, have to say the same: policy and
configuration must not drift apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from unicon_base import AnyDict, AnyMapping, PolicyError, alternatives
from unicon_base.located_yaml import Where
from unicon_base.schema.marks import Write
from unicon_base.schema.read import read_value
from unicon_core.policies.facts import TO_GIVE, Facts, dig, dotted, is_open, says, shown, value_of
from unicon_core.policies.importers.source import values_by_pattern
from unicon_core.robots.robot import plain_name
from unicon_core.text_table import figure

_CHANGE = Annotated[AnyMapping, Write("{scale: 0.05}")]
_TERMS = (
    Annotated[Mapping[str, _CHANGE], Write("{joint_vel: {scale: 0.05}}")]
    | Annotated[list[Any], Write("a list")]
)


def nested(path: Path, given: AnyMapping) -> AnyDict:
    """Return what a user gives with nested keys: `action.scale` stands under `action`.

    Args:
        path: of the source, for messages.
        given: keys of `policy.yaml`, nested or dotted.

    Raises:
        PolicyError: a fact is given twice, or also as a whole.
    """
    made: AnyDict = {}
    for key, value in given.items():
        place = made
        *steps, last = str(key).split(".")
        for step in steps:
            place = place.setdefault(step, {})
            if not isinstance(place, dict):
                raise PolicyError(
                    f"{path}: given {shown(key)}: {step} is given as {shown(place)} too; write it "
                    "once, as a mapping"
                )
        if isinstance(value, Mapping):
            known = place.get(last)
            value = {**(known if isinstance(known, dict) else {}), **value}
        place[last] = value
    return made


def merge_given(facts: Facts, given: AnyMapping) -> None:
    """Add facts that the user gives; a fact that the source says otherwise is refused.

    Args:
        facts: changed in place.
        given: `nested` keys of `policy.yaml`; `observation.terms` may be a mapping from a term's
            name to what is to be added, or the list with terms that the source lacks, and
            `observation.scale` one factor for every term whose scale was not said.

    Raises:
        PolicyError: a given fact contradicts the source, or names no term.
    """
    given = dict(given)
    if isinstance(given.get("observation"), dict):
        observation = dict(given.pop("observation"))
        _merge_terms(facts, observation)
        if observation:  # not all of it was of the terms
            given["observation"] = observation
    _merge(facts, facts.values, given, ())
    for name in [name for name in facts.asks if says(given, name) or says(facts.values, name)]:
        del facts.asks[name]


def _merge_terms(facts: Facts, observation: AnyDict) -> None:
    """Bring given terms into the source's list of terms, by name."""
    given, scale = observation.pop("terms", None), observation.pop("scale", None)
    if given is not None:
        given = read_value(
            _TERMS,
            given,
            lambda _, text: PolicyError(f"{facts.path}: given {text}"),
            "observation.terms",
        )
    if facts.values.get("observation") is None:
        facts.values["observation"] = {}
    target = facts.values["observation"]
    terms = dig(target, "terms") or []
    terms = terms if isinstance(terms, list) else [terms]
    if not isinstance(target, dict) or not all(isinstance(term, dict) for term in terms):
        return  # build_contract refuses the source
    if given is not None and terms:
        for i, extra in _changes(facts, terms, given):
            _merge(facts, terms[i], extra, ("observation", "terms", i))
    elif isinstance(given, Mapping):
        raise PolicyError(
            f"{facts.path}: given observation.terms changes terms by name, and the {facts.source} "
            "has none; give the whole list of terms in order"
        )
    elif given is not None:
        target["terms"] = terms = list(given)
    if scale is not None:
        for term in terms:
            if isinstance(term, dict) and term.get("scale", TO_GIVE) == TO_GIVE:
                term["scale"] = scale
        facts.asks.pop("observation.scale", None)


def _changes(facts: Facts, terms: list[Any], given: Any) -> list[tuple[int, AnyMapping]]:
    """Return the place of a term and what is added to it; terms of a given list are put in."""
    names = [term.get("name") for term in terms]
    if isinstance(given, Mapping):
        for name in given:
            if name not in names:
                known = alternatives(str(name), map(str, names))
                text = f"given observation.terms has no term {name!r} to change; {known}"
                raise PolicyError(f"{facts.path}: {text}")
        return [(names.index(name), extra) for name, extra in given.items()]
    order = [item.get("name") if isinstance(item, Mapping) else item for item in given]
    if [name for name in order if name in names] != names or not all(
        isinstance(name, str) for name in order
    ):
        raise PolicyError(
            f"{facts.path}: given observation.terms are {', '.join(map(str, order))} but the "
            f"{facts.source} says {', '.join(map(str, names))}; name the same terms in the same "
            "order; others may stand between them"
        )
    said = dict(zip(names, terms))
    terms[:] = [said.get(name, {"name": name}) for name in order]
    return [(i, item) for i, item in enumerate(given) if isinstance(item, Mapping)]


def _merge(facts: Facts, said: AnyDict, given: AnyMapping, where: Where) -> None:
    for key, value in given.items():
        place, known = (*where, key), said.get(key)
        if isinstance(known, list) and is_open(known):  # what the source leaves open in a list
            values = value if isinstance(value, list | tuple) else [value] * len(known)
            if len(values) == len(known):
                known = [new if is_open(old) else old for old, new in zip(known, values)]
        if isinstance(value, Mapping) and isinstance(known, dict):
            _merge(facts, known, value, place)
        elif known in (None, TO_GIVE) or _same(known, value, facts.tolerance):
            said[key] = value
        else:
            word = f" ({facts.keys[place]})" if place in facts.keys else ""
            raise facts.error(
                place,
                f"{facts.source} says {dotted(place)} is {shown(said[key])}{word} and given says "
                f"{shown(value)}; remove it from 'given', or correct the file",
            )


def _same(known: Any, value: Any, tolerance: tuple[float, float]) -> bool:
    if known == value:
        return True
    try:
        a, b = np.asarray(known, float), np.asarray(value, float)
    except (TypeError, ValueError, OverflowError):
        return False
    alike = a.shape == b.shape or 1 in (a.size, b.size)
    return alike and bool(np.allclose(a, b, *tolerance))


def check_agreement(facts: Facts, other: Facts, given: AnyMapping) -> None:
    """Compare what a file says with the metadata of the network that it names, joint by joint.

    Args:
        facts: what is going to be used.
        other: what the network's metadata say.
        given: what the user says settles it; a note says the difference.

    Raises:
        PolicyError: a joint's number differs by more than the rounding of both sources.
    """
    joints, names = facts.values.get("joints"), other.values.get("joints")
    if not isinstance(joints, list) or not isinstance(names, list):
        return
    mine_of = {plain_name(str(name)): name for name in joints}  # a robot's names, with _joint
    names = [mine_of.get(plain_name(str(name)), name) for name in names]
    if unknown := [name for name in joints if name not in names]:
        raise facts.error(
            ("joints",),
            f"joint {unknown[0]!r} is not in the metadata of {other.path.name}, which has "
            f"{', '.join(map(str, names))}; contract and network do not belong together",
        )
    relative, absolute = map(max, facts.tolerance, other.tolerance)
    for key in ("default_joint_pos", "stiffness", "damping", "action.scale"):
        mine, theirs = _by_joint(facts.values, key, joints), _by_joint(other.values, key, names)
        for joint in joints:
            a, b = mine.get(joint), theirs.get(joint)
            if a is None or b is None or np.isclose(a, b, relative, absolute):
                continue
            differs = (
                f"{key} of {joint} is {figure(a)} here and {figure(b)} in the metadata of "
                f"{other.path.name}"
            )
            if not says(given, key):
                remedy = "correct one of them, or export both again"
                raise facts.error(tuple(key.split(".")), f"{differs}; {remedy}")
            facts.notes.append(f"{facts.path.name}: {differs}; what is given counts")
            break


def _by_joint(values: AnyMapping, key: str, joints: list[str]) -> dict[str, float]:
    moved = value_of(values, "action.joints")
    if key == "action.scale" and isinstance(moved, list):
        joints = [str(name) for name in moved]
    return dict(zip(joints, values_by_pattern(value_of(values, key), joints) or ()))
