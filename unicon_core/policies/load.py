"""Finding a policy by name, folder or file, in whatever format: what workflows and tools call."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from unicon_base import AnyDict, AnyMapping, PolicyError, alternatives
from unicon_base.located_yaml import Located, Where, read_yaml
from unicon_base.packages import path_of, registered
from unicon_base.resources import (
    config_roots,
    find_resource,
    list_config,
    looked_in,
    lying_here,
    sha256_of,
)
from unicon_core.policies.contract import TORCHSCRIPT, PolicyContract
from unicon_core.policies.facts import Facts, dig, missing_facts
from unicon_core.policies.file import build_contract
from unicon_core.policies.from_model import FromModel
from unicon_core.policies.given import check_agreement, merge_given, nested
from unicon_core.policies.importers.env_yaml import WEIGHTS, env_yaml_facts, suggest_joints
from unicon_core.policies.importers.formats import (
    configuration_reader,
    counts_motors,
    metadata_reader,
    read_python,
    settled,
)
from unicon_core.policies.importers.source import Source
from unicon_core.policies.networks.onnx_file import OnnxFile, read_onnx
from unicon_core.policies.policy_yaml import (
    policy_yaml_facts,
    write_partial_yaml,
    write_policy_yaml,
)
from unicon_core.robots import Robot, load_robot

# Files that carry no name of their own: the policy is called after the folder.
_PLAIN_STEMS = ("policy", "deploy", "env", "model", "config")
_PLAIN_FOLDERS = re.compile(r"params|exported|config|[\d_.T:-]{8,}")  # or a date


@dataclass(frozen=True)
class ImportReport:
    """What an import gave.

    Attributes:
        path: the `policy.yaml` written.
        source: the format that was read.
        missing: dotted facts that the source does not say -> what each is; they are to be added.
        notes: what else to know, such as rounding.
    """

    path: Path
    source: str
    missing: Mapping[str, str]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        lines = [f"{self.path}  (from {self.source})"]
        if self.missing:
            lines.append("not said by the source, add to the file or under 'given':")
            lines += [f"  {name}: {what}".rstrip(": ") for name, what in self.missing.items()]
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])


def policy_names() -> list[str]:
    """Return the names of the policies in `config/policies/` and of registered ones, sorted."""
    ours = [name for name in list_config("policies", "/") if _config_policy(name) is not None]
    return sorted({*ours, *registered("policies")})


def load_policy(
    reference: str | Path,
    *,
    robot: Robot | None = None,
    given: AnyMapping | None = None,
    model: Callable[[], Path] | None = None,
) -> PolicyContract:
    """Load a policy in any known format.

    Args:
        reference: a name in `config/policies/` or of an entry point in the group
            `unicon.policies`, a folder, a file (`policy.yaml`, `deploy.yaml`, `env.yaml`, `.onnx`,
            TorchScript), `assets:PATH`, or `package://NAME/PATH`.
        robot: gives joint names to a `deploy.yaml`, which only counts motors, unless `given` names
            the robot that it was made for.
        given: facts that the source leaves out, with the keys of `policy.yaml`, nested or dotted.
        model: finds the file that `{from: model}` means; the robot's own unless it is given.

    Returns:
        The checked contract; its network file exists.

    Raises:
        PolicyError: nothing there; facts missing (all are named) or contradictory; files missing.
    """
    return _contract(_read(reference, robot, given or {}, model))


_OF_NETWORK = (
    "schema name onnx torchscript networks sha256 inputs outputs recurrent feeds chunk provider"
)
# Stands for what only the robot's end needs.
_UNSAID: AnyDict = {
    "period": 0.01,
    "joints": ["any"],
    **dict.fromkeys(("default_joint_pos", "stiffness", "damping"), 0.0),
    "action": {"scale": 1.0},
    "observation": {"terms": [{"name": "any", "value": 0.0}]},
}


def load_network(reference: str | Path, provider: str | None = None) -> PolicyContract:
    """Load what a server needs of a policy: its network, with the tensors that are named.

    Pose, gains, period and terms of the contract say nothing: the source may lack them.

    Args:
        reference: as for `load_policy`.
        provider: where the network runs, instead of what the policy says.

    Raises:
        PolicyError: as for `load_policy`, of the network alone.
    """
    facts = _read(reference, None, {} if provider is None else {"provider": provider})
    words = _OF_NETWORK.split()
    facts.values = _UNSAID | {key: said for key, said in facts.values.items() if key in words}
    facts.asks = {key: what for key, what in facts.asks.items() if key in words}
    return _contract(facts)


def import_policy(
    reference: str | Path,
    out_dir: str | Path,
    *,
    robot: Robot | None = None,
    given: AnyMapping | None = None,
    force: bool = False,
) -> ImportReport:
    """Write a policy of any known format as `policy.yaml`, and list what its source did not say.

    Args:
        reference: as for `load_policy`; a path that is there comes before a name.
        out_dir: folder to write to; the network is copied there.
        robot: as for `load_policy`.
        given: as for `load_policy`.
        force: replace a `policy.yaml` that is there.

    Raises:
        PolicyError: as for `load_policy`, except that missing facts are listed, not refused, but
            for joints by which the source's patterns are resolved; or a policy is there.
    """
    if not str(reference).startswith("assets:") and os.path.exists(os.path.expanduser(reference)):
        reference = Path(reference)
    refuse_to_replace(Path(out_dir) / "policy.yaml", force)
    facts = _read(reference, robot, given or {})
    if facts.network is not None and facts.network.name == WEIGHTS:
        raise PolicyError(f"{facts.path}: LeRobot's folder runs as it is; name it under policies:")
    missing = missing_facts(facts)
    if facts.by_pattern and "joints" in missing:
        raise PolicyError(
            f"{facts.path}: pose and gains stand there by patterns of joint names, and it does not "
            f"say joints ({missing['joints']}); name them: --joints NAME,NAME… or --joints FILE, "
            "or of a robot's model: --robot ROBOT --joints '{from: model}'"
        )
    if missing:
        path = write_partial_yaml(facts, missing, out_dir)
    else:
        path = write_policy_yaml(_contract(facts), out_dir)
    return ImportReport(path, facts.source, missing, tuple(facts.notes))


def refuse_to_replace(path: Path, force: bool) -> None:
    """Raise a PolicyError where something is at a path that is to be written, unless `force`."""
    if os.path.lexists(path) and not force:
        raise PolicyError(f"{path} is there; give another --out, or replace it: --force")


def _config_policy(name: str) -> Path | None:
    folders = (root / "policies" / name for root in config_roots())
    return next((f for f in folders if os.path.isdir(f) and _main_file(f) is not None), None)


def _locate(reference: str | Path) -> Path:
    text = str(reference)
    here = os.path.expanduser(text)
    if text.startswith("assets:"):
        path = find_resource(text, "policy", error=PolicyError)
    elif os.path.exists(here) and ("/" in text or isinstance(reference, Path)):
        path = Path(here).resolve()
    elif "/" not in text and (named := _config_policy(text)) is not None:
        path = named
    elif text in (known := registered("policies")):
        # A module attribute, imported now: a path, or a function that returns one.
        found = path_of(known[text], f"policy {text!r}", PolicyError)
        if found is None:
            raise PolicyError(f"policy {text!r} (entry point {known[text].value}) returned no path")
        path = found
    elif "/" in text or Path(text).suffix in (".yaml", ".onnx", ".mnn", *TORCHSCRIPT):
        path = find_resource(text, "policy", error=PolicyError)
    else:
        raise PolicyError(
            f"unknown policy {text!r}; {lying_here(text)}{alternatives(text, policy_names())}; "
            f"{looked_in('policies')}; or give a path to a folder or file"
        )
    if os.path.isfile(path):
        return path
    if not os.path.isdir(path):
        raise PolicyError(f"policy {text!r} is neither a file nor a folder; correct the path")
    if (main := _main_file(path)) is not None:
        return main
    if several := _configurations(path):
        text = f"{len(several)} policies are in this folder; name the file of one: "
        raise PolicyError(f"{path}: {text}{', '.join(each.name for each in several)}")
    text = "no policy in this folder; put policy.yaml, deploy.yaml, env.yaml or exactly one .onnx"
    raise PolicyError(f"{path}: {text} there")


def _main_file(folder: Path) -> Path | None:
    def first(*names: str) -> Path | None:
        return next((folder / name for name in names if os.path.isfile(folder / name)), None)

    if found := first("policy.yaml", "deploy.yaml", "params/deploy.yaml"):
        return found
    if first(WEIGHTS) and (found := first("config.json")):
        return found
    models = sorted(folder.glob("*.onnx"))
    if len(models) == 1 and metadata_reader(read_onnx(models[0])):
        return models[0]
    if found := first("env.yaml", "params/env.yaml"):
        return found
    models = (
        _configurations(folder)
        or models
        or sorted(p for p in folder.glob("*") if p.suffix in (*TORCHSCRIPT, ".mnn"))
    )
    return models[0] if len(models) == 1 else None


def _configurations(folder: Path) -> list[Path]:
    """The files of a folder that are configurations of others' deployments, by what they hold."""
    found = []
    for path in sorted(folder.glob("*.yaml")):
        with suppress(PolicyError):  # of a file that was not named
            if configuration_reader(_yaml(path).value):
                found.append(path)
    # rl_sar's base.yaml is a part of the others, not a policy.
    return [path for path in found if path.name != "base.yaml"] or found


def _read(
    reference: str | Path,
    robot: Robot | None,
    given: AnyMapping,
    model: Callable[[], Path] | None = None,
) -> Facts:
    path = _locate(reference)
    said = FromModel(path, nested(path, given), robot, model)
    # Isaac's simulators count joints breadth first.
    isaac = path.suffix in (".yaml", ".yml") and said.asks("joints")
    isaac = isaac and configuration_reader(_yaml(path).value) is env_yaml_facts
    said.joints("breadth_first" if isaac else "depth_first")
    facts = _facts_of(path, robot, said.given)
    said.others(facts.values.get("joints"))
    given, values = said.given, facts.values
    if "provider" in given:  # of the machine that runs it, so the workflow may say another
        values.pop("provider", None)
    merge_given(facts, given)
    for key in ("onnx", "torchscript"):
        if isinstance(given.get(key), str):  # of the workflow, which may name any file
            facts.network = facts.beside(given[key])
    facts.given_clip(dig(given, "motion", "file"))
    values.setdefault("name", _name_of(path))
    if "torchscript" in values:  # its tensors have no names: one goes in, one comes out
        values.setdefault("inputs", {"observation": "observation"})
        values.setdefault("outputs", {"action": "action"})
    elif "onnx" in values:
        onnx = read_onnx(facts.model())
        if lost := onnx.lost_weights():
            raise facts.error(("onnx",), f"the weights of {onnx.path.name} {lost}")
        _name_tensors(facts, onnx)
        suggest_joints(facts, [tensor.width for tensor in onnx.outputs])
        if facts.path != onnx.path and metadata_reader(onnx):
            whole = facts.source == "policy.yaml"
            once, notes = settled(onnx, values, facts.path.name, whole=whole)
            facts.notes += notes
            if (reader := metadata_reader(once)) is not None:
                check_agreement(facts, reader(once), given)
    facts.notes += said.notes
    facts.offer = said.offer(facts)
    return facts


def _yaml(path: Path) -> Located:
    return read_yaml(path, PolicyError, foreign=True)


def _facts_of(path: Path, robot: Robot | None, given: AnyMapping) -> Facts:
    if path.suffix in (".onnx", ".mnn"):
        onnx = read_onnx(path)
        for beside in ("policy.yaml", "deploy.yaml", "../params/deploy.yaml"):
            other = path.parent / beside
            if os.path.isfile(other):
                facts = _facts_of(other.resolve(), robot, given)
                if "onnx" in facts.values and facts.model().resolve() == path.resolve():
                    return facts
        if (reader := metadata_reader(onnx)) is not None:
            once, notes = settled(onnx, given, "given")
            facts = reader(once)
            facts.notes += notes
            return facts
        return Facts(path, "ONNX file (no metadata)", {"onnx": path.name})
    if path.suffix in TORCHSCRIPT:
        return Facts(path, "TorchScript file", {"torchscript": path.name})
    located = read_python(path) if path.suffix == ".py" else _yaml(path)
    made_for = given.get("robot")
    if isinstance(made_for, str) and counts_motors(located.value):
        robot = load_robot(made_for)  # whichever robot runs the policy
    configured = configuration_reader(located.value)
    if configured is None:
        return policy_yaml_facts(located)
    facts = configured(Source(located, given, robot))
    if facts.network is None and "onnx" not in facts.asks:
        _add_model(facts)
    return facts


def _add_model(facts: Facts) -> None:
    """Find the one network that belongs to a file which does not name it."""
    folder = facts.path.parent
    for place in (folder, folder.parent / "exported", folder / "exported"):
        for suffix, key in ((".onnx", "onnx"), (".pt", "torchscript")):
            models = sorted(place.glob(f"*{suffix}"))
            if len(models) == 1:
                facts.values[key] = models[0].name
                facts.network = models[0]
                return
    facts.asks["onnx"] = f"no single network is beside {facts.path.name}"


def _name_of(path: Path) -> str:
    if path.stem not in _PLAIN_STEMS:
        return path.stem
    folder = path.parent
    while _PLAIN_FOLDERS.fullmatch(folder.name):
        folder = folder.parent
    return folder.name or path.stem


def _name_tensors(facts: Facts, onnx: OnnxFile) -> None:
    """Fill in the names of inputs and outputs where there is no choice; else they are asked for."""
    values = facts.values
    if values.get("networks"):  # the observation is split among them by 'feeds'
        values.setdefault("inputs", {"observation": "observation"})
    pairs = values.get("recurrent")
    listed = pairs if isinstance(pairs, list | tuple) else []
    for key, canonical, tensors in (
        ("inputs", "observation", onnx.inputs),
        ("outputs", "action", onnx.outputs),
    ):
        if values.get(key):
            continue
        fed_back = [dig(pair, key.removesuffix("s")) for pair in listed]
        free = [tensor for tensor in tensors if tensor.name not in fed_back]
        if len(free) == 1:
            values[key] = {canonical: free[0].name}
        else:
            facts.asks[key] = f"it has {', '.join(map(str, free)) or 'none'}"


def _contract(facts: Facts) -> PolicyContract:
    """Build the contract, whose network is there and the one that it was written for."""
    contract = build_contract(facts)
    for part in (contract.parts[-1], *contract.networks):
        model, wanted = part.model, part.sha256
        where: Where = ("networks", part.name)
        if not part.name:
            where = ("torchscript" if contract.is_torchscript else "onnx",)
        if not os.path.isfile(model):
            text = f"no such file {model}; put the network there or correct the path"
            raise facts.error(where, text)
        if part.name and (lost := read_onnx(model).lost_weights()):
            raise facts.error(where, f"its weights {lost}")
        if wanted is not None and (digest := sha256_of(model)) != wanted:
            raise facts.error(
                where if part.name else ("sha256",),
                f"{model.name} has sha256 {digest[:12]}… and not {wanted[:12]}…; it is not the "
                "network that this contract was written for: import it again",
            )
    return contract
