"""An encoder and an actor in one policy give, bit for bit, what a plain loop of both gives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from policy_helpers import robot, toy_values, write_graph, write_linear, write_toy
from slow_network import workflow, write_slow

from unicon_base.errors import PolicyError, UniconError
from unicon_core.check import check_workflow
from unicon_core.policies import Policy, import_policy, load_policy, policy_states
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States, standard_states
from unicon_core.workflow import Program, load_document

onnxruntime: Any = pytest.importorskip("onnxruntime", reason="the networks are ONNX")

FEEDS = {"obs": ["observation[3:15]", "encoder.latent"]}
ENCODER = {"onnx": "encoder.onnx", "feeds": {"history": ["observation"]}}


def write_encoder(path: Path) -> None:
    """Write `latent, h_out = tanh(history · w + h_in · u)`, an encoder with a memory."""
    random = np.random.default_rng(3)
    weights = {"w": random.normal(size=(15, 5)), "u": random.normal(size=(5, 5))}

    write_graph(
        path,
        """a = MatMul(history, w)
        b = MatMul(h_in, u)
        c = Add(a, b)
        latent = Tanh(c)
        h_out = Identity(latent)""",
        ["history", "h_in"],
        {"history": [1, 15], "h_in": [1, 5], "latent": [1, 5], "h_out": [1, 5]},
        weights,
    )


def chained(**changes: Any) -> dict[str, Any]:
    """Values of a policy of both networks."""
    values = {
        "networks": {"encoder": ENCODER},
        "feeds": FEEDS,
        "recurrent": [{"input": "encoder.h_in", "output": "encoder.h_out"}],
        "outputs": {"action": "actions", "latent": "encoder.latent"},
    }
    return toy_values(**{**values, **changes})


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The two networks and their policy.yaml."""
    write_encoder(tmp_path / "encoder.onnx")
    write_linear(tmp_path / "policy.onnx", 17, 4)
    write_toy(tmp_path, chained())
    return tmp_path


def policy_of(folder: Path) -> tuple[Policy, States]:
    contract, machine = load_policy(folder), robot()
    specs = standard_states(machine.joint_names) | policy_states(contract, machine.joint_names)
    states = States(specs)
    return Policy(contract, states, machine), states


def test_it_is_bit_equal_to_a_plain_loop(folder: Path) -> None:
    policy, states = policy_of(folder)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    encoder, actor = (
        onnxruntime.InferenceSession(
            str(folder / f"{name}.onnx"), options, providers=["CPUExecutionProvider"]
        )
        for name in ("encoder", "policy")
    )
    random, memory = np.random.default_rng(0), np.zeros((1, 5), np.float32)
    for _ in range(50):
        for name in ("base_ang_vel", "joint_pos", "joint_vel"):
            states[name][...] = random.normal(size=states[name].shape)
        policy.warm_up()  # must not move the memory
        policy()
        vector = states["observation"][None]
        latent, memory = encoder.run(["latent", "h_out"], {"history": vector, "h_in": memory})
        joined = np.concatenate([vector[:, 3:15], latent], axis=1)
        (action,) = actor.run(["actions"], {"obs": joined})
        assert states["action"].tobytes() == action.tobytes()
        assert states["latent"].tobytes() == latent.tobytes()
    assert np.abs(memory).max() > 0.0


def test_reset_forgets_the_memory_of_each_network(folder: Path) -> None:
    policy, states = policy_of(folder)
    states["joint_vel"][...] = 1.0
    policy()
    first = states["action"].copy()
    policy()
    assert (states["action"] != first).any()
    policy.reset()
    policy()
    assert states["action"].tobytes() == first.tobytes()


def test_an_import_takes_all_networks_and_pins_each(folder: Path, tmp_path: Path) -> None:
    import_policy(folder, tmp_path / "out")
    contract = load_policy(tmp_path / "out")
    (part,) = contract.networks
    assert part.sha256 is not None
    assert contract.sha256 is not None
    assert list(map(str, contract.feeds["obs"])) == FEEDS["obs"]
    write_linear(tmp_path / "out" / "encoder.onnx", 15, 5)
    with pytest.raises(PolicyError, match=r"encoder.onnx has sha256 .* import it again"):
        load_policy(tmp_path / "out")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"feeds": {"obs": ["observation[4:15]", "encoder.latent"]}}, "has 16 values and obs"),
        ({"feeds": {"obs": ["observation[3:15]", "encoder.latnt"]}}, "nothing before it is called"),
        ({"feeds": {"odd": ["observation"]}}, "has no input 'odd'"),
        ({"feeds": {"obs": ["observation[3:15]", "encoder.latent[0:9]"]}}, "is beyond"),
        ({"feeds": None}, "feeds needs"),
        ({"feeds": {"obs": ["observation[9:3]"]}}, "which is empty"),
        ({"feeds": {"obs": [3]}}, "write observation"),
        ({"networks": None}, "feeds goes with 'networks'"),
        ({"networks": {"encoder": {**ENCODER, "onnx": "absent.onnx"}}}, "no such file"),
        ({"networks": {"encoder": {**ENCODER, "onnx": "../encoder.onnx"}}}, "is not in the folder"),
        ({"networks": {"encoder": {**ENCODER, "gain": 1}}}, "networks.encoder: unknown key 'gain'"),
        ({"networks": {"a.b": ENCODER}}, "write a name of letters"),
        ({"recurrent": None}, "nothing feeds input encoder.h_in"),
    ],
)
def test_what_does_not_fit_is_named(folder: Path, changes: dict[str, Any], message: str) -> None:
    write_toy(folder, chained(**changes))
    with pytest.raises(PolicyError, match=message.replace("[", r"\[")):
        policy_of(folder)


@pytest.mark.parametrize("batch", ["n", 1])
def test_several_robots_get_what_each_would_alone(tmp_path: Path, batch: int | str) -> None:
    write_linear(tmp_path / "encoder.onnx", 15, 5, batch=batch, names=("history", "latent"))
    write_linear(tmp_path / "policy.onnx", 17, 4, batch=batch)
    write_toy(tmp_path, chained(recurrent=None))
    contract, machine = load_policy(tmp_path), robot()
    specs = standard_states(machine.joint_names) | policy_states(contract, machine.joint_names)
    many, one = States(specs, 3), States(specs)
    all_at_once, alone = Policy(contract, many, machine), Policy(contract, one, machine)
    many["joint_vel"][...] = np.random.default_rng(0).normal(size=(3, 4))
    all_at_once()
    for row in range(3):
        alone.reset()
        one["joint_vel"][...] = many["joint_vel"][row]
        alone()
        np.testing.assert_allclose(many["action"][row], one["action"], rtol=1e-5, atol=1e-6)


def test_a_tensor_without_a_width_is_refused(folder: Path) -> None:
    shapes: dict[str, list[int | str]] = {"history": ["n"], "latent": [5]}
    encoder, weight = folder / "encoder.onnx", {"w": np.ones((15, 5))}
    write_graph(encoder, "latent = MatMul(history, w)", ["history"], shapes, weight)
    write_toy(folder, chained(recurrent=None))
    with pytest.raises(PolicyError, match="is not \\(batch × width\\) of float32"):
        policy_of(folder)


def chain_for_go2(tmp_path: Path) -> Path:
    """Write a workflow with a policy of an encoder and an actor; return it."""
    write_slow(tmp_path)
    write_linear(tmp_path / "encoder.onnx", 39, 5, names=("history", "latent"))
    write_linear(tmp_path / "actor.onnx", 44, 12)
    values = yaml.safe_load((tmp_path / "policy.yaml").read_text())
    values |= {
        "onnx": "actor.onnx",
        "networks": {"encoder": {"onnx": "encoder.onnx", "feeds": {"history": ["observation"]}}},
        "feeds": {"obs": ["observation[0:39]", "encoder.latent"]},
        "inputs": {"observation": "observation"},
        "outputs": {"action": "actions"},
        "recurrent": None,
    }
    (tmp_path / "policy.yaml").write_text(yaml.safe_dump(values), "utf-8")
    path = tmp_path / "flow.yaml"
    path.write_text(yaml.safe_dump(workflow(tmp_path, None)), "utf-8")
    return path


def test_a_replay_names_the_network_that_is_another_one(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    from unicon_lab.recording import open_record
    from unicon_lab.replay.workflow import others
    from unicon_ros.cli.main import main

    path, bag = chain_for_go2(tmp_path), tmp_path / "run.mcap"
    words = ["run", str(path), "--speed", "max", "--duration", "0.2", "--record", str(bag)]
    assert main(words) == 0
    record = open_record(bag)
    assert others(record, Program(load_document(path), dry=True)) == []
    other = np.ones((39, 5), np.float32)
    write_linear(tmp_path / "encoder.onnx", 39, 5, names=("history", "latent"), weight=other)
    (told,) = others(record, Program(load_document(path), dry=True))
    assert told.startswith(f"policy 'slow', network 'encoder': {tmp_path / 'encoder.onnx'} is not")
    assert main(["replay", str(bag), "--verify"]) == 1


def test_check_names_the_sizes_of_each_network(tmp_path: Path) -> None:
    path = chain_for_go2(tmp_path)
    text = check_workflow(path).text(200)
    assert "the networks and what fills them:" in text
    assert "encoder: encoder.onnx takes history (1 × 39, float32) of observation, gives" in text
    taken = (
        "the action: actor.onnx takes obs (1 × 44, float32) of observation[0:39] + encoder.latent"
    )
    assert taken in text


def test_an_output_that_is_read_is_a_memory_that_a_reset_forgets(tmp_path: Path) -> None:
    """The same commands as with `recurrent`, also where the flow enters it once more."""
    again = {"loop": {"do": "hold", "until": {"elapsed": 0.1}}}
    first = {"loop": {"do": {"policy": "slow"}, "until": {"elapsed": 0.2}}}
    flow = {"chain": [first, again, {"policy": "slow"}]}

    def commands() -> str:
        program = Program(**workflow(tmp_path, None, flow=flow))
        options = RunOptions(duration=0.6, speed="max", warn=lambda _: None)
        return Runner(program, options).run().sha256_commands

    write_slow(tmp_path)
    recurrent = commands()
    values = yaml.safe_load((tmp_path / "policy.yaml").read_text())
    del values["recurrent"]
    values |= {"inputs": {"observation": "obs", "memory": "h_in"}}
    values |= {"outputs": {"action": "actions", "memory": "h_out"}}
    (tmp_path / "policy.yaml").write_text(yaml.safe_dump(values), "utf-8")
    assert commands() == recurrent
    values["inputs"] = {"observation": "obs", "other": "h_in"}
    (tmp_path / "policy.yaml").write_text(yaml.safe_dump(values), "utf-8")
    with pytest.raises(UniconError, match="other"):
        commands()
