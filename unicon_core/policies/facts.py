"""What a source says of a policy, before anything is built: for importers and `load_policy`.

`values` has the shape of `policy.yaml` and holds only what was said; nothing is guessed.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from unicon_base import AnyDict, PolicyError
from unicon_base.located_yaml import Where, read_yaml
from unicon_base.resources import file_beside, find_resource
from unicon_core.policies.hints import MotionSpec

VOCABULARY: AnyDict = read_yaml(Path(__file__).with_name("vocabulary.yaml")).value
"""How other deployments name facts, states and terms."""
# Name of a term on the training side -> where its values come from.
_TERMS: dict[str, AnyDict] = VOCABULARY["parts"] | {
    name: {"state": state} for state, names in VOCABULARY["states"].items() for name in names
}
TO_GIVE = "?"
"""A factor or gain in a policy.yaml that an import wrote and nobody has filled in yet."""
_NEEDED = VOCABULARY["needed"]
_ASKED = _NEEDED | VOCABULARY["asked"]
GAINS = ("stiffness", "damping")
_BY_JOINTS = ("default_joint_pos", *GAINS, "action.scale")


@dataclass
class Facts:
    """What one source says.

    Attributes:
        path: the source's file, named in errors.
        source: its format, such as `Unitree deploy.yaml`.
        values: `policy.yaml`-shaped values, only those that were said.
        lines: line of a value in `path`, by its path of keys in `values`; empty without lines.
        keys: the source's own word for a value, by the same path.
        asks: facts that the source leaves out beyond those always needed: dotted name -> what
            there is to choose from, or "".
        notes: what to say to the user, such as rounding.
        tolerance: relative and absolute rounding of the source's numbers.
        network: the network's file where the importer found it or the workflow names it; None
            where the source names it, which then lies in the source's folder.
        clip: the motion's file, likewise.
        by_pattern: pose and gains stand in the source by patterns of names: `joints` resolves them.
        offer: what the robot's model could say of what is missing, for the message.
    """

    path: Path
    source: str
    values: AnyDict = field(default_factory=dict)
    lines: dict[Where, int] = field(default_factory=dict)
    keys: dict[Where, str] = field(default_factory=dict)
    asks: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    tolerance: tuple[float, float] = (1e-6, 1e-9)
    network: Path | None = None
    clip: Path | None = None
    by_pattern: bool = False
    offer: str = ""

    def say(self, fact: str, value: Any, word: str = "", line: int | None = None) -> None:
        """Note what the source says.

        Args:
            fact: dotted name, such as `action.scale`.
            value: of it.
            word: the source's own word for it.
            line: of it in `path`.
        """
        where = tuple(fact.split("."))
        place = self.values
        for key in where[:-1]:
            place = place.setdefault(key, {})
        place[where[-1]] = value
        if word:
            self.keys[where] = word
        if line is not None:
            self.lines[where] = line

    def beside(self, named: str) -> Path:
        """Return the file that a workflow names, which may be any: relative ones beside the source.

        Args:
            named: a path, `~` for the home folder.
        """
        return self.path.parent / os.path.expanduser(named)

    def _own(self, name: Any, key: str, *where: str) -> Path:
        """Return a file that the source names, in its folder."""
        if not isinstance(name, str):
            raise self.error(where, f"{key} is {shown(name)}; name a file")
        try:
            return file_beside(self.path, name, key, error=PolicyError)
        except PolicyError as error:
            raise self.error(where, str(error)) from error

    def model(self) -> Path:
        """Return the network's file, which need not exist.

        Raises:
            PolicyError: none is named, or one outside the folder of the source.
        """
        if self.network is not None:
            return self.network
        for key in ("onnx", "torchscript"):
            if (name := self.values.get(key)) is not None:
                return self._own(name, key, key)
        raise self.error((), "no network is named; add 'onnx: policy.onnx'")

    def given_clip(self, named: Any) -> None:
        """Take the motion file that a workflow names, which may lie anywhere.

        Args:
            named: a path beside the policy's source, absolute, or `assets:PATH`.

        Raises:
            PolicyError: there is none in the assets.
        """
        if isinstance(named, str):
            in_assets = named.startswith("assets:")
            find = find_resource(named, "motion", error=PolicyError) if in_assets else None
            self.clip = find or self.beside(named)

    def with_clip(self, motion: MotionSpec) -> MotionSpec:
        """Return a motion with the place of its file, if it names one.

        Raises:
            PolicyError: the file is not there, or of no known format.
        """
        if motion.file is None:
            return motion
        named, where = str(motion.file), ("motion", "file")
        path = self.clip or self._own(named, "motion.file", *where)
        text = f"motion.file {named!r} is not a .npz or .csv file; convert it"
        if path.suffix in (".npz", ".csv"):
            if os.path.isfile(path):
                return replace(motion, file=path)
            text = f"motion.file: no such file {path}; put it there or correct the path"
        raise self.error(where, text)

    def error(self, where: Where, message: str) -> PolicyError:
        """Return the error with `file:line` of a value, or of its parent if it has no line."""
        place = where
        while place and place not in self.lines:
            place = place[:-1]
        line = f":{self.lines[place]}" if place in self.lines else ""
        return PolicyError(message, f"{self.path}{line}")


def term_state(name: str, *, absolute: bool = False) -> AnyDict:
    """Return `state` (and `index`, `subtract`) of a term's usual name, empty if it is unknown.

    Args:
        name: the training side's name.
        absolute: whether a plain `joint_pos` means the position itself.
    """
    term = dict(_TERMS.get(name, {}))
    if term.get("state") == "joint_pos" and not (absolute and name == "joint_pos"):
        term["subtract"] = "default_joint_pos"
    return term


def dotted(where: Where) -> str:
    """Return a path of keys as `observation.terms[3].scale`."""
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in where)
    return text.removeprefix(".")


def missing_facts(facts: Facts) -> dict[str, str]:
    """Return the facts that are needed and not known: dotted name -> what it is."""
    values, place = facts.values, "observation.terms"
    missing = {name: what for name, what in _NEEDED.items() if value_of(values, name) is None}
    for name in _BY_JOINTS:
        if left := open_joints(facts, name):
            missing[name] = f"{_NEEDED[name]}; {TO_GIVE} stands for {', '.join(left)}"
    if facts.by_pattern and "joints" in missing:  # by which the source says these
        missing = {name: what for name, what in missing.items() if name not in _BY_JOINTS}
    terms = value_of(values, place)
    if terms == []:
        missing[place] = _NEEDED[place]
    if isinstance(inputs := values.get("inputs"), Mapping) and "observation" not in inputs:
        missing.pop(place, None)
    for term in terms if isinstance(terms, list) else []:
        said = [dig(term, key) is not None for key in ("name", "state", "value")]
        if said == [True, False, False]:
            missing[f"observation.terms.{term['name']}.state"] = "the state that it is taken from"
        if dig(term, "state") == "height_scan" and value_of(values, "height_scan") is None:
            missing["height_scan"] = "size and resolution of its grid in [m]"
    for name, detail in facts.asks.items():
        missing[name] = "; ".join(filter(None, (_ASKED.get(name, ""), detail)))
    return missing


def open_joints(facts: Facts, name: str) -> list[str]:
    """Return the joints for which a list of the facts has `?`."""
    values, joints = value_of(facts.values, name), facts.values.get("joints")
    if not isinstance(values, list) or not isinstance(joints, list) or len(values) != len(joints):
        return []
    return [str(joint) for joint, value in zip(joints, values) if is_open(value)]


def is_open(value: Any) -> bool:
    """Return whether a value, or one of a list, is still to be given."""
    return any(
        isinstance(one, str) and one == TO_GIVE
        for one in (value if isinstance(value, list) else [value])
    )


def dig(tree: Any, *keys: str | int) -> Any:
    """Return what stands under keys of nested mappings and lists, None where nothing does."""
    for key in keys:
        if isinstance(tree, list) and isinstance(key, int):
            tree = tree[key] if key < len(tree) else None
        else:
            tree = tree.get(key) if isinstance(tree, Mapping) else None
    return tree


def says(values: Any, fact: str) -> bool:
    """Return whether facts hold a fact, and leave nothing of it open.

    Args:
        values: the facts; `observation.terms` may be a mapping by name.
        fact: dotted; `observation.terms` means the whole list, `observation.terms.NAME.scale` a
            term's, `observation.terms.*.scale` and `observation.scale` those of every term.
    """
    term, _, key = fact.removeprefix("observation.terms.").rpartition(".")
    value, terms = value_of(values, fact), value_of(values, "observation.terms")
    if fact == "observation.terms":
        return isinstance(terms, list | tuple) and bool(terms)
    if value is not None or (term != "observation" and not fact.startswith("observation.terms.")):
        return value is not None and not is_open(value)
    if key == "scale" and value_of(values, "observation.scale") is not None:
        return True
    named = list(terms.items()) if isinstance(terms, Mapping) else []
    named += [(dig(t, "name"), t) for t in terms] if isinstance(terms, list | tuple) else []
    chosen = [t for name, t in named if term in ("*", "observation") or name == term]
    return bool(chosen) and all(dig(t, key) is not None for t in chosen)


def value_of(values: Any, name: str) -> Any:
    """Return what stands under a dotted name, None where nothing does."""
    return dig(values, *name.split("."))


def shown(value: Any) -> str:
    """Return a value for a message, cut off after 60 characters."""
    text = " ".join(str(value).split())
    return text if len(text) <= 60 else f"{text[:59]}…"
