"""What a user gives beside a source, merged into its facts: for importers and `load_policy`.

Two sources of one policy, its file and the network's metadata, have to say the same: policy and
configuration must not drift apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from unicon_base.errors import PolicyError, alternatives
from unicon_base.located_yaml import Where
from unicon_base.schema.marks import Names, Write
from unicon_base.schema.read import read_value
from unicon_core.policies.facts import TO_GIVE, Facts, dig, dotted, is_open, says, shown, value_of
from unicon_core.policies.importers.training import values_by_pattern
from unicon_core.robots.robot import plain_name
from unicon_core.text_table import figure

_CHANGE = Annotated[Mapping[str, Any], Write("{scale: 0.05}")]
_TERMS = (
    Annotated[Mapping[str, _CHANGE], Write("{joint_vel: {scale: 0.05}}")]
    | Annotated[list[Any], Write("a list")]
)


def given_joints(path: Path, given: Mapping[str, Any]) -> list[str] | None:
    """Return the joint names that the user gives, by which a source's patterns are resolved.

    Raises:
        PolicyError: they are not a list of names.
    """
    joints = given.get("joints")
    return None if joints is None else list(_checked(path, "joints", Names, joints))


def _checked(path: Path, fact: str, hint: Any, value: Any) -> Any:
    """Return a given fact as a hint has it."""
    return read_value(hint, value, lambda _, text: PolicyError(f"{path}: given {text}"), fact)


def nested(path: Path, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a user gives with nested keys: `action.scale` stands under `action`.

    Args:
        path: of the source, for messages.
        given: keys of `policy.yaml`, nested or dotted.

    Raises:
        PolicyError: a fact is given twice, or also as a whole.
    """
    made: dict[str, Any] = {}
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
        if isinstance(value, Mapping) and isinstance(place.get(last), dict):
            place[last].update(value)
        else:
            place[last] = dict(value) if isinstance(value, Mapping) else value
    return made


def merge_given(facts: Facts, given: Mapping[str, Any]) -> None:
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
    observation = given.get("observation")
    if isinstance(observation, dict):
        given["observation"] = observation = dict(observation)
        _merge_terms(facts, observation)
        if not observation:  # all of it was of the terms
            del given["observation"]
    _merge(facts, facts.values, given, ())
    for name in list(facts.asks):
        if _answered(name, given, facts.values):
            del facts.asks[name]


def _answered(name: str, given: Mapping[str, Any], values: Mapping[str, Any]) -> bool:
    both = (value_of(given, name), value_of(values, name))
    if any(value is not None and not is_open(value) for value in both):
        return True
    listed = dig(values, "observation", "terms")
    terms = listed if isinstance(listed, list) else []
    if name.startswith("observation.terms."):
        term, _, key = name.removeprefix("observation.terms.").rpartition(".")
        return any(dig(each, "name") == term and dig(each, key) is not None for each in terms)
    if name == "observation.scale":
        return bool(terms) and all("scale" in term for term in terms)
    return False


def _merge_terms(facts: Facts, observation: dict[str, Any]) -> None:
    """Bring given terms into the source's list of terms, by name."""
    given = observation.pop("terms", None)
    if given is not None:
        given = _checked(facts.path, "observation.terms", _TERMS, given)
    if facts.values.get("observation") is None:
        facts.values["observation"] = {}
    target = facts.values["observation"]
    terms = dig(target, "terms")
    if not isinstance(target, dict) or (terms and not _are_mappings(terms)):
        return  # build_contract refuses the source
    if given is not None and not terms:
        if isinstance(given, Mapping):
            raise PolicyError(
                f"{facts.path}: given observation.terms changes terms by name, and the "
                f"{facts.source} has none; give the whole list of terms in order"
            )
        target["terms"] = terms = list(given)
    elif given is not None:
        changes = _by_name if isinstance(given, Mapping) else _in_order
        for i, extra in changes(facts, terms, given):
            _merge(facts, terms[i], dict(extra), ("observation", "terms", i))
    scale = observation.pop("scale", None)
    if scale is not None:
        for term in terms or ():
            if isinstance(term, dict) and term.get("scale", TO_GIVE) == TO_GIVE:
                term["scale"] = scale
        facts.asks.pop("observation.scale", None)


def _are_mappings(terms: Any) -> bool:
    return isinstance(terms, list) and all(isinstance(term, dict) for term in terms)


Changes = list[tuple[int, Mapping[str, Any]]]
"""Place of a term, and what is added to it."""


def _by_name(facts: Facts, terms: list[dict[str, Any]], given: Mapping[str, Any]) -> Changes:
    names = [term.get("name") for term in terms]
    for name in given:
        if name not in names:
            raise PolicyError(
                f"{facts.path}: given observation.terms has no term {name!r} to change; "
                f"{alternatives(str(name), map(str, names))}"
            )
    return [(names.index(name), extra) for name, extra in given.items()]


def _in_order(facts: Facts, terms: list[dict[str, Any]], given: Sequence[Any]) -> Changes:
    """The source's terms, which are named in their order; others between them are put in."""
    names = [term.get("name") for term in terms]
    order = [item.get("name") if isinstance(item, Mapping) else item for item in given]
    added = all(isinstance(name, str) for name in order)
    if added and order != names and [name for name in order if name in names] == names:
        said = dict(zip(names, terms))
        terms[:] = [said.get(name, {"name": name}) for name in order]
        names = order
    if order != names:
        raise PolicyError(
            f"{facts.path}: given observation.terms are {', '.join(map(str, order))} but "
            f"the {facts.source} says {', '.join(map(str, names))}; name the same terms in "
            "the same order; others may stand between them"
        )
    return [(i, item) for i, item in enumerate(given) if isinstance(item, Mapping)]


def _merge(facts: Facts, said: dict[str, Any], given: Mapping[str, Any], where: Where) -> None:
    for key, value in given.items():
        place = (*where, key)
        known = _filled(said.get(key), value)
        if isinstance(value, Mapping) and isinstance(known, dict):
            _merge(facts, known, value, place)
        elif known in (None, TO_GIVE) or _same(known, value, facts.tolerance):
            said[key] = value
        else:
            word = facts.keys.get(place)
            raise facts.error(
                place,
                f"{facts.source} says {dotted(place)} is {shown(said[key])}"
                f"{f' ({word})' if word else ''} and given says {shown(value)}; "
                "remove it from 'given', or correct the file",
            )


def _filled(known: Any, given: Any) -> Any:
    """What the source says, the values that it leaves open in a list taken from what is given."""
    if not isinstance(known, list) or not is_open(known):
        return known
    values = given if isinstance(given, (list, tuple)) else [given] * len(known)
    if len(values) != len(known):
        return known
    return [value if is_open(each) else each for each, value in zip(known, values)]


def _same(known: Any, value: Any, tolerance: tuple[float, float]) -> bool:
    if known == value:
        return True
    try:
        a, b = np.asarray(known, dtype=float), np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return False
    if a.shape != b.shape and 1 not in (a.size, b.size):
        return False
    return bool(np.allclose(a, b, rtol=tolerance[0], atol=tolerance[1]))


_VECTORS = ("default_joint_pos", "stiffness", "damping", "action.scale")


def check_agreement(facts: Facts, other: Facts, given: Mapping[str, Any]) -> None:
    """Compare what a file says with the metadata of the network that it names, joint by joint.

    Args:
        facts: what is going to be used.
        other: what the network's metadata say.
        given: what the user says settles it; a note tells the difference.

    Raises:
        PolicyError: a joint's number differs by more than the rounding of both sources.
    """
    joints, names = facts.values.get("joints"), other.values.get("joints")
    if not isinstance(joints, list) or not isinstance(names, list):
        return
    mine_of = {plain_name(str(name)): name for name in joints}  # a robot's names, with _joint
    names = [mine_of.get(plain_name(str(name)), name) for name in names]
    unknown = [name for name in joints if name not in names]
    if unknown:
        raise facts.error(
            ("joints",),
            f"joint {unknown[0]!r} is not in the metadata of {other.path.name}, which has "
            f"{', '.join(map(str, names))}; contract and network do not belong together",
        )
    relative, absolute = map(max, facts.tolerance, other.tolerance)
    for key in _VECTORS:
        mine, theirs = _by_joint(facts.values, key, joints), _by_joint(other.values, key, names)
        if mine is None or theirs is None:
            continue
        for joint in joints:
            a, b = mine.get(joint), theirs.get(joint)
            if a is None or b is None or np.isclose(a, b, rtol=relative, atol=absolute):
                continue
            differs = (
                f"{key} of {joint} is {figure(a)} here and {figure(b)} in the metadata of "
                f"{other.path.name}"
            )
            if not says(given, key):
                raise facts.error(
                    tuple(key.split(".")),
                    f"{differs}; correct one of them, or export both again",
                )
            facts.notes.append(f"{facts.path.name}: {differs}; what is given counts")
            break


def _by_joint(values: Mapping[str, Any], key: str, joints: list[str]) -> dict[str, float] | None:
    value, moved = value_of(values, key), value_of(values, "action.joints")
    if key == "action.scale" and isinstance(moved, list):
        joints = moved
    found = values_by_pattern(value, joints)
    return None if found is None else dict(zip(joints, found))
