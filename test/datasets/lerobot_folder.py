"""Compare the chunk of our adapter with that of LeRobot's own class, queue and pipelines.

python lerobot_folder.py FOLDER act|diffusion, with a Python that has lerobot.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature
from lerobot.policies.factory import (
    get_policy_class,
    make_policy_config,
    make_pre_post_processors,
)

from unicon_core.policies import load_policy
from unicon_core.policies.contract import ChildSpec
from unicon_core.policies.networks import open_network
from unicon_core.robots import load_robot

FEATURES = {
    "observation.state": PolicyFeature(FeatureType.STATE, (6,)),
    "observation.environment_state": PolicyFeature(FeatureType.ENV, (3,)),
}
SMALL = {
    "act": {"chunk_size": 12, "n_action_steps": 4, "dim_model": 32, "n_heads": 2},
    "diffusion": {"down_dims": (32, 64), "horizon": 8, "n_action_steps": 6,
                  "num_train_timesteps": 5},
}  # fmt: skip
GIVEN = {
    "period": 0.05,
    "default_joint_pos": [0.0] * 6,
    "stiffness": 50.0,
    "damping": 2.0,
    "observation": {"terms": {"environment_state": {"state": "base_lin_vel"}}},
}


def main() -> None:
    """Write a folder, load it as a policy, and compare."""
    folder, kind = Path(sys.argv[1]), sys.argv[2]
    torch.manual_seed(1)
    config = make_policy_config(
        kind,
        input_features=FEATURES,
        output_features={"action": PolicyFeature(FeatureType.ACTION, (6,))},
        device="cpu",
        push_to_hub=False,
        **SMALL[kind],
    )
    config.normalization_mapping["ENV"] = NormalizationMode.MEAN_STD
    stats = {
        name: {
            "mean": torch.randn(width),
            "std": torch.rand(width) + 0.5,
            "min": torch.full((width,), -2.0),
            "max": torch.full((width,), 3.0),
        }
        for name, width in (("observation.state", 6), ("observation.environment_state", 3),
                            ("action", 6))
    }  # fmt: skip
    policy = get_policy_class(kind)(config).eval()
    before, behind = make_pre_post_processors(config, dataset_stats=stats)
    for each in (policy, before, behind):
        each.save_pretrained(folder)

    contract = load_policy(folder, robot=load_robot("arx_x5"), given=GIVEN)
    network = open_network(replace(contract, child=ChildSpec()))
    frames = config.n_obs_steps
    seen = np.random.default_rng(2).normal(size=(frames, 9)).astype(np.float32)
    (taken,), (given,) = network.inputs, network.outputs
    assert taken.shape == (1, frames * 9), taken
    chunk = np.zeros(given.shape, np.float32)
    call = network.bind({taken.name: seen.reshape(1, -1)}, {given.name: chunk})
    call()
    again = chunk.copy()
    call()
    np.testing.assert_array_equal(chunk, again)

    policy.reset()
    rows = []
    for frame in seen:  # as a robot's loop does, one frame after the other
        parts = {
            "observation.state": torch.from_numpy(frame[:6]),
            "observation.environment_state": torch.from_numpy(frame[6:]),
        }
        policy._queues["action"].clear() if kind == "diffusion" else policy.reset()
        torch.manual_seed(0)
        rows = [behind(policy.select_action(before(dict(parts)))).numpy()]
    while len(rows) < config.n_action_steps and kind == "act":
        rows.append(behind(policy._action_queue.popleft()).numpy())
    while policy.config.type == "diffusion" and policy._queues["action"]:
        rows.append(behind(policy._queues["action"].popleft()).numpy())
    expected = np.concatenate(rows)
    assert len(expected) in (4, 6), expected.shape
    np.testing.assert_allclose(chunk[0, : len(expected)], expected, atol=1e-5)
    print("alike", expected.shape)


if __name__ == "__main__":
    main()
