"""What the fuzz feeds each kind of file to: the way that `check`, `show` and `run` go until ticks.

Every kind is a function of a dice and a folder that writes a mutated file and returns what reads
it. Errors of ours are what it may raise; everything else is a finding.
"""

from __future__ import annotations

import copy
import os
import random
import shutil
import tempfile
import time
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from kinds_bag import bags, replays
from kinds_safety import preflight, safety, scene, start
from mutate import mutate_bytes, mutate_mcap, mutate_onnx, mutate_text, mutate_tree, to_text
from reading import Reader, tree, whole, write
from seeds import (
    AGIBOT,
    DEPLOY,
    ENCODINGS,
    ENV,
    FOREIGN,
    HUMANOID,
    INCLUDED,
    LEGGED_GYM,
    LEROBOT,
    LIMX,
    MEMBERS,
    SET_PATHS,
    SWEEP,
    URDF,
    WORKFLOWS,
    XML_SNIPPETS,
)

from unicon_base.errors import Fault
from unicon_core.models.kinematic_tree import read_tree
from unicon_core.models.load import load_model
from unicon_core.models.loaded import import_mujoco
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.mujoco import make as mujoco_platform
from unicon_core.policies import Policy, load_policy, policy_states, policy_table
from unicon_core.robots import load_robot, robot_table
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import Layout, States, standard_states
from unicon_lab.recording import open_record, recover
from unicon_lab.recording.recorder import Recorder
from unicon_lab.sweep.plan import Plan
from unicon_lab.sweep.sweep_file import read_sweep
from unicon_msgs_map import Decoder, Encoder, load_map

__all__ = ["KINDS"]

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config"
POLICY = CONFIG / "policies" / "go2_velocity"


@cache
def seeds_of(folder: str) -> tuple[tuple[str, str], ...]:
    files = sorted((CONFIG / folder).glob("*.yaml"))
    return tuple((file.name, file.read_text("utf-8")) for file in files)


def workflow(dice: random.Random, folder: Path) -> Reader:
    path = folder / "workflow.yaml"
    import_mujoco()  # by which blocks compute kinematics
    seed = dice.choice(WORKFLOWS)
    write(path, seed, dice)
    return lambda: whole(path, platform=platform_of(seed, dice))


def set_values(dice: random.Random, folder: Path) -> Reader:
    path = folder / "workflow.yaml"
    import_mujoco()  # by which blocks compute kinematics
    seed = dice.choice(WORKFLOWS)
    path.write_text(seed, "utf-8")
    overrides = []
    for _ in range(dice.choice((1, 1, 2, 3))):
        name = dice.choice(SET_PATHS)
        if dice.random() < 0.1:
            name = ".".join([name] * dice.choice((2, 5, 100)))
        value = to_text(mutate_tree({"a": [1, {"b": "x"}]}, dice))
        if dice.random() < 0.4:
            value = mutate_text(value, dice)
        overrides.append(f"{name}={value}")
    return lambda: whole(path, tuple(overrides), platform_of(seed, dice))


def platform_of(seed: str, dice: random.Random) -> str:
    """Return a platform that moves nothing: of members each its own, mostly."""
    return "{body: fake, hands: fake}" if seed == MEMBERS and dice.random() < 0.8 else "fake"


def robot(dice: random.Random, folder: Path) -> Reader:
    import_mujoco()  # of which what joints turn is asked, where gains are too hard
    name, text = dice.choice(seeds_of("robots"))
    path = folder / name
    if dice.random() < 0.4:  # the robot's wire alone
        values = copy.deepcopy(tree(text))
        values["transport"] = mutate_tree(values["transport"], dice)
        path.write_text(to_text(values), "utf-8")
    else:
        write(path, text, dice)
    flow = folder / "workflow.yaml"
    flow.write_text(f"robot: ./{name}\nplatform: fake\nrate: 50\nflow: hold\n", "utf-8")
    platform = dice.choice(("fake", "fake_robot"))

    def read() -> object:
        found = load_robot(path)
        robot_table(found)
        return whole(flow, platform=platform)

    return read


def policy_folder(folder: Path) -> Path:
    import_mujoco()  # by which a missing fact is offered from the model
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
    text = dice.choice((FOREIGN, (POLICY / "policy.yaml").read_text("utf-8")))
    seen = "images: {rgb_image: {size: [8, 8], crop: [1, 0, 0, 2], range: [0.1, 3], rate: 9}}"
    seen = f"height_scan: {{size: [1.6, 1.0], resolution: 0.1, order: yx}}\n{seen}\n"
    write(path, f"{text}{seen}", dice)
    given: Any = {}
    if dice.random() < 0.3:
        terms = {"joint_vel_rel": {"scale": 0.05}}
        given = mutate_tree({"observation.terms": terms, "observation.scale": 1.0}, dice)
    return lambda: loaded(path, given=given if isinstance(given, dict) else {})


DEPLOYED = (
    ("deploy.yaml", DEPLOY), ("env.yaml", ENV), ("cfg.yaml", LEGGED_GYM), ("cfg.py", HUMANOID),
    ("params.yaml", LIMX), ("rl_x1.yaml", AGIBOT), ("config.json", LEROBOT),
)  # fmt: skip


def deploy(dice: random.Random, folder: Path) -> Reader:
    name, text = dice.choice(DEPLOYED)
    path = policy_folder(folder) / name
    if name == "cfg.py":
        path.write_text(mutate_text(text, dice), "utf-8", "surrogatepass")
    else:
        write(path, text, dice)
    for network in ("encoder", "policy") if name == "params.yaml" else ():
        below = path.parent / "policy" / "isaacgym"
        below.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(POLICY / "policy.onnx", below / f"{network}.onnx")
    given: dict[str, Any] = {}
    if name in ("env.yaml", "cfg.yaml", "cfg.py", "config.json"):
        contract = tree((POLICY / "policy.yaml").read_text("utf-8"))
        keys = ["joints", "inputs", "outputs", "recurrent"]
        if name == "config.json":
            keys = ["joints", "period", "default_joint_pos", "stiffness", "damping"]
        given = {key: contract[key] for key in keys if key in contract}
        if name == "config.json":
            (path.parent / "model.safetensors").touch()
            chunk = {"execution": "real_time", "period": 0.02, "hold": 0.1, "underrun": "done"}
            terms = {"environment_state": {"state": "base_lin_vel"}}
            given |= {"chunk": chunk, "observation": {"terms": terms}}
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
                time.sleep(0.9)  # a chunk
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


@cache
def cut_off() -> bytes:
    """Return a small fault record."""
    from unicon_core import Program, block
    from unicon_lab.fault_record import FaultRecord

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


def sweep(dice: random.Random, folder: Path) -> Reader:
    import_module("scipy.stats")  # which runs code of its own where it is imported
    seeds = [ROOT / "examples" / name for name in ("terrain.yaml", "go2_exam.yaml")]
    path = folder / "sweep.yaml"
    write(path, dice.choice([*(seed.read_text("utf-8") for seed in seeds), SWEEP]), dice)

    def read() -> object:
        plan = Plan(read_sweep(path))
        return [plan.row(i).settings for i in (0, len(plan) - 1)]

    return read


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
    for other, inside in INCLUDED.items():
        (folder / other).write_text(inside, "utf-8")
    os.mkfifo(folder / "pipe.xml")
    encoding = dice.choice(ENCODINGS) if dice.random() < 0.15 else "utf-8"
    if dice.random() < 0.5:
        text = text.replace('encoding="utf-8"', f'encoding="{encoding}"')
    raw = text.encode(encoding, "replace")
    path.write_bytes(mutate_bytes(raw, dice) if dice.random() < 0.2 else raw)
    import_mujoco()  # loads its libraries before anybody watches
    go2 = load_robot("go2")

    def read() -> object:
        read_tree(load_model(path, go2, quiet=True).model, go2)
        states = States(Layout(standard_states(go2.joint_names)))
        platform = mujoco_platform(states, go2, 0.02, scene=Scene(model=path))
        try:
            platform.recv()
            platform.send()
        finally:
            platform.close()
        return platform

    return read


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
    "safety": safety,
    "sweep": sweep,
    "scene": scene,
    "preflight": preflight,
    "bag": bags,
    "replay": replays,
}
