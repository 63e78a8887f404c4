"""`networks` and `feeds` of a policy.yaml: reading them, and checking their files."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from unicon_core.errors import PolicyError
from unicon_core.located_yaml import Where
from unicon_core.policies.contract import Feed, NetworkPart, PolicyContract
from unicon_core.policies.facts import Facts
from unicon_core.policies.networks.onnx_file import read_onnx
from unicon_core.resources import file_beside, sha256_of

_NAME = re.compile(r"[A-Za-z]\w{0,63}")
_FEED = re.compile(r"([^\[\]]+)(?:\[(\d{1,6}):(\d{1,6})\])?")
_KEYS = ("onnx", "sha256", "feeds")

Feeds = Mapping[str, tuple[Feed, ...]]


def chain_facts(facts: Facts) -> tuple[tuple[NetworkPart, ...], Feeds]:
    """Return the networks before the one that gives the action, and what fills the inputs of that.

    Raises:
        PolicyError: a value of no known form.
    """
    listed, feeds = facts.values.get("networks"), facts.values.get("feeds")
    if not listed:
        if feeds:
            raise facts.error(("feeds",), "feeds goes with 'networks'; name them, or leave it out")
        return (), MappingProxyType({})
    if "torchscript" in facts.values:
        raise facts.error(("networks",), "networks needs ONNX; export the network of the action so")
    if not isinstance(listed, Mapping):
        raise facts.error(("networks",), "networks needs {NAME: {onnx: …, feeds: …}}")
    parts = []
    for name, said in listed.items():
        where: Where = ("networks", name)
        if not isinstance(name, str) or not _NAME.fullmatch(name) or name == "observation":
            raise facts.error(where, f"networks: {name!r} is not a name; use letters and digits")
        if not isinstance(said, Mapping) or not isinstance(said.get("onnx"), str):
            raise facts.error(where, f"networks.{name} needs {{onnx: FILE, feeds: …}}")
        for key in said:
            if key not in _KEYS:
                known = ", ".join(_KEYS)
                raise facts.error(where, f"networks.{name}: no key {key!r}; known: {known}")
        digest = said.get("sha256")
        if digest is not None and not (isinstance(digest, str) and len(digest) == 64):
            raise facts.error(where, f"networks.{name}.sha256: give the 64 digits of 'sha256sum'")
        model = file_beside(facts.path, said["onnx"], "onnx", error=PolicyError)
        filled = _feeds(facts, (*where, "feeds"), said.get("feeds"))
        parts.append(NetworkPart(name, model, filled, digest and digest.lower()))
    return tuple(parts), _feeds(facts, ("feeds",), feeds)


def _feeds(facts: Facts, where: Where, said: Any) -> Feeds:
    place = ".".join(map(str, where))
    if not isinstance(said, Mapping) or not said:
        raise facts.error(where, f"{place} needs {{INPUT: [observation, NAME.output]}}")
    result = {}
    for name, sources in said.items():
        texts = sources if isinstance(sources, (list, tuple)) else [sources]
        result[str(name)] = tuple(_feed(facts, where, f"{place}.{name}", text) for text in texts)
        if not texts:
            raise facts.error(where, f"{place}.{name} is empty; say what fills it")
    return MappingProxyType(result)


def _feed(facts: Facts, where: Where, place: str, text: Any) -> Feed:
    match = _FEED.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        raise facts.error(
            where, f"{place} has {text!r}; write observation, observation[0:45] or NAME.output"
        )
    source, start, stop = match.groups()
    if start is None:
        return Feed(source)
    if int(start) >= int(stop):
        raise facts.error(where, f"{place} has {text!r}, which is empty; the first comes first")
    return Feed(source, int(start), int(stop))


def check_chain(facts: Facts, contract: PolicyContract) -> None:
    """Refuse networks that are missing, or are other ones than the contract was written for.

    Raises:
        PolicyError: names the network.
    """
    for part in contract.networks:
        where: Where = ("networks", part.name)
        if not os.path.isfile(part.model):
            raise facts.error(where, f"no such file {part.model}; put the network there")
        lost = read_onnx(part.model).missing_external()
        if lost:
            raise facts.error(where, f"its weights are in {lost[0].name}; put it beside it")
        digest = sha256_of(part.model)
        if part.sha256 is not None and digest != part.sha256:
            raise facts.error(
                where,
                f"{part.model.name} has sha256 {digest[:12]}… and not {part.sha256[:12]}…; it is "
                "not the network that this contract was written for: import it again",
            )
