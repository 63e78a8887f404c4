"""What the fuzz feeds each kind of file to: the way that `check`, `show` and `run` go until ticks.

Every kind is a function of a dice and a folder that writes a mutated file and returns what reads
it. Errors of ours are what it may raise; everything else is a finding.
"""

from __future__ import annotations

import random
import shutil
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mutate import mutate_bytes, mutate_mcap, mutate_onnx, mutate_text, mutate_tree, to_text
from seeds import (
    DEPLOY,
    ENV,
    LEGGED_GYM,
    SET_PATHS,
    STARTS,
    URDF,
    WORKFLOWS,
    XML_SNIPPETS,
)

from unicon_core.check import check_workflow
from unicon_core.errors import Fault
from unicon_core.models.load import load_model
from unicon_core.models.loaded import import_mujoco
from unicon_core.policies import Policy, load_policy, policy_states, policy_table
from unicon_core.robots import load_robot, robot_table
from unicon_core.runtime import Runner, RunOptions
from unicon_core.show import show_text
from unicon_core.states import Layout, States, standard_states
from unicon_core.workflow import load_workflow
from unicon_msgs_map import Decoder, Encoder, load_map
from unicon_ros.recorder import Recorder
from unicon_ros.recording import open_record, recover

__all__ = ["KINDS"]

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config"
POLICY = CONFIG / "policies" / "go2_velocity"
Reader = Callable[[], object]


class _Tagged(yaml.SafeLoader):
    """Reads the seeds; tags of Python become what stands below them."""


def _plain(loader: Any, suffix: str, node: yaml.Node) -> Any:
    if isinstance(node, yaml.MappingNode):
        return loader.construct_mapping(node, deep=True)
    if isinstance(node, yaml.SequenceNode):
        return loader.construct_sequence(node, deep=True)
    return loader.construct_scalar(node)


_Tagged.add_multi_constructor("tag:yaml.org,2002:python/", _plain)


@cache
def tree(text: str) -> Any:
    return yaml.load(text, _Tagged)


@cache
def seeds_of(folder: str) -> tuple[tuple[str, str], ...]:
    files = sorted((CONFIG / folder).glob("*.yaml"))
    return tuple((file.name, file.read_text("utf-8")) for file in files)


def write(path: Path, text: str, dice: random.Random) -> None:
    """Write a mutated YAML file: mostly its tree changed, else its text or its bytes."""
    way = dice.random()
    if way < 0.75:
        text = to_text(mutate_tree(tree(text), dice))
    elif way < 0.92:
        text = mutate_text(text, dice)
    raw = text.encode("utf-8", "surrogatepass")
    path.write_bytes(raw if way < 0.92 else mutate_bytes(raw, dice))


def whole(path: Path, overrides: tuple[str, ...] = (), platform: str = "fake") -> object:
    """Check a workflow, and build it as `show` and `run` do."""
    overrides = (*overrides, f"platform={platform}")
    check_workflow(path, overrides)
    workflow = load_workflow(path, overrides)
    try:
        show_text(
            workflow.root,
            workflow.states,
            workflow.critical,
            robot=workflow.robot,
            policies=workflow.policies,
        )
        speed = "max" if platform == "fake" else "real"
        Runner(workflow, RunOptions(speed=speed, capacity=16)).graph.warm_up()  # type: ignore[arg-type]
        for gate in workflow.gates:
            gate()
    finally:
        workflow.close()
    return workflow


def workflow(dice: random.Random, folder: Path) -> Reader:
    path = folder / "workflow.yaml"
    write(path, dice.choice(WORKFLOWS), dice)
    return lambda: whole(path)


def set_values(dice: random.Random, folder: Path) -> Reader:
    path = folder / "workflow.yaml"
    path.write_text(dice.choice(WORKFLOWS), "utf-8")
    overrides = []
    for _ in range(dice.choice((1, 1, 2, 3))):
        name = dice.choice(SET_PATHS)
        if dice.random() < 0.1:
            name = ".".join([name] * dice.choice((2, 5, 100)))
        value = to_text(mutate_tree({"a": [1, {"b": "x"}]}, dice))
        if dice.random() < 0.4:
            value = mutate_text(value, dice)
        overrides.append(f"{name}={value}")
    return lambda: whole(path, tuple(overrides))


def robot(dice: random.Random, folder: Path) -> Reader:
    name, text = dice.choice(seeds_of("robots"))
    path = folder / name
    write(path, text, dice)
    flow = folder / "workflow.yaml"
    flow.write_text(f"robot: ./{name}\nplatform: fake\nrate: 50\nflow: hold\n", "utf-8")

    def read() -> object:
        found = load_robot(path)
        robot_table(found)
        return whole(flow)

    return read


def policy_folder(folder: Path) -> Path:
    folder = folder / "policy"
    folder.mkdir()
    shutil.copyfile(POLICY / "policy.onnx", folder / "policy.onnx")
    return folder


def loaded(path: Path, **options: Any) -> object:
    """Load a policy, tell of it, and build its block."""
    go2 = load_robot("go2")
    contract = load_policy(path, robot=go2, **options)
    policy_table(contract, go2)
    specs = standard_states(go2.joint_names) | policy_states(contract, go2.joint_names, {})
    return Policy(contract, States(Layout(specs)), go2)


def policy(dice: random.Random, folder: Path) -> Reader:
    path = policy_folder(folder) / "policy.yaml"
    write(path, (POLICY / "policy.yaml").read_text("utf-8"), dice)
    return lambda: loaded(path)


def deploy(dice: random.Random, folder: Path) -> Reader:
    name, text = dice.choice((("deploy.yaml", DEPLOY), ("env.yaml", ENV), ("cfg.yaml", LEGGED_GYM)))
    path = policy_folder(folder) / name
    write(path, text, dice)
    given: dict[str, Any] = {}
    if name != "deploy.yaml":
        contract = tree((POLICY / "policy.yaml").read_text("utf-8"))
        given = {"joints": contract["joints"], "stiffness": 20.0, "damping": 1.0}
    if dice.random() < 0.3:
        given = mutate_tree(given or {"period": 0.02, "action.scale": 0.25}, dice)
        given = given if isinstance(given, dict) else {}
    return lambda: loaded(path, given=given)


def message_map(dice: random.Random, folder: Path) -> Reader:
    name, text = dice.choice(seeds_of("maps"))
    path = folder / name
    write(path, text, dice)
    names = load_robot("go2").joint_names
    arrays = {k: np.zeros(v.shape, v.dtype) for k, v in standard_states(names).items()}
    variables = {"joint_names": list(names)}
    elements = {key: names for key in arrays if key.startswith("joint_")}

    def read() -> object:
        found = load_map(path)
        for spec in found.publish:
            raw = Encoder.build(spec, arrays, elements, variables).encode()
        for heard in found.subscribe:
            decoder = Decoder.build(heard, arrays, elements, variables)
            decoder.decode(raw if found.publish else b"\0\1\0\0")
        return found

    return read


def onnx_model(dice: random.Random, folder: Path) -> Reader:
    folder = policy_folder(folder)
    text = (POLICY / "policy.yaml").read_text("utf-8")
    lines = [line for line in text.split("\n") if not line.startswith("sha256")]
    (folder / "policy.yaml").write_text("\n".join(lines), "utf-8")
    raw = (folder / "policy.onnx").read_bytes()
    changed = mutate_onnx(raw, dice) if dice.random() < 0.7 else mutate_bytes(raw, dice)
    (folder / "policy.onnx").write_bytes(changed)
    path = folder / ("policy.yaml" if dice.random() < 0.8 else "policy.onnx")
    return lambda: loaded(path)


@cache
def recorded() -> bytes:
    """Return a small recording of two topics in three chunks."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "seed.mcap"
        recorder = Recorder(path)
        writers = [recorder.channel(topic, "std_msgs/msg/Int64") for topic in ("a", "b")]
        recorder.start()
        for number in range(30):
            cdr = b"\x00\x01\x00\x00" + number.to_bytes(8, "little")
            writers[number % 2](number + 1, cdr)
            if number % 10 == 9:
                time.sleep(0.5)  # a chunk
        recorder.close()
        return path.read_bytes()


def recording(dice: random.Random, folder: Path) -> Reader:
    """A recording that was cut off, with records changed under right checksums, or rubble."""
    raw, way = recorded(), dice.random()
    if way < 0.2:  # its beginning
        raw = mutate_bytes(raw[:40], dice) + raw[40:]
    elif way < 0.7:
        raw = mutate_mcap(raw, dice)
    else:
        raw = mutate_bytes(raw, dice)
    path = folder / "fuzzed.mcap.partial"
    path.write_bytes(raw[: dice.randrange(len(raw) + 1)] if dice.random() < 0.5 else raw)
    return lambda: recover(path)


def bounds(folder: Path) -> Path:
    """Write the bounds that `observation_stop` of the seed reads."""
    path = folder / "good.npz"
    np.savez(path, lower=np.full(3, -1.0, np.float32), upper=np.full(3, 1.0, np.float32))
    return path


def start(dice: random.Random, folder: Path) -> Reader:
    """A robot's workflow, with gates, approach and the stops of its set."""
    path, file = folder / "workflow.yaml", bounds(folder)
    if dice.random() < 0.3:
        path.write_text(STARTS, "utf-8")
        raw = mutate_bytes(file.read_bytes(), dice)
        file.write_bytes(raw)
    else:
        write(path, STARTS, dice)
    return lambda: whole(path, platform="fake_robot")


@cache
def cut_off() -> bytes:
    """Return a small fault record."""
    from unicon_core import Program, block
    from unicon_ros.fault_record import FaultRecord

    with tempfile.TemporaryDirectory() as folder:
        record = FaultRecord(folder, warn=str)
        program = Program(
            robot="go2", platform="fake", rate=50, flow=block("hold"), hooks=[record.hook]
        )
        runner = Runner(program, RunOptions(speed="max", duration=0.2, warn=str))
        record.attach(runner)

        def trip() -> None:
            raise Fault("tripped by the fuzz")

        program.platform.close = trip  # type: ignore[method-assign]
        path = record.write(runner.run())
        assert path is not None
        return path.read_bytes()


def fault_record(dice: random.Random, folder: Path) -> Reader:
    raw, way = cut_off(), dice.random()
    raw = mutate_mcap(raw, dice) if way < 0.6 else mutate_bytes(raw, dice)
    path = folder / "fault.mcap"
    path.write_bytes(raw[: dice.randrange(len(raw) + 1)] if dice.random() < 0.4 else raw)

    def read() -> object:
        record = open_record(path)
        record.states("joint_pos", "received")
        return record.facts, record.ticks, record.ended

    return read


@cache
def models() -> tuple[tuple[str, str], ...]:
    mjcf = next((CONFIG / "models" / "go2").glob("*.xml")).read_text("utf-8")
    return (("model.xml", mjcf), ("model.urdf", URDF))


def model(dice: random.Random, folder: Path) -> Reader:
    """A model file whose XML asks for what no model needs."""
    name, text = dice.choice(models())
    path = folder / name
    for _ in range(dice.choice((1, 1, 2, 3))):
        places = [at + 1 for at, mark in enumerate(text) if mark == ">"]
        at = dice.choice((0, *places, dice.randrange(len(text))))
        snippet = dice.choice(XML_SNIPPETS)
        if snippet.startswith("<!DOCTYPE"):
            at = text.index("?>") + 2 if text.startswith("<?xml") else 0
            text = text[:at] + snippet + text[at:].replace('name="', 'name="&l11;&e;', 1)
        else:
            text = text[:at] + snippet + text[at:]
    raw = text.encode("utf-8")
    path.write_bytes(mutate_bytes(raw, dice) if dice.random() < 0.2 else raw)
    import_mujoco()  # loads its libraries before anybody watches
    go2 = load_robot("go2")
    return lambda: load_model(path, go2, quiet=True)


KINDS: dict[str, Callable[[random.Random, Path], Reader]] = {
    "workflow": workflow,
    "set": set_values,
    "robot": robot,
    "policy": policy,
    "deploy": deploy,
    "map": message_map,
    "onnx": onnx_model,
    "recording": recording,
    "start": start,
    "record": fault_record,
    "model": model,
}
